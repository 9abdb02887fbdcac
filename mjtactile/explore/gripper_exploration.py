"""Exploration by a gripper that moves up and down next to the object, emulated or real. The user
may rotate the object between two explorations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from mjtactile.core.errors import InputError, Interrupted
from mjtactile.core.scenario import Scenario
from mjtactile.explore.exploration import ExplorationGoal, ExplorationResult, explored
from mjtactile.explore.grip_scan import (
    HEIGHTS,
    GripController,
    Log,
    grips_of,
    patches_of_grip,
    require_two,
)
from mjtactile.explore.surface_patch import Patch
from mjtactile.recording.observer import Observer, Observers
from mjtactile.rig.file import read_rig_file
from mjtactile.rig.finger import Rig
from mjtactile.rig.simulated import SimRigFile
from mjtactile.runtime.session import open_session

_GRIP_TIME = 30.0  # time limit of a grip, s


def recorded_folder(scenario: Scenario) -> Path | None:
    """Return the folder of a replayed rig's recording; None if it is not a replay."""
    kind, _, folder = scenario.rig.partition(":")
    return Path(folder) if kind == "replay" else None


def is_simulated(scenario: Scenario) -> bool:
    """Return True if the rig is simulated in this process, where the object can be rotated."""
    return scenario.rig == "sim" or isinstance(read_rig_file(scenario.rig), SimRigFile)


def explore_by_gripper(
    scenario: Scenario,
    goal: ExplorationGoal,
    *,
    yaw: float = 0.0,
    known: Sequence[Patch] = (),
    notify: Callable[[str], None] = lambda _: None,
    keep: Callable[[Patch], None] = lambda _: None,
    observer: Observer | None = None,
) -> ExplorationResult:
    """Grip an object in place at several heights, in one run.

    Args:
        scenario: Two-finger rig and sensor; for an emulated rig, also object and seed.
        goal: `touches`, the grips including earlier ones, at most one per height; `force`.
        yaw: Rotation of the object about the vertical since the first grips, by the user, rad.
        known: Patches from earlier grips.
        notify: Callback that receives a line for each grip.
        keep: Callback that receives each patch.
        observer: Observer, for example a recorder.

    Returns:
        The result, also after a stop.

    Raises:
        InputError: Unknown names, another number of fingers, or no grips left to do.
        DeviceError: A device fault. The rig is always brought to its safe state at the end.
    """
    before = max((patch.group for patch in known), default=0)
    log = Log()
    observers = Observers([log] if observer is None else [log, observer])
    outcome = "touches"
    with open_session(scenario, workers=0, notify=notify) as session:
        require_two(len(session.rig.fingers))
        heights = _heights(session.rig, goal.touches - before)
        observers.start(session)
        session.take_references(observers)
        controller = GripController(heights, goal.force)
        try:
            session.run(controller, time_limit=_GRIP_TIME * len(heights), observer=observers)
        except Interrupted:
            outcome = "interrupted"
        designs = [finger.design for finger in session.rig.fingers]
        perceptions = session.perceptions
        flags = session.flags
    patches = list(known)
    for grip_number, grip in enumerate(grips_of(log.cycles), before + 1):
        new = patches_of_grip(grip, perceptions, designs, yaw=yaw, group=grip_number)
        for patch in new:
            keep(patch)
        patches += new
        kinds = ", ".join(patch.kind for patch in new)
        notify(f"grip {grip_number}: {1e3 * grip[0].height:.0f} mm up: {kinds}")
    tried = before + len(heights)
    return explored(patches, outcome if patches else "no contact", tried, flags)


def _heights(rig: Rig, count: int) -> tuple[float, ...]:
    if count < 1:
        raise InputError("the requested number of grips is already complete", field="--touches")
    return tuple(height for height in HEIGHTS if height <= rig.limits.lift[1])[:count]
