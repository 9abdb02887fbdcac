"""Quasi-static membranes of sensors without a mesh, made once per process, and their geoms."""

from __future__ import annotations

from functools import lru_cache

import mujoco

from mjtactile.core.design import SensorDesign
from mjtactile.quasistatic import QuasistaticMembrane
from mjtactile.quasistatic.incremental import IncrementalMembrane, Sticking, empty_rows

QS_GRID = (21, 16)
FEELER = "feeler"
_TOLERANCE = 2  # index in a membrane's settings
_CLOSE = 1e-9  # tolerance, m


def add_feeler(body: mujoco.MjsBody, design: SensorDesign) -> None:
    """Add the geom of a sensor without a mesh; it measures distances and makes no contacts."""
    body.add_geom(
        name=FEELER,
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[design.membrane.thickness / 2, 0, 0],
        mass=0.0,
        contype=0,
        conaffinity=0,
        group=4,
    )


@lru_cache(maxsize=64)
def film_of(design: SensorDesign, grid: tuple[int, int]) -> QuasistaticMembrane:
    """Return the quasi-static membrane of a sensor, made once per process."""
    return QuasistaticMembrane(design, grid)


@lru_cache(maxsize=64)
def sticking_of(film: QuasistaticMembrane) -> Sticking:
    """Return the membrane's in-plane compliance, inverted once per process."""
    sticking = Sticking(film)
    sticking.compliance.flags.writeable = False
    return sticking


@lru_cache(maxsize=64)
def bulge_stiffness(film: QuasistaticMembrane) -> float:
    """dp/dV, Pa/m^3, of the bulge about its rest."""
    step = 0.05 * film.gauge_pressure
    live = IncrementalMembrane(film, empty_rows(0), None)
    live.x[:] = film.rest.x
    live.settings[_TOLERANCE] = _CLOSE
    live.rest_on(film.gauge_pressure + step, False, 1.0)
    return step / (live.volume - film.rest.volume)
