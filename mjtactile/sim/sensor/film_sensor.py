"""`FilmSensor`: one attached sensor whose sheet is a film and no part of MuJoCo's model. It serves
as `TactileSensor` does: call `update` before every `mj_step`; read markers and pressure.

The film lies on the bodies where they are (`mjtactile.film`), sticks to them and slides by
Coulomb's law, and pushes them and its own frame with what it bears. It has no mass and no damping:
it is always at rest. Gas and valve are the full sensor's.
"""

from __future__ import annotations

import math
from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core import geometry
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.film import Film, Status
from mjtactile.film.live import LiveFilm
from mjtactile.sim.sensor import limits
from mjtactile.sim.sensor.film_contact import FilmContact, Stiffness
from mjtactile.sim.sensor.geoms import FeltGeoms
from mjtactile.sim.sensor.membrane import BODY
from mjtactile.sim.sensor.mesh import MarkerInterpolator, MembraneMesh
from mjtactile.sim.sensor.pushes import Hold, pushes_of
from mjtactile.sim.sensor.stretches import stretches_of
from mjtactile.sim.sensor.switches import Effect, make_gas

FILM_GRID = (21, 16)
_FLAT = 1.0  # Pa, below which the sheet lies flat
_PATIENCE = 25  # steps without a solution in a row
_LATE = 2  # such steps that are not worth a word
_NO_FLEX = -2
_FEELER = "feeler"


def add_feeler(body: mujoco.MjsBody, design: SensorDesign) -> None:
    """Give a sensor without a mesh the one geom that stands for its sheet: it touches nothing, and
    distances of the sheet from other geoms can be measured with it."""
    body.add_geom(
        name=_FEELER,
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[design.membrane.thickness / 2, 0, 0],
        mass=0.0,
        contype=0,
        conaffinity=0,
        group=4,
    )


