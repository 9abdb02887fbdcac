"""`mjtactile bench tasks`: what touch buys. All tasks that ask for it, by controllers with and
without touch and by an oracle, over the same episodes; and the suite that others are compared with.

Seeds from DEVELOP on are for tuning, those from SEED on for judging: nothing is tuned on them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.tasks import oracle
from benchmarks.tasks.picture import draw
from mjtactile.evaluate.episodes import Episode, run_episode
from mjtactile.evaluate.statistics import summarise
from mjtactile.evaluate.store import read_lines
from mjtactile.evaluate.suite import new_suite, run_suite
from mjtactile.recording.observer import Observer
from mjtactile.run.cycle import Cycle
from mjtactile.run.progress import Progress
from mjtactile.sim import truth

NAME = "v1"
TASKS = ("weigh", "pour", "shake", "bump", "place", "hand-over")
CONTROLLERS = ("adaptive", "gentle", "slip_aware", "touchless")
ORACLE = str(Path(oracle.__file__))
OBJECTS = ("vial", "egg", "random")
DEVELOP = 60_000
SEED = 70_000
EPISODES = 200
HARSH = ("weigh", "pour", "bump")
"""Tasks that are also done in worlds of `--vary harsh`, by `adaptive` and by `touchless`: a quarter
as many episodes."""
QUICK = 3
_READY = "grip over what holds against the push that was announced, too, median"
_WEIGHED_FROM = 0.02  # kg
_WEIGHT_SD = (0.04, 1e-3)  # of the mass, and kg: what was asked


def run(
    out: Path, quick: bool = False, resume: bool = False, episodes: int = EPISODES
) -> dict[str, Any]:
    """Evaluate each task; without images, whose errors the markers have drawn in their place.

    Args:
        out: Gets tasks/TASK/episodes.jsonl, tasks/v1.json, tasks_harsh/TASK/episodes.jsonl,
            what_touch_buys.png.
        quick: Three episodes each.
        resume: Go on with what is there.
        episodes: Of each task for each controller.

    Returns:
        The summaries by task, of all of them together, those of the harsh worlds, and how well
        `adaptive` weighs.
    """
    count = QUICK if quick else episodes
    suite = new_suite(NAME, TASKS, objects=OBJECTS, seed=SEED, develop=DEVELOP)
    harsh = new_suite(NAME, HARSH, objects=OBJECTS, seed=SEED, develop=DEVELOP, vary="harsh")
    folder = out / "tasks"
    for kind, where, who, most in (
        (suite, folder, (*CONTROLLERS, ORACLE), count),
        (harsh, out / "tasks_harsh", (CONTROLLERS[0], CONTROLLERS[-1]), max(count // 4, 1)),
    ):
        run_suite(
            kind,
            where,
            controllers=who,
            count=most,
            resume=resume,
            say=Progress().message,
            run_one=run_one,
        )
    suite.with_results(folder).write(folder / f"{NAME}.json")
    result = results(out, count)
    draw(result, out / "what_touch_buys.png")
    return result


def results(out: Path, count: int) -> dict[str, Any]:
    """What lies in `out`: the result of `run`."""
    lines = {task: read_lines(out / "tasks" / task) for task in TASKS}
    harsh = {task: read_lines(out / "tasks_harsh" / task) for task in HARSH}
    return {
        "episodes": count,
        "seed": SEED,
        "objects": list(OBJECTS),
        "tasks": {task: summarise(own) for task, own in lines.items()},
        "together": together(lines),
        "harsh": {task: summarise(own) for task, own in harsh.items()},
        "weighed": weighed(lines["weigh"]),
    }


def together(lines: Mapping[str, Sequence[Mapping[str, Any]]]) -> dict[str, Any]:
    """The summary of all tasks' lines: an episode of one is none of another's."""
    own = [
        dict(line) | {"episode": line["episode"] * len(lines) + place}
        for place, task in enumerate(lines)
        for line in lines[task]
    ]
    return summarise(own)


def run_one(episode: Episode) -> dict[str, Any]:
    """The episode's line, and what the controller weighed."""
    if episode.controller == "oracle":
        knows = oracle.Oracle(episode.scenario)
        return run_episode(episode, controller=knows, watching=[knows])
    scale = _Scale()
    return run_episode(episode, watching=[scale]) | scale.found


class _Scale(Observer):
    """Keeps what a controller says that it holds, at the end of the hold, beside the truth."""

    def __init__(self) -> None:
        self.found: dict[str, float] = {}
        self._world: Any = None

    def begin(self, session: Any) -> None:
        self._world = session.rig.scene

    def add(self, cycle: Cycle, view: Any = None, **true: Any) -> None:
        mass = cycle.sent.memory.get("mass")
        if cycle.sent.phase == "hold" and isinstance(mass, float) and math.isfinite(mass):
            bodies = truth.object_bodies(self._world)
            really = float(self._world.model.body_mass[bodies].sum())
            self.found = {"weighed_g": 1e3 * mass, "mass_g_true": 1e3 * really}


