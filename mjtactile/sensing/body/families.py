"""Families of bodies: few numbers each, with what is believed of them before an image is seen.

A family's numbers are fitted as they stand in `names`: places in mm from where the touch was felt,
curvatures in 1/m, angles in rad. Frame S; a body comes from +z.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from mjtactile.core.types import Array
from mjtactile.film import Obstacle, obstacle

SHARP = 240.0
"""1/m: what is more curved where it touches is an edge, or a tip. From radii of 4 mm on down to a
sharp edge they look alike: the sheet leaves them before the faces begin."""
LINE = 0.25
"""Of the larger curvature, below which the smaller one is that of a line of contact."""
_FLAT = 0.2  # 1/m: what is less curved is as good as flat over a sensor
_RIM_SLOPE = 2.0  # of the flank beyond a rim
_RIM_OUT = 1.4  # roundings by which a round rim's own lies outside of what it stands for


@dataclass(frozen=True, eq=False)
class Hint:
    """Where a fit starts: `place` (2,) m in S of the touch, `height` m of the sheet's outer face
    there, `area` m^2 and `angle` rad of the patch as the nodal estimate has it, and half sides
    `frame` (2,) m of where a body may be; places x, y (nx, ny) m of the film's `nodes`, and the
    `rounding` m of what is sharp; the normal `force` N that it was felt with, and, where it is
    touched at several places, the hint of each of the `parts`, the strongest first."""

    place: Array
    height: float
    area: float
    angle: float
    frame: Array
    nodes: tuple[Array, Array]
    rounding: float
    force: float
    parts: tuple[Hint, ...] = ()

    def on(self, nodes: tuple[Array, Array], rounding: float) -> Hint:
        """The same over another film's nodes."""
        parts = tuple(part.on(nodes, rounding) for part in self.parts)
        return replace(self, nodes=nodes, rounding=rounding, parts=parts)


@dataclass(frozen=True, eq=False)
class Family:
    """A family of bodies, of which one may be a simpler case of another.

    Attributes:
        names: Of its numbers; the first three are its place: x, y in mm from the hint's, z in mm
            from the hint's height.
        mean: What is believed of them.
        sd: How surely; also the scale of a step.
        steps: Over which derivatives are taken: above the film's own tolerance, and for what turns
            or shifts an edge over a good part of the way between nodes.
        loose: By how much they may change from one look at a press to the next, as sd.
        share: The same as a share of what they are.
        low: Lower bounds.
        high: Upper bounds.
        build: From numbers and hint to what the film rests on.
        starts: From a hint to numbers to start from.
        parts: Of several bodies at once, the family of each; else none.
    """

    name: str
    names: tuple[str, ...]
    mean: Array
    sd: Array
    steps: Array
    loose: Array
    share: Array
    low: Array
    high: Array
    build: Callable[[Array, Hint], tuple[Obstacle, ...]]
    starts: Callable[[Hint], tuple[Array, ...]]
    parts: tuple[Family, ...] = ()

    def __reduce__(self):  # its functions do not pickle
        if self.parts:
            return several, (tuple(part.name for part in self.parts),)
        return _named, (self.name,)

    @property
    def heights(self) -> list[int]:
        """Which numbers are heights."""
        return [number for number, name in enumerate(self.names) if name == "z"]

    def split(self, numbers: Array) -> list[Array]:
        """`numbers` (k, ...) of each of the parts."""
        return np.split(numbers, np.cumsum([len(part.names) for part in self.parts])[:-1])

    def rebased(self, theta: Array, old: Hint, new: Hint) -> Array:
        """Numbers that counted from `old`, from `new`."""
        if self.parts:
            given = zip(self.parts, self.split(theta), old.parts, new.parts, strict=True)
            return np.concatenate([part.rebased(own, a, b) for part, own, a, b in given])
        moved = theta.copy()
        moved[:2] += 1e3 * (old.place - new.place)
        moved[2] += 1e3 * (old.height - new.height)
        return moved


def about(axis: int, angle: float) -> Array:
    """Rotation (3, 3) by `angle` rad about an axis."""
    c = math.cos(angle)
    s = math.sin(angle)
    R = np.eye(3)
    i = (axis + 1) % 3
    j = (axis + 2) % 3
    R[i, i] = R[j, j] = c
    R[i, j] = -s
    R[j, i] = s
    return R


def place_of(theta: Array, hint: Hint) -> Array:
    """The body's point that its first three numbers tell, (3,) m in S."""
    return np.array([*(hint.place + 1e-3 * theta[:2]), hint.height + 1e-3 * theta[2]])


def principal(theta: Array) -> tuple[float, float, float]:
    """Curvatures (1/m), the larger first, and the direction (rad from x) of the smaller."""
    kxx, kxy, kyy = theta[3:6]
    middle = (kxx + kyy) / 2
    half = math.hypot((kxx - kyy) / 2, kxy)
    direction = 0.5 * math.atan2(2 * kxy, kxx - kyy) + math.pi / 2
    return middle + half, middle - half, direction % math.pi


