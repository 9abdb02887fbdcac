"""Two-stage evaluation (`--screening-sample`): relevant episodes again at full fidelity.

The cheap level omits the membrane mesh and the sensing pipeline. All its failures, and a sample of
the held episodes, are run again with the requested settings. Both strata together give the success
rate over all episodes, with the sample's exact limits (Clopper & Pearson 1934).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core import foreign_file
from mjtactile.core.errors import InputError
from mjtactile.core.scenario import Scenario
from mjtactile.evaluate.pool import HERE, Running
from mjtactile.evaluate.run import evaluate
from mjtactile.evaluate.statistics import exact_limits
from mjtactile.evaluate.store import read_lines
from mjtactile.evaluate.wilson import Line

LEVEL = "-mesh,-pipeline"
"""Effects of the cheap level."""
SCREEN = "screen"
FULL = "full"
"""Subfolders of both evaluations."""
_SEED = 20_000  # seed of the sample, different from that of any episode


def screen(
    folder: Path,
    scenario: Scenario,
    *,
    sample: int,
    controllers: Sequence[str],
    count: int,
    objects: Sequence[str],
    running: Running = HERE,
) -> dict[str, Any]:
    """Screen many episodes, and run the relevant ones again.

    Args:
        folder: Output folder of both evaluations.
        scenario: Scenario without controller and object, at full fidelity.
        sample: Number of episodes to run again among those that every controller held.
        controllers: Controllers; all run the same episodes.
        count: Episodes for each.
        objects: Names and files, grasped in turn.
        running: Execution settings of the episodes.

    Returns:
        The results for the report.

    Raises:
        InputError: Raised by `evaluate`, or if the scenario already omits the membrane mesh.
        DeviceError: A worker was killed.
    """
    if "-mesh" in scenario.effects.split(","):
        message = "already omits the membrane mesh: nothing is left to screen"
        raise InputError(message, field="--effects")
    both = {"count": count, "controllers": controllers, "objects": objects}
    cheap = replace(scenario, effects=cheap_effects(scenario.effects))
    running.notify(f"screening: {count} episodes with --effects={cheap.effects}")
    evaluate(folder / SCREEN, cheap, **both, running=_resumed(running, folder / SCREEN))
    screened = read_lines(folder / SCREEN)
    again = to_run_again(screened, sample)
    running.notify(f"at full fidelity: {len(again)} of them")
    resumed = _resumed(running, folder / FULL)
    evaluate(folder / FULL, scenario, **both, only=again, running=resumed)
    return compare(screened, read_lines(folder / FULL))


def cheap_effects(effects: str) -> str:
    """Return a scenario's effects with those of the cheap level."""
    kept = [name for name in effects.split(",") if name and name != "auto"]
    return ",".join([*kept, LEVEL])


def to_run_again(lines: Sequence[Line], sample: int) -> list[int]:
    """Select the episodes that any controller failed, and a sample of those that all held.

    Args:
        lines: Lines of the cheap level.
        sample: Number of held episodes in the sample.

    Returns:
        Episode numbers, in order.
    """
    failed = {line["episode"] for line in lines if line["outcome"] != "held"}
    held = sorted({line["episode"] for line in lines} - failed)
    rng = np.random.default_rng(_SEED)
    sampled = rng.choice(held, min(sample, len(held)), replace=False).tolist() if held else []
    return sorted(failed | set(sampled))


def compare(screened: Sequence[Line], full: Sequence[Line]) -> dict[str, Any]:
    """Compare the results of both levels.

    Args:
        screened: Lines of the cheap level.
        full: Lines of the full level.

    Returns:
        Results by controller: outcomes of both levels, the number that differ with exact 95 %
        limits, and the success rate at full fidelity over all episodes.
    """
    names = list(dict.fromkeys(line["controller"] for line in screened))
    return {
        "level": LEVEL,
        "controllers": {name: _of_controller(name, screened, full) for name in names},
    }


def _of_controller(name: str, screened: Sequence[Line], full: Sequence[Line]) -> dict[str, Any]:
    cheap = {line["episode"]: line for line in screened if line["controller"] == name}
    complete = {line["episode"]: line for line in full if line["controller"] == name}
    held = {episode for episode, line in cheap.items() if line["outcome"] == "held"}
    of_failed, of_held = (
        _stratum([episode for episode in sorted(episodes) if episode in complete], cheap, complete)
        for episodes in (cheap.keys() - held, held)
    )
    # all failures are run again; the sample represents the others, within its exact limits
    fraction, low, high = (
        (of_failed["holds"] + len(held) * value) / max(len(cheap), 1)
        for value in (of_held["holds_share"], *of_held["holds_interval"])
    )
    return {
        "episodes": len(cheap),
        "screened_held": len(held),
        "screened_failed": len(cheap) - len(held),
        "of_failed": of_failed,
        "of_held": of_held,
        "holds_share": fraction,
        "holds_interval": [low, high],
    }


def _stratum(
    episodes: Sequence[int], cheap: Mapping[int, Line], complete: Mapping[int, Line]
) -> dict[str, Any]:
    count = len(episodes)
    holds = sum(complete[episode]["outcome"] == "held" for episode in episodes)
    differ = [k for k in episodes if complete[k]["outcome"] != cheap[k]["outcome"]]
    return {
        "run_again": count,
        "holds": holds,
        "holds_share": holds / count if count else 0.0,
        "holds_interval": list(exact_limits(holds, count)) if count else [0.0, 1.0],
        "differ": len(differ),
        "differ_interval": list(exact_limits(len(differ), count)) if count else [0.0, 1.0],
        "differing": [
            {"episode": k, "screened": cheap[k]["outcome"], "full": complete[k]["outcome"]}
            for k in differ
        ],
    }


def table(result: Mapping[str, Any]) -> str:
    """Format the comparison in Markdown."""
    head = (
        "| controller | episodes | held, screened | held at full fidelity, of all | screened "
        "failures: held at full fidelity | screened held: sample, held at full fidelity | "
        "outcomes differ |"
    )
    lines = [head, "|---" * 7 + "|"]
    for name, row in result["controllers"].items():
        failed = row["of_failed"]
        held = row["of_held"]
        run_again = failed["run_again"] + held["run_again"]
        differ = failed["differ"] + held["differ"]
        low, high = exact_limits(differ, run_again) if run_again else (0.0, 1.0)
        lines.append(
            f"| {name} | {row['episodes']} | "
            f"{100 * row['screened_held'] / max(row['episodes'], 1):.1f} % | "
            f"{_percent(row['holds_share'], *row['holds_interval'])} | {failed['holds']} of "
            f"{failed['run_again']} | {held['holds']} of {held['run_again']} | "
            f"{_percent(differ / max(run_again, 1), low, high)} |"
        )
    words = "95 % limits are exact; for episodes held in the screening, they come from the sample."
    return "\n".join([*lines, "", f"Screened with `--effects={result['level']}`. {words}", ""])


def _percent(share: float, low: float, high: float) -> str:
    return f"{100 * share:.1f} % ({100 * low:.1f} to {100 * high:.1f})"


def _resumed(running: Running, folder: Path) -> Running:
    """Return the settings; they resume only if this level was started before."""
    return replace(running, resume=running.resume and foreign_file.exists(folder))
