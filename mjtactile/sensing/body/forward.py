"""From a body to where the markers stand, by the film (docs/equations.md, Eq. X1-X5)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import make_interp_spline

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array
from mjtactile.film import Film, FilmState, Obstacle
from mjtactile.film.state import FilmBatch
from mjtactile.sensing.force.inverse import InverseRest

_MORE = 0.02  # of the pressure, for its derivative


class Forward:
    """The film of one sensor at rest, and where its markers stand on it.

    Args:
        design: The sensor.
        rest: What it measured of itself.
        p_rest: (N, 3) m, its markers at rest in S, as measured.
        grid: The film's nodes.
    """

    def __init__(
        self, design: SensorDesign, rest: InverseRest, p_rest: Array, grid: tuple[int, int]
    ):
        sheet = replace(design.membrane, young=rest.stiffness_scale * design.membrane.young)
        self.film = Film(
            replace(design, membrane=sheet),
            grid,
            rest.gas.gauge,
            sealed=rest.gas.constant is not None,
        )
        material = design.markers.p_SM
        self._along = [
            make_interp_spline(nodes, np.eye(len(nodes)))(np.clip(at, nodes[0], nodes[-1]))
            for nodes, at in zip((self.film.x, self.film.y), material[:, :2].T, strict=True)
        ]
        self._offset = p_rest - self.displaced(self.film.rest.x[None])[0]
        self.by_gas = self._by_gas()

    def _by_gas(self) -> Array:
        """Heights (N,) m of the markers by the share of gas that is there more than was
        measured."""
        film = self.film
        if not film.sealed:
            return np.zeros(len(self._offset))
        more = Film(film.design, film.grid, (1 + _MORE) * film.pressure_gauge)
        rise = _MORE * film.pressure_gauge
        chamber = film.design.chamber
        absolute = film.pressure_gauge + chamber.ambient
        volume = film.design.chamber_volume_flat + film.rest.volume
        yields = absolute / volume * (more.rest.volume - film.rest.volume) / rise
        by_pressure = self.displaced(np.stack([film.rest.x, more.rest.x]))[:, :, 2]
        return (by_pressure[1] - by_pressure[0]) / rise * absolute / (1 + yields)

    def displaced(self, x: Array) -> Array:
        """Displacements (n, N, 3) m of the markers, of films with nodes displaced by `x`
        (n, 3, nx, ny)."""
        rows = np.einsum("mi,ncij->ncmj", self._along[0], x)
        return np.einsum("mj,ncmj->nmc", self._along[1], rows)

    def markers(self, x: Array) -> Array:
        """Where markers are seen, (n, N, 3) m in S."""
        return self.displaced(x) + self._offset

    def solve(
        self, bodies: Sequence[Sequence[Obstacle]], start: FilmState | None = None
    ) -> FilmBatch:
        """Films on each set of bodies, from `start`."""
        count = len(bodies)
        batch = None
        if start is not None:
            batch = FilmBatch(
                *(
                    np.repeat(one[None], count, axis=0)
                    for one in (start.x, start.force, start.found)
                )
            )
        return self.film.solve_batch(bodies, batch)
