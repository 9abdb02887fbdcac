"""Solution of the quasi-static membrane: an equilibrium state and its error estimates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.quasistatic.discretization_error import (
    area_error,
    error_of_few_nodes,
    gap_error,
    lowest_point,
    relative_force_error,
)
from mjtactile.quasistatic.obstacles import Obstacle


class MembraneStatus(IntEnum):
    """Status of a solution, as the kernel reports it."""

    CONVERGED = 0
    NOT_CONVERGED = 1
    RIM_CONTACT = 2
    GLASS_CONTACT = 3
    INVERTED = 4
    NUMERICAL_FAILURE = 5
    TUNNELLING = 6
    OVERSTRETCHED = 7


_REFUSALS = {
    MembraneStatus.RIM_CONTACT: "an obstacle touches the rim of the frame",
    MembraneStatus.GLASS_CONTACT: "an obstacle lies on the glass",
    MembraneStatus.INVERTED: "an obstacle turns the membrane inside out",
    MembraneStatus.NUMERICAL_FAILURE: "the solution is not finite for this obstacle",
    MembraneStatus.TUNNELLING: "an obstacle passes between the nodes; use a finer grid",
    MembraneStatus.OVERSTRETCHED: "the stretch exceeds the range of the material model",
}

# Indices in `found`, as in kernels/qs_workspace.h.
WRENCH = slice(0, 6)
PRESSURE, VOLUME, AREA, STATUS, STEPS, STRETCHED, TENSION, LAST_STEP = range(6, 14)
FOUND = 14
FRICTIONLESS = (0.0, 0.0, 0.0)  # last settings of a solution: sticks, shear along x and y
_TOUCHES = 5e-5  # maximum distance behind an untouched membrane without an error, m


@dataclass(frozen=True, eq=False)
class ContactSetup:
    """Obstacles of a solution, and node positions `x` (nx,), `y` (ny,) m of the flat membrane.

    `half_thickness` m is that of the membrane.
    """

    bodies: Sequence[Obstacle] = ()
    x: Array = field(default_factory=lambda: np.zeros(0))
    y: Array = field(default_factory=lambda: np.zeros(0))
    half_thickness: float = 0.0

    @property
    def spacing(self) -> float:
        """Larger of the two node spacings, m."""
        return max((float(line[1] - line[0]) for line in (self.x, self.y) if len(line)), default=0)


_NO_CONTACT = ContactSetup()


@dataclass(frozen=True, eq=False)
class MembraneSolution:
    """Equilibrium of a membrane on obstacles. SI units, frame S.

    All values are NaN if the state is not `converged`.

    Attributes:
        x: Node displacements (3, nx, ny), m.
        force: Contact force at each node (nx, ny), N, along -z.
        found: Results summed by the kernel, kept as the start of a later solution.
        trend: (4, nx, ny), m and N, last change of `x` and `force`. The next solution extrapolates
            it in proportion to the motion of the obstacles in contact. None: it starts without
            extrapolation.
        contact_setup: The obstacles and the membrane's nodes; empty for a batch.
    """

    x: Array
    force: Array
    found: Array
    trend: Array | None = None
    contact_setup: ContactSetup = _NO_CONTACT

    @property
    def status(self) -> MembraneStatus:
        return MembraneStatus(int(self.found[STATUS]))

    @property
    def converged(self) -> bool:
        return self.found[STATUS] == 0

    @property
    def steps(self) -> int:
        """Steps that it took."""
        return int(self.found[STEPS])

    def _number(self, index: int) -> float:
        return float(self.found[index]) if self.converged else float("nan")

    @property
    def force_normal(self) -> float:
        """Normal force into the sensor, N: -z of the wrench."""
        return -self._number(2)

    @property
    def relative_force_error(self) -> float:
        """Relative force error not exceeded in 9 of 10 cases.

        Its causes are narrow obstacles and a contact of few nodes. Another cause is a tip behind
        the membrane between its nodes. See `QuasistaticMembrane.relative_force_error` and
        `QuasistaticMembrane.refined_for`. It is 0 without contact. It is 1 if an obstacle should be
        in contact and is not.
        """
        if not self.converged:
            return float("nan")
        on = self.contact_setup
        gap = max((self._gap(body) for body in on.bodies), default=0.0)
        if not self.force_normal > 0:
            return float(gap > _TOUCHES)
        few = error_of_few_nodes(int(np.count_nonzero(self.force > 0)) // max(len(on.bodies), 1))
        tip = gap_error(gap, self.force_normal, float(self.found[TENSION]))
        return max(relative_force_error(on.bodies, on.spacing), few, tip)

    @property
    def relative_area_error(self) -> float:
        """Relative error of `area` not exceeded in 9 of 10 cases.

        It is infinite if the contact is a point or a line on this grid. Its area is then unknown.
        It is 0 without contact.
        """
        if not self.converged:
            return float("nan")
        touching = self.force > 0
        if not touching.any():
            return float("inf") if self.relative_force_error else 0.0
        longer = max(int(touching.any(axis=axis).sum()) for axis in (0, 1))
        on = self.contact_setup
        return area_error(on.bodies, np.count_nonzero(touching) / longer, on.spacing)

    def _gap(self, body: Obstacle) -> float:
        """Return the distance of an obstacle's lowest point behind the membrane, m; 0 off the
        grid."""
        low, on = lowest_point(body), self.contact_setup
        if low is None:
            return 0.0
        at = low[:2]
        for _ in range(3):  # fixed-point iteration for the point of the flat membrane
            found = _interpolated(on.x, on.y, self.x, at)
            if found is None:
                return 0.0
            at = low[:2] - found[:2]
        return float(found[2] - (low[2] - on.half_thickness))

    @property
    def wrench(self) -> Array:
        """Frictionless wrench (6,) on the membrane about the origin of S, N and N m."""
        return self.found[WRENCH].copy() if self.converged else np.full(6, np.nan)

    @property
    def gauge_pressure(self) -> float:
        """Gauge pressure of the gas, Pa."""
        return self._number(PRESSURE)

    @property
    def volume(self) -> float:
        """Volume between the membrane and the frame's plane, m^3."""
        return self._number(VOLUME)

    @property
    def area(self) -> float:
        """Area of the membrane in contact, m^2."""
        return self._number(AREA)

    @property
    def heights(self) -> Array:
        """Heights (nx, ny) of the membrane's mid-surface at its nodes, m."""
        return self.x[2] if self.converged else np.full(self.x.shape[1:], np.nan)

    @property
    def displacements(self) -> Array:
        """Displacements (3, nx, ny) of the nodes from the mounted flat membrane, m."""
        return self.x if self.converged else np.full(self.x.shape, np.nan)

    @property
    def contact_forces(self) -> Array:
        """Force (nx, ny) N of the contact along -z, at each node."""
        return self.force if self.converged else np.full(self.force.shape, np.nan)