def kinds_of(family: Family, theta: Array, cov: Array) -> dict[str, float]:
    """What a user calls a body with numbers `theta` and covariance `cov`, with probabilities."""
    if family.parts:
        return {"several": 1.0}
    if family.name in ("disc", "block"):
        return {"face": 1.0}
    if family.name == "smooth":
        most, least, _ = principal(theta)
        variance = max(cov[3, 3], cov[5, 5])
    else:
        most = float(theta[3])
        variance = cov[3, 3]
        least = most if family.name == "ball" else 0.0
    sharp = float(ndtr((most - SHARP) / math.sqrt(max(variance, 1.0))))
    return {"smooth": 1 - sharp, "edge" if least < LINE * most else "tip": sharp}


def _smooth(theta: Array, hint: Hint) -> tuple[Obstacle, ...]:
    """An ellipsoid whose lowest point and curvatures are given: a ball, a lying cylinder, a plane
    are exact."""
    most, least, direction = principal(theta)
    tall = 1 / max(most, _FLAT)
    sizes = (math.sqrt(tall / max(least, _FLAT)), math.sqrt(tall / max(most, _FLAT)), tall)
    place = place_of(theta, hint) + (0, 0, tall)
    return (obstacle("ellipsoid", sizes, place, about(2, direction)),)


def _smooth_starts(hint: Hint) -> tuple[Array, ...]:
    c = math.cos(hint.angle)
    s = math.sin(hint.angle)
    along = np.array([c * c, c * s, s * s])  # of the curvature along the patch's longer axis
    across = np.array([s * s, -c * s, c * c])
    return tuple(
        np.array([0, 0, 0, *(a * along + b * across)])
        for a, b in ((60.0, 60.0), (20.0, 150.0), (150.0, 20.0))
    )


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


def _soft(off: Array, rounding: float) -> Array:
    """What a rim's flank rises over a face, m: nothing far inside, steeply outside, round between.

    A sharp rim's film depends on where its nodes are, in steps; one that is as round as half a
    spacing does not, and is found from any start.
    """
    return _RIM_SLOPE / 2 * (off + np.sqrt(off**2 + rounding**2))


def _off_middle(theta: Array, hint: Hint) -> tuple[Array, Array, Array]:
    """Nodes' places from the body's middle, (nx, ny) m, and the tilted face's heights there."""
    place = place_of(theta, hint)
    x = hint.nodes[0] - place[0]
    y = hint.nodes[1] - place[1]
    return x, y, place[2] + theta[3] * y - theta[4] * x


def face_of(family: Family, theta: Array, hint: Hint, moved: Array) -> tuple[Array, float]:
    """Of a body with a flat face: how far, (nx, ny) m, each node that has `moved` (2, nx, ny) m is
    beyond the face's rim, negative within; and the face's area, m^2."""
    x, y, _ = _off_middle(theta, hint)
    x = x + moved[0]
    y = y + moved[1]
    if family.name == "disc":
        radius = 1e-3 * theta[5]
        return np.hypot(x, y) - radius, math.pi * radius**2
    c = math.cos(theta[5])
    s = math.sin(theta[5])
    halves = 1e-3 * theta[6:8]
    off = np.maximum(np.abs(c * x + s * y) - halves[0], np.abs(c * y - s * x) - halves[1])
    return off, 4 * float(np.prod(halves))


def _disc(theta: Array, hint: Hint) -> tuple[Obstacle, ...]:
    x, y, face = _off_middle(theta, hint)
    off = np.hypot(x, y) - 1e-3 * theta[5] - _RIM_OUT * hint.rounding
    return (obstacle("heights", data=face + _soft(off, hint.rounding)),)


def _disc_starts(hint: Hint) -> tuple[Array, ...]:
    return tuple(np.array([0, 0, 0, 0, 0, radius]) for radius in (3.2, 5.2))


def _face(theta: Array, hint: Hint) -> tuple[Obstacle, ...]:
    x, y, face = _off_middle(theta, hint)
    c = math.cos(theta[5])
    s = math.sin(theta[5])
    flanks = np.zeros_like(x)
    for along, half in ((c * x + s * y, theta[6]), (c * y - s * x, theta[7])):
        off = np.abs(along) - 1e-3 * half - _RIM_OUT * hint.rounding
        flanks += _soft(off, hint.rounding)
    return (obstacle("heights", data=face + flanks),)


def _face_starts(hint: Hint) -> tuple[Array, ...]:
    return tuple(
        np.array([0, 0, 0, 0, 0, hint.angle + turn, half, half])
        for half in (4.0,)
        for turn in (0.0, math.pi / 4)
    )


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


