"""What a task asks of a grasp, by ground truth: how much more than needed it gripped, whether the
thing stands in the end, how it was set down, and whether it was let go when somebody took it.

The least grip is that of Coulomb's law on soft fingers: the load along the membranes and the
torque about the axis through the fingers share friction's limit as an ellipse (Howe & Cutkosky,
Int. J. Robotics Research 15, 1996), and all fingers press alike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mjtactile.core.geometry import cross
from mjtactile.core.scenario import Scenario
from mjtactile.core.task import Task, load_task
from mjtactile.core.types import Array
from mjtactile.rig.finger import Rig
from mjtactile.sim import ground_truth
from mjtactile.sim.scenes.grasp_world import GraspWorld

VERSION = "3"
"""Goes up with every change of what counts or of how it is measured."""
_EVERY = 0.02  # s between two looks at the need
_IN_AIR = 0.01  # m of the hand, from where on the fingers alone carry the object
_LET_GO = 0.02  # N on each finger, below which nothing is held
_PULL = 0.3  # N of a pull, from where on letting go is asked for
_STANDS = 5e-3  # m off the height at which it would stand
_GENEROUS = 2.0  # a grip of so many times the need is more than asked


@dataclass
class TaskScorer:
    """Watches a world in which a task is done. `pulls` has when, s after the hand was up, somebody
    pulls with more than 0.3 N, NaN: nobody does."""

    world: GraspWorld
    task: Task
    pulls: float = math.nan
    margins: list[float] = field(default_factory=list)
    ready: list[float] = field(default_factory=list)
    """The same over the least that holds against the push that was announced, too."""
    bump: float = math.nan
    """N s with which the object was pressed or fell onto its place, beyond its weight."""
    let_go_at: float = math.nan
    """s after the hand was up; one finger alone holds nothing."""
    torn: bool = False
    """It slid out of a grip that was not opened."""
    _next_check: float = -math.inf
    _up_since: float = math.nan

    def __post_init__(self) -> None:
        model = self.world.model
        self._bodies = ground_truth.object_bodies(self.world)
        self._friction = [sensor.design.membrane.friction for sensor in self.world.sensors]
        self._gripper_start = float(ground_truth.gripper_position(self.world)[2])
        self._places = model.body_weldid == 0
        self._start = self._standing()

    @classmethod
    def of(cls, scenario: Scenario, rig: Rig) -> TaskScorer:
        """Of what a scenario's seed has drawn for a simulated rig."""
        task = load_task(scenario.task)
        return cls(rig.scene, task, task.draw(scenario.seed, len(rig.fingers)).pulls())

    def after_stretch(self, forces: Sequence[float], phase: str, steps: int = 1) -> None:
        """Look at the truth after so many physics steps; `forces` N press on the fingers."""
        height = self._height()
        time = self.world.time
        second = sorted(forces)[-2:][0]  # what presses on one finger alone is not held
        if math.isnan(self._up_since):
            if self.is_up():
                self._up_since = time
        elif math.isnan(self.let_go_at) and second < _LET_GO:
            self.let_go_at = time - self._up_since
            self.torn = phase in ("lift", "hold")
        if phase in ("lower", "release") and not math.isnan(self._up_since):
            pressed = max(
                ground_truth.support_force(self.world, self._bodies) - self._weight(), 0.0
            )
            self.bump = np.nan_to_num(self.bump) + pressed * steps * self.world.timestep
        is_pulled = time - self._up_since >= self.pulls  # then who pulls carries it, too
        if phase in ("lift", "hold") and height > _IN_AIR and time >= self._next_check:
            self._next_check = time + _EVERY
            need = self.need()
            if need > 0 and second > _LET_GO and not is_pulled:
                grip = float(np.mean(forces))
                announced = self.task.orders.push / self.friction_sum()
                self.margins.append(grip / need)
                self.ready.append(grip / (need + announced))

    def is_up(self) -> bool:
        """Whether the hand is as high as what happens waits for."""
        return self._height() > 0.9 * self.task.orders.lift_height

    def in_the_air(self) -> bool:
        """Whether the fingers alone carry what they hold."""
        return self._height() > _IN_AIR

    def friction_sum(self) -> float:
        """Of all fingers' coefficients: n mu."""
        return sum(self._friction)

    def need(self) -> float:
        """N that each finger must press with at least, now; 0 where nothing touches."""
        data = self.world.data
        mass = self.world.model.body_mass[self._bodies]
        total = mass.sum()
        force = total * self.world.model.opt.gravity
        force = force + data.xfrc_applied[self._bodies, :3].sum(axis=0)
        middles = []
        radii = []
        for number in range(len(self.world.sensors)):
            middle, radius = self._patch(number)
            if radius > 0:
                middles.append(middle)
                radii.append(radius)
        if not middles:
            return 0.0
        axis = self._axis()
        arm = mass @ data.xipos[self._bodies] / total - sum(middles) / len(middles)
        along = force if axis is None else force - (force @ axis) * axis
        torque = 0.0 if axis is None else float(cross(arm, force) @ axis)
        load = math.hypot(math.sqrt(along @ along), torque / (sum(radii) / len(radii)))
        return load / sum(self._friction)

    def failure(self) -> str:
        """What the task counts and was not done, "" for nothing."""
        counts = self.task.counts
        if math.isfinite(counts.let_go):
            return self._handover_failure(counts.let_go)
        if math.isfinite(counts.upright):
            tilt, height = self._standing()
            if math.degrees(abs(tilt)) > math.degrees(counts.upright):
                return f"it does not stand: tilted by {math.degrees(tilt):.0f} deg"
            if abs(height - self._start[1]) > _STANDS:
                return f"it does not stand: {1e3 * (height - self._start[1]):+.0f} mm off its place"
        if self.bump > counts.bump:
            return f"it was set down with {self.bump:.2g} N s"
        return ""

    def measures(self) -> dict[str, float]:
        """What was measured, by its name in results; only what is known."""
        found = {"impact_N_s_true": self.bump}
        if self.margins:
            margins = np.array(self.margins)
            found["margin_true"] = float(np.median(margins))
            found["margin_above_2_true"] = float(np.mean(margins > _GENEROUS))
        if self.ready and self.task.orders.push > 0:
            found["margin_ready_true"] = float(np.median(self.ready))
        if math.isfinite(self.task.counts.upright):
            found["tilt_deg_true"] = math.degrees(self._standing()[0])
        if math.isfinite(self.pulls):
            found["release_delay_s_true"] = self.let_go_at - self.pulls
        return {name: value for name, value in found.items() if math.isfinite(value)}

    def _handover_failure(self, within: float) -> str:
        late = self.let_go_at - self.pulls
        if math.isnan(late):
            return "it was never let go of"
        if late < 0:
            return f"it was let go of {-late:.1f} s before somebody took it"
        if self.torn:
            return "it was torn out of the hand, which did not open"
        return f"it was let go of after {late:.1f} s of pulling" if late > within else ""

    def _patch(self, number: int) -> tuple[Array, float]:
        """Middle (3,) m, frame W, of what presses on a membrane, and its mean distance from there,
        m, by force: friction's limit in torque over that in force. 0: nothing presses."""
        middle, radius = ground_truth.patch(self.world, number)
        if radius <= 0:
            return middle, 0.0
        data = self.world.data
        body = self.world.sensors[number].body_id
        R_WS = data.xmat[body].reshape(3, 3)
        # vertices are no points: half of the mesh's spacing at least
        return data.xpos[body] + R_WS @ middle, max(radius, 5e-4)

    def _axis(self) -> Array | None:
        """The unit vector from one finger to the other; None for more than two, between whose
        planes every direction lies."""
        if len(self.world.sensors) != 2:
            return None
        data = self.world.data
        first, second = (
            data.xmat[sensor.body_id].reshape(3, 3)[:, 2] for sensor in self.world.sensors
        )
        return (first - second) / np.linalg.norm(first - second)

    def _height(self) -> float:
        """m of the hand over where it began."""
        return float(ground_truth.gripper_position(self.world)[2]) - self._gripper_start

    def _weight(self) -> float:
        model = self.world.model
        return float(model.body_mass[self._bodies].sum() * np.linalg.norm(model.opt.gravity))

    def _standing(self) -> tuple[float, float]:
        """Tilt of the object's own z axis, rad, and height of its middle over its place, m."""
        _, turn = ground_truth.object_pose(self.world, self.world.solid)
        upright = 1 - 2 * float(turn[1] ** 2 + turn[2] ** 2)  # z of the turned z axis
        places = np.flatnonzero(self._places)
        moved = float(self.world.model.body_pos[places[-1], 2])
        height = float(ground_truth.object_position(self.world, self._bodies)[2]) - moved
        return math.acos(min(max(upright, -1.0), 1.0)), height
