"""Scenes with severe loads on a membrane, for benchmarks and tests.

Objects fall on it, rest on it, or are pinched between two membranes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.sim.attach import DEFAULT_MESH, attach_membrane, configure_options
from mjtactile.sim.scenes.world import World

# stiffness, N/m, and mass, kg, of the jaw that pinches
_STIFFNESS = 2e4
_MASS = 0.1


@dataclass(frozen=True)
class FreeObject:
    """A free rigid body: "sphere" (radius), "box" (edge), "plate" (2 x 2 cm, thickness) or "rod"
    (radius, 2 cm long), by `size` m, and `mass` kg."""

    kind: str
    size: float
    mass: float

    def add_to(self, body: mujoco.MjsBody) -> float:
        """Add the geom; return the height of its center over its lowest point, m."""
        half = self.size / 2
        kinds = mujoco.mjtGeom
        kind, size = {
            "sphere": (kinds.mjGEOM_SPHERE, [self.size, 0, 0]),
            "box": (kinds.mjGEOM_BOX, [half] * 3),
            "plate": (kinds.mjGEOM_BOX, [0.01, 0.01, half]),
            "rod": (kinds.mjGEOM_CAPSULE, [self.size, 0.01, 0]),
        }[self.kind]
        lying = self.kind == "rod"
        body.add_geom(
            name="object",
            type=kind,
            size=size,
            mass=self.mass,
            quat=[np.sqrt(0.5), 0, np.sqrt(0.5), 0] if lying else [1, 0, 0, 0],
        )
        return self.size if self.kind in ("sphere", "rod") else half


class DropWorld(World):
    """A sensor that faces up, inflated and sealed, and a free body that falls on it at `speed` m/s,
    then rests there."""

    def __init__(
        self,
        sensor: SensorDesign | str | Path,
        item: FreeObject,
        *,
        gauge_pressure: float,
        speed: float = 0.0,
        timestep: float = 4e-3,
        mesh: tuple[int, int] = DEFAULT_MESH,
        guided: bool = False,
    ):
        """Build the scene; a `guided` object moves vertically only, otherwise it is free."""
        spec = mujoco.MjSpec()
        configure_options(spec, timestep)
        spec.worldbody.add_site(name="base")
        attachment = attach_membrane(spec, sensor, site="base", mesh=mesh)
        body = spec.worldbody.add_body(name="object", pos=[0, 0, _HIGH])
        if guided:
            body.pos = [0, 0, 0]
            body.add_joint(name="object", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1])
        else:
            body.add_freejoint(name="object")
        under = item.add_to(body)
        super().__init__(spec, [attachment])
        joint = self.model.joint("object")
        skip = 0 if guided else 2
        self._height = int(joint.qposadr[0]) + skip
        self._velocity = int(joint.dofadr[0]) + skip
        self.weight = item.mass * 9.81
        self._fill(gauge_pressure)
        top = self.sensors[0].height_at(0.0, 0.0) + attachment.design.membrane.thickness / 2
        self._hold(top + under + 2 * self.timestep * speed + 1e-5, -speed)

    def _fill(self, gauge_pressure: float) -> None:
        sensor = self.sensors[0]
        sensor.open_valve(gauge_pressure)
        for _ in range(round(_FILLING / self.timestep)):
            self._hold(_HIGH, 0.0)
            self.step()
        sensor.close_valve()

    def _hold(self, height: float, speed: float) -> None:
        self.data.qpos[self._height] = height
        self.data.qvel[self._velocity] = speed
        mujoco.mj_forward(self.model, self.data)


class FloatWorld(World):
    """An inflated and sealed sensor that floats freely, without gravity."""

    def __init__(
        self,
        sensor: SensorDesign | str | Path,
        *,
        gauge_pressure: float,
        timestep: float = 4e-3,
        mesh: tuple[int, int] = DEFAULT_MESH,
    ):
        spec = mujoco.MjSpec()
        configure_options(spec, timestep)
        spec.option.gravity = [0, 0, 0]
        body = spec.worldbody.add_body(name="float")
        body.add_freejoint()
        body.add_site(name="mount", quat=[0.8, 0.3, 0.5, 0.1])
        super().__init__(spec, [attach_membrane(spec, sensor, site="mount", mesh=mesh)])
        self.sensors[0].open_valve(gauge_pressure)
        self.step(round(_FILLING / timestep))
        self.sensors[0].close_valve()

    def turn(self, velocity: Sequence[float]) -> None:
        """Set the angular velocity to `velocity` (3,) rad/s."""
        self.data.qvel[3:6] = velocity

    @property
    def angular_momentum(self) -> float:
        """Angular momentum of the whole system about its center of mass, kg m^2/s."""
        mujoco.mj_forward(self.model, self.data)
        mujoco.mj_subtreeVel(self.model, self.data)
        return float(np.linalg.norm(self.data.subtree_angmom[1]))


class PinchWorld(World):
    """Two sensors face each other along x and squeeze a free body by `squeeze` m each, against
    gravity."""

    def __init__(
        self,
        sensor: SensorDesign | str | Path,
        item: FreeObject,
        *,
        gauge_pressure: float,
        squeeze: float,
        timestep: float = 4e-3,
        mesh: tuple[int, int] = DEFAULT_MESH,
    ):
        spec = mujoco.MjSpec()
        configure_options(spec, timestep)
        quats = {
            "left/": [np.sqrt(0.5), 0, np.sqrt(0.5), 0],
            "right/": [np.sqrt(0.5), 0, -np.sqrt(0.5), 0],
        }
        attachments = []
        for prefix, sign in (("left/", -1), ("right/", 1)):
            jaw = spec.worldbody.add_body(
                name=prefix + "jaw", pos=[sign * _JAW_DISTANCE, 0, 0], gravcomp=1.0
            )
            jaw.mass = _MASS
            jaw.inertia = [1e-4] * 3
            jaw.explicitinertial = True
            jaw.add_joint(name=prefix + "jaw", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[-sign, 0, 0])
            site = jaw.add_site(name=prefix + "tip", quat=quats[prefix])
            drive = spec.add_actuator(
                name=prefix + "jaw", target=prefix + "jaw", trntype=mujoco.mjtTrn.mjTRN_JOINT
            )
            drive.set_to_position(kp=_STIFFNESS, kv=2 * np.sqrt(_STIFFNESS * (_MASS + 0.05)))
            attachments.append(attach_membrane(spec, sensor, site=site, prefix=prefix, mesh=mesh))
        body = spec.worldbody.add_body(name="object", quat=[np.sqrt(0.5), 0, np.sqrt(0.5), 0])
        body.add_freejoint(name="object")
        half = item.add_to(body)
        super().__init__(spec, attachments)
        joint = self.model.joint("object")
        self._place = int(joint.qposadr[0]) + 2
        self.weight = item.mass * 9.81
        for device in self.sensors:
            device.open_valve(gauge_pressure)
        gravity = self.model.opt.gravity.copy()
        self.model.opt.gravity = 0.0
        self.step(round(_FILLING / timestep))
        for device in self.sensors:
            device.close_valve()
        top = self.sensors[0].height_at(0.0, 0.0) + attachments[0].design.membrane.thickness / 2
        self._close(_JAW_DISTANCE - top - half + squeeze)
        self.model.opt.gravity = gravity

    @property
    def drop(self) -> float:
        """Distance the object has sunk, m."""
        return -float(self.data.qpos[self._place])

    def _close(self, travel: float) -> None:
        """Drive both jaws by `travel` m: quickly until 3 mm before the end, then at 10 mm/s."""
        slow = 3e-3
        for start, end, time in ((0.0, travel - slow, 0.1), (travel - slow, travel, slow / 0.01)):
            for goal in np.linspace(start, end, round(time / self.timestep) + 1)[1:]:
                for actuator in range(2):
                    self.set_control(actuator, goal)
                self.step()
        self.step(round(0.1 / self.timestep))


class FaceWorld(World):
    """A weight with a flat face of `count` equal boxes that rests on a sensor and slides along x.

    The face is 18 x 56 mm if `speed` is 0, so that its edges touch, and 100 x 80 mm otherwise, so
    that it covers the membrane throughout a slide. The weight moves along z and x only.
    """

    def __init__(
        self,
        sensor: SensorDesign | str | Path,
        *,
        count: int,
        weight: float,
        speed: float = 0.0,
        gauge_pressure: float = 1000.0,
        timestep: float = 4e-3,
        mesh: tuple[int, int] = DEFAULT_MESH,
    ):
        """Inflate the sensor, and lay the face of `weight` N on it."""
        spec = mujoco.MjSpec()
        configure_options(spec, timestep)
        spec.worldbody.add_site(name="base")
        attachment = attach_membrane(spec, sensor, site="base", mesh=mesh)
        body = spec.worldbody.add_body(name="face", pos=[0, 0, _HIGH])
        for name, axis, damping in (("z", [0, 0, 1], 1.0), ("x", [1, 0, 0], 0.0)):
            joint = body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
            joint.damping = [damping, 0.0, 0.0]
        half = (0.05, 0.04) if speed else (0.009, 0.028)
        part = half[1] / count
        for row in range(count):
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                size=[half[0], part, _HALF_FACE],
                pos=[0, (2 * row + 1) * part - half[1] + _OFF_CENTER, 0],
                mass=weight / 9.81 / count,
            )
        drive = spec.add_actuator(name="drive", trntype=mujoco.mjtTrn.mjTRN_JOINT, target="x")
        drive.set_to_velocity(kv=_DRIVE)
        super().__init__(spec, [attachment])
        self._speed = speed
        self._dof = int(self.model.joint("z").dofadr[0])
        self._height = int(self.model.joint("z").qposadr[0])
        device = self.sensors[0]
        device.open_valve(gauge_pressure)
        for _ in range(round(_FILLING / timestep)):
            self.data.qpos[self._height] = 0.0
            self.data.qvel[self._dof] = 0.0
            self.step()
        device.close_valve()
        top = device.height_at(0.0, 0.0) + attachment.design.membrane.thickness / 2
        self.data.qpos[self._height] = top + _HALF_FACE + 1e-5 - _HIGH
        self.data.qvel[self._dof] = 0.0
        mujoco.mj_forward(self.model, self.data)

    def forces(self, settling: float, duration: float) -> np.ndarray:
        """Return the normal contact forces (n,), N, of each step.

        `settling` s at rest, and as long at the speed, come first.
        """
        self.step(round(settling / self.timestep))
        self.data.ctrl[0] = self._speed
        self.step(round(settling / self.timestep))
        forces = []
        for _ in range(round(duration / self.timestep)):
            self.step()
            forces.append(self.data.qfrc_constraint[self._dof])
        return np.array(forces)


# height of the object during filling, m; jaw distance from the center, m; filling time, s
_HIGH = 0.5
_JAW_DISTANCE = 0.04
_FILLING = 0.3
_HALF_FACE = 0.004  # half the thickness of a face, m
_OFF_CENTER = 0.005  # offset of the face along y, m: seams do not pass through the center
_DRIVE = 200.0  # gain of the slide's drive, N s/m
