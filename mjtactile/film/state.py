"""Where a film came to rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array
from mjtactile.film.bodies import Obstacle
from mjtactile.film.fineness import doubt, doubt_of_few


class FilmStatus(IntEnum):
    """How a solution ended, as the kernel says it."""

    CONVERGED = 0
    NOT_CONVERGED = 1
    AT_THE_RIM = 2
    ON_THE_GLASS = 3
    INSIDE_OUT = 4
    BROKEN_DOWN = 5
    GOES_THROUGH = 6
    OVERSTRETCHED = 7


# Places in `found`, as kernels/film.c has them.
WRENCH = slice(0, 6)
PRESSURE, VOLUME, AREA, STATUS, STEPS, STRETCHED, TENSION, LAST_STEP = range(6, 14)
FOUND = 14


@dataclass(frozen=True, eq=False)
class FilmState:
    """A film at rest on what presses it. SI units, frame S.

    Numbers of a state that is not `converged` are NaN.

    Attributes:
        x: (3, nx, ny) m, the nodes' displacements.
        force: (nx, ny) N of the contact at each of them, along -z.
        found: What the kernel adds up; all are kept for a start from here.
        trend: (4, nx, ny) m and N, how `x` and `force` changed on the way here; a start goes on
            with it as far as the bodies that touch did. None: it begins where this ends.
        pressed_by: The grid's wider spacing, m, and the bodies; of a batch, none.
    """

    x: Array
    force: Array
    found: Array
    trend: Array | None = None
    pressed_by: tuple[float, Sequence[Obstacle]] = (0.0, ())

    @property
    def status(self) -> FilmStatus:
        return FilmStatus(int(self.found[STATUS]))

    @property
    def converged(self) -> bool:
        return self.found[STATUS] == 0

    @property
    def steps(self) -> int:
        """Steps that it took."""
        return int(self.found[STEPS])

    def _number(self, place: int) -> float:
        return float(self.found[place]) if self.converged else float("nan")

    @property
    def force_normal(self) -> float:
        """Force, N, that presses into the sensor: -z of the wrench."""
        return -self._number(2)

    @property
    def doubt(self) -> float:
        """Share of the force within which 9 of 10 presses are, because bodies or the contact are
        narrow for the grid (`Film.doubt`, `Film.fine_enough`); 0 where nothing touches."""
        if not self.force_normal > 0:
            return 0.0 if self.converged else float("nan")
        spacing, bodies = self.pressed_by
        return max(doubt(bodies, spacing), doubt_of_few(int(np.count_nonzero(self.force > 0))))

    @property
    def wrench(self) -> Array:
        """Force, N, and torque about the origin of S, N m, (6,) of the bodies on the film;
        frictionless."""
        return self.found[WRENCH].copy() if self.converged else np.full(6, np.nan)

    @property
    def pressure_gauge(self) -> float:
        """Gauge pressure of the gas, Pa."""
        return self._number(PRESSURE)

    @property
    def volume(self) -> float:
        """Volume between the film and the frame's plane, m^3."""
        return self._number(VOLUME)

    @property
    def area(self) -> float:
        """Area of the sheet in contact, m^2."""
        return self._number(AREA)

    @property
    def heights(self) -> Array:
        """Heights (nx, ny) m of the sheet's middle at its nodes, which are at `places`."""
        return self.x[2] if self.converged else np.full(self.x.shape[1:], np.nan)

    @property
    def displacements(self) -> Array:
        """Displacements (3, nx, ny) m of the mounted flat sheet's nodes."""
        return self.x if self.converged else np.full(self.x.shape, np.nan)

    @property
    def contact_forces(self) -> Array:
        """Force (nx, ny) N of the contact along -z, at each node."""
        return self.force if self.converged else np.full(self.force.shape, np.nan)


@dataclass(frozen=True, eq=False)
class FilmBatch:
    """Films of n environments at rest: `x` (n, 3, nx, ny), `force` (n, nx, ny), `found`
    (n, FOUND) and `trend` (n, 4, nx, ny), as of `FilmState`."""

    x: Array
    force: Array
    found: Array
    trend: Array | None = None

    def __len__(self) -> int:
        return len(self.found)

    def __getitem__(self, number: int) -> FilmState:
        trend = None if self.trend is None else self.trend[number]
        return FilmState(self.x[number], self.force[number], self.found[number], trend)

    @property
    def converged(self) -> NDArray[np.bool_]:
        """(n,) of each."""
        return self.found[:, STATUS] == FilmStatus.CONVERGED

    @property
    def force_normal(self) -> Array:
        """(n,) N; NaN where it did not converge."""
        return np.where(self.converged, -self.found[:, 2], np.nan)
