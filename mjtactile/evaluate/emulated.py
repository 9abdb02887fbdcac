"""Episodes on emulated rigs with the real drivers, scored with the world's ground truth."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mjtactile.core.errors import InputError
from mjtactile.core.scenario import Scenario
from mjtactile.core.task import load_task
from mjtactile.recording.observer import Observer
from mjtactile.rig.domain_randomization import NONE
from mjtactile.rig.file import RigFile, read_rig_file
from mjtactile.runtime.cycle import Cycle

# minimum rise of the object over rise of the gripper: it rolls slightly when lifted
_COMES_ALONG = 0.9
_STANDS = 3e-3  # tolerance on the object's start height, m


def check(scenario: Scenario) -> bool:
    """Return True if the rig of a scenario is emulated.

    Args:
        scenario: Scenario of an evaluation.

    Returns:
        False if the rig is simulated.

    Raises:
        InputError: The rig has real devices, where the object is not put back between episodes. Or
            the emulated world does not support the scenario.
    """
    file = read_rig_file(scenario.rig)
    if not isinstance(file, RigFile):
        return False
    if file.emulator is None:
        raise InputError(
            "has real devices, where the object is not put back between episodes",
            source=file.path,
            field="--rig",
            choices=["a simulated or an emulated one"],
        )
    if scenario.randomization != NONE:
        raise InputError(
            "an emulated world follows its rig file and is not randomized",
            field="--randomization",
            choices=[NONE],
        )
    task = load_task(scenario.task)
    is_randomized = not task.is_plain and any(
        disturbance.kind != "move_support" for disturbance in task.disturbances
    )
    if is_randomized or task.object != type(task.object)():
        raise InputError(
            f"the disturbances of {task.name!r} are not available on an emulated rig",
            field="--task",
            choices=["lift", "place"],
        )
    return True


class TrueOutcome(Observer):
    """Ground truth of the emulated world, read once a cycle from lifting on."""

    def __init__(self, break_force: float):
        self._break_force = break_force
        self._truth: Any = None
        self._start = 0.0
        self._last: Mapping[str, Any] = {}
        self._came_along = True
        self._held: list[float] = []
        self._peak = 0.0
        self._done = False

    def start(self, session: Any) -> None:
        """Store the start height of the object."""
        self._truth = session.rig.truth
        self._start = float(self._truth()["object_height"])

    def add(self, cycle: Cycle, view: Any = None, **true: Any) -> None:
        """Evaluate the ground truth of one cycle."""
        if cycle.sent.phase == "approach":
            return
        self._last = self._truth()
        self._done = cycle.sent.phase == "done"
        forces = [float(self._last["contact_1"]), float(self._last["contact_2"])]
        self._peak = max(self._peak, *forces)
        if cycle.sent.phase == "hold":
            self._held.append(sum(forces) / len(forces))
            risen = float(self._last["object_height"]) - self._start
            self._came_along &= risen > _COMES_ALONG * float(self._last["lift_height"])

    def score(self, summary: Mapping[str, Any]) -> dict[str, Any]:
        """Replace the controller's outcome in a run's summary by ground truth.

        Args:
            summary: Summary of `mjtactile.runtime.grasp.GraspResult`.

        Returns:
            The summary with true forces, N, at the image times. The `outcome` is based on the final
            and lifted height of the object. The gripper may end above its start height, stopped by
            the table.
        """
        if not self._last:
            return dict(summary)
        height_error = abs(float(self._last["object_height"]) - self._start)
        held = self._done and bool(self._held) and self._came_along and height_error < _STANDS
        outcome = "held" if held else "dropped"
        if self._peak > self._break_force:
            outcome = "crushed"
        hold = sum(self._held) / len(self._held) if self._held else None
        true = {"peak_force_true_N": self._peak, "hold_force_true_N": hold}
        reason = {"reason": ""} if outcome == "held" else {}
        known = {"outcome": outcome, "outcome_from": "ground truth"}
        return dict(summary) | true | reason | known


def files(scenario: Scenario) -> list[Path]:
    """Return the files of an emulated rig that its episodes depend on."""
    return [read_rig_file(scenario.rig).path]
