"""Parametric shape models, each with a prior of its parameters.

The parameters of a model are fitted as listed in `names`. Positions are in mm relative to the
estimated contact position, curvatures in 1/m, angles in rad. The frame is S; the shape approaches
from +z.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.normal_distribution import normal_cdf
from mjtactile.core.types import Array
from mjtactile.quasistatic import Obstacle
from mjtactile.quasistatic.obstacles import NUMBERS, POOL_START, unchecked_obstacles
from mjtactile.sensing.contact_shape.primitives import (
    InitialGuess,
    block_starts,
    disc_starts,
    lying_starts,
    obstacle_rows,
    offset_from_center,
    principal,
    smooth_starts,
)

SHARP = 240.0
"""Curvature above which a contact is an edge or a tip, 1/m. Radii from 4 mm down to a sharp edge
are indistinguishable. The membrane leaves them before the flat sides start."""
LINE = 0.25
"""Ratio of the smaller to the larger curvature below which the contact is a line."""


@dataclass(frozen=True, eq=False)
class ShapeModel:
    """Parametric shape model. One model may be a special case of another.

    Attributes:
        names: Parameter names; the first three are the position: x, y relative to the initial
            guess, z relative to its height, mm.
        mean: Prior mean.
        sd: Prior standard deviation; also the scale of a step.
        steps: Steps of finite differences: above the solver tolerance. For parameters that rotate
            or shift an edge, a large part of the node spacing.
        loose: Standard deviation of the change between two evaluations of a contact episode.
        share: Relative standard deviation of the membrane model error per evaluation, for
            parameters that stay constant; zero for all others.
        low: Lower bounds.
        high: Upper bounds.
        starts: Function from the initial guess to start parameters.
        parts: Model of each part of a shape with several contacts; else empty.
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
    starts: Callable[[InitialGuess], tuple[Array, ...]]
    parts: tuple[ShapeModel, ...] = ()

    def __reduce__(self):  # its functions do not pickle
        if self.parts:
            return several, (tuple(part.name for part in self.parts),)
        return _named, (self.name,)

    def rows(self, thetas: Array, hint: InitialGuess) -> tuple[Array, Array | None]:
        """Build the obstacles of `thetas` (m, k): rows (m, parts, NUMBERS) and their pool. See
        `obstacle_rows`."""
        if not self.parts:
            rows, heights = obstacle_rows(self.name, thetas, hint)
            return rows[:, None], heights
        each = np.split(thetas, self._part_ends, axis=1)
        made = np.empty((len(thetas), len(self.parts), NUMBERS))
        pools: list[Array] = []
        used = 0
        for index, (part, parameters, own) in enumerate(
            zip(self.parts, each, hint.parts, strict=True)
        ):
            made[:, index], heights = obstacle_rows(part.name, parameters, own)
            if heights is not None:
                made[:, index, POOL_START] += used
                used += heights.size
                pools.append(heights)
        return made, np.concatenate(pools) if pools else None

    def build(self, theta: Array, hint: InitialGuess) -> tuple[Obstacle, ...]:
        """Build the obstacles of one shape."""
        rows, pool = self.rows(theta[None], hint)
        return unchecked_obstacles(rows[0], pool)

    @cached_property
    def heights(self) -> list[int]:
        """Indices of the height parameters."""
        return [index for index, name in enumerate(self.names) if name == "z"]

    @cached_property
    def kept(self) -> Array:
        """Mask (k,) of the parameters that stay constant: curvatures and sizes."""
        return self.share > 0

    @cached_property
    def blocks(self) -> dict[str, tuple[Array, ...]]:
        """Indices of the blocks of a matrix (k, k): rows and columns of the constant ("k") or the
        other ("f") parameters."""
        lines = {"k": self.kept, "f": ~self.kept}
        return {a + b: np.ix_(lines[a], lines[b]) for a in lines for b in lines}

    @cached_property
    def curved(self) -> NDArray[np.bool_]:
        """Mask (k,) of the curvatures."""
        return np.array([name.startswith("k") for name in self.names])

    @cached_property
    def sized(self) -> NDArray[np.bool_]:
        """Mask (k,) of the radii and half sides."""
        return self.kept & ~self.curved

    def index(self, *names: str) -> int | None:
        """Return the index of the first parameter with one of these names; None: there is none."""
        return next((k for k, name in enumerate(self.names) if name in names), None)

    def split(self, parameters: Array) -> list[Array]:
        """Split `parameters` (k, ...) into those of each part."""
        return np.split(parameters, self._part_ends)

    @cached_property
    def _part_ends(self) -> Array:
        return np.cumsum([len(part.names) for part in self.parts])[:-1]

    def rebased(self, theta: Array, old: InitialGuess, new: InitialGuess) -> Array:
        """Return parameters relative to the guess `new` instead of the guess `old`."""
        if self.parts:
            given = zip(self.parts, self.split(theta), old.parts, new.parts, strict=True)
            return np.concatenate([part.rebased(values, a, b) for part, values, a, b in given])
        moved = theta.copy()
        moved[:2] += 1e3 * (old.position - new.position)
        moved[2] += 1e3 * (old.height - new.height)
        return moved


