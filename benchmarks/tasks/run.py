"""`mjtactile bench tasks`: benefit of touch in manipulation tasks.

All tasks that need touch run over the same episodes, by controllers with and without touch and by
an oracle. The episodes are also the suite for comparison of other controllers.

Seeds from DEVELOP on are for tuning. Those from SEED on are for evaluation only.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.tasks import oracle
from benchmarks.tasks.compared_controllers import CONTROLLERS, SHOWN
from benchmarks.tasks.figure import plot
from benchmarks.tasks.simulation_levels import LEVELS, MESH, agreement, folder_of
from benchmarks.tasks.tables import table as table
from mjtactile.core import renamed
from mjtactile.core.errors import InputError
from mjtactile.evaluate.benchmark_suite import Suite, load_suite, new_suite, read, rounds, run_round
from mjtactile.evaluate.episodes import Episode, run_episode
from mjtactile.evaluate.pool import Running
from mjtactile.evaluate.statistics import summarise
from mjtactile.recording.observer import Observer
from mjtactile.runtime.cycle import Cycle
from mjtactile.runtime.progress import Progress
from mjtactile.sim import ground_truth

NAME = "v1"
TASKS = ("weigh", "pour", "shake", "bump", "place", "hand-over")
ORACLE = str(Path(oracle.__file__))
OBJECTS = ("vial", "egg", "random")
DEVELOP = 60_000
SEED = 70_000
EPISODES = 200
HARSH = ("weigh", "pour", "bump")
HARSH_CONTROLLERS = (CONTROLLERS[0], CONTROLLERS[-1])
"""Controllers that also run tasks with `--randomization harsh`, a quarter as many episodes."""
QUICK = 3
_TURN = 10  # episodes of a task before the next one's turn
_WEIGHED_FROM = 0.02  # kg
_WEIGHT_SD = (0.04, 1e-3)  # required sd: fraction of the mass, and constant part, kg


def run(
    out: Path,
    quick: bool = False,
    resume: bool = False,
    episodes: int = EPISODES,
    level: str = MESH,
    parts: Sequence[str] = (),
) -> dict[str, Any]:
    """Evaluate each task without images, or at a cheaper level.

    Sampled marker errors replace those of images.

    Args:
        out: Gets tasks_LEVEL/CONTROLLER/TASK/episodes.jsonl, the suite tasks_LEVEL/NAME.json,
            tasks_LEVEL_harsh/CONTROLLER/TASK/episodes.jsonl, controller_comparison.png.
        quick: Three episodes each.
        resume: Continue with the stored results.
        episodes: Number for each task and controller.
        level: One of `LEVELS`. Each has separate folders.
        parts: Controllers to run now; earlier results of others count as well.

    Returns:
        The summaries by task, of all of them together, those of the harsh worlds, the accuracy of
        the mass that `adaptive` estimates, and the agreement of the level with the mesh's lines in
        `out`.

    Raises:
        InputError: There is no such level or controller.
    """
    if level not in LEVELS:
        problem = f"{level!r} is unknown{renamed.hint(f'--level {level}', renamed.OPTIONS)}"
        raise InputError(problem, field="--level", choices=list(LEVELS))
    unknown = [name for name in parts if name not in SHOWN]
    if unknown:
        raise InputError(f"{unknown[0]!r} is unknown", field="--parts", choices=list(SHOWN))
    names = parts or SHOWN
    count = QUICK if quick else episodes
    harsh_count = max(count // 4, 1)
    harsh_names = [name for name in HARSH_CONTROLLERS if name in names]
    turns = rounds(count, _TURN)
    for maximum in turns:
        again = resume or maximum > turns[0]
        _round(suite_of(level), out / folder_of(level), names, maximum, again)
        if maximum <= harsh_count or maximum == count:
            worlds = suite_of(level, harsh=True)
            _round(
                worlds,
                out / folder_of(level, "harsh"),
                harsh_names,
                min(maximum, harsh_count),
                again,
            )
    suite = suite_of(level)
    folder = out / folder_of(level)
    suite.with_results(*_kept(folder)).write(folder / f"{suite.name}.json")
    result = results(out, count, level)
    plot(result, out / "controller_comparison.png")
    return result


def suite_of(level: str, *, harsh: bool = False) -> Suite:
    """Return the tasks at one level, with `--randomization default` or harsh."""
    name = NAME if level == MESH else f"{NAME}-{level}"
    randomization = "harsh" if harsh else "default"
    tasks = HARSH if harsh else TASKS
    effects = LEVELS[level].effects
    return new_suite(
        name,
        tasks,
        objects=OBJECTS,
        seed=SEED,
        develop=DEVELOP,
        randomization=randomization,
        effects=effects,
    )


def _round(suite: Suite, folder: Path, names: Sequence[str], count: int, resume: bool) -> None:
    """Run the first `count` episodes of each task by each controller, in separate folders."""
    for name in names:
        own = ORACLE if name == "oracle" else name
        run_round(
            suite,
            folder / name,
            controllers=[own],
            count=count,
            running=Running(resume=resume, notify=Progress().message, run_one=run_one),
        )


def _kept(folder: Path) -> list[Path]:
    """Return the existing folders of the shown controllers."""
    return [folder / name for name in SHOWN if (folder / name).exists()]


def lines_of(suite: Suite, folder: Path) -> dict[str, list[dict[str, Any]]]:
    """Return the lines of every task in `folder`.

    Raises:
        InputError: The lines belong to another suite or level.
    """
    return {
        task: [line for own in _kept(folder) for line in read(suite, own, task)]
        for task in suite.tasks
    }


def _mesh_lines(out: Path) -> dict[str, list[dict[str, Any]]]:
    """Return the results of the mesh level: the lines in `out`, else the shipped suite's
    outcomes."""
    if _kept(out / folder_of(MESH)):
        return lines_of(suite_of(MESH), out / folder_of(MESH))
    known = load_suite(NAME)
    return {
        task: [{**line, "controller": name} for name in own for line in known.lines(task, name)]
        for task, own in known.results.items()
    }


def results(out: Path, count: int, level: str) -> dict[str, Any]:
    """Return the result of `run` from the files in `out`."""
    lines = lines_of(suite_of(level), out / folder_of(level))
    harsh = lines_of(suite_of(level, harsh=True), out / folder_of(level, "harsh"))
    full = {} if level == MESH else _mesh_lines(out)
    return {
        "block": "tasks" if level == MESH else f"tasks_{level}",
        "level": level,
        "episodes": count,
        "seed": SEED,
        "objects": list(OBJECTS),
        "tasks": {task: summarise(own) for task, own in lines.items()},
        "together": together(lines),
        "harsh": {task: summarise(own) for task, own in harsh.items()},
        "weighed": weighed(lines["weigh"]),
        "agreement": {name: agreement(name, full, lines) for name in SHOWN if full},
    }


def together(lines: Mapping[str, Sequence[Mapping[str, Any]]]) -> dict[str, Any]:
    """Summarize the lines of all tasks together; every episode is counted separately."""
    own = [
        dict(line) | {"episode": line["episode"] * len(lines) + place}
        for place, task in enumerate(lines)
        for line in lines[task]
    ]
    return summarise(own)


def run_one(episode: Episode) -> dict[str, Any]:
    """Run an episode; return its line, and the mass estimated by the controller."""
    if episode.controller == "oracle":
        knows = oracle.Oracle(episode.scenario)
        return run_episode(episode, controller=knows, watching=[knows])
    scale = _Scale()
    return run_episode(episode, watching=[scale]) | scale.found


class _Scale(Observer):
    """Observer that stores a controller's mass estimate at the end of the hold, with ground
    truth."""

    sees = False

    def __init__(self) -> None:
        self.found: dict[str, float] = {}
        self._world: Any = None

    def start(self, session: Any) -> None:
        self._world = session.rig.scene

    def add(self, cycle: Cycle, view: Any = None, **true: Any) -> None:
        mass = cycle.sent.memory.get("mass")
        if cycle.sent.phase == "hold" and isinstance(mass, float) and math.isfinite(mass):
            bodies = ground_truth.object_bodies(self._world)
            actual = float(self._world.model.body_mass[bodies].sum())
            self.found = {"weighed_g": 1e3 * mass, "mass_g_true": 1e3 * actual}


def weighed(lines: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Compute the errors of the mass that `adaptive` estimates, from 20 g on.

    They are the mean and sd, g, and the rms of the error over the required one (1: as required).
    """
    pairs = [
        (1e-3 * line["weighed_g"], 1e-3 * line["mass_g_true"])
        for line in lines
        if line["controller"] == CONTROLLERS[0]
        and line["outcome"] == "held"
        and line.get("mass_g_true", 0.0) >= 1e3 * _WEIGHED_FROM
    ]
    if len(pairs) < 2:
        return {"objects": len(pairs)}
    reported, true = np.array(pairs).T
    error = reported - true
    required = _WEIGHT_SD[0] * true + _WEIGHT_SD[1]
    return {
        "objects": len(pairs),
        "mean_g": 1e3 * float(error.mean()),
        "sd_g": 1e3 * float(error.std(ddof=1)),
        "mean_share": float((error / true).mean()),
        "sd_share": float((error / true).std(ddof=1)),
        "over_asked": float(np.sqrt(np.mean((error / required) ** 2))),
    }
