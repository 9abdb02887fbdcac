"""How a film at rest answers small changes of what presses it (docs/equations.md, X6)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.film import bodies
from mjtactile.film.bodies import Obstacle
from mjtactile.film.state import AREA, PRESSURE, VOLUME, WRENCH

Shape = Callable[[Array], Obstacle | Sequence[Obstacle]]
_STEP = 1e-6  # of a number, or of one: differences of bodies alone, which are closed forms


@dataclass(frozen=True, eq=False)
class FilmDerivatives:
    """Derivatives of a film's state by n numbers of its bodies: what is in SI units, over the
    number's own unit.

    Exact where a small change lets touch what touches; across a change of that set, which comes at
    every few hundredths of a millimetre, they are the slope on this side of it. Of what is thinner
    than the spacing they are rough: it is looked for in elevenths of that, and moved under nodes;
    a blade's force by its height is 13 % off, by its place it is no derivative.

    Attributes:
        displacements: (n, 3, nx, ny) of the nodes.
        contact_forces: (n, nx, ny) of the force along -z at each node.
        wrench: (n, 6) of force and torque about the origin of S.
        pressure_gauge: (n,) of the gas.
        volume: (n,) between the film and the frame's plane.
        area: (n,) of the sheet in contact.
    """

    displacements: Array
    contact_forces: Array
    wrench: Array
    pressure_gauge: Array
    volume: Array
    area: Array

    @property
    def heights(self) -> Array:
        """(n, nx, ny) of the nodes' heights."""
        return self.displacements[:, 2]

    @property
    def force_normal(self) -> Array:
        """(n,) of the force that presses into the sensor."""
        return -self.wrench[:, 2]


def changed_bodies(
    shape: Shape, numbers: ArrayLike, steps: ArrayLike | None
) -> tuple[list[list[Obstacle]], Array]:
    """Bodies as they are, and before and after a step of each number.

    Args:
        shape: makes bodies of numbers.
        numbers: (n,).
        steps: (n,) of them; None: a millionth of each, or of one.

    Returns:
        1 + 2 n times the bodies; the steps (n,).

    Raises:
        InputError: numbers that are not finite, steps that are not positive, or another number of
            bodies after a step.
    """
    at = bodies.finite("numbers", numbers, (-1,))
    by = _STEP * np.maximum(1, np.abs(at)) if steps is None else np.asarray(steps, dtype=float)
    if by.shape != at.shape or not (by > 0).all():
        raise InputError("are not as many positive numbers", field="steps")
    places = [at]
    for step in np.diag(by):
        places += [at - step, at + step]
    made = [shape(place) for place in places]
    listed = [[one] if isinstance(one, Obstacle) else list(one) for one in made]
    if len({len(one) for one in listed}) != 1:
        raise InputError("gives another number of bodies after a step", field="shape")
    return listed, by


def gathered(by_x: Array, by_force: Array, by_found: Array) -> FilmDerivatives:
    """What the kernel found, by name."""
    picked = (by_found[:, place] for place in (PRESSURE, VOLUME, AREA))
    return FilmDerivatives(by_x, by_force, by_found[:, WRENCH], *picked)
