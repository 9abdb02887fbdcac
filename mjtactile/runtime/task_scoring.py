"""Ground-truth score of a task: relative grip force, final pose, impact, and handover.

The grip force is relative to its minimum, which follows from Coulomb's law for soft fingers. Two
loads share the friction limit as an ellipse (Howe & Cutkosky, Int. J. Robotics Research 15, 1996).
These are the load along the membranes and the torque about the axis through the fingers. All
fingers have the same normal force.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mjtactile.core.geometry import cross
from mjtactile.core.gripper_path import GripperPath
from mjtactile.core.scenario import Scenario
from mjtactile.core.task import Task, load_task
from mjtactile.core.types import Array
from mjtactile.rig.finger import Rig
from mjtactile.sim import ground_truth
from mjtactile.sim.scenes.grasp_world import GraspWorld
from mjtactile.sim.scenes.initial_state import path_axes

VERSION = "3"
"""Version, incremented with every change of the criteria or their measurement."""
_EVERY = 0.02  # interval between evaluations of the minimum grip force, s
_IN_AIR = 0.01  # minimum gripper height at which the fingers alone carry the object, m
RELEASED = 0.02  # maximum normal force per finger of a released object, N
_PULL = 0.3  # minimum pull that requires a release, N
STANDS = 5e-3  # tolerance of the height of a standing object, m
_GENEROUS = 2.0  # ratio of the grip to the required force that counts as excessive


@dataclass
class TaskScorer:
    """Scorer of a task in a simulated world.

    `pulls` is the time after the lift, s, at which a person pulls with more than 0.3 N (NaN:
    never). `path` is that of the gripper.
    """

    world: GraspWorld
    task: Task
    pulls: float = math.nan
    path: GripperPath | None = None
    margins: list[float] = field(default_factory=list)
    ready: list[float] = field(default_factory=list)
    """Ratio of grip force to the minimum that also withstands the announced push."""
    set_down_impact: float = math.nan
    """Impulse on the object during its placement, beyond its weight, N s."""
    released_at: float = math.nan
    """Time of release after the lift, s. A single finger in contact does not hold an object."""
    torn: bool = False
    """It slid out of a grip that was not opened."""
    second_fell: bool = False
    """The second object fell off while the first was held."""
    _next_check: float = -math.inf
    _up_since: float = math.nan

    def __post_init__(self) -> None:
        model = self.world.model
        self._bodies = ground_truth.object_bodies(self.world)
        self._gripper_start = float(ground_truth.gripper_position(self.world)[2])
        self._supports = model.body_weldid == 0
        self._start = self._standing()
        self._start_position = ground_truth.object_position(self.world, self._bodies)

    @classmethod
    def of(cls, scenario: Scenario, rig: Rig) -> TaskScorer:
        """Create the scorer of a scenario with the events sampled for its seed."""
        task = load_task(scenario.task)
        sampled = task.sample(scenario.seed, len(rig.fingers))
        return cls(rig.scene, task, sampled.pulls(), sampled.path)

    def after_step_batch(self, forces: Sequence[float], phase: str, steps: int = 1) -> None:
        """Evaluate the ground truth after `steps` physics steps, with normal `forces`, N, per
        finger."""
        height = self._height()
        time = self.world.time
        second = sorted(forces)[-2:][0]  # contact on a single finger is not a grip
        if math.isnan(self._up_since):
            if self.is_up():
                self._up_since = time
        elif math.isnan(self.released_at) and second < RELEASED:
            self.released_at = time - self._up_since
            self.torn = phase in ("lift", "hold")
        if phase in ("lower", "release") and not math.isnan(self._up_since):
            pressed = max(
                ground_truth.support_force(self.world, self._bodies) - self._weight(), 0.0
            )
            self.set_down_impact = (
                np.nan_to_num(self.set_down_impact) + pressed * steps * self.world.timestep
            )
        is_pulled = time - self._up_since >= self.pulls  # a pulling person carries it, too
        if phase in ("lift", "hold") and height > _IN_AIR and time >= self._next_check:
            self._next_check = time + _EVERY
            stacked = self.world.second_object
            self.second_fell |= stacked is not None and stacked.has_fallen
            need = self.need()
            if need > 0 and second > RELEASED and not is_pulled:
                grip = float(np.mean(forces))
                announced = self.task.goal.push / self.friction_sum()
                self.margins.append(grip / need)
                self.ready.append(grip / (need + announced))

    def is_up(self) -> bool:
        """Return True if the gripper is at the height at which the task's events start."""
        return self._height() > 0.9 * self.task.goal.lift_height

    def in_the_air(self) -> bool:
        """Return True if the fingers alone carry the object."""
        return self._height() > _IN_AIR

    def friction_sum(self) -> float:
        """Return the present sum of the fingers' friction coefficients: n mu."""
        return sum(sensor.friction for sensor in self.world.sensors)

    def need(self) -> float:
        """Return the present minimum normal force per finger, N; 0 without contact."""
        data = self.world.data
        mass = self.world.model.body_mass[self._bodies]
        total = mass.sum()
        second = self.world.second_object
        carried = total if second is None else total + second.load
        force = carried * (self.world.model.opt.gravity - self._acceleration())
        force = force + data.xfrc_applied[self._bodies, :3].sum(axis=0)
        patches = [self._patch(finger) for finger in range(len(self.world.sensors))]
        middles = [center for center, radius in patches if radius > 0]
        radii = [radius for _, radius in patches if radius > 0]
        if not middles:
            return 0.0
        axis = self._axis()
        arm = mass @ data.xipos[self._bodies] / total - sum(middles) / len(middles)
        along = force if axis is None else force - (force @ axis) * axis
        torque = 0.0 if axis is None else float(cross(arm, force) @ axis)
        load = math.hypot(math.sqrt(along @ along), torque / (sum(radii) / len(radii)))
        return load / self.friction_sum()

    def failure(self) -> str:
        """Return the failed requirement of the task, or ""."""
        counts = self.task.success
        if math.isfinite(counts.release_within):
            return self._handover_failure(counts.release_within)
        if math.isfinite(counts.max_tilt):
            tilt, height = self._standing()
            if math.degrees(abs(tilt)) > math.degrees(counts.max_tilt):
                return f"it is not upright: tilted by {math.degrees(tilt):.0f} deg"
            if abs(height - self._start[1]) > STANDS:
                return (
                    "it does not stand at its place: height off by "
                    f"{1e3 * (height - self._start[1]):+.0f} mm"
                )
        if self.set_down_impact > counts.max_impact:
            return f"it was set down with an impact of {self.set_down_impact:.2g} N s"
        if counts.stacked and self.second_fell:
            return "the second object fell off it"
        missed = self._distance_to_place()
        if missed > counts.place_within:
            return f"it was set down {1e3 * missed:.0f} mm from its place"
        return ""

    def measures(self) -> dict[str, float]:
        """Return the available measures by name; non-finite values are omitted."""
        found = {"impact_N_s_true": self.set_down_impact}
        if self.margins:
            margins = np.array(self.margins)
            found["margin_true"] = float(np.median(margins))
            found["margin_above_2_true"] = float(np.mean(margins > _GENEROUS))
        if self.ready and self.task.goal.push > 0:
            found["margin_ready_true"] = float(np.median(self.ready))
        if math.isfinite(self.task.success.max_tilt):
            found["tilt_deg_true"] = math.degrees(self._standing()[0])
        if math.isfinite(self.task.success.place_within):
            found["place_error_mm_true"] = 1e3 * self._distance_to_place()
        if math.isfinite(self.pulls):
            found["release_delay_s_true"] = self.released_at - self.pulls
        return {name: value for name, value in found.items() if math.isfinite(value)}

    def _handover_failure(self, within: float) -> str:
        late = self.released_at - self.pulls
        if math.isnan(late):
            return "it was never released"
        if late < 0:
            return f"it was released {-late:.1f} s before the pull"
        if self.torn:
            return "it was pulled out of the gripper, which did not open"
        return f"it was released only {late:.1f} s after the pull" if late > within else ""

    def _patch(self, finger: int) -> tuple[Array, float]:
        """Return center and radius of the contact patch on a membrane.

        The center (3,), m, is in frame W. The radius, m, is the force-weighted mean distance from
        it. It is the ratio of the friction limits in torque and force. It is 0 without contact.
        """
        center, radius = ground_truth.patch(self.world, finger)
        if radius <= 0:
            return center, 0.0
        data = self.world.data
        body = self.world.sensors[finger].body_id
        R_WS = data.xmat[body].reshape(3, 3)
        # a vertex represents an area: at least half of the mesh spacing
        return data.xpos[body] + R_WS @ center, max(radius, 5e-4)

    def _axis(self) -> Array | None:
        """Return the unit vector from one finger to the other; None for more than two fingers.

        Every direction lies between the planes of more than two fingers.
        """
        if len(self.world.sensors) != 2:
            return None
        data = self.world.data
        first, second = (
            data.xmat[sensor.body_id].reshape(3, 3)[:, 2] for sensor in self.world.sensors
        )
        return (first - second) / np.linalg.norm(first - second)

    def _acceleration(self) -> Array:
        """Return the present acceleration (3,) of the gripper on its path, m/s^2, in W."""
        if self.path is None or math.isnan(self._up_since):
            return np.zeros(3)
        axes = path_axes(self.world.start)
        return self.path.acceleration(self.world.time - self._up_since) @ axes

    def _distance_to_place(self) -> float:
        """Return the horizontal distance of the object from the end of the path, m."""
        if self.path is None:
            return 0.0
        moved = self.path.at(self.path.end)[:3] @ path_axes(self.world.start)
        position = ground_truth.object_position(self.world, self._bodies)
        return math.hypot(*(position - self._start_position - moved)[:2])

    def _height(self) -> float:
        """Return the height of the gripper above its start, m."""
        return float(ground_truth.gripper_position(self.world)[2]) - self._gripper_start

    def _weight(self) -> float:
        model = self.world.model
        return float(model.body_mass[self._bodies].sum() * np.linalg.norm(model.opt.gravity))

    def _standing(self) -> tuple[float, float]:
        """Return the tilt of the object's z axis, rad, and its center height above the target,
        m."""
        _, rotation = ground_truth.object_pose(self.world, self.world.solid)
        upright = 1 - 2 * float(rotation[1] ** 2 + rotation[2] ** 2)  # z of the turned z axis
        slots = np.flatnonzero(self._supports)
        moved = float(self.world.model.body_pos[slots[-1], 2])
        height = float(ground_truth.object_position(self.world, self._bodies)[2]) - moved
        return math.acos(min(max(upright, -1.0), 1.0)), height