class FilmSensor:
    """Runtime of one sensor without a mesh; see `TactileSensor`, whose properties it has."""

    contact = "film"

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        design: SensorDesign,
        mesh: MembraneMesh,
        prefix: str,
        effects: frozenset[str],
    ):
        """`mesh` is the film's grid. Raises InputError for a scene that a film cannot feel."""
        self.design = design
        self.mesh = mesh
        self.prefix = prefix
        self._model = model
        self._data = data
        self._timestep = float(model.opt.timestep)
        self.body_id = _body(model, prefix + BODY)
        self.flex_id = _NO_FLEX
        self.vertex_geom_ids = np.array([model.geom(prefix + _FEELER).id])
        self.contact_ids = np.array([*self.vertex_geom_ids.repeat(2), self.flex_id])
        first = int(model.body_geomadr[self.body_id])
        self.housing_geom_ids = np.arange(first, first + int(model.body_geomnum[self.body_id]))
        self._film = film = _film_of(design, (mesh.nx, mesh.ny))
        top = float(film.rest.x[2].max())
        half = math.hypot(design.frame.length, design.frame.width) / 2
        self._geoms = FeltGeoms(model, data, self.body_id, math.hypot(half, top) + 1e-3)
        self._live = LiveFilm(film, self._geoms.rows, self._geoms.pool)
        friction = design.membrane.friction if Effect.FRICTION in effects else 0.0
        self._contact = FilmContact(self._live, friction, _bulge_stiffness(film))
        self._markers = MarkerInterpolator(mesh, design.markers.p_SM)
        self._gas = make_gas(design.chamber, effects)
        self._pushes = pushes_of(model, data)
        self._pushing = False
        self._moved = np.zeros(6)
        self._shifted = np.zeros(3)
        self._flat = mesh.p_SV[mesh.interior]
        self._place: tuple[int, Array, Array] | None = None
        self._lost = 0
        self._reason = ""
        self._solved = math.nan
        self._time = float(data.time)
        self._rows = np.full_like(self._geoms.rows, math.nan)
        self._touches_many = False
        self.sleepy = True
        self._volume = design.chamber_volume_flat
        self._gas.advance(self._volume, 0.0)
        self._follow()

    # -- before every step

    def update(self) -> None:
        """Come to rest on what is there now, and push; call before every `mj_step`."""
        self._follow()
        self._push()

    def _follow(self) -> None:
        """Bring film, gas and what sticks up to the present poses, once for each moment."""
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        time = float(self._data.time)
        near = self._geoms.look()
        moved = not np.array_equal(self._rows, self._geoms.rows)
        if time == self._solved and not moved and not self._stale():
            return
        self._rows[:] = self._geoms.rows
        free = not near and not self.is_touched
        if not (free and self._gas.is_still and not self._stale() and not math.isnan(self._solved)):
            self._settle(near)
        if time != self._time or math.isnan(self._solved):
            self._volume = self.design.chamber_volume_flat + self._live.volume
            self._gas.advance(self._volume, time - self._time)
            self._time = time
        self._contact_follows(near)
        self._solved = time

    def _stale(self) -> bool:
        """Whether somebody has moved the valve since."""
        return self._gas.is_open and not math.isclose(
            self._live.pressure_gauge, self._gas.supply_gauge, abs_tol=_FLAT
        )

    def _settle(self, near: bool) -> None:
        live = self._live
        gas = self._gas
        kept = live.keep()
        stiffness = gas.stiffness(self._timestep)
        if stiffness <= 0:  # a held pressure
            pressure = gas.supply_gauge if gas.is_open else gas.pressure_gauge
            if abs(pressure) < _FLAT and not near:
                live.lie_flat()
                status = Status.CONVERGED
            else:
                status = live.go_to_pressure(pressure)
        else:
            absolute = gas.pressure_gauge + gas.ambient
            exponent = stiffness * self._volume / absolute
            status = live.rest_on(absolute * self._volume**exponent, True, exponent)
        if status == Status.CONVERGED:
            self._lost = 0
            return
        live.restore(kept)
        self._lost += 1
        self._reason = _REASONS[status]
        if status in (Status.AT_THE_RIM, Status.ON_THE_GLASS):
            self._lost = _PATIENCE

    def _contact_follows(self, near: bool) -> None:
        if not self.is_touched:
            self._contact.release()
            self._place = None
            return
        bodies = self._geoms.near_bodies()
        self._touches_many = len(bodies) > 1
        body = int(bodies[0]) if len(bodies) else -1
        R_SB, p_SB = self._pose(body)
        moved = np.zeros(6)
        if self._place is not None and self._place[0] == body:
            moved = _motion(self._place[1], self._place[2], R_SB, p_SB, self._contact.middle)
        self._contact.follow(moved)
        self._moved = moved
        self._shifted = np.zeros(3) if self._place is None else p_SB - self._place[2]
        self._place = (body, R_SB, p_SB)

    def _pose(self, body: int) -> tuple[Array, Array]:
        data = self._data
        R_WS = data.xmat[self.body_id].reshape(3, 3)
        return R_WS.T @ data.xmat[body].reshape(3, 3), (
            data.xpos[body] - data.xpos[self.body_id]
        ) @ R_WS

    def _push(self) -> None:
        """Write what the film bears to the body that touches and to the frame."""
        if self._place is None:
            if self._pushing:
                self._pushing = False
                self._pushes.set(self.prefix, np.zeros(self._model.nv), None)
            return
        model = self._model
        data = self._data
        body = self._place[0]
        R_WS = data.xmat[self.body_id].reshape(3, 3)
        stiff = self._contact.stiffness(self._gas.stiffness(self._timestep))
        p_WC = data.xpos[self.body_id] + R_WS @ stiff.middle
        wrench = self._contact.wrench
        f_W = R_WS @ wrench[:3]
        t_W = R_WS @ (wrench[3:] - geometry.cross(stiff.middle, wrench[:3]))
        force = np.zeros(model.nv)
        mujoco.mj_applyFT(model, data, f_W, t_W, p_WC, self.body_id, force)
        mujoco.mj_applyFT(model, data, -f_W, -t_W, p_WC, body, force)
        dof = _free_dof(model, body)
        hold = None if dof < 0 else self._hold(body, dof, R_WS, p_WC, stiff)
        self._pushes.set(self.prefix, force, hold)
        self._pushing = True

    def _hold(self, body: int, dof: int, R_WS: Array, p_WC: Array, stiff: Stiffness) -> Hold:
        """How stiffly a free body is held, by the degrees of freedom of its joint."""
        data = self._data
        R_SB = R_WS.T @ data.xmat[body].reshape(3, 3)
        r = R_WS.T @ (p_WC - data.xpos[body])
        across = np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])
        G = np.zeros((6, 6))
        G[:3, :3] = R_WS.T
        G[:3, 3:] = -across @ R_SB
        G[3:, 3:] = R_SB
        weight = np.concatenate([stiff.along, stiff.about])
        moved = np.concatenate([R_WS @ self._shifted, R_SB.T @ self._moved[3:]])
        return Hold(dof, (G.T * weight) @ G, moved / self._timestep)

    # -- what it is like now

    @property
    def is_asleep(self) -> bool:
        """Whether nothing is near and nothing moves it."""
        return not self.is_touched and not self._geoms.near.any() and self._gas.is_still

    @property
    def is_touched(self) -> bool:
        """Whether anything touches the film."""
        return bool(self._live.force.any())

    def wake(self) -> None:
        """Nothing to wake; as `TactileSensor` has it."""

    @property
    def time(self) -> float:
        return float(self._data.time)

    @property
    def wrench(self) -> Array:
        """(6,) N and N m about the origin of S that the world exerts on the film, at the last
        solution."""
        return self._contact.wrench if self.is_touched else np.zeros(6)

    @property
    def contact_area(self) -> float:
        """m^2 of the film that lies on what touches it."""
        return self._live.area if self.is_touched else 0.0

    @property
    def slides(self) -> bool:
        """Whether what touches is at friction's limit."""
        return self._contact.slides

    def contact_forces(self) -> tuple[Array, Array]:
        """Forces (n, 3) N on the film at its nodes that touch, and their places (n, 3) m in S;
        what shears is shared out as the normal force is."""
        force = self._live.force
        i, j = np.nonzero(force > 0)
        film = self._film
        x = self._live.x
        places = np.stack([film.x[i] + x[0, i, j], film.y[j] + x[1, i, j], x[2, i, j]], axis=1)
        normal = force[i, j]
        share = normal / normal.sum() if len(normal) else normal
        wrench = self.wrench
        return np.column_stack([share * wrench[0], share * wrench[1], -normal]), places

    @property
    def p_SV(self) -> Array:
        """Positions (n, 3) m in S of the film's nodes now, the frame's among them."""
        self._follow()
        p_SV = self.mesh.p_SV + self._live.x.reshape(3, -1).T
        spread = self._contact.spread()
        if spread is not None:
            p_SV[self.mesh.interior, :2] += spread.T
        return p_SV

    @property
    def heights(self) -> Array:
        """Heights (k,) m of the inner nodes."""
        return self._live.x[2].ravel()[self.mesh.interior]

    @property
    def displacements(self) -> Array:
        """Displacements (3 k,) m of the inner nodes from the flat sheet; a copy."""
        return np.ascontiguousarray(self._live.x.reshape(3, -1).T[self.mesh.interior]).ravel()

    def penetrations(self, rows: NDArray[np.int64]) -> Array:
        """None: a film lies on what touches it."""
        return np.zeros(len(rows))

    @property
    def dofs(self) -> NDArray[np.int64]:
        """A film has no degrees of freedom in the model."""
        return np.empty(0, np.int64)

    def marker_poses(self) -> tuple[Array, Array]:
        """Marker centres (N, 3) m and outward unit normals (N, 3) in S, in the design's order."""
        return self._markers.marker_poses(self.p_SV)

    def marker_poses_before(self, seconds: float) -> tuple[Array, Array]:
        """Where the markers are: a film at rest has no velocity, and images of it no motion
        blur."""
        return self.marker_poses()

    def height_at(self, x: float, y: float) -> float:
        """Height, m, of the material point (x, y) of the flat sheet."""
        at = MarkerInterpolator(self.mesh, np.array([[x, y, 0.0]]))
        return float(at.marker_poses(self.p_SV)[0][0, 2])

    def stretches(self) -> tuple[Array, Array]:
        """Principal stretches (m, 2) of each triangle against the free sheet, and areas (m,)
        m^2."""
        return stretches_of(self.design, self.mesh, self.p_SV)

    def stretch_and_area(self) -> tuple[float, float]:
        """Largest principal stretch, and the film's area, m^2."""
        stretches, areas = self.stretches()
        return float(stretches.max()), float(areas.sum())

    # -- the chamber, as of `TactileSensor`

    @property
    def pressure_gauge(self) -> float:
        return self._gas.pressure_gauge

    @property
    def gas_time(self) -> float:
        return self._time

    @property
    def temperature(self) -> float:
        return self._gas.temperature

    @property
    def volume(self) -> float:
        return self._volume

    @property
    def valve_is_open(self) -> bool:
        return self._gas.is_open

    def open_valve(self, supply_gauge: float | None = None) -> None:
        """Connect the chamber to a supply at `supply_gauge` Pa (default: the design's)."""
        self._follow()
        self._gas.open(self.design.chamber.supply_gauge if supply_gauge is None else supply_gauge)

    def close_valve(self) -> None:
        """Trap the gas that is in the chamber now."""
        self._follow()
        self._gas.close()

    def inflate(self, displacements: Array, pressure_gauge: float) -> None:
        """Be at rest with these displacements (3 k,) m, sealed at `pressure_gauge` Pa."""
        live = self._live
        live.lie_flat()
        x = live.x.reshape(3, -1)
        x[:, self.mesh.interior] = displacements.reshape(-1, 3).T
        live.rest_on(pressure_gauge, False, 1.0)
        self._volume = self.design.chamber_volume_flat + live.volume
        self._gas.seal(self._volume, pressure_gauge)
        self._time = self.time
        self._solved = math.nan
        self._follow()

    def puncture(self, conductance: float) -> None:
        """Make a hole to ambient of `conductance` m^3/(s Pa); 0 mends it."""
        self._gas.puncture(conductance)

    def warm(self, rate: float) -> None:
        """From now on, gas and walls get warmer by `rate` K/s."""
        self._gas.warm(rate)

    # -- its limits

    def flags(self) -> limits.Flags:
        """What makes the present numbers less good than they look."""
        flags: limits.Flags = {}
        if self._lost > _LATE:
            flags["film"] = f"the film found no rest for {self._lost} steps: {self._reason}"
        if self._touches_many:
            flags["bodies"] = (
                "several bodies are near one film, which takes all that touches it for the first "
                "of them; leave the sheet on"
            )
        return flags | limits.sheet_flags(self.design, self.pressure_gauge, *self.stretches())

    def failure(self) -> str | None:
        """Say why this sensor's state is outside what the film describes, or None."""
        if self._lost >= _PATIENCE:
            return f"sensor {self.prefix!r}: {self._reason}; leave the sheet on"
        if self._volume <= 0:
            return f"sensor {self.prefix!r}: the chamber has no volume left"
        return None


