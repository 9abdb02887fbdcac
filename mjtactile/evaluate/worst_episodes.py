"""The worst episodes of an evaluation, with a figure of each.

They are run again and recorded. The repeated run gives the same grasp.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

from mjtactile.core.errors import MjtactileError
from mjtactile.evaluate.episodes import OUTCOMES, Episode
from mjtactile.evaluate.parameter_sensitivity import measures
from mjtactile.evaluate.wilson import Line
from mjtactile.recording.decimated_history import DecimatedHistory
from mjtactile.recording.writer import Recorder
from mjtactile.report.summary import write_plots
from mjtactile.runtime.grasp import run_grasp

_RANKS = dict.fromkeys(OUTCOMES, 2) | {"error": 1, "held": 0}
_SLIP = 5.0  # mm that are as bad as breaking


def worst(lines: Sequence[Line], count: int) -> list[Line]:
    """Return the `count` worst lines: failures, then errors, then episodes closest to a failure.

    The kinds (controller, object, outcome) alternate, so that a frequent kind does not hide the
    others.
    """
    chosen: list[Line] = []
    for rank in (2, 1, 0):
        own = [line for line in lines if _RANKS[line["outcome"]] == rank]
        own.sort(key=_badness, reverse=True)
        kinds: dict[tuple[str, ...], list[Line]] = {}
        for line in own:
            kind = (line["controller"], line["object"], line["outcome"])
            kinds.setdefault(kind, []).append(line)
        if rank:
            chosen += _in_turn(list(kinds.values()))
        else:
            chosen += chain.from_iterable(kinds.values())
    return sorted(chosen[:count], key=_rank_and_badness, reverse=True)


def _rank_and_badness(line: Line) -> tuple[int, float]:
    return _RANKS[line["outcome"]], _badness(line)


def _in_turn(kinds: Sequence[Sequence[Line]]) -> Iterator[Line]:
    """The first of each kind, then the second of each, and so on."""
    for k in range(max(map(len, kinds), default=0)):
        yield from (kind[k] for kind in kinds if k < len(kind))


def _badness(line: Line) -> float:
    """Return the closeness to a failure; 1 is the breaking force, or a large slip."""
    found = measures(line)
    squeezed = found["peak_to_break_ratio"] or 0.0
    slipped = (found["slip_mm"] or 0.0) / _SLIP
    return max(squeezed, slipped)


def draw(episode: Episode, folder: Path) -> Path | None:
    """Repeat the episode, record it into `folder` and plot its summary image there.

    Returns None if there is no image.
    """
    picture = folder / "summary.png"
    if picture.exists():
        return picture
    scenario = episode.scenario
    summary: dict[str, Any] = scenario.names() | {"outcome": "error"}
    try:
        with Recorder(folder / "recording", scenario.header(), frames=0) as recorder:
            recorder.strip = DecimatedHistory()
            try:
                summary = run_grasp(scenario, [recorder], workers=0).summary()
            except MjtactileError as error:
                summary["reason"] = " ".join(str(error).split())
            recorder.close(outcome=summary["outcome"])
        if not recorder.cycles:
            return None
        write_plots(folder, recorder, summary)
    except (MjtactileError, OSError):
        return None  # no room
    return picture if picture.exists() else None  # without matplotlib the report has no images