def kinds_of(family: ShapeModel, theta: Array, cov: Array) -> dict[str, float]:
    """Return the probabilities of the reported kinds for parameters `theta` with covariance
    `cov`."""
    if family.parts:
        return {"multiple": 1.0}
    if family.name in ("disc", "block"):
        return {"flat": 1.0}
    if family.name == "smooth":
        maximum, minimum, _ = principal(theta)
        variance = max(cov[3, 3], cov[5, 5])
    else:
        maximum = float(theta[3])
        variance = cov[3, 3]
        minimum = maximum if family.name == "ball" else 0.0
    sharp = normal_cdf((maximum - SHARP) / math.sqrt(max(variance, 1.0)))
    return {"smooth": 1 - sharp, "edge" if minimum < LINE * maximum else "point": sharp}


def face_of(
    family: ShapeModel, theta: Array, hint: InitialGuess, moved: Array
) -> tuple[Array, float]:
    """Return signed distances (nx, ny), m, from a flat face's rim, and its area, m^2. The distance
    is negative inside the rim. `moved` (2, nx, ny) are the node displacements, m."""
    x, y, _ = offset_from_center(theta, hint)
    x = x + moved[0]
    y = y + moved[1]
    if family.name == "disc":
        radius = 1e-3 * theta[5]
        return np.hypot(x, y) - radius, math.pi * radius**2
    c = math.cos(theta[5])
    s = math.sin(theta[5])
    halves = 1e-3 * theta[6:8]
    distance = np.maximum(np.abs(c * x + s * y) - halves[0], np.abs(c * y - s * x) - halves[1])
    return distance, 4 * float(np.prod(halves))


# Steps of finite differences, in the parameters' units.
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
# Changes between two evaluations of a contact episode, mm and rad: the shape is pushed deeper, and
# moves and rotates with its holder. Parameters not named here stay, except for a fraction of their
# standard deviation.
_LOOSE = {
    "x": 1.0, "y": 1.0, "z": 1.0, "tilt_x": 0.03, "tilt_y": 0.03, "lean": 0.03,
    "direction": 0.05, "angle": 0.05,
}  # fmt: skip
_STIFF = 0.01
# Relative error of a curvature or size from the membrane model that differs between evaluations.
# Measured on the objects of bench shape, seeds 2000 to 2059: with the right model, 0.02 to 0.06
# perform alike.
_SHARE = {"k": 0.03, "radius": 0.05, "half": 0.05}


def several(names: Sequence[str]) -> ShapeModel:
    """Return a shape model of several simultaneous contacts, one named model for each."""
    parts = tuple(FAMILIES[name] for name in names)

    def starts(hint: InitialGuess) -> tuple[Array, ...]:
        own = [part.starts(of) for part, of in zip(parts, hint.parts, strict=True)]
        many = max(len(part_names) for part_names in own)
        return tuple(
            np.concatenate([part_names[k % len(part_names)] for part_names in own])
            for k in range(many)
        )

    parameters = tuple(name for part in parts for name in part.names)
    mean, sd, steps, loose, fraction, low, high = (
        np.concatenate([getattr(part, name) for part in parts]) for name in _COLUMNS
    )
    family = ShapeModel(
        "+".join(names), parameters, mean, sd, steps, loose, fraction, low, high, starts, parts
    )
    return family


_COLUMNS = ("mean", "sd", "steps", "loose", "share", "low", "high")


def _named(name: str) -> ShapeModel:
    return FAMILIES[name]


def _family(
    name: str,
    parameters: tuple[tuple[str, float, float, float, float], ...],
    starts: Callable[[InitialGuess], tuple[Array, ...]],
) -> ShapeModel:
    columns = list(zip(*parameters, strict=True))
    names = columns[0]
    mean, sd, low, high = (np.array(column, float) for column in columns[1:])
    steps = np.array([_STEPS[parameter.split("_")[0]] for parameter in names])
    loose = np.array(
        [
            _LOOSE.get(parameter, _STIFF * spread)
            for parameter, spread in zip(names, sd, strict=True)
        ]
    )
    fraction = np.array([_SHARE.get(parameter.split("_")[0], 0.0) for parameter in names])
    return ShapeModel(name, names, mean, sd, steps, loose, fraction, low, high, starts)


_AT = (("x", 0, 3, -8, 8), ("y", 0, 3, -8, 8), ("z", 0, 1, -4, 3))  # mm
FAMILIES: dict[str, ShapeModel] = {
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
            smooth_starts,
        ),
        _family(
            "ball",
            (*_AT, ("k", 100, 150, 0.2, 800)),
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
            lying_starts((120.0,)),
        ),
        _family(
            "disc",
            (
                *_AT,
                ("tilt_x", 0, 0.07, -0.5, 0.5),
                ("tilt_y", 0, 0.07, -0.5, 0.5),
                ("radius", 5, 2, 1.5, 14),
            ),
            disc_starts,
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
            block_starts,
        ),
    )
}
