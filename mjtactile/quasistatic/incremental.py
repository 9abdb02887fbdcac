"""`IncrementalMembrane`: quasi-static membrane updated in place at every step of a simulation.

It keeps one state and its own workspace, so the membranes of many environments can run in threads.
The in-plane stiffness of the untouched membrane, inverted once, holds sticking contact
(docs/theory/quasistatic_membrane.md, X7).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array
from mjtactile.kernels import bound, kernel
from mjtactile.quasistatic import obstacles
from mjtactile.quasistatic.discretization_error import row_error
from mjtactile.quasistatic.membrane import QuasistaticMembrane
from mjtactile.quasistatic.solution import (
    AREA,
    FOUND,
    FRICTIONLESS,
    PRESSURE,
    STATUS,
    VOLUME,
    MembraneStatus,
)
from mjtactile.quasistatic.stick_contact import compliance_of

_STICKS = 6  # index of friction in the settings
_TOLERANCE = 1e-6  # tolerance of the displacements, m
_MAX_STEPS = 40
HEAT_RATIO = 14
"""Index of the gas exponent in a membrane's parameters."""
AWAY = 10.0
"""Position, m, of obstacles that are not near (kernels/qs_scene.c)."""
_RAMP = 200.0  # maximum change of gas pressure in one solution, Pa


class IncrementalMembrane:
    """Present state of one membrane. SI units, frame S.

    `membrane` is the shared model. `x` (3, nx, ny) m are displacements, `force` (nx, ny) N contact
    forces along -z.
    """

    def __init__(
        self, membrane: QuasistaticMembrane, rows: Array, pool: Array | None, below_rim: float = 0.0
    ):
        """Bind the solver to obstacles `rows` (k, NUMBERS), read at every solution, and `pool`.

        They may be up to `below_rim` m below the rim of the frame, which carries them there.
        """
        self.membrane = membrane
        self.x = np.zeros_like(membrane.rest.x)
        self.force = np.zeros_like(membrane.rest.force)
        self.trend = np.zeros((4, *membrane.grid))
        self.rows = rows
        self.pool = pool
        self.found = np.zeros(FOUND)
        self.settings = np.array(
            [0.0, 0.0, _TOLERANCE, float(_MAX_STEPS), 1.0, below_rim, *FRICTIONLESS]
        )
        self.constants = membrane._constants.copy()
        room = np.empty_like(membrane._room)
        kept = (membrane._kept.size, membrane._kept)
        fixed = (
            self.constants,
            membrane._law,
            *membrane.grid,
            *kept,
            membrane.rest.x,
            room.size,
            room,
        )
        pooled = 0 if pool is None else pool.size
        given = (self.settings, len(rows), rows, pooled, pool)
        state = (self.x, self.force, self.trend, self.found)
        self.arguments = (*fixed, *given, *state)
        """Arguments of `qs_follow` for this membrane."""
        self._solve = bound("qs_solve", *fixed, 1, 0, 1, *given, *state)

    def rest_on(self, gas: float, sealed: bool, exponent: float) -> MembraneStatus:
        """Solve for the equilibrium on the obstacles; without convergence `x` is invalid.

        `gas` is p V^exponent of the absolute pressure if `sealed`, else the gauge pressure, Pa.
        """
        self.constants[HEAT_RATIO] = exponent
        self.settings[:2] = gas, sealed
        self._solve()
        return MembraneStatus(int(self.found[STATUS]))

    def with_shear(self, shear: Array) -> Callable[[], tuple[Array, Array] | None]:
        """Return a function that finds the present equilibrium with an in-plane force later.

        Its results are displacements (3, nx, ny), m, and the included loads (2, nx, ny), N, of the
        nodes; None without an equilibrium.

        Args:
            shear: In-plane force (2,), N, of the contact, distributed like the normal force.
        """
        settings, rows, constants = self.settings.copy(), self.rows.copy(), self.constants.copy()
        settings[_STICKS:] = 1.0, *shear
        x, force = self.x.copy(), self.force.copy()

        def solve() -> tuple[Array, Array] | None:
            membrane = self.membrane
            room, found = np.empty_like(membrane._room), np.zeros(FOUND)
            kernel("qs_solve")(
                *(constants, membrane._law, *membrane.grid, membrane._kept.size, membrane._kept),
                *(membrane.rest.x, room.size, room, 1, 0, 1, settings, len(rows), rows),
                *(0 if self.pool is None else self.pool.size, self.pool),
                *(x, force, np.zeros((4, *membrane.grid)), found),
            )
            if found[STATUS] != MembraneStatus.CONVERGED:
                return None
            return x, (shear - found[:2])[:, None, None] * force / force.sum()

        return solve

    def go_to_pressure(self, gauge_pressure: float) -> MembraneStatus:
        """Change to a gauge pressure that may differ much from the present one, in small steps to
        equilibrium."""
        start = float(self.found[PRESSURE])
        count = max(1, int(np.ceil(abs(gauge_pressure - start) / _RAMP)))
        status = MembraneStatus.CONVERGED
        for pressure in np.linspace(start, gauge_pressure, count + 1)[1:]:
            status = self.rest_on(float(pressure), False, 1.0)
        return status

    def lie_flat(self) -> None:
        """Reset to the mounted flat membrane without pressure."""
        self.x[:] = 0.0
        self.force[:] = 0.0
        self.trend[:] = 0.0
        self.found[:] = 0.0

    def below_rim(self) -> tuple[float, int]:
        """Return the depth, m, of the deepest obstacle below the membrane's mid-surface on the
        frame, and its row; 0 and -1 if none is below."""
        membrane = self.membrane
        x, y = np.meshgrid(membrane.x, membrane.y, indexing="ij")
        inner = np.zeros(membrane.grid, bool)
        inner[1:-1, 1:-1] = True
        positions = np.stack([x[~inner], y[~inner]], axis=1)
        depth, row = self._deepest(positions, np.zeros(len(positions)))
        return max(depth, 0.0), row if depth > 0 else -1

    def deepest(self) -> int:
        """Return the row of the obstacle that is deepest below the untouched membrane; -1: none."""
        membrane = self.membrane
        x, y = np.meshgrid(membrane.x, membrane.y, indexing="ij")
        positions = np.stack([x.ravel(), y.ravel()], axis=1)
        return self._deepest(positions, membrane.rest.x[2].ravel())[1]

    def _deepest(self, positions: Array, surface: Array) -> tuple[float, int]:
        """Return the largest depth, m, of obstacles below `surface` (n,) m at `positions` (n, 2) m,
        and its row; infinitely far above and -1 if none is there."""
        found = -math.inf, -1
        pooled = 0 if self.pool is None else self.pool.size
        heights = np.empty(len(positions))
        for row in np.flatnonzero(self.rows[:, 15] < AWAY):
            obstacle = (1, self.rows[row : row + 1], pooled, self.pool)
            kernel("qs_obstacle_heights")(
                self.constants, *obstacle, len(positions), positions, heights
            )
            found = max(found, (float((surface - heights).max()), int(row)))
        return found

    def relative_force_error(self) -> float:
        """Return the relative force error not exceeded in 9 of 10 cases, of reachable obstacles."""
        membrane, rows = self.membrane, self.rows
        position, extent = rows[:, 13:16], rows[:, 19]
        over = (np.abs(position[:, :2]) - extent[:, None] < (membrane.x[-1], membrane.y[-1])).all(
            axis=1
        )
        near = over & (position[:, 2] - extent < membrane.rest.heights.max())
        return row_error(rows[near], membrane.spacing)

    @property
    def volume(self) -> float:
        """Volume between the membrane and the frame's plane, m^3."""
        return float(self.found[VOLUME])

    @property
    def gauge_pressure(self) -> float:
        """Gauge pressure of the last solution, Pa."""
        return float(self.found[PRESSURE])

    @property
    def area(self) -> float:
        """Contact area of the membrane, m^2."""
        return float(self.found[AREA])


