"""How a film at rest answers small changes of what presses it (docs/theory/quasistatic_membrane.md,
X6)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.kernels import kernel
from mjtactile.quasistatic import obstacles
from mjtactile.quasistatic.obstacles import Obstacle
from mjtactile.quasistatic.solution import AREA, FOUND, PRESSURE, VOLUME, WRENCH, MembraneSolution

Shape = Callable[[Array], Obstacle | Sequence[Obstacle]]
_STEP = 1e-8  # of a number, or of one: differences of bodies alone, which are closed forms
POSE_STEP = 1e-8  # m, rad
_LOOSE = 1e-6  # m, a tolerance that single precision is enough for
_TURNS = np.array([
    [[0.0, 0, 0], [0, 0, -1], [0, 1, 0]],
    [[0.0, 0, 1], [0, 0, 0], [-1, 0, 0]],
    [[0.0, -1, 0], [1, 0, 0], [0, 0, 0]],
])  # fmt: skip
"""What a small turn about x, y and z does to a place."""


class Resting(Protocol):
    """Of a `QuasistaticMembrane`, what derivatives want."""

    grid: tuple[int, int]
    sealed: bool
    _gas: float
    _numbers: Array
    _law: Array
    _derive_room: Array
    _room: Array
    _kept: Array


@dataclass(frozen=True, eq=False)
class SolutionSensitivities:
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
        gauge_pressure: (n,) of the gas.
        volume: (n,) between the film and the frame's plane.
        area: (n,) of the sheet in contact.
    """

    displacements: Array
    contact_forces: Array
    wrench: Array
    gauge_pressure: Array
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
    """Bodies as they are, and after a step of each number.

    Args:
        shape: makes bodies of numbers.
        numbers: (n,).
        steps: (n,) of them; None: 1e-8 of each, or of one.

    Returns:
        1 + n times the bodies; the steps (n,).

    Raises:
        InputError: numbers that are not finite, steps that are zero or not finite, or another
            number of bodies after a step.
    """
    at = obstacles.finite("numbers", numbers, (-1,))
    by = _STEP * np.maximum(1, np.abs(at))
    if steps is not None:
        by = obstacles.finite("steps", steps, at.shape)
        if not by.all():
            raise InputError("must not be zero", field="steps")
    made = [shape(place) for place in (at, *(at + np.diag(by)))]
    listed = [obstacles.listed(one, "shape") for one in made]
    if len({len(one) for one in listed}) != 1:
        raise InputError("gives another number of bodies after a step", field="shape")
    return listed, by


def moved_rows(rows: Array) -> Array:
    """Bodies as they are, and after a step of their pose, all of them as one.

    Args:
        rows: (k, NUMBERS) of the bodies.

    Returns:
        (1 + 6, k, NUMBERS): as they are, shifted by POSE_STEP along x, y and z of S, and turned by
        it about these axes through the origin of S.
    """
    moved = np.repeat(rows[None], 1 + 6, axis=0)
    for axis in range(3):
        moved[1 + axis, :, 13 + axis] += POSE_STEP
    places, rotations = rows[:, 13:16], rows[:, 4:13].reshape(-1, 3, 3)
    moved[4:, :, 13:16] += POSE_STEP * np.einsum("aij,kj->aki", _TURNS, places)
    by_turn = np.einsum("aij,kjl->akil", _TURNS, rotations)
    moved[4:, :, 4:13] += POSE_STEP * by_turn.reshape(3, -1, 9)
    return moved


def derived(
    film: Resting, state: MembraneSolution, rows: Array, pool: Array | None, by: Array
) -> SolutionSensitivities:
    """Ask the kernel.

    Args:
        film: Whose state it is.
        state: At rest.
        rows: (1 + n, k, NUMBERS) of bodies, as they are, and after each of n steps.
        pool: What they have of planes, triangles and heights.
        by: (n,) steps.

    Returns:
        The derivatives.

    Raises:
        InputError: The state is about to lose its balance, or rests on something else.
    """
    if not film._derive_room.size:
        film._derive_room = np.empty(kernel("film_derive_room")(film._numbers))
    room, count = film._derive_room, len(by)
    by_x, by_force = np.empty((count, 3, *film.grid)), np.empty((count, *film.grid))
    by_detection = np.empty((count, FOUND))
    settings = np.array([film._gas, film.sealed, 0.0, 1.0, 0.0, 0.0])
    fixed = (film._numbers, film._law, *film.grid, room.size, room, settings)
    given = _given(state, rows, pool, by)
    if _ask("film_derive", *fixed, *given, by_x, by_force, by_detection):
        raise InputError("does not rest on these bodies, but elsewhere", field="state")
    picked = (by_detection[:, place] for place in (PRESSURE, VOLUME, AREA))
    return SolutionSensitivities(by_x, by_force, by_detection[:, WRENCH], *picked)


def answered(
    film: Resting, state: MembraneSolution, rows: Array, pool: Array | None, by: Array
) -> tuple[Array, Array]:
    """Say about how a film's heights and contact forces change: what a step of its solution would
    have them do, without what moves in the plane, for a fifth of what `derived` costs.

    Args:
        film: Whose state it is.
        state: At rest.
        rows: (1 + n, k, NUMBERS) of bodies, as they are, and after each of n steps.
        pool: What they have of planes, triangles and heights.
        by: (n,) steps.

    Returns:
        (n, nx, ny) of the heights, m, and of the forces, N, over each step's unit. Heights are
        within 5 to 10 % of the derivatives, forces 10 to 20 % larger; of light touches on few
        nodes, and of sharp rims, both are within 40 %. Where a body ends between nodes, and that
        end moves, nothing of it is seen.

    Raises:
        InputError: The state is about to lose its balance.
    """
    by_z, by_force = (np.empty((len(by), *film.grid)) for _ in range(2))
    settings = np.array([film._gas, film.sealed, _LOOSE, 1.0, 0.0, 0.0])
    fixed = (film._numbers, film._law, *film.grid, film._kept.size, film._kept)
    given = _given(state, rows, pool, by)
    _ask("film_answer", *fixed, film._room.size, film._room, settings, *given, by_z, by_force)
    return by_z, by_force


def _given(state: MembraneSolution, rows: Array, pool: Array | None, by: Array) -> tuple[Any, ...]:
    """Bodies, steps and state, as kernels take them."""
    pooled = 0 if pool is None else pool.size
    return rows.shape[1], len(by), rows, pooled, pool, by, state.x, state.force


def _ask(name: str, *arguments: Any) -> Any:
    """What a kernel returns. Raises InputError where the sheet is not stiff in every direction."""
    try:
        return kernel(name)(*arguments)
    except np.linalg.LinAlgError as error:
        raise InputError("loses its balance here", field="state") from error
