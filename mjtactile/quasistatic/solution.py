"""Where a film came to rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.quasistatic.discretization_error import (
    doubt,
    doubt_of_area,
    doubt_of_few,
    doubt_of_gap,
    lowest_place,
)
from mjtactile.quasistatic.obstacles import Obstacle


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


_COMPLAINTS = {
    FilmStatus.AT_THE_RIM: "an obstacle touches the frame's rim",
    FilmStatus.ON_THE_GLASS: "an obstacle lies on the glass",
    FilmStatus.INSIDE_OUT: "an obstacle pulls the sheet inside out",
    FilmStatus.BROKEN_DOWN: "the numbers break down on this obstacle",
    FilmStatus.GOES_THROUGH: "an obstacle goes through between the film's nodes; take a finer grid",
    FilmStatus.OVERSTRETCHED: "an obstacle stretches the sheet beyond what its law is known for",
}

# Places in `found`, as kernels/qs_workspace.h has them.
WRENCH = slice(0, 6)
PRESSURE, VOLUME, AREA, STATUS, STEPS, STRETCHED, TENSION, LAST_STEP = range(6, 14)
FOUND = 14
_TOUCHES = 5e-5  # m that a body may be behind a sheet that it does not touch


@dataclass(frozen=True, eq=False)
class Pressing:
    """What presses a film.

    Attributes:
        bodies: All of them.
        x: (nx,) m, places of the flat sheet's nodes.
        y: (ny,) m.
        half_thickness: m, by which the sheet's middle stays off its outer face.
    """

    bodies: Sequence[Obstacle] = ()
    x: Array = field(default_factory=lambda: np.zeros(0))
    y: Array = field(default_factory=lambda: np.zeros(0))
    half_thickness: float = 0.0

    @property
    def spacing(self) -> float:
        """m, the wider of both."""
        return max((float(line[1] - line[0]) for line in (self.x, self.y) if len(line)), default=0)


_BY_NOTHING = Pressing()


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
        pressed_by: The bodies, and the film's nodes; of a batch, none.
    """

    x: Array
    force: Array
    found: Array
    trend: Array | None = None
    pressed_by: Pressing = _BY_NOTHING

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
        narrow for the grid, or a tip is behind the sheet between its nodes (`Film.doubt`,
        `Film.fine_enough`); 0 where nothing touches, 1 where a body should and does not."""
        if not self.converged:
            return float("nan")
        on = self.pressed_by
        gap = max((self._gap(body) for body in on.bodies), default=0.0)
        if not self.force_normal > 0:
            return float(gap > _TOUCHES)
        few = doubt_of_few(int(np.count_nonzero(self.force > 0)) // max(len(on.bodies), 1))
        tip = doubt_of_gap(gap, self.force_normal, float(self.found[TENSION]))
        return max(doubt(on.bodies, on.spacing), few, tip)

    @property
    def area_doubt(self) -> float:
        """Share of `area` within which 9 of 10 are: infinite where the contact is a point or a line
        for this grid, whose area it cannot tell; 0 where nothing touches."""
        if not self.converged:
            return float("nan")
        touching = self.force > 0
        if not touching.any():
            return float("inf") if self.doubt else 0.0
        longer = max(int(touching.any(axis=axis).sum()) for axis in (0, 1))
        on = self.pressed_by
        return doubt_of_area(on.bodies, np.count_nonzero(touching) / longer, on.spacing)

    def _gap(self, body: Obstacle) -> float:
        """How far, m, a body's lowest place is behind the sheet; 0 where it is not over it."""
        low, on = lowest_place(body), self.pressed_by
        if low is None:
            return 0.0
        at = low[:2]
        for _ in range(3):  # which place of the flat sheet is there
            found = _between(on.x, on.y, self.x, at)
            if found is None:
                return 0.0
            at = low[:2] - found[:2]
        return float(found[2] - (low[2] - on.half_thickness))

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


def judged(state: FilmState) -> FilmState:
    """The state, or InputError, in one line, for what cannot be."""
    complaint = _COMPLAINTS.get(state.status)
    if complaint is not None:
        raise InputError(complaint, field="obstacle")
    return state


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


def _between(x: Array, y: Array, fields: Array, at: Array) -> Array | None:
    """Fields (k, nx, ny) at a place of the flat sheet, (k,), by the four nodes about it; None
    beside the grid."""
    i = (at[0] - x[0]) / (x[1] - x[0])
    j = (at[1] - y[0]) / (y[1] - y[0])
    if not (0 <= i < len(x) - 1 and 0 <= j < len(y) - 1):
        return None
    m, n = int(i), int(j)
    u, v = i - m, j - n
    shares = np.outer((1 - u, u), (1 - v, v))
    return (fields[:, m : m + 2, n : n + 2] * shares).sum(axis=(1, 2))
