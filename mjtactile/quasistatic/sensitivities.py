"""Sensitivities of a membrane equilibrium to obstacles (docs/theory/quasistatic_membrane.md,
X6)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.kernels import kernel
from mjtactile.quasistatic import obstacles
from mjtactile.quasistatic.obstacles import Obstacle
from mjtactile.quasistatic.solution import (
    AREA,
    FOUND,
    FRICTIONLESS,
    PRESSURE,
    VOLUME,
    WRENCH,
    MembraneSolution,
)

if TYPE_CHECKING:
    from mjtactile.quasistatic.membrane import QuasistaticMembrane

Shape = Callable[[Array], Obstacle | Sequence[Obstacle]]
# relative to a parameter, or to 1; differences of the obstacles alone, which are closed forms
_STEP = 1e-8
POSE_STEP = 1e-8  # step of the pose, m, rad
_LOOSE = 1e-6  # tolerance for a solve in single precision, m
_TURNS = np.array([
    [[0.0, 0, 0], [0, 0, -1], [0, 1, 0]],
    [[0.0, 0, 1], [0, 0, 0], [-1, 0, 0]],
    [[0.0, -1, 0], [1, 0, 0], [0, 0, 0]],
])  # fmt: skip
"""Derivatives of a position by rotation about x, y and z."""


@dataclass(frozen=True, eq=False)
class SolutionSensitivities:
    """Derivatives of a membrane state by n parameters of its obstacles.

    Each quantity is in SI units, divided by the unit of the parameter. The derivatives are exact
    while the set of nodes in contact is unchanged. That set changes every few hundredths of a
    millimeter. There the derivatives are one-sided. For obstacles thinner than the spacing they are
    approximate. Such obstacles are sampled at elevenths of the spacing and moved under nodes. For a
    blade, the derivative of the force by height has an error of 13 %. The one by position is not
    valid.

    Attributes:
        displacements: (n, 3, nx, ny) Derivatives of the node displacements.
        contact_forces: (n, nx, ny) Derivatives of the force along -z at each node.
        wrench: (n, 6) Derivatives of force and torque about the origin of S.
        gauge_pressure: (n,) Derivatives of the gas pressure.
        volume: (n,) Derivatives of the volume between the membrane and the frame's plane.
        area: (n,) Derivatives of the contact area.
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
        """Derivatives (n,) of the normal force into the sensor."""
        return -self.wrench[:, 2]


def changed_obstacles(
    shape: Shape, parameters: ArrayLike, steps: ArrayLike | None
) -> tuple[list[list[Obstacle]], Array]:
    """Create the obstacles at parameters (n,) and after a step of each; return 1 + n lists and
    steps.

    Raises InputError for invalid parameters or steps, or a changed number of obstacles.
    """
    at = obstacles.finite("parameters", parameters, (-1,))
    by = _STEP * np.maximum(1, np.abs(at))
    if steps is not None:
        by = obstacles.finite("steps", steps, at.shape)
        if not by.all():
            raise InputError("must not be zero", field="steps")
    made = [shape(values) for values in (at, *(at + np.diag(by)))]
    listed = [obstacles.as_list(obstacle, "shape") for obstacle in made]
    if len({len(obstacle) for obstacle in listed}) != 1:
        raise InputError("returns a different number of obstacles after a step", field="shape")
    return listed, by


def moved_obstacles(rows: Array) -> Array:
    """Return (1 + 6, k, NUMBERS): obstacles at their pose and after each rigid step of
    POSE_STEP."""
    moved = np.repeat(rows[None], 1 + 6, axis=0)
    for axis in range(3):
        moved[1 + axis, :, 13 + axis] += POSE_STEP
    positions, rotations = rows[:, 13:16], rows[:, 4:13].reshape(-1, 3, 3)
    moved[4:, :, 13:16] += POSE_STEP * np.einsum("aij,kj->aki", _TURNS, positions)
    by_turn = np.einsum("aij,kjl->akil", _TURNS, rotations)
    moved[4:, :, 4:13] += POSE_STEP * by_turn.reshape(3, -1, 9)
    return moved


def sensitivities_of(
    membrane: QuasistaticMembrane,
    state: MembraneSolution,
    rows: Array,
    pool: Array | None,
    by: Array,
) -> SolutionSensitivities:
    """Compute the derivatives of a state by the kernel.

    `rows` (1 + n, k, NUMBERS) are the obstacles, unchanged and after each of the steps `by` (n,).
    Raises InputError if the state is close to instability, or belongs to other obstacles.
    """
    if not membrane._derive_room.size:
        membrane._derive_room = np.empty(kernel("qs_sensitivities_size")(membrane._constants))
    room, count = membrane._derive_room, len(by)
    by_x, by_force = np.empty((count, 3, *membrane.grid)), np.empty((count, *membrane.grid))
    by_detection = np.empty((count, FOUND))
    settings = np.array([membrane._gas, membrane.sealed, 0.0, 1.0, 0.0, 0.0, *FRICTIONLESS])
    fixed = (membrane._constants, membrane._law, *membrane.grid, room.size, room, settings)
    given = _kernel_arguments(state, rows, pool, by)
    if _call_kernel("qs_sensitivities", *fixed, *given, by_x, by_force, by_detection):
        raise InputError("is not an equilibrium on these obstacles", field="state")
    picked = (by_detection[:, index] for index in (PRESSURE, VOLUME, AREA))
    return SolutionSensitivities(by_x, by_force, by_detection[:, WRENCH], *picked)


def approximate_sensitivities(
    membrane: QuasistaticMembrane,
    state: MembraneSolution,
    rows: Array,
    pool: Array | None,
    by: Array,
) -> tuple[Array, Array]:
    """Approximate derivatives (n, nx, ny) of heights, m, and forces, N, at a fifth of the cost.

    They are those of one solver step without the in-plane displacements. Heights are within 5 to 10
    % of the exact derivatives, forces are 10 to 20 % too large. Both are within 40 % for light
    contact on few nodes and for sharp rims. Raises InputError close to instability.
    """
    by_z, by_force = (np.empty((len(by), *membrane.grid)) for _ in range(2))
    settings = np.array([membrane._gas, membrane.sealed, _LOOSE, 1.0, 0.0, 0.0, *FRICTIONLESS])
    fixed = (
        membrane._constants,
        membrane._law,
        *membrane.grid,
        membrane._kept.size,
        membrane._kept,
    )
    given = _kernel_arguments(state, rows, pool, by)
    workspace = (membrane._room.size, membrane._room)
    _call_kernel(
        "qs_approximate_sensitivities", *fixed, *workspace, settings, *given, by_z, by_force
    )
    return by_z, by_force


def _kernel_arguments(
    state: MembraneSolution, rows: Array, pool: Array | None, by: Array
) -> tuple[Any, ...]:
    """Return obstacles, steps and state as kernel arguments."""
    pooled = 0 if pool is None else pool.size
    return rows.shape[1], len(by), rows, pooled, pool, by, state.x, state.force


def _call_kernel(name: str, *arguments: Any) -> Any:
    """Return the result of a kernel. Raises InputError for an indefinite stiffness."""
    try:
        return kernel(name)(*arguments)
    except np.linalg.LinAlgError as error:
        raise InputError(
            "is unstable: the stiffness is not positive definite", field="state"
        ) from error