@dataclass(frozen=True, eq=False)
class Grip:
    """In-plane stiffness (3 n, 3 n) of n sticking patches about their centers.

    Each patch has three rigid motions: x, y and rotation. `labels` (n,) are the patches. `spread`
    (2, inner, 3 n) are displacements of all inner nodes by the motions.
    """

    labels: NDArray[np.int32]
    stiffness: Array
    spread: Array


class Sticking:
    """In-plane compliance of one membrane with free heights, shared by all contacts."""

    def __init__(self, membrane: QuasistaticMembrane):
        self.membrane = membrane

    @cached_property
    def compliance(self) -> Array:
        """(2 inner, 2 inner) m/N; x and y of each node in turn."""
        return compliance_of(self.membrane, self.membrane.rest)

    def grip(self, x: Array, force: Array, owners: NDArray[np.int32] | None = None) -> Grip:
        """Compute the stiffness of the nodes in contact when each patch moves as one rigid set.

        `owners` (nx, ny) is the patch of each node in contact, 0 elsewhere; None: a single patch of
        the nodes with a `force`.
        """
        from scipy.linalg import cho_factor, cho_solve  # takes a while to import

        membrane = self.membrane
        held = (force > 0).astype(np.int32) if owners is None else owners
        i, j = np.nonzero(held)
        labels, patches = np.unique(held[i, j], return_inverse=True)
        load = force[i, j]
        positions = np.stack([membrane.x[i] + x[0, i, j], membrane.y[j] + x[1, i, j]], axis=1)
        sums = np.stack(
            [np.bincount(patches, load * coordinate) for coordinate in positions.T], axis=1
        )
        lever = positions - (sums / np.bincount(patches, load)[:, None])[patches]
        nodes = (i - 1) * (membrane.grid[1] - 2) + j - 1
        picked = np.stack([2 * nodes, 2 * nodes + 1], axis=1).ravel()
        rigid = np.zeros((len(nodes), 2, len(labels), 3))
        rows = np.arange(len(nodes))
        rigid[rows, 0, patches, 0] = rigid[rows, 1, patches, 1] = 1.0
        rigid[rows, 0, patches, 2] = -lever[:, 1]
        rigid[rows, 1, patches, 2] = lever[:, 0]
        motions = rigid.reshape(len(picked), -1)
        columns = self.compliance[:, picked]
        # half the cost of an LU factorization
        loads = cho_solve(cho_factor(columns[picked]), motions)
        stiffness = motions.T @ loads
        spread = (columns @ loads).reshape(-1, 2, motions.shape[1]).transpose(1, 0, 2)
        return Grip(labels, (stiffness + stiffness.T) / 2, spread)


def empty_rows(count: int) -> Array:
    """Return rows (count, NUMBERS) for absent obstacles."""
    return np.zeros((count, obstacles.NUMBERS))
