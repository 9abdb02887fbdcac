"""Shape primitives with few parameters: obstacles for the membrane model, and starts of a fit.

Positions are in mm relative to the estimated contact position, curvatures in 1/m, angles in rad.
Frame S; the shape approaches from +z.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mjtactile.core.sensor_parts import Frame
from mjtactile.core.types import Array
from mjtactile.quasistatic import Obstacle
from mjtactile.quasistatic.obstacles import unchecked_obstacle

EDGE = 1.5e-3  # distance from the frame where long shapes are cut off, m
ROUNDING = 0.5  # rounding of the rims, in node spacings of the membrane
_FLAT = 0.2  # curvature that is flat at the size of a sensor, 1/m
_RIM_SLOPE = 2.0  # slope of the flank beyond a rim
_RIM = 360  # number of points on an outline
_RIM_OUT = 1.4  # outward offset of the rounded rim from the nominal rim, in rounding radii


@dataclass(frozen=True, eq=False)
class InitialGuess:
    """Start of a fit.

    `position` (2,) is the contact position, m, frame S, and `height` the height of the membrane's
    outer face there, m. `area`, m^2, and `angle`, rad, are those of the patch from the nodal
    estimate. `frame` (2,) holds the half-extents of the allowed region, m, an ellipse if `round`.
    `nodes` are the positions x, y (nx, ny) of the membrane nodes, m. `rounding` is the radius of
    sharp edges, m. `force` is the estimated normal force, N. For several contact patches, `parts`
    holds one guess for each, the strongest first.
    """

    position: Array
    height: float
    area: float
    angle: float
    frame: Array
    nodes: tuple[Array, Array]
    rounding: float
    force: float
    parts: tuple[InitialGuess, ...] = ()
    round: bool = False


def feasible_half_extents(frame: Frame, edge: float) -> Array:
    """Return the half-extents (2,) of the region that long shapes may fill, m. For a rectangle they
    are `edge` m inside the frame. For another outline they are the half-axes of the largest ellipse
    in it."""
    half = np.array([frame.length, frame.width]) / 2 - edge
    if frame.outline is None:
        return half
    farthest = np.linalg.norm(frame.outline.points(_RIM) / frame.outline.half_sizes, axis=1)
    return farthest.min() * half


def about(axis: int, angle: float) -> Array:
    """Return the rotation (3, 3) by `angle`, rad, about an axis."""
    c = math.cos(angle)
    s = math.sin(angle)
    R = np.eye(3)
    i = (axis + 1) % 3
    j = (axis + 2) % 3
    R[i, i] = R[j, j] = c
    R[i, j] = -s
    R[j, i] = s
    return R


def place_of(theta: Array, hint: InitialGuess) -> Array:
    """Return the reference point of the shape from its first three parameters (3,), m, frame S."""
    x, y, z = (1e-3 * theta[:3]).tolist()
    return np.array([hint.position[0] + x, hint.position[1] + y, hint.height + z])


def principal(theta: Array) -> tuple[float, float, float]:
    """Return both curvatures, 1/m, the larger first, and the direction of the smaller, rad from
    x."""
    kxx, kxy, kyy = theta[3:6]
    mean = (kxx + kyy) / 2
    half = math.hypot((kxx - kyy) / 2, kxy)
    direction = 0.5 * math.atan2(2 * kxy, kxx - kyy) + math.pi / 2
    return mean + half, mean - half, direction % math.pi


def _raised_position(theta: Array, hint: InitialGuess, up: float) -> tuple[float, float, float]:
    """Return the position `up` m above that of the first three parameters."""
    x, y, z = place_of(theta, hint).tolist()
    return x, y, z + up


def smooth(theta: Array, hint: InitialGuess) -> tuple[Obstacle, ...]:
    """Create an ellipsoid with this lowest point and curvatures. It is exact for a ball, a lying
    cylinder and a plane."""
    maximum, minimum, direction = principal(theta)
    tall = 1 / max(maximum, _FLAT)
    sizes = (math.sqrt(tall / max(minimum, _FLAT)), math.sqrt(tall / max(maximum, _FLAT)), tall)
    return (
        unchecked_obstacle(
            "ellipsoid", sizes, _raised_position(theta, hint, tall), about(2, direction)
        ),
    )


def smooth_starts(hint: InitialGuess) -> tuple[Array, ...]:
    c = math.cos(hint.angle)
    s = math.sin(hint.angle)
    # components of the curvature along the patch's longer axis
    along = np.array([c * c, c * s, s * s])
    across = np.array([s * s, -c * s, c * c])
    return tuple(
        np.array([0, 0, 0, *(a * along + b * across)])
        for a, b in ((60.0, 60.0), (20.0, 150.0), (150.0, 20.0))
    )


def ball(theta: Array, hint: InitialGuess) -> tuple[Obstacle, ...]:
    radius = 1 / max(float(theta[3]), _FLAT)
    return (unchecked_obstacle("sphere", (radius,), _raised_position(theta, hint, radius)),)


def cylinder(theta: Array, hint: InitialGuess) -> tuple[Obstacle, ...]:
    """Create a lying cylinder that ends at the frame."""
    radius = 1 / max(theta[3], _FLAT)
    R = about(2, theta[4]) @ about(1, theta[5])
    position = place_of(theta, hint)
    to_edges = _directions_in_ellipse if hint.round else _distance_to_edge
    back, forth = to_edges(hint.frame, position, R[:, 0])
    center = position + R[:, 0] * (forth - back) / 2 + R[:, 2] * radius
    turned = np.column_stack([R[:, 1], R[:, 2], R[:, 0]])
    return (unchecked_obstacle("cylinder", (radius, (back + forth) / 2), center.tolist(), turned),)


def _soft(distance: Array, rounding: float) -> Array:
    """Return the rise of a rim's flank over its face, m: zero far inside, steep outside, rounded
    between. The membrane solution on a sharp rim changes in steps with the node positions. With a
    rounding of half a spacing it does not, and the fit converges from any start."""
    rise = np.sqrt(distance * distance + rounding**2)
    rise += distance
    rise *= _RIM_SLOPE / 2
    return rise


def offset_from_center(theta: Array, hint: InitialGuess) -> tuple[Array, Array, Array]:
    """Return the node positions relative to the shape's center (nx, ny), m, and the heights there.
    The heights are those of the tilted face."""
    position = place_of(theta, hint)
    x = hint.nodes[0] - position[0]
    y = hint.nodes[1] - position[1]
    return x, y, position[2] + theta[3] * y - theta[4] * x


def _node_offsets(thetas: Array, hint: InitialGuess) -> tuple[Array, Array, Array]:
    """Return node offsets for shapes `thetas` (m, k), as `offset_from_center`. They are x (m, nx,
    1), y (m, 1, ny), heights (m, nx, ny)."""
    position = 1e-3 * thetas[:, :3, None, None]
    x = (hint.nodes[0][:, :1] - hint.position[0]) - position[:, 0]
    y = (hint.nodes[1][:1] - hint.position[1]) - position[:, 1]
    tilt_x, tilt_y = thetas[:, 3, None, None], thetas[:, 4, None, None]
    return x, y, (hint.height + position[:, 2] + tilt_x * y) - tilt_y * x


def _faces(heights: Array) -> list[tuple[Obstacle, ...]]:
    return [
        (unchecked_obstacle("heights", (), (0.0, 0.0, 0.0), heights=height),) for height in heights
    ]


def discs(thetas: Array, hint: InitialGuess) -> list[tuple[Obstacle, ...]]:
    """Build the discs with parameters `thetas` (m, 6)."""
    x, y, heights = _node_offsets(thetas, hint)
    distance = np.sqrt(x**2 + y**2)
    distance -= 1e-3 * thetas[:, 5, None, None] + _RIM_OUT * hint.rounding
    heights += _soft(distance, hint.rounding)
    return _faces(heights)


def disc(theta: Array, hint: InitialGuess) -> tuple[Obstacle, ...]:
    return discs(theta[None], hint)[0]


def blocks(thetas: Array, hint: InitialGuess) -> list[tuple[Obstacle, ...]]:
    """Build the blocks with parameters `thetas` (m, 8)."""
    x, y, heights = _node_offsets(thetas, hint)
    c = np.cos(thetas[:, 5])[:, None, None]
    s = np.sin(thetas[:, 5])[:, None, None]
    for along, half in ((c * x + s * y, 6), (c * y - s * x, 7)):
        distance = np.abs(along)
        distance -= 1e-3 * thetas[:, half, None, None] + _RIM_OUT * hint.rounding
        heights += _soft(distance, hint.rounding)
    return _faces(heights)


def block(theta: Array, hint: InitialGuess) -> tuple[Obstacle, ...]:
    return blocks(theta[None], hint)[0]


def disc_starts(hint: InitialGuess) -> tuple[Array, ...]:
    return tuple(np.array([0, 0, 0, 0, 0, radius]) for radius in (3.2, 5.2))


def block_starts(hint: InitialGuess) -> tuple[Array, ...]:
    return tuple(
        np.array([0, 0, 0, 0, 0, hint.angle + angle, half, half])
        for half in (4.0,)
        for angle in (0.0, math.pi / 4)
    )


def _distance_to_edge(frame: Array, position: Array, along: Array) -> tuple[float, float]:
    """Return the backward and forward distances, m, along a line through `position` to a rectangle
    with half-extents `frame` (2,)."""
    back = forth = math.inf
    for axis, side in enumerate(frame.tolist()):  # floats: arrays of two take ten times as long
        step = float(along[axis])
        if abs(step) < 1e-9:
            continue
        ahead = math.copysign(float(position[axis]), position[axis] * step)
        back = min(back, (side + ahead) / abs(step))
        forth = min(forth, (side - ahead) / abs(step))
    return max(back, 1e-3), max(forth, 1e-3)


def _directions_in_ellipse(half: Array, position: Array, along: Array) -> tuple[float, float]:
    """Return the backward and forward distances, m, along a line through `position` to an ellipse
    with half-axes `half` (2,)."""
    at = position[:2] / half
    step = along[:2] / half
    a = float(step @ step)
    b = float(at @ step)
    root = math.sqrt(max(b**2 + a * (1 - float(at @ at)), 0.0))
    return max((root + b) / a, 1e-3), max((root - b) / a, 1e-3)


def lying_starts(curvatures: tuple[float, ...]) -> Callable[[InitialGuess], tuple[Array, ...]]:
    turns = np.arange(4) * math.pi / 4

    def starts(hint: InitialGuess) -> tuple[Array, ...]:
        return tuple(
            np.array([0, 0, 0, k, hint.angle + angle, 0]) for k in curvatures for angle in turns
        )

    return starts