def _lying_starts(curvatures: tuple[float, ...]) -> Callable[[Hint], tuple[Array, ...]]:
    turns = np.arange(4) * math.pi / 4

    def starts(hint: Hint) -> tuple[Array, ...]:
        return tuple(
            np.array([0, 0, 0, k, hint.angle + turn, 0]) for k in curvatures for turn in turns
        )

    return starts


# Of derivatives, in the numbers' own units.
_STEPS = {
    "x": 0.1,
    "y": 0.1,
    "z": 0.03,
    "k": 3.0,
    "tilt": 0.006,
    "lean": 0.006,
    "direction": 0.03,
    "angle": 0.03,
    "half": 0.05,
    "radius": 0.1,
    "opening": 0.02,
    "roll": 0.01,
}
# mm and rad from one look at a press to the next: the body is pressed on, and goes and turns with
# what holds it; what is not named stays, but for a share of its sd.
_LOOSE = {
    "x": 1.0, "y": 1.0, "z": 1.0, "tilt_x": 0.03, "tilt_y": 0.03, "lean": 0.03,
    "direction": 0.05, "angle": 0.05,
}  # fmt: skip
_STIFF = 0.01
# of a curvature or a size: what the film has wrong in another way at another force
_SHARE = {"k": 0.06, "radius": 0.05, "half": 0.05}


def several(names: Sequence[str]) -> Family:
    """Bodies that touch at the same time, each of a family of its own; their hint has as many
    parts."""
    parts = tuple(FAMILIES[name] for name in names)

    def build(theta: Array, hint: Hint) -> tuple[Obstacle, ...]:
        given = zip(parts, family.split(theta), hint.parts, strict=True)
        return tuple(body for part, numbers, own in given for body in part.build(numbers, own))

    def starts(hint: Hint) -> tuple[Array, ...]:
        own = [part.starts(of) for part, of in zip(parts, hint.parts, strict=True)]
        many = max(len(one) for one in own)
        return tuple(np.concatenate([one[k % len(one)] for one in own]) for k in range(many))

    numbers = tuple(name for part in parts for name in part.names)
    mean, sd, steps, loose, share, low, high = (
        np.concatenate([getattr(part, name) for part in parts]) for name in _COLUMNS
    )
    family = Family(
        "+".join(names), numbers, mean, sd, steps, loose, share, low, high, build, starts, parts
    )
    return family


_COLUMNS = ("mean", "sd", "steps", "loose", "share", "low", "high")


def _named(name: str) -> Family:
    return FAMILIES[name]


def _family(
    name: str,
    numbers: tuple[tuple[str, float, float, float, float], ...],
    build: Callable[[Array, Hint], tuple[Obstacle, ...]],
    starts: Callable[[Hint], tuple[Array, ...]],
) -> Family:
    columns = list(zip(*numbers, strict=True))
    names = columns[0]
    mean, sd, low, high = (np.array(column, float) for column in columns[1:])
    steps = np.array([_STEPS[number.split("_")[0]] for number in names])
    loose = np.array(
        [_LOOSE.get(number, _STIFF * spread) for number, spread in zip(names, sd, strict=True)]
    )
    share = np.array([_SHARE.get(number.split("_")[0], 0.0) for number in names])
    return Family(name, names, mean, sd, steps, loose, share, low, high, build, starts)


_AT = (("x", 0, 3, -8, 8), ("y", 0, 3, -8, 8), ("z", 0, 1, -4, 3))  # mm
FAMILIES: dict[str, Family] = {
    family.name: family
    for family in (
        _family(
            "smooth",
            (
                *_AT,
                ("k_xx", 100, 150, -1, 800),
                ("k_xy", 0, 100, -400, 400),
                ("k_yy", 100, 150, -1, 800),
            ),
            _smooth,
            _smooth_starts,
        ),
        _family(
            "ball",
            (*_AT, ("k", 100, 150, 0.2, 800)),
            _ball,
            lambda hint: tuple(np.array([0, 0, 0, k]) for k in (200.0, 80.0, 25.0)),
        ),
        _family(
            "cylinder",
            (
                *_AT,
                ("k", 100, 150, 0.2, 800),
                ("direction", 0, 1.0, -9, 9),
                ("lean", 0, 0.1, -0.3, 0.3),
            ),
            _cylinder,
            _lying_starts((120.0,)),
        ),
        _family(
            "disc",
            (
                *_AT,
                ("tilt_x", 0, 0.07, -0.5, 0.5),
                ("tilt_y", 0, 0.07, -0.5, 0.5),
                ("radius", 5, 2, 1.5, 14),
            ),
            _disc,
            _disc_starts,
        ),
        _family(
            "block",
            (
                *_AT,
                ("tilt_x", 0, 0.07, -0.5, 0.5),
                ("tilt_y", 0, 0.07, -0.5, 0.5),
                ("angle", 0, 1.0, -9, 9),
                ("half_x", 4.5, 2, 1.5, 14),
                ("half_y", 4.5, 2, 1.5, 14),
            ),
            _face,
            _face_starts,
        ),
    )
}
