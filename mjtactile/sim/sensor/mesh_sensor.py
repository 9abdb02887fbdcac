"""`TactileSensor`: one attached sensor at run time, whose membrane is a mesh in the model."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core import analytical_solutions
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.flags import Reasons
from mjtactile.core.neo_hookean import Law, principal_stresses
from mjtactile.core.types import Array
from mjtactile.sim.sensor import validity_checks
from mjtactile.sim.sensor.base_sensor import BaseSensor, require
from mjtactile.sim.sensor.contact_points import ContactPoints
from mjtactile.sim.sensor.curvature_standoff import StandOff
from mjtactile.sim.sensor.effect_switches import PHYSICS, make_geometry, make_load
from mjtactile.sim.sensor.membrane import FLEX, ContactStiffness, pre_stretch, touch_with
from mjtactile.sim.sensor.mesh import MembraneMesh
from mjtactile.sim.sensor.own_links import exclude_from_elements
from mjtactile.sim.sensor.rubber_flex import RelaxingMesh, Rubber, all_rows
from mjtactile.sim.sensor.sharp_geoms import missed
from mjtactile.sim.sensor.sleep import Sleeper
from mjtactile.sim.sensor.spin_damping_correction import SpinCorrection
from mjtactile.sim.sensor.stiction import Stiction
from mjtactile.sim.sensor.thin_object_margin import ThinObjectMargin, refuse_thin

GLASS_MARGIN = 0.02
"""Fraction of the chamber's depth in front of the glass that the membrane may not enter."""


