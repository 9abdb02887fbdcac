"""`GripperWorld`: a simulated rig over its table (docs/reference/rig_files.md), without an
object."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.gripper_path import GripperPath
from mjtactile.core.sensor_parts import Frame
from mjtactile.core.types import Array
from mjtactile.rig.jaw_transmission import JawLaw
from mjtactile.rig.simulated import SimRigFile
from mjtactile.sim.attach import attach_membrane, configure_options
from mjtactile.sim.batched_quasistatic_step import Drive, QuasistaticStepper, is_available
from mjtactile.sim.scenes.actuators import PositionActuator
from mjtactile.sim.scenes.gantry import add_gantry, require_path
from mjtactile.sim.scenes.gripper_drives import ActuatorLift, Jaws, make_lift
from mjtactile.sim.scenes.initial_state import Start, load_robot, place_jaws, plan_start
from mjtactile.sim.scenes.inverse_kinematics import solve
from mjtactile.sim.scenes.world import World
from mjtactile.sim.sensor.effect_switches import PHYSICS, set_servo
from mjtactile.sim.sensor.quasistatic_sensor import QuasistaticSensor

DEFAULT_TIMESTEP = 4e-3
_TABLE = 0.2  # half-extent of the table, m
_CLOSING = 1e-4  # difference of openings for a derivative, m


class GripperWorld(World):
    """Gripper with a sensor on each finger, in the order of the rig file, and its lift.

    The current-limited jaws move towards their target opening at most at the rig's speed.
    """

    def __init__(
        self,
        rig: SimRigFile,
        designs: Sequence[SensorDesign],
        tip_height: float,
        *,
        timestep: float = DEFAULT_TIMESTEP,
        mesh: tuple[int, int] | None = None,
        opening: float | None = None,
        grip: float | None = None,
        effects: frozenset[str] = PHYSICS,
        furnish: Callable[[mujoco.MjSpec, Start], None] = lambda spec, start: None,
        path: GripperPath | None = None,
    ):
        """Create the scene.

        `designs` are the fingers' sensors, `tip_height` m is the height of the fingertips above the
        table. `opening` m is the initial jaw opening (default: the rig file's), `grip` m the
        opening at contact with the object (default: `opening`). `furnish` adds objects to the
        table. `path` is the task's. The scene then has a gantry, unless an arm or a mocap body
        moves the gripper. Raises InputError for a rig that cannot follow it.
        """
        self.rig = rig
        self.effects = effects
        opening = self._checked(rig.gripper.start if opening is None else opening)
        spec, coordinates, mocap = load_robot(rig)
        configure_options(spec, timestep)
        attachments = [
            attach_membrane(
                spec, design, site=finger.site, prefix=f"{finger.name}/", mesh=mesh, effects=effects
            )
            for design, finger in zip(designs, rig.fingers, strict=True)
        ]
        for jaw in rig.gripper.actuators:
            set_servo(spec, jaw.name, effects)
        robot = spec.compile()
        bodies = [robot.body(f"{finger.name}/sensor").id for finger in rig.fingers]

        def height(rotations: Array) -> float:
            for design, R_WS in zip(designs, rotations, strict=True):
                self._check_clearance(tip_height, _half_height(design.frame, R_WS))
            return rig.table_height + tip_height

        self.start = plan_start(robot, rig, bodies, opening, height, coordinates, mocap, grip)
        if path is not None:
            require_path(rig, self.start, path)
        if path is not None and rig.lift.kind == "actuator":
            add_gantry(spec, robot, self.start)
            robot = spec.compile()
            self.start = plan_start(robot, rig, bodies, opening, height, coordinates, mocap, grip)
        self._robot_dofs = _dofs_without(robot, [f"{finger.name}/" for finger in rig.fingers])
        # no other mechanism brings the gripper to its height
        if rig.lift.kind in ("actuator", "none"):
            _raise(spec, robot, int(robot.body_rootid[self.start.gripper]), self.start.raised)
        if rig.table:
            max_offset = 0.0 if path is None else path.max_offset
            _add_table(spec, [*self.start.centre[:2], rig.table_height], _TABLE + max_offset)
        furnish(spec, self.start)
        super().__init__(spec, attachments, self._place)
        self._jaws = Jaws(self.model, self.data, rig)
        self._lift = make_lift(self.model, self.data, rig, self.start)
        self._kinematics = mujoco.MjData(self.model)
        self._opening_target = self._opening_goal = opening
        self._lift_target = self._lift_goal = 0.0
        self._lift_speed = rig.lift.speed
        self._hold_still()
        mujoco.mj_forward(self.model, self.data)
        self._batches = self._qs_stepper()

    # -- commands of a real gripper

    def set_finger_target(self, opening: float, force_limit: float | None = None) -> None:
        """Set the target gap between the sensors' frames, m, and the force limit, N.

        None keeps the force limit. Raises InputError for a value that is negative or not finite.
        """
        if not np.isfinite(opening) or opening < 0:
            raise InputError(
                f"{opening!r} m is not a finite opening >= 0", source="gripper", field="opening"
            )
        self._opening_target = min(float(opening), self.max_opening)
        if force_limit is not None:
            if not np.isfinite(force_limit) or force_limit < 0:
                raise InputError(
                    f"{force_limit!r} N is not a finite force >= 0",
                    source="gripper",
                    field="force_limit",
                )
            self._jaws.limit_force(force_limit)

    def set_lift_target(self, height: float, speed: float | None = None) -> None:
        """Set the lift's target height, m, and speed, m/s (None: the rig's). Raises InputError."""
        if not np.isfinite(height) or not 0 <= height <= self.rig.lift.travel:
            raise InputError(
                f"{height!r} m is outside 0 to {self.rig.lift.travel:g} m",
                source="gripper",
                field="lift_height",
            )
        self._lift_target = float(height)
        self._lift_speed = self.rig.lift.speed if speed is None else speed

    def displace(self, displacement: Array) -> None:
        """Set the goal of the task's path (4,): x, y, z, m, and tilt, rad, from its start."""
        self._lift.displace(displacement)

    # -- state reported by a real gripper

    @property
    def max_opening(self) -> float:
        return self.rig.gripper.opening[1]

    @property
    def opening(self) -> float:
        """Gap between the sensors' frames, m; twice their mean distance from the center."""
        return self._jaws.opening()

    @property
    def opening_speed(self) -> float:
        """Rate of change of the opening, m/s; negative while closing."""
        return self._jaws.speed()

    @property
    def grip_force(self) -> float:
        """Closing force of the servos on each finger, as indicated by their current, N."""
        return self._jaws.force()

    def grip_force_available(self, opening: float) -> float:
        """Return the maximum closing force on each finger at rest, N, with the jaws at `opening` m.

        It is the force of the actuators at their closest goal, with springs and weight in the
        mechanism, by virtual work.
        """
        states = [self._closed_to(x) for x in (opening + _CLOSING / 2, opening - _CLOSING / 2)]
        motion = np.zeros(self.model.nv)
        mujoco.mj_differentiatePos(self.model, motion, _CLOSING, *(qpos for qpos, _ in states))
        load = np.mean([load for _, load in states], axis=0)
        work = float(load[self._robot_dofs] @ motion[self._robot_dofs])
        return self._jaws.force_available(opening) + self._jaws.finger_force(work)

    def _closed_to(self, opening: float) -> tuple[Array, Array]:
        """Return qpos, and the forces of springs and weight at rest (nv,), at `opening` m."""
        state = mujoco.MjData(self.model)
        state.qpos[:] = self.data.qpos
        state.mocap_pos[:] = self.data.mocap_pos
        state.mocap_quat[:] = self.data.mocap_quat
        solve(self.model, state, place_jaws(self.model, state, self.rig, opening))
        mujoco.mj_fwdVelocity(self.model, state)
        return state.qpos.copy(), state.qfrc_passive - state.qfrc_bias

    @property
    def lift_height(self) -> float:
        """Height of the gripper above its start position, m."""
        return self._lift.height()

    def place_gripper(self, opening: float, lift: float) -> None:
        """Set jaws and lift to these coordinates, m, at rest, for experiments."""
        scratch = self._kinematics
        scratch.qpos[:] = self.data.qpos
        scratch.mocap_pos[:] = self.data.mocap_pos
        self._lift.place(lift, scratch)
        solve(self.model, scratch, place_jaws(self.model, scratch, self.rig, opening))
        self.data.qpos[:] = scratch.qpos
        self.data.mocap_pos[:] = scratch.mocap_pos
        self.data.qvel[self._robot_dofs] = 0.0
        self._opening_target = self._opening_goal = opening
        self._lift_target = self._lift_goal = lift

    @property
    def linear_drive(self) -> Drive | None:
        """Jaws and lift as linear coefficients; None if one of them is not linear."""
        return self._jaws.drive_with(self._lift)

    @property
    def jaw_actuators(self) -> list[tuple[PositionActuator, JawLaw]]:
        """Actuators of the jaws with their transmissions."""
        return self._jaws.actuators

    @property
    def lift_joint(self) -> tuple[int, float] | None:
        """Address in qpos that determines the height, and m per unit; None without such a lift."""
        return self._lift.joint() if isinstance(self._lift, ActuatorLift) else None

    # -- inside
    # --------------------------------------------------------------------------------

    def _before_step(self) -> None:
        """Move both goals towards their targets at limited speed and lead."""
        jaw_step = self.rig.gripper.speed * self.timestep
        lift_step = self._lift_speed * self.timestep
        self._jaws.refresh_force()
        max_lead = self._jaws.max_lead(self.rig.gripper.speed) + 4 * jaw_step
        goal = _nearer(self._opening_goal, self._opening_target, jaw_step)
        self._opening_goal = _nearer(self.opening, goal, max_lead)
        self._lift_goal = _nearer(self._lift_goal, self._lift_target, lift_step)
        self._jaws.drive(self._opening_goal)
        self._lift.drive(self._lift_goal)

    def _qs_stepper(self) -> QuasistaticStepper | None:
        """Return a stepper for batches, if all sensors are quasi-static and the drives linear."""
        membranes = [sensor for sensor in self.sensors if isinstance(sensor, QuasistaticSensor)]
        drive = self._jaws.drive_with(self._lift)
        known = type(self)._before_step is GripperWorld._before_step
        if not (
            membranes and len(membranes) == len(self.sensors) and drive and known and is_available()
        ):
            return None
        return QuasistaticStepper(self.model, self.data, membranes, drive, *self._stepper.speeds)

    def _write_goals(self, batches: QuasistaticStepper) -> None:
        jaw_step = self.rig.gripper.speed * self.timestep
        max_lead = self._jaws.max_lead(self.rig.gripper.speed) + 4 * jaw_step
        batches.maximum[:] = jaw_step, max_lead, self._lift_speed * self.timestep
        batches.goals[:] = (
            self._opening_goal,
            self._opening_target,
            self._lift_goal,
            self._lift_target,
        )

    def _read_goals(self, batches: QuasistaticStepper) -> None:
        self._opening_goal = float(batches.goals[0])
        self._lift_goal = float(batches.goals[2])
        self._lift.drive(self._lift_goal)

    def _check_clearance(self, tip_height: float, half: float) -> None:
        """Reject objects that cannot be grasped at this height."""

    def _checked(self, opening: float) -> float:
        low, high = self.rig.gripper.opening
        if not low <= opening <= high or not opening > 0:
            raise InputError(
                f"{opening!r} m is outside {low:g} to {high:g} m", source="gripper", field="opening"
            )
        return opening

    def _place(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Set a new state to the planned start."""
        data.qpos[: len(self.start.qpos)] = self.start.qpos
        data.mocap_pos[:] = self.start.mocap_pos

    def _hold_still(self) -> None:
        """Set every control so that the robot is at rest initially."""
        for actuator_id in range(self.model.nu):
            try:
                actuator = PositionActuator(
                    self.model, self.data, self.model.actuator(actuator_id).name, ""
                )
            except (InputError, KeyError):
                continue  # a motor, or a servo without a name: it stays at control 0
            actuator.set_goal(actuator.length)
        self._jaws.drive(self._opening_goal)
        self._lift.drive(0.0)
        for actuator_id in np.flatnonzero(self.model.actuator_actnum == 1):
            self.data.act[self.model.actuator_actadr[actuator_id]] = self.data.ctrl[actuator_id]


def _half_height(frame: Frame, R_WS: Array) -> float:
    """Return how far a sensor's frame reaches below its centre, m."""
    length, width = frame.length / 2 + frame.rim, frame.width / 2 + frame.rim
    return abs(R_WS[2, 0]) * length + abs(R_WS[2, 1]) * width


def _nearer(start: float, goal: float, maximum: float) -> float:
    """Return `goal`, limited to a distance of `maximum` from `start`."""
    return start + min(max(goal - start, -maximum), maximum)


def _dofs_without(model: mujoco.MjModel, prefixes: Sequence[str]) -> Array:
    """Return the degrees of freedom of all MuJoCo bodies except those of the sensors."""
    ours = [not model.body(int(body)).name.startswith(tuple(prefixes)) for body in model.dof_bodyid]
    return np.flatnonzero(ours)


def _raise(spec: mujoco.MjSpec, model: mujoco.MjModel, root: int, by: float) -> None:
    """Raise the MuJoCo body `root` of the compiled `model`, a child of the world, by `by` m."""
    body = next(body for body in spec.bodies if body.id == root)
    if body.frame is not None:  # in the parent's axes, which may be rotated: same position in W
        body.set_frame(spec.worldbody.add_frame())
        body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        body.quat = model.body_quat[root]
    body.pos = model.body_pos[root] + [0.0, 0.0, by]


def _add_table(spec: mujoco.MjSpec, top: Sequence[float], half: float) -> None:
    """Add a table from a separate model, so that defaults of the user's MJCF do not apply."""
    x, y, z = (float(value) for value in top)
    child = mujoco.MjSpec()
    table = child.worldbody.add_body(name="table")
    table.add_geom(
        name="table",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[x, y, z - 0.01],
        size=[half, half, 0.01],
        # an object that is pushed slides rather than tips
        friction=[0.3, 0.005, 0.0001],
        rgba=[0.75, 0.7, 0.65, 1.0],
    )
    child.worldbody.add_light(pos=[x, y - 0.5, z + 1.0], dir=[0, 0.4, -0.9])
    spec.attach(child, frame=spec.worldbody.add_frame(), prefix="table/")
