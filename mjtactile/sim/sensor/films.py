"""The films of sensors without a mesh, each made once a process, and the geom that stands for one
in MuJoCo's model."""

from __future__ import annotations

from functools import lru_cache

import mujoco
import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array
from mjtactile.film import Film
from mjtactile.film.live import Sticking
from mjtactile.film.places import carried
from mjtactile.sim.sensor.mesh import MembraneMesh

FILM_GRID = (21, 16)
FEELER = "feeler"


def add_feeler(body: mujoco.MjsBody, design: SensorDesign) -> None:
    """Give a sensor without a mesh the one geom that stands for its sheet: it touches nothing, and
    distances of the sheet from other geoms can be measured with it."""
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
def film_of(design: SensorDesign, grid: tuple[int, int]) -> Film:
    """The film of a sensor, made once a process and shared: nothing in it changes."""
    return Film(design, grid)


def onto_mesh(film: Film, mesh: MembraneMesh) -> Array | None:
    """Displacements of a mesh's vertices by those of a film's nodes, (n, nodes); None: both are the
    same, as a rectangle's are."""
    if film.design.frame.outline is None:
        return None
    by_node = carried(film, mesh.p_SV[:, :2])
    frame = np.setdiff1d(np.arange(len(mesh.p_SV)), mesh.interior)
    by_node[frame] = 0.0
    return by_node


@lru_cache(maxsize=64)
def sticking_of(film: Film) -> Sticking:
    """The film's sheet in the plane, inverted once a process."""
    sticking = Sticking(film)
    sticking.compliance.flags.writeable = False
    return sticking


@lru_cache(maxsize=64)
def bulge_stiffness(film: Film) -> float:
    """dp/dV, Pa/m^3, of the bulge about its rest."""
    step = 0.05 * film.pressure_gauge
    other = Film(film.design, film.grid, film.pressure_gauge + step)
    return step / (other.rest.volume - film.rest.volume)