_REASONS = {
    Status.NOT_CONVERGED: "the film does not come to rest on what touches it",
    Status.AT_THE_RIM: "something presses below the frame's rim",
    Status.ON_THE_GLASS: "the membrane is pushed against the glass",
    Status.INSIDE_OUT: "what touches is steeper than a film can follow",
    Status.BROKEN_DOWN: "what touches is more than a film can follow",
}


@lru_cache(maxsize=64)
def _film_of(design: SensorDesign, grid: tuple[int, int]) -> Film:
    """The film of a sensor, made once a process and shared: nothing in it changes."""
    return Film(design, grid)


@lru_cache(maxsize=64)
def _bulge_stiffness(film: Film) -> float:
    """dp/dV, Pa/m^3, of the bulge about its rest."""
    step = 0.05 * film.pressure_gauge
    other = Film(film.design, film.grid, film.pressure_gauge + step)
    return step / (other.rest.volume - film.rest.volume)


def _free_dof(model: mujoco.MjModel, body: int) -> int:
    """Address of a body's own free joint, or -1."""
    if model.body_jntnum[body] != 1:
        return -1
    joint = int(model.body_jntadr[body])
    if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE:
        return -1
    return int(model.jnt_dofadr[joint])


def _motion(R_0: Array, p_0: Array, R_1: Array, p_1: Array, middle: Array) -> Array:
    """(6,) by which the body's point at `middle` moved, m, and its turn, rad, between two poses."""
    R = R_1 @ R_0.T
    turn = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    was = R.T @ (middle - p_1) + p_0
    return np.concatenate([middle - was, turn])


def _body(model: mujoco.MjModel, name: str) -> int:
    found = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
    if found < 0:
        raise InputError(
            f"the model has no body {name!r}; was it compiled from the spec that the sensor was "
            "attached to?",
            source="bind",
            field="model",
        )
    return found
