"""`Touch`: tactile sensors in all worlds of a scene of MuJoCo Warp."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np
import warp as wp

from mjtactile.warp.arrays import floats, vectors
from mjtactile.warp.contact_stiffness import ContactStiffness
from mjtactile.warp.device.contact import Patch
from mjtactile.warp.device.forces import Contacts, add_forces
from mjtactile.warp.device.gas import Heat
from mjtactile.warp.device.joints import Joints, Motion
from mjtactile.warp.device.markers import find_markers
from mjtactile.warp.device.sticking import NodeLoads
from mjtactile.warp.device.update import States, reset_worlds
from mjtactile.warp.marker_positions import weights_of
from mjtactile.warp.membranes import Membranes
from mjtactile.warp.physics import Physics
from mjtactile.warp.sticking import new_sticking

_FREE = int(mujoco.mjtJoint.mjJNT_FREE)


class Touch:
    """Tactile sensors in all worlds of one scene; `bind` makes it.

    Its arrays stay on the device, and every `mujoco_warp.step` updates them:

    - `wrench` (worlds, fingers, 6): N and N m on the membrane, about the origin of S.
    - `pressure` (worlds, fingers): gauge pressure, Pa.
    - `status` (worlds, fingers): 0 if the last solution is an equilibrium, 1 if it is not yet one,
      else the reason for its rejection (`mjtactile.quasistatic.MembraneStatus`). A rejected
      solution keeps the last good one, in its own world only.
    - `area` m^2, and of the body with the largest force: `center` m in S, `slides` (1 at the
      friction limit), `slid` m since first touch. All are (worlds, fingers).
    - `friction`, `modulus` (a factor), `sealed` and `supply` (worlds, fingers) may be written.
      Where `sealed` is 0, a valve connects the chamber to `supply`, Pa (gauge). `reset` seals the
      chamber with the sensor's pressure at `rest_volume`, m^3, which may be written, too.
    """

    def __init__(
        self, model: mujoco.MjModel, m: Any, d: Any, membranes: Membranes, sensor_geoms: Any
    ):
        self.membranes = membranes
        self._m, self._d = m, d
        count, worlds = membranes.count, d.nworld
        self.worlds, self.fingers = worlds, count // worlds
        self._physics = Physics(
            membranes,
            membranes.scheme,
            new_sticking(membranes),
            sensor_geoms,
            membranes.fields,
            membranes.gas,
            _heat(membranes, float(model.opt.timestep)),
            _states(membranes, sensor_geoms),
        )
        fields, states = membranes.fields, self._physics.states
        self._joints = _joints(model, worlds)
        self._contacts = _contacts(self._physics)
        self._contact_stiffness: ContactStiffness | None = None
        self._markers: Any = None
        shape = (worlds, self.fingers)
        # the same, of all membranes in one row: (worlds * fingers, ...)
        self.membrane_wrench, self.membrane_status = states.wrench, fields.status
        self.membrane_friction, self.membrane_patches = states.friction, states.patches
        rest = float(membranes.membrane.rest.volume)
        self.membrane_volume = wp.full(count, rest, dtype=float)
        self.rest_volume = self.membrane_volume.reshape((worlds, self.fingers))
        self.wrench = states.wrench.reshape((*shape, 6))
        self.pressure = fields.pressure.reshape(shape)
        self.status = fields.status.reshape(shape)
        self.area = states.area.reshape(shape)
        self.center = states.center.reshape(shape)
        self.slides = states.slides.reshape(shape)
        self.slid = states.slid.reshape(shape)
        self.friction = states.friction.reshape(shape)
        self.modulus = membranes.modulus.reshape(shape)
        self.sealed = membranes.gas.sealed.reshape(shape)
        self.supply = self._physics.heat.supply.reshape(shape)
        m.dof_damping = self._joints.damping
        self.reset()

    def update(self, m: Any, d: Any) -> None:
        """Find the equilibria on the present poses, and add the forces.

        `mujoco_warp.step` calls it.
        """
        self._physics.update(m, d)
        arrays = (m.opt.timestep, d.qfrc_passive, d.sensordata)
        inputs = [self._contacts, self._joints, _motion(d), *arrays]
        wp.launch(add_forces, dim=self.worlds, inputs=inputs)

    def markers(self) -> Any:
        """Compute the marker positions of the last step.

        Returns:
            (worlds, fingers, markers) Array of Warp of vectors, m, frame S, in the layout's order.
            The next call overwrites it.
        """
        part, physics = self.membranes, self._physics
        states = physics.states
        with wp.ScopedDevice(part.device):
            if self._markers is None:
                rest, weights = weights_of(part.membrane)
                self._markers = vectors(rest), floats(weights)
                count = self._markers[0].shape[0]
                self._positions = wp.zeros((part.count, count), dtype=wp.vec3)
            wp.launch_tiled(
                find_markers,
                dim=[part.count],
                inputs=[
                    *(part.rubber, part.fields, states.nodes),
                    *(physics.sticking, *self._markers, self._positions),
                ],
                block_dim=part.block,
            )
        return self._positions.reshape((self.worlds, self.fingers, -1))

    def stiffness(self) -> Any:
        """Compute the derivatives of `wrench` by the pose of the obstacles at the last step.

        Six warm solutions with friction, of the gas within one time step.

        Returns:
            (worlds, fingers, 6, 6) Array of Warp, N/m, N m/m, N/rad, N m/rad: rows are forces and
            torques, columns are translations of all obstacles along the axes of S and rotations
            about them. The next call overwrites it.
        """
        with wp.ScopedDevice(self.membranes.device):
            if self._contact_stiffness is None:
                self._contact_stiffness = ContactStiffness(self._physics)
            self._contact_stiffness.find(self._m, self._d)
        return self._contact_stiffness.matrix.reshape((self.worlds, self.fingers, 6, 6))

    def reset(self, mask: Any = None) -> None:
        """Return membranes to rest without contact in the worlds that start again.

        Args:
            mask: (worlds,) bool array of Warp; None: all worlds.
        """
        if mask is None:
            mask = wp.full(self.worlds, True, dtype=bool)
        membrane = self.membranes.membrane
        wp.launch(
            reset_worlds,
            dim=(self.membranes.count, self.membranes.rubber.rest.shape[1]),
            inputs=[
                *(self.fingers, mask, self.membranes.rubber.rest, float(membrane.gauge_pressure)),
                *(float(membrane.rest.volume), self.membrane_volume, self.membranes.gas),
                *(self._physics.heat, self.membranes.fields, self._physics.states),
            ],
        )

    def failures(self) -> int:
        """Return the number of membranes whose last solution was rejected. Waits for the device."""
        return int((self.status.numpy() > 1).sum())


def _states(membranes: Membranes, sensor_geoms: Any) -> Any:
    count, nodes = membranes.count, membranes.grid[0] * membranes.grid[1]
    states = States()
    states.patches = wp.zeros((count, sensor_geoms.bodies.shape[1]), dtype=Patch)
    states.before = wp.zeros((count, 3, nodes), dtype=float)
    states.nodes = NodeLoads()
    states.nodes.load = wp.zeros((count, 2, nodes), dtype=float)
    states.nodes.lag = wp.zeros((count, 2, nodes), dtype=float)
    states.nodes.unit = wp.zeros((count, 6 * sensor_geoms.bodies.shape[1], nodes), dtype=float)
    friction = float(membranes.design.membrane.friction)
    states.friction = wp.full(count, friction, dtype=float)
    states.wrench = wp.zeros((count, 6), dtype=float)
    states.area, states.slid = wp.zeros(count, dtype=float), wp.zeros(count, dtype=float)
    states.slides = wp.zeros(count, dtype=int)
    states.center = wp.zeros(count, dtype=wp.vec3)
    states.tension = wp.zeros(count, dtype=float)
    return states


def _heat(membranes: Membranes, step: float) -> Any:
    """Return the gas's memory, and set the exponent of its response within a step."""
    chamber, gas = membranes.design.chamber, membranes.gas
    heat = Heat()
    for name in ("amount", "warmth", "volume", "supply"):
        setattr(heat, name, wp.zeros(membranes.count, dtype=float))
    heat.exchange = step / chamber.heat_exchange
    heat.gamma = float(chamber.polytropic_exponent)
    lost = -math.expm1(-heat.exchange) / heat.exchange if heat.exchange else 1.0
    gas.exponent = 1 + (chamber.polytropic_exponent - 1) * lost
    return heat


