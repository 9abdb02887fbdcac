"""`GraspWorld`: a table, an object, and a two-finger gripper with one membrane sensor per finger."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from mjtactile import resources
from mjtactile.design import SensorDesign, load_sensor
from mjtactile.errors import InputError
from mjtactile.sim.attach import DEFAULT_MESH, attach, recommend_options
from mjtactile.sim.objects import ObjectModel, add_object, load_object
from mjtactile.sim.switches import PHYSICS, set_servo
from mjtactile.sim.world import World

SITES = ("left_fingertip", "right_fingertip")
SENSOR_PREFIXES = ("left/", "right/")
DEFAULT_TIMESTEP = 4e-3


class GraspWorld(World):
    """Two opposed fingers, driven by one jaw servo through a gear, on a hand that a lift carries.

    The servo is current-limited: it moves towards its target opening at no more than `jaw_speed` and pushes with no
    more than its force limit. Sensors 0 and 1 are left and right.
    """

    def __init__(self, sensor: SensorDesign | str | Path = "dense", grasped: ObjectModel | str | Path = "egg", *,
                 timestep: float = DEFAULT_TIMESTEP, mesh: tuple[int, int] = DEFAULT_MESH,
                 object_pose: tuple[float, float, float] = (0.0, 0.0, 0.0), opening: float = 0.08,
                 jaw_speed: float = 0.05, lift_speed: float = 0.05, effects: frozenset[str] = PHYSICS):
        """`timestep` s and `mesh` trade accuracy for speed; `object_pose` is x, y (m) and yaw (rad) of the object's file on
        the table; `opening` m is where the jaws start, `effects` are names of effects.py."""
        self.design = load_sensor(sensor)
        self.design.require_rectangle("grasping, which rests on sensing,")
        self.object = grasped if isinstance(grasped, ObjectModel) else load_object(grasped)
        self.effects = effects
        spec = mujoco.MjSpec.from_file(str(resources.find("two_finger", "models/grippers", ".xml")))
        recommend_options(spec, timestep)
        self._place_hand(spec)
        attachments = [attach(spec, self.design, site=site, prefix=prefix, mesh=mesh, effects=effects)
                       for site, prefix in zip(SITES, SENSOR_PREFIXES, strict=True)]
        set_servo(spec, "jaw", effects)
        _add_table(spec)
        add_object(spec, self.object, object_pose)
        super().__init__(spec, attachments)
        self._jaw, self._lift = self.model.actuator("jaw").id, self.model.actuator("lift").id
        self._opening_tendon = self.model.tendon("opening").id
        self._jaw_joints = [self.model.joint(name) for name in ("left_jaw", "right_jaw")]
        self._lift_joint = self.model.joint("lift")
        self._stiffness = float(self.model.actuator_gainprm[self._jaw, 0])
        self._damping = float(-self.model.actuator_biasprm[self._jaw, 2])
        self._speeds = (jaw_speed, lift_speed)
        self.max_opening = float(sum(joint.range[1] for joint in self._jaw_joints))
        self._set_jaws(opening)
        self._finger_target = self._finger_goal = opening
        self._lift_target = self._lift_goal = 0.0

    # -- commands: what a real gripper takes ---------------------------------------------------------------------

    def set_finger_target(self, opening: float, force_limit: float | None = None) -> None:
        """Set the goal for the gap between the two sensors' frames, m, and the most the servo may push, N.

        Raises InputError for a value that is not finite, a negative opening or a force limit that is not positive.
        """
        if not np.isfinite(opening) or opening < 0:
            raise InputError(f"{opening!r} m is not a finite opening >= 0", source="gripper", field="opening")
        self._finger_target = min(float(opening), self.max_opening)
        if force_limit is not None:
            if not np.isfinite(force_limit) or force_limit <= 0:
                raise InputError(f"{force_limit!r} N is not a finite force > 0", source="gripper", field="force_limit")
            self.model.actuator_forcerange[self._jaw] = (-force_limit, force_limit)

    def set_lift_target(self, height: float) -> None:
        """Set the goal of the lift, m above where the hand started. Raises InputError when it is out of reach."""
        low, high = (float(v) for v in self._lift_joint.range)
        if not np.isfinite(height) or not low <= height <= high:
            raise InputError(f"{height!r} m is outside {low:g} to {high:g} m", source="gripper", field="lift_height")
        self._lift_target = float(height)

    def open_valve(self, sensor: int, supply_gauge: float | None = None) -> None:
        """Connect one chamber to a supply of `supply_gauge` Pa (default: the design's)."""
        self.sensors[sensor].open_valve(supply_gauge)

    def close_valve(self, sensor: int) -> None:
        """Trap the gas that one chamber holds now."""
        self.sensors[sensor].close_valve()

    # -- state: what a real gripper reports ----------------------------------------------------------------------

    @property
    def opening(self) -> float:
        """Gap between the two sensors' frames, m."""
        return float(sum(self.data.qpos[joint.qposadr[0]] for joint in self._jaw_joints))

    @property
    def opening_speed(self) -> float:
        """Rate of change of the opening, m/s; negative while closing."""
        return float(sum(self.data.qvel[joint.dofadr[0]] for joint in self._jaw_joints))

    @property
    def grip_force(self) -> float:
        """Force with which the servo closes each finger, N; what its current would say."""
        return float(-self.data.actuator_force[self._jaw])

    @property
    def lift_height(self) -> float:
        """Height of the hand above where it started, m."""
        return float(self.data.qpos[self._lift_joint.qposadr[0]])

    def place_hand(self, opening: float, lift: float) -> None:
        """Put jaws and lift at these coordinates, m, at rest, with their goals there: for experiments, not for control."""
        for joint in self._jaw_joints:
            self.data.qpos[joint.qposadr[0]], self.data.qvel[joint.dofadr[0]] = opening / 2, 0.0
        self.data.qpos[self._lift_joint.qposadr[0]], self.data.qvel[self._lift_joint.dofadr[0]] = lift, 0.0
        self._finger_target = self._finger_goal = opening
        self._lift_target = self._lift_goal = lift

    # -- inside --------------------------------------------------------------------------------------------------

    def _before_step(self) -> None:
        """Move both goals towards their targets at limited speed, the jaw's no further ahead than its force needs."""
        jaw_step, lift_step = (speed * self.timestep for speed in self._speeds)
        force = 1.2 * self.model.actuator_forcerange[self._jaw, 1] + self._damping * self._speeds[0]
        reach = force / self._stiffness + 4 * jaw_step
        goal = self._finger_goal + np.clip(self._finger_target - self._finger_goal, -jaw_step, jaw_step)
        self._finger_goal = float(np.clip(goal, self.opening - reach, self.opening + reach))
        self._lift_goal += float(np.clip(self._lift_target - self._lift_goal, -lift_step, lift_step))
        self.set_control(self._jaw, self._finger_goal)
        self.set_control(self._lift, self._lift_goal)

    def _place_hand(self, spec: mujoco.MjSpec) -> None:
        """Put the fingertips at the object's grasp height, clear of the table."""
        half = self.design.frame.width / 2 + self.design.frame.rim
        if self.object.grasp_height <= half:
            raise InputError(f"grasp height {self.object.grasp_height * 1e3:g} mm is below {half * 1e3:g} mm: the sensors' "
                             "frames would hit the table; put the object on a stand", source=self.object.path,
                             field="grasp_height_m")
        spec.body("hand").pos = [0.0, 0.0, self.object.grasp_height]

    def _set_jaws(self, opening: float) -> None:
        if not 0 < opening <= self.max_opening:
            raise InputError(f"{opening!r} m is outside 0 to {self.max_opening:g} m", source="gripper", field="opening")
        for joint in self._jaw_joints:
            self.data.qpos[joint.qposadr[0]] = opening / 2
        self.data.ctrl[self._jaw] = opening
        mujoco.mj_forward(self.model, self.data)


def _add_table(spec: mujoco.MjSpec) -> None:
    table = spec.worldbody.add_body(name="table")
    table.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_BOX, pos=[0, 0, -0.01], size=[0.2, 0.2, 0.01],
                   friction=[0.3, 0.005, 0.0001],  # an object that is pushed slides rather than tips
                   rgba=[0.75, 0.7, 0.65, 1.0])
    spec.worldbody.add_light(pos=[0, -0.5, 1.0], dir=[0, 0.4, -0.9])