class TactileSensor(BaseSensor):
    """Run-time state of one sensor with a mesh. Call `update` before every `mj_step`."""

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        design: SensorDesign,
        mesh: MembraneMesh,
        prefix: str,
        contact: str = "auto",
        effects: frozenset[str] = PHYSICS,
    ):
        """Bind the sensor; `contact` is "vertices", "elements", "both", or "auto" by the scene."""
        super().__init__(model, data, design, mesh, prefix, effects)
        self.flex_id = require(model, mujoco.mjtObj.mjOBJ_FLEX, prefix + FLEX)
        self.vertex_geom_ids = _vertex_geoms(model, mesh, prefix)
        self.contact_ids = np.array(
            [self.vertex_geom_ids[0], self.vertex_geom_ids[-1], self.flex_id]
        )
        """Ids that identify the membrane in a contact: first and last contact sphere (one
        contiguous block) and the flex."""
        pre_stretch(model, self.flex_id, mesh, design.membrane.pre_stretch)
        # a trace is needed to compile without a warning, none to simulate
        model.flex_damping[self.flex_id] = 0.0
        self._make_contact(model, data, contact)
        self._make_membrane(model, data, effects)
        self._sleeper = Sleeper(
            model, data, mesh, self._tendon, self.flex_id, self.body_id, self.vertex_geom_ids
        )
        self._follow()

    def _make_contact(self, model: mujoco.MjModel, data: mujoco.MjData, contact: str) -> None:
        """Select the contact model and create its stiffness, margins and stiction."""
        mesh = self.mesh
        membrane = self.design.membrane
        vertices = self.vertex_geom_ids
        self.missed = missed(model, self.body_id, mesh)
        """Radius, m, and name of the thinnest geom that could slip between vertices."""
        if contact == "auto":
            contact = "elements" if np.isfinite(self.missed[0]) else "vertices"
        self.contact = contact
        on_vertices = contact == "vertices"
        if not on_vertices:
            refuse_thin(model, self.body_id, mesh)
        touch_with(model, vertices, self.flex_id, self.contact)
        if not on_vertices:
            exclude_from_elements(model, self.body_id, self.flex_id)
        self._contact_stiffness = ContactStiffness(
            model, vertices, self.flex_id, mesh, membrane, remembers=on_vertices
        )
        # live views
        self._frictions = model.geom_friction[vertices[0] : vertices[-1] + 1, 0]
        self._flex_friction = model.flex_friction[self.flex_id]
        self._margins = model.geom_margin[vertices[0] : vertices[-1] + 1]
        bodies = model.geom_bodyid[vertices]
        self._body_margins = model.body_margin[bodies[0] : bodies[-1] + 1]
        self._stand_off = StandOff(model, data, vertices, mesh)
        self._approach: ThinObjectMargin | None = None
        self._points: ContactPoints | None = None
        self._stiction: Stiction | None = None
        if on_vertices:
            stiffness = membrane.young * membrane.thickness
            self._points = ContactPoints(model, data, vertices, self.body_id, mesh, stiffness)
            self._stiction = Stiction(model, data, vertices, self.body_id)
        else:
            self._approach = ThinObjectMargin(model, data, self.body_id, self.flex_id, mesh)

    @property
    def friction(self) -> float:
        return float(self._frictions[0])

    def set_friction(self, friction: float) -> None:
        self._frictions[:] = friction
        self._flex_friction[0] = friction

    def _make_membrane(
        self, model: mujoco.MjModel, data: mujoco.MjData, effects: frozenset[str]
    ) -> None:
        """Create the rubber's law, the load of the gas, and the volume it encloses."""
        mesh = self.mesh
        design = self.design
        self._rubber: Rubber | None = None
        if design.membrane.law is Law.NEO_HOOKEAN:
            self._rubber = Rubber(model, self.flex_id, mesh, design.membrane)
        self._relaxing = _relaxing(design, mesh)
        self._turning = SpinCorrection(model, data, self.body_id, self.flex_id, mesh)
        self._tendon = make_load(model, data, mesh, self.prefix, effects)
        if self._relaxing and self._rubber:
            rows = all_rows(model, self.flex_id)
            self._relaxing.carry(self._rubber.thin, rows, self._tendon.forces)
        # rooms for every step
        self._p_SV = mesh.p_SV.copy()
        self._flat = mesh.p_SV[mesh.interior].ravel()
        self._moved = np.empty_like(self._flat)
        self._geometry = make_geometry(mesh, design.chamber_volume_flat, effects)
        # volume and time of the last gas update
        self._volume = design.chamber_volume_flat
        self._time = self.time

    def update(self) -> None:
        """Update gas volume, pressure and stiffness to the present state, unless asleep."""
        if self._sleeper.asleep:
            if self.sleepy and not self._sleeper.wakes():
                return
            self.wake()
        elif self.sleepy and self._sleeper.may_sleep(self._is_still):
            self._sleeper.sleep()
            self._turning.stop()
            return
        self._follow()

    @property
    def is_asleep(self) -> bool:
        return self._sleeper.asleep

    @property
    def _is_still(self) -> bool:
        """True if gas and rubber are in equilibrium."""
        return self._gas.is_still and (self._relaxing is None or self._relaxing.is_still)

    @property
    def is_touched(self) -> bool:
        """True if the membrane had a contact at the last step."""
        contact = self._data.contact
        geom = contact.geom
        spheres = (geom >= self.vertex_geom_ids[0]) & (geom <= self.vertex_geom_ids[-1])
        return bool(spheres.any() or (contact.flex == self.flex_id).any())

    def wake(self) -> None:
        """Resume from the state in which the sensor fell asleep."""
        self._sleeper.stay_awake()
        if self._sleeper.asleep:
            self._sleeper.wake()
            self._time = float(self._data.time)  # no gas has flowed during sleep
            self._follow()

    def _update_to_now(self) -> None:
        self.wake()
        self._follow()

    def _follow(self) -> None:
        np.add(self._flat, self._tendon.displacements, out=self._moved)
        p_SV = self._p_SV
        p_SV[self.mesh.interior] = self._moved.reshape(-1, 3)
        self._volume, gradient = self._geometry.volume_and_gradient(p_SV)
        time = float(self._data.time)
        elapsed = time - self._time
        self._gas.advance(self._volume, elapsed)
        self._time = time
        pressure = self._gas.gauge_pressure
        if self._relaxing:
            # reset the load's forces, because relaxation forces are added to them
            self._tendon.resume()
        self._tendon.apply(pressure, self._gas.stiffness(self._timestep), gradient)
        self._contact_stiffness.set_pressure(pressure)
        if self._rubber:
            self._rubber.update(p_SV)
            if self._relaxing:
                self._relaxing.update(p_SV, elapsed)
        self._turning.update(p_SV)
        self._stand_off.update()
        if self._approach:
            self._approach.update(p_SV)
        if self._points:
            self._points.update(p_SV, self.tensions, pressure)
        if self._stiction:
            self._stiction.update(self._stand_off.margins)
        else:
            self._margins[:] = self._stand_off.margins  # only vertices remember
        # MuJoCo compiles this maximum and searches contacts of bodies with several geoms within it
        self._body_margins[:] = self._margins

    @property
    def p_SV(self) -> Array:
        """Vertex positions (n, 3) m in S, rim included, now (not one step old)."""
        p_SV = self.mesh.p_SV.copy()
        p_SV[self.mesh.interior] = (self._flat + self._tendon.displacements).reshape(-1, 3)
        return p_SV

    @property
    def heights(self) -> Array:
        """Heights (k,) m in S of the interior vertices now; a copy."""
        return self._flat[2::3] + self._tendon.displacements[2::3]

    @property
    def displacements(self) -> Array:
        """Present displacements (3 k,) m of the interior vertices from the flat membrane; a
        copy."""
        return self._tendon.displacements.copy()

    def penetrations(self, rows: NDArray[np.int64]) -> Array:
        """Return penetration depths (n,) m of this sensor's contacts `rows` of MuJoCo's list."""
        contact = self._data.contact
        first = int(self.vertex_geom_ids[0])
        pairs = contact.geom[rows]
        mine = (pairs >= first) & (pairs <= self.vertex_geom_ids[-1])
        vertices = np.where(mine[:, 1], pairs[:, 1], pairs[:, 0]) - first
        on_vertex = mine.any(axis=1)  # else on a triangle
        stand_off = self._stand_off.margins[np.where(on_vertex, vertices, 0)]
        skin = self._approach.skin if self._approach else 0.0
        margins = np.where(on_vertex, stand_off, skin)
        return margins - contact.dist[rows]

    @property
    def dofs(self) -> NDArray[np.int64]:
        """The degrees of freedom of the vertices, x, y, z of one after the other."""
        return np.arange(self._tendon.dofs.start, self._tendon.dofs.stop)

    def marker_poses_before(self, seconds: float) -> tuple[Array, Array]:
        """Return marker poses `seconds` ago by the present velocity, for motion blur."""
        p_SV = self.p_SV
        velocity = np.asarray(self._data.qvel)[self._tendon.dofs].reshape(-1, 3)
        p_SV[self.mesh.interior] -= seconds * velocity
        return self._markers.marker_poses(p_SV)

    def tensions(self) -> Array:
        """Return the tension (n,) N/m at the vertices: the geometric mean of the principal ones."""
        membrane = self.design.membrane
        triangles = self.mesh.triangles.ravel()
        stretches = np.maximum(self.stretches()[0], 0.1)
        stresses = principal_stresses(stretches, membrane.young, membrane.poisson, membrane.law)
        along = (
            membrane.thickness
            * np.maximum(stresses, 0.0)
            * stretches**2
            / stretches.prod(axis=1, keepdims=True)
        )
        mean = np.sqrt(along.prod(axis=1))
        count = len(self.mesh.p_SV)
        return np.bincount(triangles, np.repeat(mean, 3), count) / np.bincount(
            triangles, minlength=count
        )

    @property
    def volume(self) -> float:
        """Gas volume, m^3, at the last `update`."""
        return self._volume

    @property
    def gas_time(self) -> float:
        """Time at which `gauge_pressure` was valid, s."""
        return self.time if self.is_asleep else self._time

    def inflate(self, displacements: Array, gauge_pressure: float) -> None:
        """Set the vertices to `displacements` (3 k,), m, at rest, and seal at `gauge_pressure`,
        Pa."""
        self.wake()
        self._tendon.displacements[:] = displacements
        self._data.qvel[self._tendon.dofs] = 0.0
        self._gas.seal(self._geometry.volume_and_gradient(self.p_SV)[0], gauge_pressure)
        self._time = self.time
        if self._relaxing:
            self._relaxing.settle(self.p_SV)
        self._follow()

    @property
    def chatter(self) -> tuple[float, float]:
        """Standard deviation of the contact's normal force from step to step, and its mean, N."""
        return self._stiction.chatter if self._stiction else (0.0, 0.0)

    def flags(self) -> Reasons:
        """Return flags for reduced accuracy of the present state; empty when there are none."""
        return validity_checks.membrane_flags(self.design, self.gauge_pressure, *self.stretches())

    def failure(self) -> str | None:
        """Return the reason why this sensor's state is outside the model's validity, or None."""
        if self.is_asleep:
            return None
        moved = self._tendon.displacements
        depth = self.design.chamber.depth
        maximum = max(moved.max(), -moved.min())
        if maximum > (1 - GLASS_MARGIN) * depth and moved[2::3].min() < -(1 - GLASS_MARGIN) * depth:
            return (
                f"sensor {self.prefix!r}: the membrane is pushed against the glass "
                f"({depth * 1e3:g} mm deep)"
            )
        if (empty := self._empty()) is not None:
            return empty
        extent = 2 * max(self.design.frame.length, self.design.frame.width)
        if maximum > extent:
            pressure = self.gauge_pressure
            bursts = self.design.membrane.law is Law.NEO_HOOKEAN and np.isnan(
                analytical_solutions.bulge_height(self.design, pressure)
            )
            return (
                f"sensor {self.prefix!r}: the membrane has moved "
                f"by more than {extent * 1e3:g} mm"
                f"{f'; rubber like this may not hold {1e-3 * pressure:.3g} kPa' if bursts else ''}"
            )
        return None


def _vertex_geoms(model: mujoco.MjModel, mesh: MembraneMesh, prefix: str) -> NDArray[np.int64]:
    """Return the ids of the contact spheres of the mesh's interior vertices."""
    names = [f"{prefix}v{v}" for v in mesh.interior]
    return np.array([require(model, mujoco.mjtObj.mjOBJ_GEOM, name) for name in names])


def _relaxing(design: SensorDesign, mesh: MembraneMesh) -> RelaxingMesh | None:
    if design.relaxation is None:
        return None
    if design.membrane.law is not Law.NEO_HOOKEAN:
        raise InputError(
            "relaxation requires neo-Hookean rubber: leave out relaxation as well as "
            "hyperelasticity",
            source=design.name,
            field="effects",
        )
    return RelaxingMesh(mesh, design.membrane, design.relaxation)
