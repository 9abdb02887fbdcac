"""Two sensors that hold an object between them while it is pulled, turned, shaken or dragged."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from benchmarks.scenes.slip_cases import SlipCase
from mjtactile.core.design import SensorDesign
from mjtactile.sim.attach import DEFAULT_MESH, Attachment, attach_membrane, configure_options
from mjtactile.sim.scenes.world import World

MESH = DEFAULT_MESH
# initial jaw distance from the center, m; filling time, s; offset of the object meanwhile, m
_JAW_DISTANCE = 0.05
_FILLING = 0.3
_AWAY = 0.06
# stiffness, N/m, and mass, kg, of a jaw
_STIFFNESS = 2e4
_MASS = 0.1
# stiffness of half a soft object, N/m, and its damping, N s/m
_SOFT = (400.0, 4000.0)
_SOFT_DAMPING = 1.0
_ANCHOR = 1e4  # damping that holds an object while the jaws drag past it, N s/m
_TURNING = 3e-3  # lever arm of a torque in the contact, m
_QUATS = {
    "left/": [np.sqrt(0.5), 0, np.sqrt(0.5), 0],
    "right/": [np.sqrt(0.5), 0, -np.sqrt(0.5), 0],
}
# settling time of the grip, s; closing speed, m/s; initial clearance, m
_SETTLE = 0.25
_CLOSING = 0.02
_CLEARANCE = 1e-3
# Test: the grip changes by a twentieth at this rate, Hz. Stiffness of the grip: N/m of finger
# displacement, and N/m per N, of two membranes at 1 kPa on a hard object
_TEST_FRACTION = 0.05
_TEST_RATE = 4.0
_SOFT_GRIP = 220.0
_STIFF_GRIP = 520.0


class SlipWorld(World):
    """Simulation of a case; `run` yields once per step.

    The jaws close along x; the pull lies in the y-z plane.
    """

    def __init__(
        self,
        design: SensorDesign,
        case: SlipCase,
        *,
        mesh: tuple[int, int] = MESH,
        timestep: float = 1 / 240,
        test: bool = False,
    ):
        """Build the scene; `test` adds a small modulation of the grip, for the slip test."""
        spec = mujoco.MjSpec()
        configure_options(spec, timestep)
        spec.option.gravity = [0, 0, 0]
        self.case = case
        self.direction = np.array([0.0, np.sin(case.angle), np.cos(case.angle)])
        attachments = [self._add_jaw(spec, design, prefix, mesh) for prefix in _QUATS]
        body = spec.worldbody.add_body(name="object", pos=[0, *case.offset])
        body.add_freejoint(name="object")
        extent = _add_body(body, case)
        super().__init__(spec, attachments)
        self._drives = {
            name: self.model.actuator(name).id
            for name in ("left/x", "right/x", "left/y", "right/y")
        }
        joint = self.model.joint("object")
        self._body = self.model.body("object").id
        self._dofs = joint.dofadr[0] + np.arange(6)
        self._place = int(joint.qposadr[0])
        for sensor, friction in zip(self.sensors, case.friction, strict=True):
            self.model.geom_friction[sensor.vertex_geom_ids, 0] = friction
        self._extent = extent
        self._test = test
        self._test_direction = 0.0
        self._test_start = 0.0

    def _add_jaw(
        self, spec: mujoco.MjSpec, design: SensorDesign, prefix: str, mesh: tuple[int, int]
    ) -> Attachment:
        sign = -1 if prefix == "left/" else 1
        jaw = spec.worldbody.add_body(name=prefix + "jaw", pos=[sign * _JAW_DISTANCE, 0, 0])
        jaw.mass = _MASS
        jaw.inertia = [1e-4] * 3
        jaw.explicitinertial = True
        for name, axis in (("x", [-sign, 0, 0]), ("y", self.direction)):
            jaw.add_joint(name=prefix + name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
            drive = spec.add_actuator(
                name=prefix + name, target=prefix + name, trntype=mujoco.mjtTrn.mjTRN_JOINT
            )
            drive.set_to_position(kp=_STIFFNESS, kv=2 * np.sqrt(_STIFFNESS * (_MASS + 0.05)))
        site = jaw.add_site(name=prefix + "tip", quat=_QUATS[prefix])
        return attach_membrane(spec, design, site=site, prefix=prefix, mesh=mesh)

    def press(self, sensor: int) -> float:
        """Return the sum of the normal contact forces on membrane `sensor`, N.

        The loads of a case are measured relative to it.
        """
        contact = self.data.contact
        touching = np.isin(contact.geom, self.sensors[sensor].vertex_geom_ids).any(axis=1) & (
            contact.efc_address >= 0
        )
        return float(self.data.efc_force[contact.efc_address[touching]].sum())

    # -- motion ------------------------------------------------------------------------------------

    def inflate(self, gauge_pressure: float) -> None:
        """Fill and seal both chambers, with the object out of the way."""
        self._hold_body(away=True)
        for sensor in self.sensors:
            sensor.open_valve(gauge_pressure)
        self._still(_FILLING, away=True)
        if gauge_pressure:
            for sensor in self.sensors:
                sensor.close_valve()

    def grip(self) -> Iterator[None]:
        """Close on the object, which is fixed until both fingers press."""
        top = max(sensor.height_at(0.0, 0.0) for sensor in self.sensors)
        goal = (
            _JAW_DISTANCE
            - top
            - self.sensors[0].design.membrane.thickness / 2
            - self._extent
            - _CLEARANCE
        )
        self._close(0.0, goal, 0.15)
        while np.mean([self.press(k) for k in range(2)]) < self.case.grip and goal < _JAW_DISTANCE:
            goal += _CLOSING * self.timestep
            self._squeeze(goal)
            self._hold_body()
            self.step()
        self._travel = goal
        for _ in range(round(_SETTLE / self.timestep)):
            self.step()
            yield

    def load(self, seconds: float) -> Iterator[None]:
        """Apply the load of the case for `seconds`."""
        case = self.case
        motion = self.case.profile
        normal = np.array([self.press(k) for k in range(2)])
        limit = float(np.dot(case.friction, normal))
        drag = (
            _ANCHOR
            if motion.load in ("drag", "one")
            else max(case.fraction - 1, 0.2) * limit / case.speed
        )
        self.model.dof_damping[self._dofs[:3]] = drag
        self.model.dof_damping[self._dofs[3:]] = drag * _TURNING**2
        start = self.time
        if self._test:
            grip = float(normal.mean())
            self._test_direction = _TEST_FRACTION * grip / (_SOFT_GRIP + _STIFF_GRIP * grip)
            self._test_start = start
        for _ in range(round(seconds / self.timestep)):
            self._squeeze(self._travel)
            self._apply(self.time - start, limit, seconds)
            self.step()
            yield

    def _apply(self, t: float, limit: float, seconds: float) -> None:
        case = self.case
        motion = self.case.profile
        part = t / case.rise
        grown = case.fraction * (part if not motion.stays else min(part, 1.0))
        if motion.load == "pull":
            self._pull(grown * limit)
        elif motion.load == "torque":
            self.data.xfrc_applied[self._body, 3] = grown * limit * _TURNING
        elif motion.load == "grip":
            self._pull(case.fraction * limit * min(t / 0.2, 1.0))
            opened = (4e-3 if case.slips else 0.4e-3) * min(max(t - 0.4, 0.0) / case.rise, 1.0)
            self._squeeze(self._travel - opened)
        elif motion.load == "shake":
            omega = 2 * np.pi * case.frequency
            amplitude = min(case.fraction * limit / (case.mass * omega**2), 0.02)
            self._move(*[amplitude * min(part, 1.0) * np.sin(omega * t)] * 2)
        elif motion.load in ("drag", "one", "roll"):
            moved = min(1e-3 * case.rise * t, 1e-3 * case.fraction)
            self._move(moved, {"drag": moved, "one": 0.0, "roll": -moved}[motion.load])
        elif motion.load == "squeeze":
            self._squeeze(
                self._travel + 1e-3 * case.fraction * np.sin(2 * np.pi * t / (4 * case.rise))
            )
        else:  # taps: open and close again
            up = 0.5 - 0.5 * np.cos(np.pi * t / case.rise)
            self._squeeze(self._travel - up * 1e-3 * case.fraction)

    def _pull(self, force: float) -> None:
        self.data.xfrc_applied[self._body, :3] = force * self.direction

    def _squeeze(self, goal: float) -> None:
        turned = 2 * np.pi * _TEST_RATE * (self.time - self._test_start)
        goal += self._test_direction * float(np.sin(turned))
        for name in ("left/x", "right/x"):
            self.set_control(self._drives[name], goal)

    def _move(self, left: float, right: float) -> None:
        self.set_control(self._drives["left/y"], left)
        self.set_control(self._drives["right/y"], right)

    def _close(self, start: float, end: float, seconds: float) -> None:
        for goal in np.linspace(start, end, max(round(seconds / self.timestep), 1) + 1)[1:]:
            self._squeeze(goal)
            self._hold_body()
            self.step()

    def _still(self, seconds: float, *, away: bool = False) -> None:
        for _ in range(round(seconds / self.timestep)):
            self._hold_body(away=away)
            self.step()

    def _hold_body(self, *, away: bool = False) -> None:
        place = [0.0, *self.case.offset]
        self.data.qpos[self._place : self._place + 7] = [
            place[0],
            place[1],
            place[2] + (_AWAY if away else 0),
            1,
            0,
            0,
            0,
        ]
        self.data.qvel[self._dofs] = 0


def _add_body(body: mujoco.MjsBody, case: SlipCase) -> float:
    """Add the object's geoms; return its half width along x, m."""
    kinds = mujoco.mjtGeom
    size = case.size
    rotation = [np.sqrt(0.5), np.sqrt(0.5), 0, 0]
    if case.body.startswith("soft"):
        return _add_soft(body, case)
    kind, sizes, quat = {
        "ball": (kinds.mjGEOM_SPHERE, [size, 0, 0], [1, 0, 0, 0]),
        "box": (kinds.mjGEOM_BOX, [size, 0.7 * size, 0.8 * size], [1, 0, 0, 0]),
        "cylinder": (kinds.mjGEOM_CYLINDER, [size, 1.2 * size, 0], [1, 0, 0, 0]),
        "lying cylinder": (kinds.mjGEOM_CYLINDER, [size, 1.2 * size, 0], rotation),
    }[case.body]
    body.add_geom(type=kind, size=sizes, quat=quat, mass=case.mass)
    return size


def _add_soft(body: mujoco.MjsBody, case: SlipCase) -> float:
    """Add two faces on springs along x, flat or round; return the half width along x, m."""
    size = case.size
    stiffness = float(np.random.default_rng([case.seed, 13]).uniform(*_SOFT))
    body.mass = 0.8 * case.mass
    body.inertia = [0.8 * case.mass * 0.4 * size**2] * 3
    body.explicitinertial = True
    for side, sign in (("left", -1), ("right", 1)):
        face = body.add_body(name=side, pos=[sign * size, 0, 0])
        face.add_joint(
            name=side,
            type=mujoco.mjtJoint.mjJNT_SLIDE,
            axis=[-sign, 0, 0],
            stiffness=[stiffness, 0, 0],
            damping=[_SOFT_DAMPING, 0, 0],
        )
        if case.body == "soft block":
            face.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                pos=[-sign * 3e-3, 0, 0],
                size=[3e-3, 0.7 * size, 0.8 * size],
                mass=0.1 * case.mass,
            )
        else:
            face.add_geom(
                type=mujoco.mjtGeom.mjGEOM_SPHERE,
                pos=[-sign * size / 2, 0, 0],
                size=[size / 2, 0, 0],
                mass=0.1 * case.mass,
            )
    return size
