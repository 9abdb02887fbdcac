"""`IncrementalMembrane`: a film that is followed from step to step in place, beside a simulation.

`QuasistaticMembrane` makes a state for every solution; this one keeps one, with its own room, so
that films of many environments can be followed in threads. What sticks to it is held by the sheet
in the plane (docs/theory/quasistatic_membrane.md, X7) with the stiffness of the sheet at rest,
whose inverse is made once."""

from __future__ import annotations

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
    PRESSURE,
    STATUS,
    TENSION,
    VOLUME,
    WRENCH,
    MembraneStatus,
)
from mjtactile.quasistatic.stiffness import compliance_of

_TOLERANCE = 1e-6  # m, of what is left of the displacements
_MAX_STEPS = 40
HEAT_RATIO = 14
"""Place of the gas's exponent in a film's numbers."""
_RAMP = 200.0  # Pa that the gas may rise or fall by in one solution


class IncrementalMembrane:
    """One film's present state. SI units, frame S.

    Attributes:
        film: What it is of; shared, never changed.
        x: (3, nx, ny) m of displacements.
        force: (nx, ny) N of contact at each node, along -z.
    """

    def __init__(
        self, film: QuasistaticMembrane, rows: Array, pool: Array | None, below_rim: float = 0.0
    ):
        """`rows` (k, NUMBERS) are the bodies, read at every solution; `pool` what they have of
        planes; `below_rim` m is how far they may be below the frame's rim, which bears them
        there."""
        self.film = film
        self.x = np.zeros_like(film.rest.x)
        self.force = np.zeros_like(film.rest.force)
        self.trend = np.zeros((4, *film.grid))
        self.rows = rows
        self.pool = pool
        self.found = np.zeros(FOUND)
        self.settings = np.array([0.0, 0.0, _TOLERANCE, float(_MAX_STEPS), 1.0, below_rim])
        self.numbers = film._numbers.copy()
        room = np.empty_like(film._room)
        kept = (film._kept.size, film._kept)
        fixed = (self.numbers, film._law, *film.grid, *kept, film.rest.x, room.size, room)
        pooled = 0 if pool is None else pool.size
        given = (self.settings, len(rows), rows, pooled, pool)
        state = (self.x, self.force, self.trend, self.found)
        self.arguments = (*fixed, *given, *state)
        """What `film_follow` takes of a film."""
        self._solve = bound("film_solve", *fixed, 1, 0, 1, *given, *state)

    def rest_on(self, gas: float, sealed: bool, exponent: float) -> MembraneStatus:
        """Come to rest on the bodies.

        Args:
            gas: p V^exponent of the absolute pressure where `sealed`, else the gauge pressure, Pa.
            sealed: Whether the gas stays in.
            exponent: Of the gas, for what happens within a step.

        Returns:
            How it ended. What did not converge leaves displacements that mean nothing.
        """
        self.numbers[HEAT_RATIO] = exponent
        self.settings[:2] = gas, sealed
        self._solve()
        return MembraneStatus(int(self.found[STATUS]))

    def go_to_pressure(self, gauge_pressure: float) -> MembraneStatus:
        """Come to rest at a gauge pressure that may be far from the present one, in small steps."""
        start = float(self.found[PRESSURE])
        count = max(1, int(np.ceil(abs(gauge_pressure - start) / _RAMP)))
        status = MembraneStatus.CONVERGED
        for pressure in np.linspace(start, gauge_pressure, count + 1)[1:]:
            status = self.rest_on(float(pressure), False, 1.0)
        return status

    def lie_flat(self) -> None:
        """Be the mounted sheet, without a pressure."""
        self.x[:] = 0.0
        self.force[:] = 0.0
        self.trend[:] = 0.0
        self.found[:] = 0.0

    def keep(self) -> tuple[Array, Array, Array]:
        """The present state, for `restore`."""
        return self.x.copy(), self.force.copy(), self.found.copy()

    def restore(self, kept: tuple[Array, Array, Array]) -> None:
        """Go back to what `keep` gave."""
        for place, was in zip((self.x, self.force, self.found), kept, strict=True):
            place[:] = was
        self.trend[:] = 0.0

    def below_rim(self) -> float:
        """m by which bodies are below where the sheet's middle is on the frame; 0 where none is."""
        film = self.film
        x, y = np.meshgrid(film.x, film.y, indexing="ij")
        inner = np.zeros(film.grid, bool)
        inner[1:-1, 1:-1] = True
        places = np.stack([x[~inner], y[~inner]], axis=1)
        heights = np.empty(len(places))
        pooled = 0 if self.pool is None else self.pool.size
        given = (len(self.rows), self.rows, pooled, self.pool, len(places), places)
        kernel("film_heights")(self.numbers, *given, heights)
        return max(-float(heights.min()), 0.0)

    def doubt(self) -> float:
        """Share of the force within which 9 of 10 presses are, by the narrowest body whose reach is
        over the frame and below the sheet's top (`mjtactile.quasistatic.discretization_error`)."""
        film, rows = self.film, self.rows
        place, reach = rows[:, 13:16], rows[:, 19]
        over = (np.abs(place[:, :2]) - reach[:, None] < (film.x[-1], film.y[-1])).all(axis=1)
        near = over & (place[:, 2] - reach < film.rest.heights.max())
        return row_error(rows[near], film.spacing)

    @property
    def volume(self) -> float:
        """m^3 between the film and the frame's plane."""
        return float(self.found[VOLUME])

    @property
    def gauge_pressure(self) -> float:
        """Pa, of the last solution."""
        return float(self.found[PRESSURE])

    @property
    def tension(self) -> float:
        """N/m, mean over the sheet."""
        return float(self.found[TENSION])

    @property
    def area(self) -> float:
        """m^2 of the sheet in contact."""
        return float(self.found[AREA])

    @property
    def wrench(self) -> Array:
        """(6,) N and N m about the origin of S of the bodies on the film, frictionless; a view."""
        return self.found[WRENCH]


