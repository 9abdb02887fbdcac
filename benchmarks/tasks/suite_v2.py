"""`mjtactile bench suite-v2`: ten tasks with sampled touch, and the shipped controllers with touch.

`v1` compares controllers with and without touch. `v2` has all its tasks, and `wet`, `carry`,
`stack` and `slosh`. Its results decide which controller is the default.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.tasks.figure import plot
from benchmarks.tasks.run import OBJECTS, TASKS, together
from benchmarks.tasks.simulation_levels import LEVELS
from mjtactile.evaluate.benchmark_suite import Suite, new_suite, read, rounds, run_round
from mjtactile.evaluate.pool import Running
from mjtactile.evaluate.statistics import paired, summarise
from mjtactile.runtime.progress import Progress

NAME = "v2"
LEVEL = "synthetic"
ALL_TASKS = (*TASKS, "wet", "carry", "stack", "slosh")
FIRST = "adaptive"
OTHERS = ("gentle", "slip_aware")
SEED = 82_000
DEVELOP = 60_000
EPISODES = 24
QUICK = 1
_TURN = 6  # episodes of a task before the next one's turn


def run(
    out: Path, quick: bool = False, resume: bool = False, episodes: int = EPISODES
) -> dict[str, Any]:
    """Evaluate each task by each controller over the same episodes.

    Args:
        out: Gets suite_v2/CONTROLLER/TASK/episodes.jsonl, the suite v2.json, suite_v2.png.
        quick: One episode each.
        resume: Continue with the stored results.
        episodes: Number for each task and controller.

    Returns:
        The summaries by task, of all of them together, and the paired differences between
        `adaptive` and each other controller.

    Raises:
        InputError: Stored results are of other files.
    """
    count = QUICK if quick else episodes
    folder = out / "suite_v2"
    suite = suite_v2()
    turns = rounds(count, _TURN)
    for maximum in turns:
        running = Running(resume=resume or maximum > turns[0], notify=Progress().message)
        for name in (FIRST, *OTHERS):
            run_round(suite, folder / name, controllers=[name], count=maximum, running=running)
    folders = [folder / name for name in (FIRST, *OTHERS)]
    suite.with_results(*folders).write(out / f"{NAME}.json")
    lines = {
        task: [line for own in folders for line in read(suite, own, task)] for task in suite.tasks
    }
    result = {
        "episodes": count,
        "seed": SEED,
        "tasks": {task: summarise(own) for task, own in lines.items()},
        "together": together(lines),
        "pairs": {task: differences(own) for task, own in lines.items()},
    }
    plot(result, out / "suite_v2.png")
    return result


def suite_v2() -> Suite:
    """Return the suite of the files as they are now, without results."""
    return new_suite(
        NAME, ALL_TASKS, objects=OBJECTS, seed=SEED, develop=DEVELOP, effects=LEVELS[LEVEL].effects
    )


def differences(lines: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the success of `adaptive` minus that of each other controller, over their common
    episodes."""
    own = {
        name: [line for line in lines if line["controller"] == name] for name in (FIRST, *OTHERS)
    }
    comparisons = len(ALL_TASKS) * len(OTHERS)
    return {
        name: paired(own[name], own[FIRST], comparisons=comparisons)
        for name in OTHERS
        if own[name] and own[FIRST]
    }


def table(result: Mapping[str, Any]) -> str:
    """Return the results as Markdown."""
    names = (FIRST, *OTHERS)
    minus = " | ".join(f"adaptive minus {name}, points" for name in OTHERS)
    lines = [
        f"| held without damage | {' | '.join(names)} | {minus} |",
        "|---" * (1 + len(names) + len(OTHERS)) + "|",
    ]
    for task, summary in result["tasks"].items():
        groups = [summary["controllers"].get(name) for name in names]
        pairs = [result["pairs"][task].get(name) for name in OTHERS]
        cells = [*map(_held, groups), *map(_points, pairs)]
        lines.append(f"| {task} | {' | '.join(cells)} |")
    every = result["together"]["controllers"]
    cells = [_held(every.get(name)) for name in names]
    lines.append(f"| all | {' | '.join([*cells, *('' for _ in OTHERS)])} |")
    lines += [
        "",
        f"| grip force / required, median; slip, mm, median | {' | '.join(names)} |",
        "|---" * (1 + len(names)) + "|",
    ]
    for task, summary in result["tasks"].items():
        cells = [_medians(summary["controllers"].get(name)) for name in names]
        lines.append(f"| {task} | {' | '.join(cells)} |")
    lines += [
        "",
        "Differences: success rate in percentage points over the episodes that both completed, with"
        " the 95 % interval of this pair alone.",
    ]
    return "\n".join(lines) + "\n"


def _held(group: Mapping[str, Any] | None) -> str:
    if group is None:
        return ""
    low, high = group["success_interval"]
    count = group["episodes"] - group["error"]
    return f"{group['held']} of {count} ({100 * low:.0f}-{100 * high:.0f} %)"


def _points(pair: Mapping[str, Any] | None) -> str:
    if pair is None or not pair["episodes"]:
        return ""
    low, high = (100 * limit for limit in pair["difference_interval"])
    return f"{100 * pair['difference']:+.0f} ({low:+.0f} to {high:+.0f})"


def _medians(group: Mapping[str, Any] | None) -> str:
    if group is None:
        return ""
    values = [group.get(name, {}).get("median") for name in ("margin", "slip_mm")]
    return "; ".join("" if value is None else f"{value:.1f}" for value in values)
