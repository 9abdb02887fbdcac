"""Tangent stiffness of a membrane at a state, with constant gas pressure."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from mjtactile.core.types import Array
from mjtactile.kernels import band_stride, kernel
from mjtactile.quasistatic.solution import MembraneSolution


class Sheet(Protocol):
    """Attributes of a `QuasistaticMembrane` that its stiffness needs."""

    grid: tuple[int, int]
    _numbers: Array
    _law: Array
    _room: Array


def factor_of(film: Sheet, state: MembraneSolution) -> Array:
    """Return the Cholesky factor's lower band (width + 1, 3 inner nodes) in SciPy's format."""
    width = 3 * film.grid[1] - 1
    return np.ascontiguousarray(_band(film, state)[:, : width + 1].T)


def compliance_of(film: Sheet, state: MembraneSolution) -> Array:
    """Return the in-plane compliance (2 inner, 2 inner), m/N, of a membrane with free heights."""
    band = _band(film, state)
    count = 2 * len(band) // 3
    room = np.empty(8 * len(band))
    found = np.empty((count, count))
    kernel("film_compliance")(*film.grid, band, room.size, room, found)
    return found


def _band(film: Sheet, state: MembraneSolution) -> Array:
    """The factor by columns, as kernels/band_cholesky_f64.h has it."""
    columns, rows = film.grid
    band = np.empty((3 * (columns - 2) * (rows - 2), band_stride(3 * rows - 1)))
    fixed = (film._numbers, film._law, *film.grid)
    given = (state.x, state.gauge_pressure, film._room.size, film._room)
    kernel("film_stiffness")(*fixed, *given, band)
    return band