@dataclass(frozen=True, eq=False)
class Grip:
    """How a set of nodes that stick is held.

    Attributes:
        middle: (2,) m, what it turns about.
        stiffness: (3, 3) of force along x and y, N, and torque about z, N m, by displacements along
            x and y, m, and a turn about z, rad.
        spread: (2, inner, 3) displacements of all inner nodes by the three strains.
        nodes: (m,) numbers of the nodes among those that move.
    """

    middle: Array
    stiffness: Array
    spread: Array
    nodes: NDArray[np.intp]


class Sticking:
    """How one film's sheet gives in the plane while its heights are free, once for all contacts.

    Costs 8 (inner nodes)^2 x 4 bytes: 2.3 MB at 21 x 16.
    """

    def __init__(self, film: QuasistaticMembrane):
        self.film = film

    @cached_property
    def compliance(self) -> Array:
        """(2 inner, 2 inner) m/N; x and y of each node in turn."""
        return compliance_of(self.film, self.film.rest)

    def grip(self, x: Array, force: Array) -> Grip:
        """Say how the nodes that touch are held when they move as one body.

        Args:
            x: (3, nx, ny) m, the film's displacements.
            force: (nx, ny) N, of contact.

        Returns:
            The grip; `force` must be positive somewhere.
        """
        from scipy.linalg import cho_factor, cho_solve  # takes a while to import

        film = self.film
        i, j = np.nonzero(force > 0)
        share = force[i, j]
        places = np.stack([film.x[i] + x[0, i, j], film.y[j] + x[1, i, j]], axis=1)
        middle = share @ places / share.sum()
        off = places - middle
        nodes = (i - 1) * (film.grid[1] - 2) + j - 1
        picked = np.stack([2 * nodes, 2 * nodes + 1], axis=1).ravel()
        rigid = np.zeros((len(picked), 3))
        rigid[0::2, 0] = rigid[1::2, 1] = 1.0
        rigid[0::2, 2], rigid[1::2, 2] = -off[:, 1], off[:, 0]
        columns = self.compliance[:, picked]
        loads = cho_solve(cho_factor(columns[picked]), rigid)  # half of what an LU takes
        stiffness = rigid.T @ loads
        spread = (columns @ loads).reshape(-1, 2, 3).transpose(1, 0, 2)
        return Grip(middle, (stiffness + stiffness.T) / 2, spread, nodes)


def empty_rows(count: int) -> Array:
    """Rows (count, NUMBERS) for bodies that are not there."""
    return np.zeros((count, obstacles.NUMBERS))
