"""Random shapes pressed into the quasi-static membrane, to train the start of a fit
(docs/theory/contact_shape.md, Eq. F27)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import SHAPES, Array
from mjtactile.quasistatic import MembraneSolution, Obstacle
from mjtactile.quasistatic.obstacles import unchecked_obstacle
from mjtactile.quasistatic.solution import STATUS, WRENCH
from mjtactile.sensing.contact_shape.contact_area import state_area
from mjtactile.sensing.contact_shape.forward_model import ForwardModel
from mjtactile.sensing.contact_shape.primitives import InitialGuess
from mjtactile.sensing.contact_shape.shape_models import FAMILIES, kinds_of
from mjtactile.sensing.settings import ContactShapeSettings

GROUPS = (*FAMILIES, "multiple", "other")
"""Classes of the presses: the shape models, several contacts, and shapes without a model."""
_FORCES = (0.03, 1.6)  # range of kept presses, N
_DEPTHS = (0.2e-3, 3e-3)  # m
_CURVATURES = (12.0, 500.0)  # 1/m
_SIZES = (1.8, 9.0)  # radius and half sides of faces, mm
_WITHIN = 0.72  # fraction of the frame's half-extents in which centers lie
_STEEP = 1.3  # maximum slope of a height field: the membrane leaves a steeper flank
_BATCH = 64
_SHARES = (0.16, 0.12, 0.16, 0.16, 0.16, 0.10, 0.14)  # of GROUPS


@dataclass(frozen=True, eq=False)
class Presses:
    """Random presses.

    Attributes:
        heights: Marker heights (n, N) relative to rest, m.
        group: Index in GROUPS (n,).
        kind: Index in SHAPES (n,); -1: not defined.
        theta: Parameters of the model (n, 8) relative to `press_guess`; NaN beyond their number.
        center: Pressure center (n, 2), mm.
        area: Contact area (n,), m^2.
        force: Normal force (n,), N.
    """

    heights: Array
    group: NDArray[np.int64]
    kind: NDArray[np.int64]
    theta: Array
    center: Array
    area: Array
    force: Array

    def __len__(self) -> int:
        return len(self.area)

    @classmethod
    def joined(cls, parts: Sequence[Presses]) -> Presses:
        """Return the presses of all parts."""
        columns = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in cls.__dataclass_fields__
        }
        return cls(**columns)


@dataclass(frozen=True, eq=False)
class _Shape:
    """One random shape. It has a `group`, a `kind` (-1: not defined), and parameters `theta`.
    `build` makes its obstacles for a height, mm."""

    group: int
    kind: int
    theta: Array
    build: Callable[[float], tuple[Obstacle, ...]]


def press_guess(
    forward: ForwardModel, frame: Array, rounding: float, is_round: bool
) -> InitialGuess:
    """Return the guess that the parameters of presses are relative to: the center of the frame."""
    return InitialGuess(
        np.zeros(2), 0.0, 1e-5, 0.0, frame, forward.nodes, rounding, 0.1, round=is_round
    )


def random_presses(
    forward: ForwardModel,
    hint: InitialGuess,
    count: int,
    rng: np.random.Generator,
    s: ContactShapeSettings,
) -> Presses:
    """Press `count` random shapes into the membrane. Forces out of range are left out."""
    found = []
    for first in range(0, count, _BATCH):
        shapes = [_random_shape(hint, rng) for _ in range(min(_BATCH, count - first))]
        found.append(_pressed(forward, hint, shapes, rng, s))
    return Presses.joined(found)


def _pressed(
    forward: ForwardModel,
    hint: InitialGuess,
    shapes: list[_Shape],
    rng: np.random.Generator,
    s: ContactShapeSettings,
) -> Presses:
    depths = [_log_uniform(rng, _DEPTHS) for _ in shapes]
    lowered = [
        1e3 * (_contact_height(forward, shape) - depth)
        for shape, depth in zip(shapes, depths, strict=True)
    ]
    bodies = [shape.build(z) for shape, z in zip(shapes, lowered, strict=True)]
    batches = [
        [n for n, body in enumerate(bodies) if len(body) == parts]
        for parts in sorted({len(body) for body in bodies})
    ]
    rows = []
    for chosen in batches:
        batch = forward.membrane.solve_batch([bodies[n] for n in chosen], again=False)
        force = -batch.found[:, WRENCH][:, 2]
        kept = (batch.found[:, STATUS] == 0) & (force > _FORCES[0]) & (force < _FORCES[1])
        heights = forward.heights(batch.x) - forward.rest_heights
        for index in np.flatnonzero(kept):
            shape = shapes[chosen[index]]
            theta = np.full(8, np.nan)
            theta[: len(shape.theta)] = shape.theta
            theta[2] = lowered[chosen[index]]
            state = batch[int(index)]
            area = _area(forward, hint, shape, theta, state, s)
            center = _pressure_center(forward, state)
            rows.append(
                (heights[index], shape.group, shape.kind, theta, center, area, force[index])
            )
    heights, group, kind, theta, center, area, force = zip(*rows, strict=True)
    return Presses(
        np.array(heights),
        np.array(group),
        np.array(kind),
        np.array(theta),
        np.array(center),
        np.array(area),
        np.array(force),
    )


def _contact_height(forward: ForwardModel, shape: _Shape) -> float:
    """Return the height parameter of a shape that just touches the membrane at rest, m."""
    rest = forward.membrane.rest.x
    x, y = forward.nodes
    positions = np.column_stack([(x + rest[0]).ravel(), (y + rest[1]).ravel()])
    heights = forward.membrane.obstacle_heights(shape.build(0.0), positions)
    return float((rest[2].ravel() - heights)[np.isfinite(heights)].max())


def _pressure_center(forward: ForwardModel, state: MembraneSolution) -> Array:
    """Return the pressure center (2,) of a membrane solution, mm."""
    force = state.contact_forces
    fraction = force / force.sum()
    positions = (nodes + moved for nodes, moved in zip(forward.nodes, state.x[:2], strict=True))
    return 1e3 * np.array([float((fraction * position).sum()) for position in positions])


def _area(
    forward: ForwardModel,
    hint: InitialGuess,
    shape: _Shape,
    theta: Array,
    state: MembraneSolution,
    s: ContactShapeSettings,
) -> float:
    name = GROUPS[shape.group]
    family = FAMILIES.get(name, FAMILIES["smooth"])
    return state_area(forward, state, family, theta[: len(family.names)], hint, s)


# -- shapes


def _random_shape(hint: InitialGuess, rng: np.random.Generator) -> _Shape:
    group = int(rng.choice(len(GROUPS), p=np.array(_SHARES) / sum(_SHARES)))
    name = GROUPS[group]
    at = _center(hint, rng)
    if name == "multiple":
        return _two_balls(hint, at, group, rng)
    if name == "other":
        return _height_field(hint, at, group, rng)
    family = FAMILIES[name]
    theta = np.concatenate([1e3 * at, [0.0], _NUMBERS[name](rng)])

    def build(z: float) -> tuple[Obstacle, ...]:
        lowered = theta.copy()
        lowered[2] = z
        return family.build(lowered, hint)

    kinds = kinds_of(family, theta, np.eye(len(theta)))
    kind = max(kinds, key=lambda each: kinds[each])
    return _Shape(group, SHAPES.index(kind), theta, build)


def _center(hint: InitialGuess, rng: np.random.Generator) -> Array:
    while True:
        offset = rng.uniform(-1, 1, 2)
        if not hint.round or float(offset @ offset) < 1:
            return _WITHIN * offset * hint.frame


def _log_uniform(rng: np.random.Generator, ends: tuple[float, float]) -> float:
    return math.exp(rng.uniform(math.log(ends[0]), math.log(ends[1])))


def _ball_numbers(rng: np.random.Generator) -> list[float]:
    return [_log_uniform(rng, _CURVATURES)]


def _cylinder_numbers(rng: np.random.Generator) -> list[float]:
    return [_log_uniform(rng, _CURVATURES), rng.uniform(0, math.pi), 0.05 * rng.standard_normal()]


def _smooth_numbers(rng: np.random.Generator) -> list[float]:
    a, b = _log_uniform(rng, _CURVATURES), _log_uniform(rng, (3.0, _CURVATURES[1]))
    t = rng.uniform(0, math.pi)
    c, s = math.cos(t), math.sin(t)
    return [a * c * c + b * s * s, (a - b) * c * s, a * s * s + b * c * c]


def _disc_numbers(rng: np.random.Generator) -> list[float]:
    return [*_tilts(rng), _log_uniform(rng, _SIZES)]


def _block_numbers(rng: np.random.Generator) -> list[float]:
    halves = [_log_uniform(rng, _SIZES), _log_uniform(rng, _SIZES)]
    return [*_tilts(rng), rng.uniform(-math.pi / 2, math.pi / 2), *halves]


def _tilts(rng: np.random.Generator) -> list[float]:
    """Return tilts about x and y: half of the faces are nearly parallel to the frame."""
    sd = 0.04 if rng.random() < 0.5 else 0.13
    return list(sd * rng.standard_normal(2))


_NUMBERS: dict[str, Callable[[np.random.Generator], list[float]]] = {
    "ball": _ball_numbers,
    "cylinder": _cylinder_numbers,
    "smooth": _smooth_numbers,
    "disc": _disc_numbers,
    "block": _block_numbers,
}


def _two_balls(hint: InitialGuess, at: Array, group: int, rng: np.random.Generator) -> _Shape:
    radii = 1 / np.array([_log_uniform(rng, (60.0, 400.0)) for _ in range(2)])
    t = rng.uniform(0, math.pi)
    half = rng.uniform(4e-3, 9e-3) * np.array([math.cos(t), 0.8 * math.sin(t)])
    above = rng.uniform(-3e-4, 3e-4)

    def build(z: float) -> tuple[Obstacle, ...]:
        return tuple(
            unchecked_obstacle(
                "sphere",
                (radius,),
                (*(at / 3 + sign * half), 1e-3 * z + radius + max(sign * above, 0.0)),
            )
            for sign, radius in zip((-1, 1), radii, strict=True)
        )

    return _Shape(group, SHAPES.index("multiple"), np.array([*1e3 * at, 0.0]), build)


def _height_field(hint: InitialGuess, at: Array, group: int, rng: np.random.Generator) -> _Shape:
    """Return a height field without a shape model."""
    t = rng.uniform(0, math.pi)
    x, y = hint.nodes[0] - at[0], hint.nodes[1] - at[1]
    u, v = math.cos(t) * x + math.sin(t) * y, math.cos(t) * y - math.sin(t) * x
    name = ("wedge", "tip", "superquadric", "ring", "rim")[int(rng.integers(5))]
    kind = {"wedge": "edge", "tip": "point", "rim": "flat"}.get(name)
    if name == "wedge":
        slope = rng.uniform(0.25, _STEEP)
        u_over = np.abs(u) - _log_uniform(rng, (4e-3, 40e-3))
        w = _log_uniform(rng, (0.1e-3, 2e-3))
        field = slope * (np.hypot(v, w) - w) + _STEEP * np.clip(u_over, 0, None)
    elif name == "tip":
        sides = int(rng.integers(3, 7))
        turns = 2 * math.pi * np.arange(sides) / sides + t
        slope = rng.uniform(0.4, _STEEP)
        distance = np.max([math.cos(a) * x + math.sin(a) * y for a in turns], axis=0)
        w = _log_uniform(rng, (0.1e-3, 1.5e-3))
        field = slope * (np.hypot(distance, w) - w)
    elif name == "superquadric":
        power = rng.uniform(2.2, 4.0)
        a, b = 1e-3 * np.exp(rng.uniform(math.log(4.0), math.log(14.0), 2))
        tall = 1e-3 * rng.uniform(3.0, 14.0)
        q = np.abs(u / a) ** power + np.abs(v / b) ** power
        field = tall * (1 - np.clip(1 - q, 0, None) ** (1 / power))
        field += _STEEP * min(a, b) * np.clip(q - 0.9, 0, None)
    elif name == "ring":
        distance = np.abs(np.hypot(x, y) - rng.uniform(4e-3, 9e-3))
        w = rng.uniform(1.2e-3, 4e-3)
        field = w - np.sqrt(np.clip(w * w - distance * distance, 0.16 * w * w, None))
        field += _STEEP * np.clip(distance - 0.9 * w, 0, None)
    else:
        rim = _log_uniform(rng, (0.3e-3, 2.5e-3))
        distance = np.hypot(x, y) - 1e-3 * _log_uniform(rng, _SIZES)
        distance += rim
        field = rim - np.sqrt(np.clip(rim**2 - np.clip(distance, 0, rim) ** 2, 0.0, None))
        field += _STEEP * np.clip(distance - 0.8 * rim, 0, None)
        tilts = _tilts(rng)
        field = field + tilts[0] * y - tilts[1] * x

    def build(z: float) -> tuple[Obstacle, ...]:
        # a height field counts from its lowest node
        return (unchecked_obstacle("heights", (), (0.0, 0.0, 0.0), heights=field + 1e-3 * z),)

    index = -1 if kind is None else SHAPES.index(kind)
    return _Shape(group, index, np.array([*1e3 * at, 0.0]), build)
