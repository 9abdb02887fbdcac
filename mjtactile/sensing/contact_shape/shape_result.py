"""Report of a fitted shape: curvatures, radius, direction, pose, outline."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import SHAPES, Array, ContactShape
from mjtactile.sensing.contact_shape.contact_area import areas, nearest_part, shares
from mjtactile.sensing.contact_shape.forward_model import ForwardModel
from mjtactile.sensing.contact_shape.gauss_newton import Fit
from mjtactile.sensing.contact_shape.primitives import InitialGuess, about, place_of, principal
from mjtactile.sensing.contact_shape.quadric_deviation import Deviation
from mjtactile.sensing.contact_shape.shape_filter import touching
from mjtactile.sensing.contact_shape.shape_models import SHARP, ShapeModel, kinds_of
from mjtactile.sensing.settings import ContactShapeSettings

_FINER = 4  # subdivision of the membrane's node spacing for an outline
_UNKNOWN_DIRECTION_SD = math.pi / math.sqrt(12)  # rad
_Rotations = tuple[int | None, int | None, int | None]


def build_shape(
    forward: ForwardModel,
    found: Fit,
    kind: str,
    probabilities: dict[str, float],
    scale: float,
    sizes: tuple[float, tuple[float, float]],
    s: ContactShapeSettings,
    other: Deviation | None = None,
) -> ContactShape:
    """Build the reported contact shape from a fit. `scale` is the factor on the fit's covariance,
    from its misfit, `sizes` are the area and its interval, m^2, `other` is the deviation from the
    model. The radius is that of the fitted ball, if the object is one."""
    cov = reported_covariance(found, scale, s)
    if found.family.parts:
        return _several(forward, found, cov, probabilities, sizes[1], s)
    theta, own_sd = found.theta, math.sqrt(cov[3, 3])
    if other is not None:
        theta, cov = theta + other.theta, cov + other.cov
    force = s.friction * found.state.force_normal
    total = _ContactSummary(sizes[0], force, sizes[1], found.misfit)
    outline = found.once("outline", lambda: _outline(forward, found, found.state.contact_forces))
    shape = _body(found.family, theta, found.hint, cov, kind, probabilities, total, outline, s)
    if other is None or found.family.name != "ball":
        return shape
    return replace(_with_unequal(shape, other), **_radius(found.theta[3], own_sd))


def _with_unequal(shape: ContactShape, other: Deviation) -> ContactShape:
    """Return a ball with the two curvatures of its deviation `other`, and their direction."""
    mean = shape.curvatures[0]
    on_axes, on_diagonals = other.unequal
    bent = np.array([0, 0, 0, mean + on_axes, on_diagonals, mean - on_axes])
    maximum, minimum, direction = principal(bent)
    sd = math.hypot(shape.curvatures_sd[0], other.unequal_sd)
    ratio = other.unequal_sd / max(maximum - mean, 1e-9)
    return replace(
        shape,
        curvatures=(maximum, max(minimum, 0.0)),
        curvatures_sd=(sd, sd),
        direction=direction,
        direction_sd=min(ratio / 2, _UNKNOWN_DIRECTION_SD),
        R_SO=about(2, direction) @ shape.R_SO,
    )


def reported_covariance(found: Fit, scale: float, s: ContactShapeSettings) -> Array:
    """Return the covariance of the parameters including the error of membrane model and simulator.
    That error scales all curvatures or sizes together, and grows as fewer nodes touch."""
    size = s.mesh_ratio * s.size_by_node
    family = found.family
    curved = s.mesh_ratio**2 * s.curvature_by_node
    wrong = (curved * family.curved + size * family.sized) / touching(found) * found.theta
    return found.cov_with(scale) + np.multiply.outer(wrong, wrong)


@dataclass(frozen=True)
class _ContactSummary:
    """Contact quantities other than the shape parameters: `area` and its `interval`, m^2, `force`,
    N, and `misfit`."""

    area: float
    force: float
    interval: tuple[float, float]
    misfit: float


def _body(
    family: ShapeModel,
    theta: Array,
    hint: InitialGuess,
    cov: Array,
    kind: str,
    probabilities: dict[str, float],
    total: _ContactSummary,
    outline: Array,
    s: ContactShapeSettings,
) -> ContactShape:
    measures = _MEASURES[family.name](theta, cov, s)
    R, rotation = _axes(family, theta, measures.get("direction", 0.0))
    return ContactShape(
        kind,
        probabilities,
        area=total.area,
        area_interval=total.interval,
        p_SO=place_of(theta, hint),
        R_SO=R,
        pose_cov=_pose_cov(cov, rotation),
        outline=outline,
        force_normal=total.force,
        family=family.name,
        misfit=total.misfit,
        **measures,
    )


def _several(
    forward: ForwardModel,
    found: Fit,
    cov: Array,
    probabilities: dict[str, float],
    interval: tuple[float, float],
    s: ContactShapeSettings,
) -> ContactShape:
    """Build the result for several contacts, each with the nodes nearest to it. Each part gets its
    fraction of the area interval and of the force."""
    family = found.family
    thetas = family.split(found.theta)
    sizes = areas(forward, found, s)
    carry = shares(forward, found)
    outlines = found.once("outlines", lambda: _outlines(forward, found))
    load = s.friction * found.state.force_normal
    maximum = max(sum(sizes), 1e-12)
    ends = np.cumsum([0, *(len(part.names) for part in family.parts)])
    bodies = []
    for index, part in enumerate(family.parts):
        part_slice = slice(ends[index], ends[index + 1])
        kinds = kinds_of(part, thetas[index], cov[part_slice, part_slice])
        total = _ContactSummary(
            sizes[index],
            carry[index] * load,
            (sizes[index] / maximum * interval[0], sizes[index] / maximum * interval[1]),
            found.misfit,
        )
        body = _body(
            part,
            thetas[index],
            found.hint.parts[index],
            cov[part_slice, part_slice],
            max(kinds, key=lambda name: kinds[name]),
            dict.fromkeys(SHAPES, 0.0) | kinds,
            total,
            outlines[index],
            s,
        )
        bodies.append(body)
    bodies.sort(key=lambda body: -body.force_normal)
    return ContactShape(
        "multiple",
        probabilities,
        area=sum(body.area for body in bodies),
        area_interval=interval,
        p_SO=bodies[0].p_SO,
        R_SO=bodies[0].R_SO,
        pose_cov=bodies[0].pose_cov,
        outline=bodies[0].outline,
        force_normal=load,
        family=family.name,
        misfit=found.misfit,
        parts=tuple(bodies),
    )


def _smooth(theta: Array, cov: Array, s: ContactShapeSettings) -> dict[str, Any]:
    maximum, minimum, direction = principal(theta)
    step = 1e-3
    rows = np.array(
        [
            np.subtract(principal(theta + step * e)[:2], (maximum, minimum)) / step
            for e in np.eye(len(theta))
        ]
    ).T
    sd = np.sqrt(np.maximum(np.diag(rows @ cov @ rows.T), 0))
    bent = maximum - minimum
    direction_sd = min(math.sqrt(cov[4, 4]) / max(bent / 2, 1e-9) / 2, _UNKNOWN_DIRECTION_SD)
    measures: dict[str, Any] = {
        "curvatures": (maximum, minimum),
        "curvatures_sd": sd,
        "direction": direction,
        "direction_sd": direction_sd,
    }
    mean = (maximum + minimum) / 2
    if minimum > 0 and maximum < s.ball_ratio * minimum:
        measures |= _radius(mean, math.hypot(*sd) / 2)
    return measures


def with_curvature_spread(
    shape: ContactShape, fits: list[tuple[float, Fit]], sharp: float = 0.0
) -> ContactShape:
    """Return the shape with the standard deviations of its curvatures over all round models. `fits`
    are their probabilities and fits, the reported one first. `sharp` is the probability of an edge
    or a point. Its curvature has no maximum; half its possible radii are below half of 1 / SHARP.
    """
    if shape.family not in _ROUND or (len(fits) == 1 and sharp < _NEGLIGIBLE):
        return shape
    bent = [(p, _principal(fit)) for p, fit in fits if fit.family.name in _ROUND]
    p = np.array([bending[0] for bending in bent])
    deviation = np.array([bending[1] for bending in bent]) - shape.curvatures
    deviation[0] = 0.0
    variance = p @ deviation**2 / p.sum()
    variance[0] += sharp * SHARP**2
    sd = np.sqrt(np.square(shape.curvatures_sd) + variance)
    grown = float(np.linalg.norm(sd) / max(np.linalg.norm(shape.curvatures_sd), 1e-9))
    return replace(shape, curvatures_sd=sd, radius_sd=grown * shape.radius_sd)


def with_position_spread(shape: ContactShape, others: list[tuple[float, Fit]]) -> ContactShape:
    """Return the shape with the covariance of its position over all models. `others` are the
    probabilities and fits of those that are not reported. A round model has its lowest point there,
    and a flat one the center of its face."""
    if not others or shape.parts:
        return shape
    cov = shape.pose_cov.copy()
    for probability, fit in others:
        if not fit.family.parts:
            off = place_of(fit.theta, fit.hint) - shape.p_SO
            cov[:3, :3] += probability * np.outer(off, off)
    return replace(shape, pose_cov=cov)


def with_tip(shape: ContactShape, probability: float) -> ContactShape:
    """Return the shape with the covariance of its position for a tip with `probability`. The lowest
    point of a sharp tip is farther from the sensor than that of the ball that fits it."""
    if probability < _NEGLIGIBLE:
        return shape
    size = math.sqrt(max(shape.area, 0.0) / math.pi)
    cov = shape.pose_cov.copy()
    cov[[0, 1, 2], [0, 1, 2]] += probability * (size * np.array(_TIP)) ** 2
    return replace(shape, pose_cov=cov)


_NEGLIGIBLE = 1e-6  # probability
_TIP = (0.2, 0.2, 0.4)  # error of a tip's position over the contact radius
_ROUND = ("ball", "cylinder", "smooth")


def _principal(fit: Fit) -> tuple[float, float]:
    """Return the curvatures of a round shape, 1/m, the larger first."""
    if fit.family.name == "smooth":
        return principal(fit.theta)[:2]
    k = float(fit.theta[3])
    return (k, k if fit.family.name == "ball" else 0.0)


def _radius(curvature: float, sd: float) -> dict[str, Any]:
    return {"radius": 1 / max(curvature, 1e-3), "radius_sd": sd / max(curvature, 1e-3) ** 2}


def _ball(theta: Array, cov: Array, s: ContactShapeSettings) -> dict[str, Any]:
    sd = math.sqrt(cov[3, 3])
    bent = {"curvatures": (theta[3], theta[3]), "curvatures_sd": (sd, sd)}
    return bent | _radius(theta[3], sd)


def _cylinder(theta: Array, cov: Array, s: ContactShapeSettings) -> dict[str, Any]:
    sd = math.sqrt(cov[3, 3])
    bent = {"curvatures": (theta[3], 0.0), "curvatures_sd": (sd, 0.0)}
    return bent | _radius(theta[3], sd) | _direction(theta[4], cov[4, 4])


def _direction(angle: float, variance: float) -> dict[str, Any]:
    sd = min(math.sqrt(variance), _UNKNOWN_DIRECTION_SD)
    return {"direction": angle % math.pi, "direction_sd": sd}


def _disc(theta: Array, cov: Array, s: ContactShapeSettings) -> dict[str, Any]:
    flat = {"curvatures": (0.0, 0.0), "curvatures_sd": (0.0, 0.0)}
    return flat | {"radius": 1e-3 * theta[5], "radius_sd": 1e-3 * math.sqrt(cov[5, 5])}


def _face(theta: Array, cov: Array, s: ContactShapeSettings) -> dict[str, Any]:
    flat = {"curvatures": (0.0, 0.0), "curvatures_sd": (0.0, 0.0)}
    return flat | _direction(theta[5], cov[5, 5])


_MEASURES = {"ball": _ball, "cylinder": _cylinder, "smooth": _smooth, "disc": _disc, "block": _face}


def _axes(family: ShapeModel, theta: Array, direction: float) -> tuple[Array, _Rotations]:
    """Return the shape's axes in S, and the indices of the parameters that rotate it about x, y,
    z of S, for an edge and a cylinder about their own axes."""
    indices = (
        family.index("tilt_x"),
        family.index("tilt_y", "lean"),
        family.index("direction", "angle"),
    )
    x, y, z = (None if index is None else float(theta[index]) for index in indices)
    angle = direction if z is None else z
    return about(2, angle) @ about(1, y or 0.0) @ about(0, x or 0.0), indices


def _pose_cov(cov: Array, turns: _Rotations) -> Array:
    """Return the covariance (6, 6) of position, m, and rotations, rad. Rotations that are not
    parameters of the model have NaN on the diagonal (unknown)."""
    indices = [0, 1, 2, *turns]
    units = np.array([1e-3, 1e-3, 1e-3, 1.0, 1.0, 1.0])
    pose = np.zeros((6, 6))
    for i, a in enumerate(indices):
        for j, b in enumerate(indices):
            if a is not None and b is not None:
                pose[i, j] = units[i] * units[j] * cov[a, b]
        if a is None:
            pose[i, i] = np.nan
    return pose


def _outlines(forward: ForwardModel, found: Fit) -> list[Array]:
    """Return the outline of each of several contacts."""
    nearest, force = nearest_part(forward, found), found.state.contact_forces
    return [
        _outline(forward, found, np.where(nearest == index, force, 0.0))
        for index in range(len(found.family.parts))
    ]


def _outline(forward: ForwardModel, found: Fit, force: Array) -> Array:
    """Return the border (P, 2), m, of the contact region, interpolated between the nodes. In that
    region the contact `force` (nx, ny), N, exceeds half of its median."""
    pressed = force > 0
    if not pressed.any():
        return np.zeros((0, 2))
    window = tuple(_window(lines) for lines in np.nonzero(pressed))
    across, along = (_interpolation_matrix(count) for count in force[window].shape)
    fine = across @ force[window] @ along.T
    inside = (fine > 0.5 * float(np.median(force[pressed]))).astype(np.uint8)
    contours, _ = cv2.findContours(inside, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not contours:
        return np.zeros((0, 2))
    b, a = max(contours, key=cv2.contourArea)[:, 0].T
    x, y = (
        nodes[window] + moved[window]
        for nodes, moved in zip(forward.nodes, found.state.displacements, strict=False)
    )
    return np.column_stack([((across[a] @ field) * along[b]).sum(axis=1) for field in (x, y)])


def _window(lines: NDArray[np.intp]) -> slice:
    """Return the range of the `lines` of nodes (n,), with one more on each side."""
    return slice(max(int(lines.min()) - 1, 0), int(lines.max()) + 2)


@cache
def _interpolation_matrix(count: int) -> Array:
    """Return the linear interpolation matrix (m, count) from node values to points between them."""
    positions = np.linspace(0, count - 1, _FINER * (count - 1) + 1)
    return np.maximum(0.0, 1 - np.abs(positions[:, None] - np.arange(count)))