def weighed(lines: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """How far what `adaptive` weighed is off, from 20 g on: mean and sd, g, of the mass, and the
    rms of the error over what was asked (1: as asked)."""
    pairs = [
        (1e-3 * line["weighed_g"], 1e-3 * line["mass_g_true"])
        for line in lines
        if line["controller"] == CONTROLLERS[0]
        and line["outcome"] == "held"
        and line.get("mass_g_true", 0.0) >= 1e3 * _WEIGHED_FROM
    ]
    if len(pairs) < 2:
        return {"things": len(pairs)}
    said, really = np.array(pairs).T
    error = said - really
    asked = _WEIGHT_SD[0] * really + _WEIGHT_SD[1]
    return {
        "things": len(pairs),
        "mean_g": 1e3 * float(error.mean()),
        "sd_g": 1e3 * float(error.std(ddof=1)),
        "mean_share": float((error / really).mean()),
        "sd_share": float((error / really).std(ddof=1)),
        "over_asked": float(np.sqrt(np.mean((error / asked) ** 2))),
    }


def table(result: Mapping[str, Any]) -> str:
    """Held and whole, in percent with intervals; then grip over need, and what each task adds."""
    names = [*CONTROLLERS, "oracle"]
    head = " | ".join(names)
    lines = [
        f"| held and whole | {head} | adaptive less touchless, points |",
        "|---" * (len(names) + 2) + "|",
    ]
    for task, summary in result["tasks"].items():
        cells = [_share(summary["controllers"].get(name)) for name in names]
        lines.append(f"| {task} | {' | '.join(cells)} | {_difference(summary)} |")
    every = result["together"]
    cells = [_share(every["controllers"].get(name)) for name in names]
    lines.append(f"| all {len(result['tasks'])} | {' | '.join(cells)} | {_difference(every)} |")
    for task, summary in result["harsh"].items():
        cells = [_share(summary["controllers"].get(name)) for name in names]
        lines.append(f"| {task}, harsh worlds | {' | '.join(cells)} | {_difference(summary)} |")
    lines += ["", f"| crushed / dropped | {head} |", "|---" * (len(names) + 1) + "|"]
    for task, summary in result["tasks"].items():
        cells = [_failures(summary["controllers"].get(name)) for name in names]
        lines.append(f"| {task} | {' | '.join(cells)} |")
    lines += ["", f"| grip over need, median | {head} |", "|---" * (len(names) + 1) + "|"]
    for task, summary in result["tasks"].items():
        cells = [_value(summary["controllers"].get(name), "margin", "{:.1f}") for name in names]
        lines.append(f"| {task} | {' | '.join(cells)} |")
    lines += ["", f"| beside | {head} |", "|---" * (len(names) + 1) + "|"]
    for task, key, which, label, form in (
        ("place", "bump_N_s", "median", "bump when placing, N s: median", "{:.4f}"),
        ("place", "bump_N_s", "p95", "bump when placing, N s: 95 %", "{:.4f}"),
        ("hand-over", "let_go_s", "median", "let go after, s: median", "{:.2f}"),
        ("hand-over", "let_go_s", "p95", "let go after, s: 95 %", "{:.2f}"),
        ("bump", "margin_ready", "median", f"bump: {_READY}", "{:.1f}"),
        ("hand-over", "margin_ready", "median", f"hand-over: {_READY}", "{:.1f}"),
        ("", "margin", "median", "grip over need in all tasks, median", "{:.1f}"),
        ("", "margin", "p95", "grip over need in all tasks, 95 %", "{:.1f}"),
    ):
        own = (result["tasks"][task] if task else every)["controllers"]
        cells = [_value(own.get(name), key, form, which) for name in names]
        lines.append(f"| {label} | {' | '.join(cells)} |")
    found = result["weighed"]
    if found["things"] > 1:
        lines += [
            "",
            f"`adaptive` weighs {found['things']} things of 20 g and more with an error of "
            f"{100 * found['mean_share']:+.1f} % on the mean and {100 * found['sd_share']:.1f} % "
            f"sd, {found['over_asked']:.2f} times 4 % + 1 g in the rms.",
        ]
    return "\n".join(lines) + "\n"


def _share(group: Mapping[str, Any] | None) -> str:
    if group is None:
        return ""
    low, high = group["success_interval"]
    ended = group["episodes"] - group["error"]
    return f"{group['held']} of {ended} ({100 * low:.0f}-{100 * high:.0f} %)"


def _failures(group: Mapping[str, Any] | None) -> str:
    return "" if group is None else f"{group['crushed']} / {group['dropped']}"


def _difference(summary: Mapping[str, Any]) -> str:
    """Of the first controller against touchless, in points."""
    for pair in summary["paired"]:
        if (pair["first"], pair["second"]) == (CONTROLLERS[0], CONTROLLERS[-1]):
            low, high = pair["difference_interval"]
            return f"{0 - 100 * pair['difference']:+.0f} ({-100 * high:+.0f} to {-100 * low:+.0f})"
    return ""


def _value(group: Mapping[str, Any] | None, key: str, form: str, which: str = "median") -> str:
    value = None if group is None else group[key][which]
    return "" if value is None else form.format(value)
