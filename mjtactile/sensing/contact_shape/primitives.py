"""Shape primitives with few parameters: obstacles for the membrane model, and starts of a fit.

Positions are in mm relative to the estimated contact position, curvatures in 1/m, angles in rad.
Frame S; the shape approaches from +z.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from mjtactile.core.sensor_parts import Frame
from mjtactile.core.types import Array
from mjtactile.kernels import kernel
from mjtactile.quasistatic.obstacles import NUMBERS

EDGE = 1.5e-3  # distance from the frame where long shapes are cut off, m
ROUNDING = 0.5  # rounding of the rims, in node spacings of the membrane
_MODELS = ("smooth", "ball", "cylinder", "disc", "block")  # order of the kernel
_FACES = ("disc", "block")
_RIM = 360  # number of points on an outline


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

    @cached_property
    def _kernel_arguments(self) -> tuple[Any, ...]:
        """Arguments of the kernel that do not depend on the parameters."""
        place = [*self.position, self.height, *self.frame, self.round, self.rounding]
        x, y = self.nodes[0][:, 0].copy(), self.nodes[1][0].copy()
        return np.array(place), len(x), len(y), x, y


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


def obstacle_rows(name: str, thetas: Array, hint: InitialGuess) -> tuple[Array, Array | None]:
    """Build the obstacles of the shape model `name` with parameters `thetas` (m, k).

    A smooth shape is an ellipsoid with the given lowest point and curvatures. It is exact for a
    ball, a lying cylinder and a plane. A cylinder ends at the frame. The rims of a disc and a block
    are rounded.

    Returns:
        The rows (m, NUMBERS) of `quasistatic.obstacles`, and the heights at the nodes (n,), m, of
        a disc or a block, else None.
    """
    place, columns, lines, x, y = hint._kernel_arguments
    count, parameters = thetas.shape
    rows = np.empty((count, NUMBERS))
    heights = np.empty(count * columns * lines) if name in _FACES else None
    kernel("shape_obstacles")(
        _MODELS.index(name), count, parameters, thetas, place, columns, lines, x, y, rows, heights
    )
    return rows, heights


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


def offset_from_center(theta: Array, hint: InitialGuess) -> tuple[Array, Array, Array]:
    """Return the node positions relative to the shape's center (nx, ny), m, and the heights there.
    The heights are those of the tilted face."""
    position = place_of(theta, hint)
    x = hint.nodes[0] - position[0]
    y = hint.nodes[1] - position[1]
    return x, y, position[2] + theta[3] * y - theta[4] * x


def disc_starts(hint: InitialGuess) -> tuple[Array, ...]:
    return tuple(np.array([0, 0, 0, 0, 0, radius]) for radius in (3.2, 5.2))


def block_starts(hint: InitialGuess) -> tuple[Array, ...]:
    return tuple(
        np.array([0, 0, 0, 0, 0, hint.angle + angle, half, half])
        for half in (4.0,)
        for angle in (0.0, math.pi / 4)
    )


def lying_starts(curvatures: tuple[float, ...]) -> Callable[[InitialGuess], tuple[Array, ...]]:
    turns = np.arange(4) * math.pi / 4

    def starts(hint: InitialGuess) -> tuple[Array, ...]:
        return tuple(
            np.array([0, 0, 0, k, hint.angle + angle, 0]) for k in curvatures for angle in turns
        )

    return starts