def _joints(model: mujoco.MjModel, worlds: int) -> Any:
    joints = Joints()
    for name, values in {
        "parent": model.body_parentid,
        "count": model.body_jntnum,
        "first": model.body_jntadr,
        "kind": model.jnt_type,
        "dof": model.jnt_dofadr,
        "free": [_carried(model, body) for body in range(model.nbody)],
    }.items():
        setattr(joints, name, wp.array(np.asarray(values, np.int32), dtype=int))
    joints.inertia = wp.array(model.dof_M0[None].astype(np.float32), dtype=float)
    damping = np.asarray(model.dof_damping, np.float32).reshape(-1)[: model.nv]
    joints.own = wp.array(damping, dtype=float)
    joints.damping = wp.array(np.tile(damping, (worlds, 1)), dtype=float)
    return joints


def _carried(model: mujoco.MjModel, body: int) -> int:
    """Return the body whose free joint carries `body`, or -1."""
    while body > 0:
        first = int(model.body_jntadr[body])
        if model.body_jntnum[body] == 1 and model.jnt_type[first] == _FREE:
            return body
        body = int(model.body_parentid[body])
    return -1


def _contacts(physics: Physics) -> Any:
    membranes, states = physics.membranes, physics.states
    contacts = Contacts()
    contacts.geoms, contacts.fields, contacts.gas = (
        physics.sensor_geoms,
        physics.fields,
        physics.gas,
    )
    contacts.patches, contacts.wrench = states.patches, states.wrench
    contacts.tension = states.tension
    contacts.half = math.sqrt(membranes.design.frame.area / math.pi)
    contacts.bulge = float(membranes.scheme.bulge)
    contacts.spacing = float(min(membranes.rubber.dx, membranes.rubber.dy))
    return contacts


def _motion(d: Any) -> Any:
    motion = Motion()
    for name in Motion.vars:
        setattr(motion, name, getattr(d, name))
    return motion
