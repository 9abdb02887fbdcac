"""Families of bodies: few numbers each, with what is believed of them before an image is seen.

A family's numbers are fitted as they stand in `names`: places in mm from where the touch was felt,
curvatures in 1/m, angles in rad. Frame S; a body comes from +z.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mjtactile.core.types import Array
from mjtactile.film import Obstacle, obstacle

_FLAT = 0.2  # 1/m: what is less curved is as good as flat over a sensor
_LONG = 0.04  # m, half of what goes on beyond the sheet
_TALL = 0.02  # m


@dataclass(frozen=True)
class Hint:
    """Where a fit starts: `place` (2,) m in S of the touch, `height` m of the sheet's outer face
    there, `area` m^2 and `angle` rad of the patch as the nodal estimate has it, and half sides
    `frame` (2,) m of where a body may be."""

    place: Array
    height: float
    area: float
    angle: float
    frame: Array


@dataclass(frozen=True)
class Family:
    """A kind of body; several may be one `kind` to the user, of which one is the simpler case.

    Attributes:
        names: Of its numbers; the first three are its place: x, y in mm from the hint's, z in mm
            from the hint's height.
        mean: What is believed of them.
        sd: How surely; also the scale of a step.
        low, high: Bounds.
        build: From numbers and hint to what the film rests on.
        starts: From a hint to numbers to start from.
    """

    kind: str
    name: str
    names: tuple[str, ...]
    mean: Array
    sd: Array
    low: Array
    high: Array
    build: Callable[[Array, Hint], tuple[Obstacle, ...]]
    starts: Callable[[Hint], tuple[Array, ...]]


def about(axis: int, angle: float) -> Array:
    """Rotation (3, 3) by `angle` rad about an axis."""
    c, s = math.cos(angle), math.sin(angle)
    R = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R[i, i] = R[j, j] = c
    R[i, j], R[j, i] = -s, s
    return R


def place_of(theta: Array, hint: Hint) -> Array:
    """The body's point that its first three numbers tell, (3,) m in S."""
    return np.array([*(hint.place + 1e-3 * theta[:2]), hint.height + 1e-3 * theta[2]])


def principal(theta: Array) -> tuple[float, float, float]:
    """Curvatures (1/m), the larger first, and the direction (rad from x) of the smaller."""
    kxx, kxy, kyy = theta[3:6]
    middle, half = (kxx + kyy) / 2, math.hypot((kxx - kyy) / 2, kxy)
    direction = 0.5 * math.atan2(2 * kxy, kxx - kyy) + math.pi / 2
    return middle + half, middle - half, direction % math.pi


def _smooth(theta: Array, hint: Hint) -> tuple[Obstacle, ...]:
    """An ellipsoid whose lowest point and curvatures are given: a ball, a lying cylinder, a plane
    are exact."""
    most, least, direction = principal(theta)
    tall = 1 / max(most, _FLAT)
    sizes = (math.sqrt(tall / max(least, _FLAT)), math.sqrt(tall / max(most, _FLAT)), tall)
    place = place_of(theta, hint) + (0, 0, tall)
    return (obstacle("ellipsoid", sizes, place, about(2, direction)),)


def _smooth_starts(hint: Hint) -> tuple[Array, ...]:
    return tuple(np.array([0, 0, 0, k, 0, k]) for k in (120.0, 40.0))


def _ball(theta: Array, hint: Hint) -> tuple[Obstacle, ...]:
    radius = 1 / max(theta[3], _FLAT)
    return (obstacle("sphere", (radius,), place_of(theta, hint) + (0, 0, radius)),)


def _cylinder(theta: Array, hint: Hint) -> tuple[Obstacle, ...]:
    """Lying, as long as the sensor is; its ends are before the frame."""
    radius = 1 / max(theta[3], _FLAT)
    R = about(2, theta[4]) @ about(1, theta[5])
    place = place_of(theta, hint)
    back, forth = _ways_to(hint.frame, place, R[:, 0])
    middle = place + R[:, 0] * (forth - back) / 2 + R[:, 2] * radius
    turned = np.column_stack([R[:, 1], R[:, 2], R[:, 0]])
    return (obstacle("cylinder", (radius, (back + forth) / 2), middle, turned),)


def _disc(theta: Array, hint: Hint) -> tuple[Obstacle, ...]:
    R = about(0, theta[3]) @ about(1, theta[4])
    radius = 1e-3 * theta[5]
    return (obstacle("cylinder", (radius, _TALL), place_of(theta, hint) + R[:, 2] * _TALL, R),)


def _disc_starts(hint: Hint) -> tuple[Array, ...]:
    radius = 1e3 * math.sqrt(max(hint.area, 1e-5) / math.pi)
    return (np.array([0, 0, 0, 0, 0, min(max(radius, 2.0), 8.0)]),)


def _face(theta: Array, hint: Hint) -> tuple[Obstacle, ...]:
    R = about(2, theta[5]) @ about(0, theta[3]) @ about(1, theta[4])
    sizes = (1e-3 * theta[6], 1e-3 * theta[7], _TALL)
    return (obstacle("box", sizes, place_of(theta, hint) + R[:, 2] * _TALL, R),)


def _face_starts(hint: Hint) -> tuple[Array, ...]:
    half = min(max(0.5e3 * math.sqrt(max(hint.area, 1e-5)), 2.0), 8.0)
    return tuple(
        np.array([0, 0, 0, 0, 0, hint.angle + turn, half, half]) for turn in (0.0, math.pi / 4)
    )


