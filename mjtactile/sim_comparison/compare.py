"""From a recording's folder to its shadow: what is simulated again, and in how many processes."""

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
    thing: str = "",
    until: float = math.inf,
    causes: Sequence[str] = (),
    workers: int = 1,
    say: Callable[[str], None] = lambda _: None,
) -> tuple[SimComparison, RecordedEpisode]:
    """Simulate again what was recorded, and say where the two part.

    Args:
        folder: The recording, or a run's folder around it.
        rig: The simulated rig that stands for the recording's hand.
        thing: The object that was grasped, where the recording does not say it.
        until: s from the first cycle, after which nothing is looked at.
        causes: Names of those to try; none: all.
        workers: Processes that simulate.
        say: Is given a line where something goes on.

    Returns:
        The shadow, and the recording.

    Raises:
        InputError: The recording names no object or stage, or has no cycles.
    """
    episode = RecordedEpisode(folder)
    staged = "stage" in episode.recording.notes
    again = StageReplay(folder, until) if staged else _hand(episode, folder, rig, thing, until)
    found = recorded(episode)
    if math.isfinite(until):
        found = found.at(found.time[found.time <= until])

    def many(wanted: Sequence[Amounts]) -> Sequence[Signals | None]:
        ran: Any = Parallel(n_jobs=workers)(delayed(attempted)(again.run, one) for one in wanted)
        return list(ran)

    say("the simulator does it again")
    chosen = causes_of(staged, tuple(causes))
    return explain(found, again.run, chosen, many=many, say=say), episode


def _hand(
    episode: RecordedEpisode, folder: Path, rig: str, thing: str, until: float
) -> GripperReplay:
    header = episode.recording.header
    name = thing or header.get("object")
    if not name:
        raise InputError(
            "the recording does not say what was grasped", source=folder, field="--object"
        )
    scenario = Scenario(object=name, rig=rig, sensor=episode.design, seed=header.get("seed") or 0)
    return GripperReplay(folder, replace(scenario, effects=without_rendering("auto")), until)
