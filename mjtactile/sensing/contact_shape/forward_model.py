"""Forward model from a contact shape to the marker heights.

It uses the quasi-static membrane (docs/theory/quasistatic_membrane.md, Eq. X1-X5).
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array
from mjtactile.quasistatic import MembraneSolution, QuasistaticMembrane
from mjtactile.quasistatic.inflation import inflated_further
from mjtactile.quasistatic.interpolation import interpolation_matrix
from mjtactile.quasistatic.sensitivities import approximate_sensitivities, sensitivities_of
from mjtactile.quasistatic.solution import AREA, PRESSURE, STATUS
from mjtactile.sensing.force.rest_equilibrium import InverseRest

_STEPS = 20  # enough for 49 of 50 converging solutions; those that never converge use all
_TOLERANCE = 3e-6  # tolerance of the displacements, m: a fortieth of the marker noise
_MORE = 0.02  # relative step of the pressure for its derivative
SUMS = np.array([*range(6), PRESSURE, AREA])
"""Membrane sums used in the fit: wrench (N, N m), pressure (Pa), area (m^2)."""
SUM_AREA = 7
ShapeRows = tuple[Array, Array | None]
"""Obstacles (m, k, NUMBERS) of m shapes, and their pool (`ShapeModel.rows`)."""


class ForwardModel:
    """Quasi-static membrane model of one sensor, with the heights of its markers. `spacing` is the
    approximate node spacing, m, and `gauge_pressure` that at rest, Pa (None: taken from `rest`).
    Without `rest` it is that of the sensor file, sealed."""

    def __init__(
        self,
        design: SensorDesign,
        rest: InverseRest | None,
        spacing: float,
        gauge_pressure: float | None = None,
    ):
        young, stretch = (1.0, 1.0) if rest is None else (rest.young, rest.stretch)
        stretched = replace(
            design.membrane,
            young=young * design.membrane.young,
            pre_stretch=stretch * design.membrane.pre_stretch,
        )
        if rest is not None and gauge_pressure is None:
            gauge_pressure = rest.gas.gauge_pressure
        sides = (design.frame.length, design.frame.width)
        columns, rows = (max(round(side / spacing) + 1, 9) for side in sides)
        self.membrane = QuasistaticMembrane(
            replace(design, membrane=stretched),
            (columns, rows),
            gauge_pressure,
            sealed=rest is None or rest.gas.constant is not None,
        )
        self.spacing = float(self.membrane.x[1] - self.membrane.x[0])
        x, y = np.meshgrid(self.membrane.x, self.membrane.y, indexing="ij")
        self.nodes: tuple[Array, Array] = (x, y)
        material = design.markers.p_SM
        self._by_node = interpolation_matrix(self.membrane, material[:, :2]).T.copy()
        self.rest_heights = self.heights(self.membrane.rest.x[None])[0]

    @cached_property
    def by_gas(self) -> Array:
        """Derivative (N,), m, of the marker heights by the relative excess of gas."""
        membrane = self.membrane
        if not membrane.sealed:
            return np.zeros(len(self.rest_heights))
        more = inflated_further(membrane, (1 + _MORE) * membrane.gauge_pressure)
        rise = _MORE * membrane.gauge_pressure
        chamber = membrane.design.chamber
        absolute = membrane.gauge_pressure + chamber.ambient
        volume = membrane.design.chamber_volume_flat + membrane.rest.volume
        yields = absolute / volume * (more.volume - membrane.rest.volume) / rise
        higher = self.heights(more.x[None])[0] - self.rest_heights
        return higher / rise * absolute / (1 + yields)

    def heights(self, x: Array) -> Array:
        """Return the marker heights (n, N), m, for node displacements `x` (n, 3, nx, ny)."""
        return x[:, -1].reshape(len(x), -1) @ self._by_node

    def answers(
        self, state: MembraneSolution, bodies: ShapeRows, steps: Array
    ) -> tuple[Array, Array]:
        """Approximate the derivatives of marker heights (n, N), m, and normal force (n,), N, by the
        parameters (`approximate_sensitivities`). The state is on the first of `bodies`. Each other
        one is one of `steps` (n,) further."""
        by_z, by_force = approximate_sensitivities(self.membrane, state, *bodies, steps)
        return self.heights(by_z[:, None]), by_force.sum(axis=(1, 2))

    def derivatives(
        self, state: MembraneSolution, bodies: ShapeRows, steps: Array
    ) -> tuple[Array, Array]:
        """Compute the exact derivatives of marker heights (n, N), m, and of the sums (n, 8) (SUMS),
        by the parameters. See `answers`."""
        by = sensitivities_of(self.membrane, state, *bodies, steps)
        sums = np.column_stack([by.wrench, by.gauge_pressure, by.area])
        return self.heights(by.displacements), sums

    def solve(
        self, bodies: ShapeRows, start: MembraneSolution | None = None, shear: Array | None = None
    ) -> MembraneSolution | None:
        """Solve the membrane on one shape that loads it with the in-plane force `shear` (2,), N
        (None: without friction), starting from `start` (None: from rest). None: the solver did not
        converge, for which far starts get fewer steps."""
        membrane = self.membrane
        rows, pool = bodies
        if start is None:
            found = membrane.resume(rows[0], pool, membrane.rest, again=True, shear=shear)
        else:
            found = membrane.resume(rows[0], pool, start, _TOLERANCE, _STEPS, shear=shear)
        return found if found.found[STATUS] == 0 else None