def _edge(theta: Array, hint: Hint) -> tuple[Obstacle, ...]:
    """Two faces that meet in a line, which ends before the frame."""
    direction, lean, half, roll = theta[3:7]
    R = about(2, direction) @ about(1, lean) @ about(0, roll)
    place = place_of(theta, hint)
    along = R[:, 0]
    faces = [np.array([0, sign * math.cos(half), -math.sin(half)]) @ R.T for sign in (-1.0, 1.0)]
    level = np.array([*along[:2], 0.0]) / math.hypot(*along[:2])
    rows = [(*normal, normal @ place) for normal in faces]
    for sign, reach in zip((-1.0, 1.0), _ways_to(hint.frame, place, level), strict=True):
        rows.append((*(sign * level), sign * (level @ place) + reach))
    return (_convex(np.array(rows)),)


def _ways_to(frame: Array, place: Array, along: Array) -> tuple[float, float]:
    """How far, m, a line through `place` goes back and forth before a rectangle of half sides
    `frame` (2,)."""
    ways = []
    for sign in (-1.0, 1.0):
        far = [
            (side - at if sign * way > 0 else side + at) / abs(way)
            for side, at, way in zip(frame, place, along, strict=False)
            if abs(way) > 1e-9
        ]
        ways.append(max(min(far), 1e-3))
    return ways[0], ways[1]


def _convex(rows: Array) -> Obstacle:
    """What lies within all half-spaces n x <= d of `rows` (k, 4), in S."""
    numbers = obstacle("wedge", (1.0, 1.0, 1.0)).numbers.copy()
    numbers[17] = len(rows)
    return Obstacle("mesh", numbers, rows.ravel())


def _edge_starts(hint: Hint) -> tuple[Array, ...]:
    return tuple(
        np.array([0, 0, -0.1, hint.angle + turn, 0, 0.85, 0]) for turn in (0.0, math.pi / 2)
    )


def _tip(theta: Array, hint: Hint) -> tuple[Obstacle, ...]:
    R = about(0, theta[3]) @ about(1, theta[4])
    return (obstacle("cone", (_TALL * math.tan(theta[5]), _TALL), place_of(theta, hint), R),)


def _tip_starts(hint: Hint) -> tuple[Array, ...]:
    return (np.array([0, 0, -0.3, 0, 0, 0.9]),)


def _family(
    kind: str,
    name: str,
    numbers: tuple[tuple[str, float, float, float, float], ...],
    build: Callable[[Array, Hint], tuple[Obstacle, ...]],
    starts: Callable[[Hint], tuple[Array, ...]],
) -> Family:
    columns = list(zip(*numbers, strict=True))
    mean, sd, low, high = (np.array(column, float) for column in columns[1:])
    return Family(kind, name, columns[0], mean, sd, low, high, build, starts)


_AT = (("x", 0, 3, -8, 8), ("y", 0, 3, -8, 8), ("z", 0, 1, -4, 3))  # mm
FAMILIES: dict[str, Family] = {
    family.name: family
    for family in (
        _family(
            "smooth",
            "smooth",
            (
                *_AT,
                ("k_xx", 80, 100, -1, 600),
                ("k_xy", 0, 70, -300, 300),
                ("k_yy", 80, 100, -1, 600),
            ),
            _smooth,
            _smooth_starts,
        ),
        _family(
            "smooth",
            "ball",
            (*_AT, ("k", 80, 100, 0.2, 600)),
            _ball,
            lambda hint: tuple(np.array([0, 0, 0, k]) for k in (120.0, 40.0)),
        ),
        _family(
            "smooth",
            "cylinder",
            (
                *_AT,
                ("k", 80, 100, 0.2, 600),
                ("direction", 0, 1.0, -9, 9),
                ("lean", 0, 0.1, -0.3, 0.3),
            ),
            _cylinder,
            lambda hint: tuple(
                np.array([0, 0, 0, 100, hint.angle + turn, 0]) for turn in (0.0, math.pi / 2)
            ),
        ),
        _family(
            "disc",
            "disc",
            (
                *_AT,
                ("tilt_x", 0, 0.1, -0.5, 0.5),
                ("tilt_y", 0, 0.1, -0.5, 0.5),
                ("radius", 5, 3, 0.7, 14),
            ),
            _disc,
            _disc_starts,
        ),
        _family(
            "face",
            "face",
            (
                *_AT,
                ("tilt_x", 0, 0.1, -0.5, 0.5),
                ("tilt_y", 0, 0.1, -0.5, 0.5),
                ("angle", 0, 1.0, -9, 9),
                ("half_x", 5, 3, 0.7, 14),
                ("half_y", 5, 3, 0.7, 14),
            ),
            _face,
            _face_starts,
        ),
        _family(
            "edge",
            "edge",
            (
                *_AT,
                ("direction", 0, 1.0, -9, 9),
                ("lean", 0, 0.1, -0.5, 0.5),
                ("half_opening", 0.85, 0.3, 0.3, 1.45),
                ("roll", 0, 0.2, -0.7, 0.7),
            ),
            _edge,
            _edge_starts,
        ),
        _family(
            "tip",
            "tip",
            (
                *_AT,
                ("tilt_x", 0, 0.2, -0.7, 0.7),
                ("tilt_y", 0, 0.2, -0.7, 0.7),
                ("half_angle", 0.9, 0.2, 0.3, 1.3),
            ),
            _tip,
            _tip_starts,
        ),
    )
}
