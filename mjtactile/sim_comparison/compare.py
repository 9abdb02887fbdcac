"""Comparison of a recording's folder with its simulation, in several processes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed

from mjtactile.core.errors import InputError
from mjtactile.core.scenario import Scenario
from mjtactile.export.episode import RecordedEpisode
from mjtactile.sim_comparison.attribution import SimComparison, attempted, explain
from mjtactile.sim_comparison.discrepancy_parameters import causes_of
from mjtactile.sim_comparison.resimulate import (
    Amounts,
    GripperReplay,
    StageReplay,
    without_rendering,
)
from mjtactile.sim_comparison.signals import Signals, recorded


def shadow_of(
    folder: Path,
    *,
    rig: str = "sim",
    item: str = "",
    until: float = math.inf,
    causes: Sequence[str] = (),
    workers: int = 1,
    notify: Callable[[str], None] = lambda _: None,
) -> tuple[SimComparison, RecordedEpisode]:
    """Simulate a recording and report where both differ.

    Args:
        folder: The recording, or the folder of a run that contains it.
        rig: The simulated rig that represents the recording's gripper.
        item: The grasped object, if the recording does not name it.
        until: Time from the first cycle, s, after which data are ignored.
        causes: Names of the causes to test; none: all.
        workers: Number of simulating processes.
        notify: Callback for progress messages.

    Returns:
        The comparison, and the recording.

    Raises:
        InputError: The recording names no object or stage, or has no cycles.
    """
    episode = RecordedEpisode(folder)
    staged = "stage" in episode.recording.notes
    again = (
        StageReplay(folder, until) if staged else _replay_gripper(episode, folder, rig, item, until)
    )
    found = recorded(episode)
    if math.isfinite(until):
        found = found.at(found.time[found.time <= until])

    def many(requested: Sequence[Amounts]) -> Sequence[Signals | None]:
        ran: Any = Parallel(n_jobs=workers)(
            delayed(attempted)(again.run, parameter) for parameter in requested
        )
        return list(ran)

    notify("simulating the recording")
    chosen = causes_of(staged, tuple(causes))
    return explain(found, again.run, chosen, many=many, notify=notify), episode


def _replay_gripper(
    episode: RecordedEpisode, folder: Path, rig: str, item: str, until: float
) -> GripperReplay:
    header = episode.recording.header
    name = item or header.get("object")
    if not name:
        raise InputError(
            "the recording does not name the grasped object", source=folder, field="--object"
        )
    scenario = Scenario(object=name, rig=rig, sensor=episode.design, seed=header.get("seed") or 0)
    return GripperReplay(folder, replace(scenario, effects=without_rendering("auto")), until)
