"""Ground-truth score of a simulated grasp: forces, slip, held or dropped or crushed.

It is never an input of sensing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mjtactile.core.task_sections import SuccessCriteria
from mjtactile.core.types import Array, Markers, Touch
from mjtactile.runtime.task_scoring import TaskScorer
from mjtactile.sim import ground_truth
from mjtactile.sim.scenes.grasp_world import GraspWorld
from mjtactile.sim.scenes.scene_triangles import SceneView

RISEN = 0.01  # minimum lift of the gripper for the decision between held and lost, m
# An object counts as held if it rose by at least this fraction of the gripper's lift,
HELD_FRACTION = 0.5
# Interval of the strain check of a soft object, s; strain changes as slowly as the fingers move
_STRAIN_EVERY = 0.02
_NO_MARKERS = np.zeros((0, 3))
# minus this tolerance, m: without a lift, an object that is not dropped counts as held
HELD_SLACK = 1e-3
_STANDS = 2e-3  # maximum height change of an object that stands, m


@dataclass
class GraspScore:
    """Watches a world at every physics step. A phase counts from the image after the command that
    started it."""

    world: GraspWorld
    task_scorer: TaskScorer | None = None
    phase: str = "approach"
    peak_force: float = 0.0
    peak_stress: float = math.nan
    """Maximum stress, Pa, and `peak_energy`, J/m^3, exceeded in 5 % of a soft object's volume."""
    peak_energy: float = math.nan
    crushed_at: float | None = None
    _next_phase: str = "approach"
    _wrenches: list[Array] = field(default_factory=list)
    _object_pose: dict[str, list[float]] = field(default_factory=dict)
    _markers: list[Array] = field(default_factory=list)
    _hold_sum: float = 0.0
    _hold_steps: int = 0
    _held: list[bool] = field(default_factory=list)
    view: SceneView | None = None
    """The scene as it was when the images were taken."""
    lost: bool = False
    """True if the gripper rose and the object did not rise with it."""
    fell: bool = False
    """True if the object was released in the air and fell."""
    _release_height: float = math.nan
    _carried: float = 0.0
    _grip_start: Array | None = None
    _slip: float = 0.0

    def __post_init__(self) -> None:
        self._bodies = ground_truth.object_bodies(self.world)
        self._solid = ground_truth.solid_bodies(self.world)
        self._friction = [sensor.design.membrane.friction for sensor in self.world.sensors]
        self._next_strain = -math.inf
        self._rest_height = self._object_position()[2]
        self._gripper_start = ground_truth.gripper_position(self.world)[2]

    def start_cycle(self) -> None:
        """Start a cycle after its images were taken: the phase sent last now applies."""
        self.phase = self._next_phase

    def send(self, phase: str) -> None:
        """Store the phase of a sent command. It applies from the next images on."""
        self._next_phase = phase

    def snapshot(self, with_view: bool = True) -> None:
        """Store the ground truth at the time of the images. The world must be paused.

        Storing its view as well costs a tenth of a cycle without images.
        """
        self.start_cycle()
        sensors = range(len(self.world.sensors))
        self._wrenches = [ground_truth.contact_wrench(self.world, i) for i in sensors]
        # synthetic touch has no markers, and computing them takes a sixth of an episode
        sees = "pipeline" in self.world.effects
        self._markers = [self.world.marker_poses(i)[0] if sees else _NO_MARKERS for i in sensors]
        p_WO, q_WO = ground_truth.object_pose(self.world, self.world.solid)
        self._object_pose = {
            "object_position_true": p_WO.tolist(),
            "object_quaternion_true": q_WO.tolist(),
        }
        self.view = SceneView.of(self.world) if with_view else None

    def columns(self, touch: Sequence[Touch], phase: str) -> dict[str, list[Any]]:
        """Return the ground-truth columns of one cycle (`mjtactile.recording.log_schema.TRUE`).

        `phase` is that of the command sent in this cycle.
        """
        self.send(phase)
        pairs = zip(touch, self._markers, strict=True)
        errors = [_marker_error(estimate.markers, p_SM) for estimate, p_SM in pairs]
        return {
            "force_normal_true": [float(-wrench[2]) for wrench in self._wrenches],
            "wrench_true": [wrench.tolist() for wrench in self._wrenches],
            "marker_error_true": errors,
            **self._object_pose,
        }

    def after_step_batch(self) -> None:
        """Sample the ground truth; call after every physics step or batch of steps."""
        each = ground_truth.step_batch_forces(self.world)
        forces = each[-1].tolist()
        peak = float(each.max())
        self.peak_force = max(self.peak_force, peak)
        if (peak > self.world.object.break_force or self._is_torn()) and self.crushed_at is None:
            self.crushed_at = self.world.time
        if self.task_scorer is not None:
            self.task_scorer.after_step_batch(forces, self.phase, len(each))
        if self.phase == "release":
            self._watch_fall()
        if self.phase not in ("lift", "hold"):
            return
        p_WO = self._object_position()
        p_WH = ground_truth.gripper_position(self.world)
        self._track_slip((p_WO - p_WH) @ ground_truth.gripper_rotation(self.world))
        self._carried = max(self._carried, float((each @ self._friction).max()))
        lifted = float(p_WH[2] - self._gripper_start)
        risen = bool(p_WO[2] - self._rest_height > HELD_FRACTION * lifted - HELD_SLACK)
        self.lost |= lifted > RISEN and not risen
        if self.phase == "hold":
            self._hold_sum += float(each.sum()) / each.shape[1]
            self._hold_steps += len(each)
            self._held.append(risen)

    def due(self) -> float:
        """Return the latest world time of the next call to `after_step_batch`, s.

        If the task measures the placement impact, it is after each step, since an impact lasts
        milliseconds.
        """
        sets_down = self.phase in ("lower", "release")
        counts = self.task_scorer is not None and math.isfinite(
            self.task_scorer.task.success.max_impact
        )
        return self.world.time if sets_down and counts else math.inf

    def _watch_fall(self) -> None:
        """Detect a fall of the object from its height at release."""
        height = float(self._object_position()[2])
        if math.isnan(self._release_height):
            self._release_height = height
        counts = SuccessCriteria() if self.task_scorer is None else self.task_scorer.task.success
        self.fell |= self._release_height - height > counts.max_drop

    def _is_torn(self) -> bool:
        """Return True if the strain of a soft object exceeds its material's limit."""
        material = self.world.object.flex_material
        solid = self.world.solid
        time = self.world.time
        if solid is None or material is None or time < self._next_strain:
            return False
        self._next_strain = time + _STRAIN_EVERY
        strain = solid.strain(self.world.data)
        self.peak_stress = float(np.fmax(self.peak_stress, strain.stress))
        self.peak_energy = float(np.fmax(self.peak_energy, strain.energy_density))
        return (
            strain.stress > material.break_stress or strain.energy_density > material.break_energy
        )

    def forces(self) -> list[float]:
        """Return the normal force of the object on each membrane, N, positive in compression."""
        return (-ground_truth.contact_loads(self.world, self.world.sensors)[:, 2]).tolist()

    def _object_position(self) -> Array:
        return ground_truth.object_position(self.world, self._solid)

    def _track_slip(self, relative: Array) -> None:
        """Update the largest motion of the object relative to the gripper since it was lifted, m.

        `relative` (3,), m, is its current position in the gripper's frame.
        """
        if self._grip_start is None:
            self._grip_start = relative
        self._slip = max(self._slip, float(np.linalg.norm(relative - self._grip_start)))

    def reason(self) -> str:
        """Return the reason why a lifted object was dropped, or "".

        The reasons are insufficient grip for its weight, a release in the air, or failure of the
        task.
        """
        if self.outcome() == "dropped" and self._is_held and self.fell:
            return "it was released in the air and fell"
        if self.outcome() == "dropped" and self._is_held and self.task_scorer is not None:
            return self.task_scorer.failure()
        model = self.world.model
        weight = float(model.body_mass[self._bodies].sum() * np.linalg.norm(model.opt.gravity))
        if self.outcome() != "dropped" or self._grip_start is None or weight <= self._carried:
            return ""
        return (
            f"too heavy for this grip: it weighs {weight:.2g} N, and the fingers can carry at "
            f"most {self._carried:.2g} N with a friction coefficient of "
            f"{min(self._friction):.2g}"
        )

    def outcome(self) -> str:
        """Return the outcome of the grasp.

        It is "crushed" if a finger ever loaded the object beyond its limit. It is "held" if the
        object stayed up and the task did not fail, else "dropped".
        """
        if self.crushed_at is not None:
            return "crushed"
        fails = self.task_scorer is not None and self.task_scorer.failure()
        return "held" if self._is_held and not fails and not self.fell else "dropped"

    @property
    def is_standing(self) -> bool:
        """True if the object is at its initial height. A raised gripper did not lose it."""
        risen = float(self._object_position()[2] - self._rest_height)
        return abs(risen) < _STANDS and not self.lost and not self.fell

    @property
    def _is_held(self) -> bool:
        return bool(self._held) and all(self._held)

    def measures(self) -> dict[str, float]:
        """Return additional measures of the task, by name."""
        return {} if self.task_scorer is None else self.task_scorer.measures()

    @property
    def hold_force(self) -> float:
        """Mean normal force per finger over the hold phase, N; NaN when it was never reached."""
        return self._hold_sum / self._hold_steps if self._hold_steps else math.nan

    @property
    def slip(self) -> float:
        """Slip, m; NaN when the object was never lifted."""
        return self._slip if self._grip_start is not None else float("nan")


def _marker_error(markers: Markers | None, p_SM: Array) -> float:
    """Return the mean position error, m, of detected markers; NaN without any."""
    if markers is None or not len(markers):
        return math.nan
    return float(np.linalg.norm(markers.p_SM - p_SM[markers.ids], axis=1).mean())
