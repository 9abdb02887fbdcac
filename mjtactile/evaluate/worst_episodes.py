"""The worst episodes of an evaluation, with a figure of each.

They are run again and recorded. The repeated run gives the same grasp.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest
from math import ceil
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
_SHOWN_MAX = 10
_SLIP = 5.0  # slip, mm, that is as bad as breaking


def worst(lines: Sequence[Line], count: int | None) -> list[Line]:
    """Return the `count` worst lines: failures, then errors, then episodes closest to a failure.

    None: at most ten, of which a tenth of the held episodes: a repetition costs a whole episode.
    The kinds (controller, object, outcome) alternate, so that none hides the others.
    """
    if count is None:
        held = sum(_RANKS[line["outcome"]] == 0 for line in lines)
        count = min(_SHOWN_MAX, len(lines) - held + ceil(held / _SHOWN_MAX))
    chosen: list[Line] = []
    for rank in (2, 1, 0):
        ranked = [line for line in lines if _RANKS[line["outcome"]] == rank]
        ranked.sort(key=_badness, reverse=True)
        kinds: dict[tuple[str, ...], list[Line]] = {}
        for line in ranked:
            kind = (line["controller"], line["object"], line["outcome"])
            kinds.setdefault(kind, []).append(line)
        # alternate between the kinds
        rows = zip_longest(*kinds.values()) if rank else kinds.values()
        chosen += [line for row in rows for line in row if line is not None]
    return sorted(
        chosen[:count], key=lambda line: (_RANKS[line["outcome"]], _badness(line)), reverse=True
    )


def _badness(line: Line) -> float:
    """Return the closeness to a failure; 1 is the breaking force, or a large slip."""
    found = measures(line)
    squeezed = found["peak_to_break_ratio"] or 0.0
    slipped = (found["slip_mm"] or 0.0) / _SLIP
    return max(squeezed, slipped)


def render(episode: Episode, folder: Path) -> Path | None:
    """Repeat and record the episode; return its summary image in `folder`, None without one."""
    image = folder / "summary.png"
    if image.exists():
        return image
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
    return image if image.exists() else None  # without matplotlib the report has no images
