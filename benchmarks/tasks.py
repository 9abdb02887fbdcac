"""`mjtactile bench tasks`: what touch buys. All tasks that ask for it, by controllers with and
without touch, over the same episodes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mjtactile.core.scenario import Scenario
from mjtactile.evaluate.run import evaluate
from mjtactile.evaluate.statistics import summarise
from mjtactile.evaluate.store import read_lines
from mjtactile.run.progress import Progress

TASKS = ("weigh", "pour", "shake", "bump", "place", "hand-over")
CONTROLLERS = ("adaptive", "gentle", "slip_aware", "touchless")
OBJECTS = ("vial", "egg", "random")
SEED = 20_000  # nothing was tuned on these
EPISODES = 200
QUICK = 3


def run(
    out: Path, quick: bool = False, resume: bool = False, episodes: int = EPISODES
) -> dict[str, Any]:
    """Evaluate each task; without images, whose errors the markers have drawn in their place."""
    count = QUICK if quick else episodes
    say = Progress().message
    tasks = {}
    for task in TASKS:
        folder = out / "tasks" / task
        scenario = Scenario(task=task, effects="-images", vary="default", seed=SEED)
        say(task)
        evaluate(
            folder,
            scenario,
            count=count,
            controllers=CONTROLLERS,
            objects=OBJECTS,
            resume=resume,
            say=say,
        )
        tasks[task] = summarise(read_lines(folder))
    return {"episodes": count, "seed": SEED, "objects": list(OBJECTS), "tasks": tasks}


def table(result: Mapping[str, Any]) -> str:
    """Held and whole, in percent with intervals; then grip over need, and what each task adds."""
    names = list(CONTROLLERS)
    lines = [
        f"| held and whole, of {result['episodes']} | {' | '.join(names)} | `adaptive` less "
        "`touchless` |",
        "|---" * (len(names) + 2) + "|",
    ]
    for task, summary in result["tasks"].items():
        cells = [_share(summary["controllers"][name]) for name in names]
        lines.append(f"| {task} | {' | '.join(cells)} | {_difference(summary)} |")
    lines += [
        "",
        f"| grip over need, median | {' | '.join(names)} |",
        "|---" * (len(names) + 1) + "|",
    ]
    for task, summary in result["tasks"].items():
        cells = [_median(summary["controllers"][name], "margin", "{:.1f}") for name in names]
        lines.append(f"| {task} | {' | '.join(cells)} |")
    lines += ["", f"| | {' | '.join(names)} |", "|---" * (len(names) + 1) + "|"]
    for task, key, label, form in (
        ("place", "bump_N_s", "bump when placing, N s: median", "{:.4f}"),
        ("hand-over", "let_go_s", "let go after, s: median", "{:.2f}"),
    ):
        if task in result["tasks"]:
            own = result["tasks"][task]["controllers"]
            cells = [_median(own[name], key, form) for name in names]
            lines.append(f"| {label} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _share(group: Mapping[str, Any]) -> str:
    low, high = group["success_interval"]
    ended = group["episodes"] - group["error"]
    return f"{100 * group['success']:.0f} % ({100 * low:.0f}-{100 * high:.0f}), {ended}"


def _difference(summary: Mapping[str, Any]) -> str:
    """Of the first controller against the last, in points."""
    for pair in summary["paired"]:
        if (pair["first"], pair["second"]) == (CONTROLLERS[0], CONTROLLERS[-1]):
            low, high = pair["difference_interval"]
            return (
                f"{-100 * pair['difference']:+.0f} points ({-100 * high:+.0f} to {-100 * low:+.0f})"
            )
    return ""


def _median(group: Mapping[str, Any], key: str, form: str) -> str:
    value = group[key]["median"]
    return "" if value is None else form.format(value)
