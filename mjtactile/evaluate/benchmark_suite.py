"""`Suite`: fixed tasks, seeds and scoring, with the results of shipped controllers.

`mjtactile bench tasks` writes `models/suites/NAME.json`. It stores the SHA-256 of the files behind
its results, and the scoring version. No comparison is made if one of them differs.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from mjtactile.core import foreign_file, resources
from mjtactile.core.errors import InputError
from mjtactile.core.renamed import hint
from mjtactile.core.scenario import Scenario
from mjtactile.core.toml import read_json
from mjtactile.evaluate import store
from mjtactile.evaluate.pool import HERE, Running
from mjtactile.evaluate.run import common_settings, evaluate
from mjtactile.evaluate.statistics import ADJUSTMENT, paired, summarise
from mjtactile.evaluate.wilson import Line, wilson
from mjtactile.runtime.task_scoring import VERSION

FOLDER = "models/suites"
_LETTERS = dict(held="h", dropped="d", crushed="c", unsafe="u", hung="w", raised="r", error="e")
_NONE = "."
_ROUND = 5  # episodes of a task before the next one's turn
_MEASURES = ("margin", "slip_mm", "impact_N_s", "release_delay_s")


@dataclass(frozen=True)
class Suite:
    """Fixed set of tasks, and the results of other controllers.

    Attributes:
        name: Name of the file.
        scoring_version: Version of the scoring (`mjtactile.runtime.task_scoring`).
        tasks: Names of tasks.
        objects: Objects, grasped in turn.
        seed: Seed of the first episode. Do not tune on these seeds; use `develop` instead.
        develop: First seed for development.
        randomization, effects: Options of the evaluation.
        files: SHA-256 of each task file and of the randomization file, by file name.
        results: Results by task and controller: its "outcomes", one letter per episode, and the
            medians of the measured values.
    """

    name: str
    scoring_version: str
    tasks: Sequence[str]
    objects: Sequence[str]
    seed: int
    develop: int
    randomization: str
    effects: str
    files: Mapping[str, str]
    results: Mapping[str, Mapping[str, Mapping[str, Any]]]

    def scenario(self, task: str) -> Scenario:
        """Return the common scenario of all episodes of a task."""
        shared = {name: getattr(self, name) for name in ("effects", "randomization", "seed")}
        return Scenario(task=task, **shared)

    def lines(self, task: str, controller: str) -> list[Line]:
        """Return the results of a shipped controller: episodes and outcomes."""
        words = {letter: word for word, letter in _LETTERS.items()}
        letters = enumerate(self.results[task][controller]["outcomes"])
        return [{"episode": k, "outcome": words[char]} for k, char in letters if char != _NONE]

    def with_results(self, *folders: Path) -> Suite:
        """Return this suite with the results in `folders`, one subfolder per task."""
        found = {
            task: _results([line for folder in folders for line in read(self, folder, task)])
            for task in self.tasks
        }
        return replace(self, results=found)

    def write(self, path: Path) -> None:
        """Write the file."""
        path.write_text(json.dumps(asdict(self), indent=1) + "\n", encoding="utf-8")


def new_suite(
    name: str,
    tasks: Sequence[str],
    *,
    objects: Sequence[str],
    seed: int,
    develop: int,
    randomization: str = "default",
    effects: str = "-images",
) -> Suite:
    """Return a suite of the current files, without results."""
    files = _hashes(tasks, randomization)
    return Suite(name, VERSION, tasks, objects, seed, develop, randomization, effects, files, {})


def load_suite(name_or_path: str | Path) -> Suite:
    """Read a suite, and check that its files and its scoring match its results.

    Args:
        name_or_path: Shipped name or file.

    Returns:
        The suite.

    Raises:
        InputError: The suite does not exist, cannot be read, or depends on a changed file or
            version.
    """
    path = resources.find(name_or_path, FOLDER, ".json")
    try:
        table = read_json(path)
        if isinstance(table, dict) and (old := "".join(map(hint, table))):
            raise InputError(f"is a suite of an older version{old}", source=path)
        suite = Suite(**table)
    except TypeError as error:
        raise InputError(f"is not a suite of tasks: {error}", source=path) from error
    if suite.scoring_version != VERSION:
        message = f"was scored by version {suite.scoring_version}, but this is version {VERSION}"
        raise InputError(message, source=path)
    now = _hashes(suite.tasks, suite.randomization)
    changed = ", ".join(name for name, known in suite.files.items() if now.get(name) != known)
    if changed:
        message = f"its results belong to other versions of these files: {changed}"
        raise InputError(message, source=path)
    return suite


def run_suite(
    suite: Suite, folder: Path, *, controllers: Sequence[str], count: int, running: Running = HERE
) -> None:
    """Run a suite's tasks, each into its own folder.

    The tasks alternate after a few episodes. An interrupted run then has equally many of each.

    Args:
        suite: Suite to run.
        folder: Output folder, with one subfolder per task.
        controllers: Names and files.
        count: Episodes of each task for each controller.
        running: Execution settings of the episodes.

    Raises:
        InputError: Raised by `evaluate`.
        DeviceError: Raised by `evaluate`.
    """
    for maximum in rounds(count):
        resumed = replace(running, resume=running.resume or maximum > _ROUND)
        run_round(suite, folder, controllers=controllers, count=maximum, running=resumed)


def rounds(count: int, each: int = _ROUND) -> list[int]:
    """Return the number of episodes per task after each round of `each`, up to `count`."""
    return [*range(each, count, each), count]


def run_round(
    suite: Suite, folder: Path, *, controllers: Sequence[str], count: int, running: Running = HERE
) -> None:
    """Run the missing episodes among the first `count` of each task; see `run_suite`."""
    for task in suite.tasks:
        task_folder = folder / task
        stored = 0
        if foreign_file.exists(task_folder / store.MANIFEST):
            stored = store.read_manifest(task_folder)["options"]["count"]
        settings = {"controllers": controllers, "objects": suite.objects, "running": running}
        running.notify(f"{task}: {max(count, stored)} episodes")
        evaluate(task_folder, suite.scenario(task), count=max(count, stored), **settings)


def read(suite: Suite, folder: Path, task: str) -> list[dict[str, Any]]:
    """Read the lines of one task in `folder`; empty if the task was not run.

    Raises InputError where they are of another scenario, or of other files, than the suite's.
    """
    own = folder / task
    path = own / store.MANIFEST
    if not foreign_file.exists(path):
        return []
    known = store.read_manifest(own)
    options = known["options"]
    expected = common_settings(suite.scenario(task))
    if options["scenario"] != expected or options["objects"] != list(suite.objects):
        raise InputError(f"does not belong to task {task} of suite {suite.name}", source=path)
    files = suite.files.items()
    changed = ", ".join(name for name, own in files if known["files"].get(name, own) != own)
    if changed:
        raise InputError(f"was run with a different {changed}", source=path)
    return store.read_lines(own)


def compare(suite: Suite, folder: Path) -> dict[str, Any]:
    """Compare the results in `folder` with those of the suite.

    Args:
        suite: Suite that was run.
        folder: Output folder of `run_suite`.

    Returns:
        Results under "tasks" by task and controller, and under "together" by controller over all
        tasks. Each has `held` of `episodes`, its interval, the medians of the measured values, and
        "against". The latter is the difference to each shipped controller over the same episodes
        (`mjtactile.evaluate.statistics.paired`; positive: the new one holds more).

    Raises:
        InputError: There are no results, or they belong to another suite.
    """
    found: dict[str, dict[str, list[Line]]] = {}
    numbered: dict[str, list[Line]] = {}
    known: dict[str, list[Line]] = {}
    shipped: dict[str, dict[str, list[Line]]] = {}
    for index, task in enumerate(suite.tasks):
        for line in read(suite, folder, task):
            found.setdefault(task, {}).setdefault(line["controller"], []).append(line)
        for controller, lines in found.get(task, {}).items():
            numbered.setdefault(controller, []).extend(_numbered(suite, index, lines))
        shipped[task] = {name: suite.lines(task, name) for name in suite.results.get(task, {})}
        for name, lines in shipped[task].items():
            known.setdefault(name, []).extend(_numbered(suite, index, lines))
    if not found:
        raise InputError(f"contains no results of {suite.name}", source=folder, field="--suite")
    comparisons = sum(len(results) * len(shipped[task]) for task, results in found.items())
    if len(found) > 1:
        comparisons += len(numbered) * len(known)
    tasks = {
        task: {
            name: _compared(name, lines, shipped[task], comparisons)
            for name, lines in results.items()
        }
        for task, results in found.items()
    }
    together = {
        name: _compared(name, lines, known, comparisons) for name, lines in numbered.items()
    }
    head = {"suite": suite.name, "scoring_version": suite.scoring_version}
    return {**head, "tasks": tasks, "together": together}


def _numbered(suite: Suite, index: int, lines: Sequence[Line]) -> list[Line]:
    """Return the lines of the task at `index` with episode numbers that no other task has."""
    return [{**line, "episode": line["episode"] * len(suite.tasks) + index} for line in lines]


def _compared(
    controller: str, mine: Sequence[Line], others: Mapping[str, Sequence[Line]], comparisons: int
) -> dict[str, Any]:
    """Compare one controller's lines with those of others, by name.

    `comparisons` is the number of comparisons in the report.
    """
    summary = summarise(mine)["controllers"][controller]
    return {
        "held": summary["held"],
        "episodes": summary["episodes"] - summary["error"],
        "interval": summary["success_interval"],
        **{name: summary[name]["median"] for name in _MEASURES if name in summary},
        "against": {
            name: paired(lines, mine, comparisons=comparisons) for name, lines in others.items()
        },
    }


def table(suite: Suite, result: Mapping[str, Any]) -> str:
    """Format a comparison as a Markdown table."""
    others = list(dict.fromkeys(name for row in suite.results.values() for name in row))
    against = " | ".join(f"against `{name}`" for name in others)
    lines = [
        f"| {suite.name} | controller | held undamaged | grip force / minimum holding force | "
        f"{against} |",
        "|---" * (4 + len(others)) + "|",
    ]
    rows = dict(result["tasks"])
    if len(rows) > 1:  # all tasks together may be conclusive if single tasks are not
        rows[f"all {len(rows)}"] = result["together"]
    for task, row in rows.items():
        for controller, found in row.items():
            margin = found.get("margin")
            cells = [
                task,
                controller,
                fraction(found["held"], found["episodes"]),
                "" if margin is None else f"{margin:.1f}",
                *(_difference(found["against"].get(name)) for name in others),
            ]
            lines.append(f"| {' | '.join(cells)} |")
    lines += [
        "",
        "Against: difference of the success rate in percentage points, with its interval, and the "
        f"number of episodes that both completed. {_intervals_text(rows)}",
    ]
    return "\n".join(lines) + "\n"


def _intervals_text(rows: Mapping[str, Any]) -> str:
    """Return the confidence of the intervals of a comparison, as a sentence."""
    counts = {
        pair["comparisons"]
        for row in rows.values()
        for found in row.values()
        for pair in found["against"].values()
    }
    count = max(counts, default=1)
    if count == 1:
        return "The interval covers the true difference with 95 %."
    return (
        f"The intervals of all {count} comparisons together cover the true differences with 95 % "
        f"({ADJUSTMENT})."
    )


def fraction(held: int, of: int) -> str:
    """Format a success rate with its interval: "26 of 33 (62-89 %)"."""
    low, high = wilson(held, of)
    return f"{held} of {of} ({100 * low:.0f}-{100 * high:.0f} %)"


def _difference(pair: Mapping[str, Any] | None) -> str:
    """Format the difference over the common episodes, in points, with its interval."""
    if pair is None or not pair["episodes"]:
        return ""
    low, high = (100 * limit for limit in pair["adjusted_interval"])
    return f"{100 * pair['difference']:+.0f} ({low:+.0f} to {high:+.0f}) of {pair['episodes']}"


def _results(lines: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the stored results of one task."""
    summary = summarise(list(lines))["controllers"]
    found: dict[str, dict[str, Any]] = {}
    for controller, group in summary.items():
        mine = [line for line in lines if line["controller"] == controller]
        outcomes = {line["episode"]: _LETTERS[line["outcome"]] for line in mine}
        letters = "".join(outcomes.get(k, _NONE) for k in range(max(outcomes) + 1))
        found[controller] = {"outcomes": letters}
        for name in _MEASURES:
            median = group.get(name, {}).get("median")
            if median is not None and math.isfinite(median):
                found[controller][name] = float(f"{median:.3g}")
    return found


def _hashes(tasks: Sequence[str], randomization: str) -> dict[str, str]:
    """Return a checksum of each file's values; comments and layout do not count."""
    paths = [resources.find(task, "models/tasks", ".toml") for task in tasks]
    paths.append(resources.find(randomization, "models/randomization", ".toml"))
    return {path.name: store.checksum(path) for path in paths}
