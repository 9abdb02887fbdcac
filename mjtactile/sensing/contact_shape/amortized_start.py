"""Initial values of a contact-shape fit from a network (docs/theory/contact_shape.md, Eq. F27).

The network estimates class, parameters and area of a shape from the marker heights of one image.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import SHAPES, Array
from mjtactile.sensing.contact_shape.network import Network, train
from mjtactile.sensing.contact_shape.press_view import PressView
from mjtactile.sensing.contact_shape.random_presses import GROUPS, Presses
from mjtactile.sensing.contact_shape.shape_models import FAMILIES

_WIDTHS = (96, 64)
_CURVATURE_OFFSET = 20.0  # offset of a curvature before its logarithm, 1/m
_SQUARE = 0.12  # logarithmic ratio of half sides below which a face is square
_ASIDE = 6.0  # maximum distance of the lowest point from the pressure center, mm
_LOG_SD = (-3.0, 1.0)  # range of the logarithmic sd of the logarithmic area

# outputs
_GROUP = slice(0, len(GROUPS))
_KIND = slice(_GROUP.stop, _GROUP.stop + len(SHAPES))
_AREA = slice(_KIND.stop, _KIND.stop + 2)  # logarithm, mm^2, and its logarithmic sd
_FORCE = slice(_AREA.stop, _AREA.stop + 1)
_CENTER = slice(_FORCE.stop, _FORCE.stop + 2)  # pressure center, mm
_POINT = slice(_CENTER.stop, _CENTER.stop + 3)  # height there, mm, and slope
_CURVES = slice(_POINT.stop, _POINT.stop + 3)
_DISC = slice(_CURVES.stop, _CURVES.stop + 3)  # position next to the pressure center, size
_BLOCK = slice(_DISC.stop, _DISC.stop + 7)
_OUTPUTS = _BLOCK.stop
_PARAMETERS = {
    "smooth": _CURVES,
    "ball": _CURVES,
    "cylinder": _CURVES,
    "disc": _DISC,
    "block": _BLOCK,
}


@dataclass(frozen=True, eq=False)
class Proposal:
    """Estimate of one image.

    `probabilities` (len(GROUPS),) belong to the shape models, `kinds` (len(SHAPES),) to the
    reported kinds of shape. `area` is the median of the area, m^2, and `log_sd` the standard
    deviation of its logarithm. `force`, N, is the normal force. `outputs` are the scaled outputs of
    the network.
    """

    probabilities: Array
    kinds: Array
    area: float
    log_sd: float
    force: float
    outputs: Array

    def theta(self, name: str) -> Array:
        """Return the parameters of the shape model `name`, relative to `press_guess`."""
        y = self.outputs
        return _DECODED[name](y[_CENTER], y[_POINT], y[_PARAMETERS[name]])


@dataclass(frozen=True, eq=False)
class AmortizedStart:
    """Network of one sensor at one rest state. `inputs` (2, k) holds mean and standard deviation of
    the inputs. `scale` (2, m) holds those of the outputs."""

    view: PressView
    network: Network
    inputs: Array
    scale: Array

    def propose(self, heights: Array, ids: NDArray[np.int64]) -> Proposal:
        """Estimate the shape from `heights` (n,), m, above rest of the markers `ids`."""
        x, center = self.view(self.view.completed(heights, ids)[None])
        y = np.asarray(self.network((x[0] - self.inputs[0]) / self.inputs[1]), dtype=float)
        y = self.scale[0] + self.scale[1] * y
        y[_CENTER] += center[0]
        area, log_sd = y[_AREA]
        return Proposal(
            _softmax(y[_GROUP]),
            _softmax(y[_KIND]),
            1e-6 * math.exp(area),
            math.exp(min(max(log_sd, _LOG_SD[0]), _LOG_SD[1])),
            math.exp(y[_FORCE][0]),
            y,
        )


def _softmax(y: Array) -> Array:
    fraction = np.exp(y - y.max())
    return fraction / fraction.sum()


# -- training


def trained(
    presses: Presses, view: PressView, sd: float, rounds: int, rng: np.random.Generator
) -> Iterator[AmortizedStart]:
    """Fit the network to presses. Marker noise has `sd`, m. Yield it after each round."""
    views = []
    for _ in range(_SAMPLES):
        noise = sd * rng.standard_normal(presses.heights.shape)
        views.append(view(presses.heights + noise))
    targets, weights = _targets(presses)
    targets[:, _CENTER] -= views[0][1]
    count = np.maximum(weights.sum(axis=0), 1)
    mean = (weights * targets).sum(axis=0) / count
    spread = np.sqrt((weights * (targets - mean) ** 2).sum(axis=0) / count)
    classes = slice(0, _KIND.stop)
    mean[classes], spread[classes] = 0.0, 1.0
    mean[_AREA.stop - 1], spread[_AREA.stop - 1] = -1.5, 1.0
    spread = np.maximum(spread, 1e-6)
    moments = np.array([views[0][0].mean(axis=0), views[0][0].std(axis=0) + 1e-6], np.float32)
    samples = [((x - moments[0]) / moments[1]).astype(np.float32) for x, _ in views]
    shifts = [((center - views[0][1]) / spread[_CENTER]).astype(np.float32) for _, center in views]
    number = [0]
    scaled = ((targets - mean) / spread).astype(np.float32)
    weights = weights.astype(np.float32)
    area = _AREA.start
    targets32, spread_area = targets.astype(np.float32), float(spread[area])

    def inputs(source: np.random.Generator) -> Array:
        number[0] = int(source.integers(_SAMPLES))
        return samples[number[0]]

    def slope(y: Array, at: Array) -> Array:
        w = weights[at]
        goal = scaled[at].copy()
        goal[:, _CENTER] -= shifts[number[0]][at]
        back = _HUBER * np.tanh((y - goal) / _HUBER) * w
        for part in (_GROUP, _KIND):
            fraction = np.exp(y[:, part] - y[:, part].max(axis=1, keepdims=True))
            fraction /= fraction.sum(axis=1, keepdims=True)
            back[:, part] = (fraction - targets32[at][:, part]) * w[:, part]
        # Gaussian log likelihood of the logarithmic area
        log_sd = np.clip(mean[area + 1] + y[:, area + 1], *_LOG_SD)
        residual = spread_area * (y[:, area] - goal[:, area])
        precision = np.exp(-2 * log_sd)
        back[:, area + 1] = np.clip(1 - residual**2 * precision, -5, 1) * _AREA_WEIGHT
        return (back / len(at)).astype(np.float32)

    first = Network.initial((moments.shape[1], *_WIDTHS, _OUTPUTS), rng)
    scale = np.array([mean, spread])
    for network in train(first, inputs, slope, rounds, rng):
        yield AmortizedStart(view, network, moments, scale)


_HUBER = 3.0  # error, in standard deviations of an output, from which it counts less
_AREA_WEIGHT = 0.1
_SAMPLES = 3  # samples of the marker noise


def _targets(presses: Presses) -> tuple[Array, Array]:
    """Return outputs and their weights (n, m)."""
    y = np.zeros((len(presses), _OUTPUTS))
    w = np.zeros_like(y)
    y[np.arange(len(y)), presses.group] = 1
    w[:, _GROUP] = 1
    known = presses.kind >= 0
    y[known, _KIND.start + presses.kind[known]] = 1
    w[known, _KIND] = 1
    y[:, _AREA.start] = np.log(1e6 * np.maximum(presses.area, 2e-7))
    w[:, _AREA.start] = 1
    y[:, _FORCE.start] = np.log(presses.force)
    w[:, _FORCE] = 1
    y[:, _CENTER] = presses.center
    w[:, _CENTER] = 1
    for name, part in _PARAMETERS.items():
        count = len(FAMILIES[name].names)
        for n in np.flatnonzero(presses.group == GROUPS.index(name)):
            point, parameters = _ENCODED[name](presses.center[n], presses.theta[n, :count])
            y[n, _POINT], y[n, part] = point, parameters
            w[n, _POINT] = w[n, part] = 1
    return y, w


# -- continuous parameters: their values have no jump where axes or angles are exchanged


def _matrix_log(a: float, b: float, angle: float) -> list[float]:
    """Return the entries of the symmetric matrix with values `a` along `angle`, `b` across."""
    c, s = math.cos(angle), math.sin(angle)
    return [a * c * c + b * s * s, (a - b) * c * s, a * s * s + b * c * c]


def _eigenvalues(m: Array) -> tuple[float, float, float]:
    """Return the larger and the smaller eigenvalue, and the direction of the larger."""
    mean, radius = (m[0] + m[2]) / 2, math.hypot((m[0] - m[2]) / 2, m[1])
    return mean + radius, mean - radius, 0.5 * math.atan2(2 * m[1], m[0] - m[2])


def _log_curvature(k: float) -> float:
    return math.log(max(k, 0.0) + _CURVATURE_OFFSET)


def _from_log_curvature(value: float) -> float:
    return math.exp(min(value, 7.0)) - _CURVATURE_OFFSET


def _on_curves(center: Array, theta: Array, K: Array) -> list[float]:
    """Return height, mm, and slope (2,) of a paraboloid at `center` (2,), mm. Its lowest point is
    `theta[:3]`, mm. Its curvatures are `K` (2, 2), 1/m."""
    offset = center - theta[:2]
    slope = 1e-3 * K @ offset
    return [theta[2] + float(slope @ offset) / 2, *slope]


def _below_curves(center: Array, point: Array, K: Array) -> Array:
    """Return the lowest point (3,), mm, of a paraboloid from `_on_curves`. It is at most `_ASIDE`
    away."""
    values, axes = np.linalg.eigh(1e-3 * K)
    offset = np.clip(axes.T @ point[1:3] / np.maximum(values, 1e-9), -_ASIDE, _ASIDE)
    height = point[0] - float(values @ offset**2) / 2
    return np.array([*center - axes @ offset, height])


def _matrix(entries: Array | list[float]) -> Array:
    return np.array([[entries[0], entries[1]], [entries[1], entries[2]]])


def _encode_smooth(center: Array, theta: Array) -> tuple[list[float], list[float]]:
    maximum, minimum, angle = _eigenvalues(theta[3:6])
    bent = _matrix_log(_log_curvature(maximum), _log_curvature(minimum), angle)
    return _on_curves(center, theta, _matrix(theta[3:6])), bent


def _decode_smooth(center: Array, point: Array, y: Array) -> Array:
    maximum, minimum, angle = _eigenvalues(y)
    bent = _matrix_log(
        max(_from_log_curvature(maximum), 0.2), max(_from_log_curvature(minimum), 0.2), angle
    )
    return np.array([*_below_curves(center, point, _matrix(bent)), *bent])


def _encode_ball(center: Array, theta: Array) -> tuple[list[float], list[float]]:
    k = float(theta[3])
    return _on_curves(center, theta, k * np.eye(2)), [_log_curvature(k), 0.0, _log_curvature(k)]


def _decode_ball(center: Array, point: Array, y: Array) -> Array:
    maximum, minimum, _ = _eigenvalues(y)
    k = max(_from_log_curvature((maximum + minimum) / 2), 0.2)
    return np.array([*_below_curves(center, point, k * np.eye(2)), k])


def _encode_cylinder(center: Array, theta: Array) -> tuple[list[float], list[float]]:
    # the larger curvature is across the axis
    angle = theta[4] + math.pi / 2
    axis = np.array([math.cos(theta[4]), math.sin(theta[4])])
    descent = -math.tan(theta[5])
    along = float((center - theta[:2]) @ axis)
    position = np.array([*theta[:2] + along * axis, theta[2] + along * descent])
    K = theta[3] * (np.eye(2) - np.outer(axis, axis))
    height, *slope = _on_curves(center, position, K)
    point = [height, *(np.array(slope) + descent * axis)]
    return point, _matrix_log(_log_curvature(theta[3]), _log_curvature(0.0), angle)


def _decode_cylinder(center: Array, point: Array, y: Array) -> Array:
    maximum, _, angle = _eigenvalues(y)
    k = max(_from_log_curvature(maximum), 0.2)
    axis = np.array([-math.sin(angle), math.cos(angle)])
    descent = float(point[1:3] @ axis)
    across = np.array([point[0], *(point[1:3] - descent * axis)])
    K = k * (np.eye(2) - np.outer(axis, axis))
    direction = math.atan2(axis[1], axis[0])
    return np.array([*_below_curves(center, across, K), k, direction, -math.atan(descent)])


def _on_face(center: Array, theta: Array) -> list[float]:
    offset = center - theta[:2]
    slope = np.array([-theta[4], theta[3]])
    return [theta[2] + float(slope @ offset), *slope]


def _below_face(center: Array, point: Array, offset: Array) -> list[float]:
    """Return position, mm, and tilts of a face, centered `offset` from the pressure center."""
    position = center + offset
    return [*position, point[0] + float(point[1:3] @ offset), point[2], -point[1]]


def _encode_disc(center: Array, theta: Array) -> tuple[list[float], list[float]]:
    return _on_face(center, theta), [*(theta[:2] - center), math.log(theta[5])]


def _decode_disc(center: Array, point: Array, y: Array) -> Array:
    return np.array([*_below_face(center, point, y[:2]), math.exp(y[2])])


def _encode_block(center: Array, theta: Array) -> tuple[list[float], list[float]]:
    a, b = math.log(theta[6]), math.log(theta[7])
    four = [math.cos(4 * theta[5]), math.sin(4 * theta[5])]
    parameters = [*(theta[:2] - center), *_matrix_log(a, b, theta[5]), *four]
    return _on_face(center, theta), parameters


def _decode_block(center: Array, point: Array, y: Array) -> Array:
    a, b, angle = _eigenvalues(y[2:5])
    if a - b < _SQUARE:
        angle = math.atan2(y[6], y[5]) / 4
    return np.array([*_below_face(center, point, y[:2]), angle, math.exp(a), math.exp(b)])


_Encode = Callable[[Array, Array], tuple[list[float], list[float]]]
_ENCODED: dict[str, _Encode] = {
    "smooth": _encode_smooth,
    "ball": _encode_ball,
    "cylinder": _encode_cylinder,
    "disc": _encode_disc,
    "block": _encode_block,
}
_DECODED: dict[str, Callable[[Array, Array, Array], Array]] = {
    "smooth": _decode_smooth,
    "ball": _decode_ball,
    "cylinder": _decode_cylinder,
    "disc": _decode_disc,
    "block": _decode_block,
}
