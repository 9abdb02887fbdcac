"""Exploring with a hand that cannot turn what it grips: emulated and real ones. It goes up and down
beside the object; who stands by may turn the object between two explorations."""

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

_GRIP_TIME = 30.0  # s


def recorded_folder(scenario: Scenario) -> Path | None:
    """Where a replayed rig's recording is; None: it is no replay."""
    kind, _, folder = scenario.rig.partition(":")
    return Path(folder) if kind == "replay" else None


def is_simulated(scenario: Scenario) -> bool:
    """Whether the rig is a world of this process, in which the object can be turned."""
    return scenario.rig == "sim" or isinstance(read_rig_file(scenario.rig), SimRigFile)


def explore_by_gripper(
    scenario: Scenario,
    wanted: ExplorationGoal,
    *,
    yaw: float = 0.0,
    known: Sequence[Patch] = (),
    say: Callable[[str], None] = lambda _: None,
    keep: Callable[[Patch], None] = lambda _: None,
    observer: Observer | None = None,
) -> ExplorationResult:
    """Grip an object where it stands, at one height after the other, in one run.

    Args:
        scenario: Rig of two fingers and sensor; an emulated one's object and seed.
        wanted: `touches`, grips with those before, at most one at each height; `force`.
        yaw: rad by which somebody turned the object about the vertical since the first grips.
        known: Patches from before.
        say: Is given a line for each grip.
        keep: Is given each patch.
        observer: A recorder, for example.

    Returns:
        What was found, also when it was stopped.

    Raises:
        InputError: For names, another number of fingers, nothing left to do.
        DeviceError: For a fault; the rig is brought to its safe state on every way out.
    """
    before = max((patch.group for patch in known), default=0)
    log = Log()
    watching = Observers([log] if observer is None else [log, observer])
    outcome = "touches"
    with open_session(scenario, workers=0, say=say) as session:
        require_two(len(session.rig.fingers))
        heights = _heights(session.rig, wanted.touches - before)
        watching.begin(session)
        session.take_references(watching)
        try:
            session.run(
                GripController(heights, wanted.force),
                time_limit=_GRIP_TIME * len(heights),
                observer=watching,
            )
        except Interrupted:
            outcome = "interrupted"
        designs = [finger.design for finger in session.rig.fingers]
        perceptions = session.perceptions
        flags = session.flags
    patches = list(known)
    for number, grip in enumerate(grips_of(log.moments), before + 1):
        new = patches_of_grip(grip, perceptions, designs, yaw=yaw, group=number)
        for patch in new:
            keep(patch)
        patches += new
        kinds = ", ".join(patch.kind for patch in new)
        say(f"grip {number}: {1e3 * grip[0].height:.0f} mm up: {kinds}")
    tried = before + len(heights)
    return explored(patches, outcome if patches else "nothing there", tried, flags)


def _heights(rig: Rig, count: int) -> tuple[float, ...]:
    """Where to grip."""
    reached = [height for height in HEIGHTS if height <= rig.limits.lift[1]]
    if count < 1:
        raise InputError("as many as are asked for were made before", field="--touches")
    return tuple(reached[:count])