def require_admissible(state: MembraneSolution) -> MembraneSolution:
    """Return the state. Raises a one-line InputError for an inadmissible one."""
    complaint = _REFUSALS.get(state.status)
    if complaint is not None:
        raise InputError(complaint, field="obstacle")
    return state


@dataclass(frozen=True, eq=False)
class MembraneSolutionBatch:
    """Membranes of n environments in equilibrium, with the fields of `MembraneSolution`."""

    x: Array
    force: Array
    found: Array
    trend: Array | None = None

    def __len__(self) -> int:
        return len(self.found)

    def __getitem__(self, index: int) -> MembraneSolution:
        trend = None if self.trend is None else self.trend[index]
        return MembraneSolution(self.x[index], self.force[index], self.found[index], trend)

    @property
    def converged(self) -> NDArray[np.bool_]:
        """(n,) of each."""
        return self.found[:, STATUS] == MembraneStatus.CONVERGED

    @property
    def force_normal(self) -> Array:
        """(n,) N; NaN where it did not converge."""
        return np.where(self.converged, -self.found[:, 2], np.nan)


def _interpolated(x: Array, y: Array, fields: Array, at: Array) -> Array | None:
    """Interpolate fields (k, nx, ny) bilinearly at a point of the flat membrane; None off the
    grid."""
    i = (at[0] - x[0]) / (x[1] - x[0])
    j = (at[1] - y[0]) / (y[1] - y[0])
    if not (0 <= i < len(x) - 1 and 0 <= j < len(y) - 1):
        return None
    m, n = int(i), int(j)
    u, v = i - m, j - n
    weights = np.outer((1 - u, u), (1 - v, v))
    return (fields[:, m : m + 2, n : n + 2] * weights).sum(axis=(1, 2))
