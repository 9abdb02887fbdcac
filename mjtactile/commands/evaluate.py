"""`mjtactile evaluate`: many grasps, and their success rate."""

from __future__ import annotations

import argparse
import contextlib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjtactile import InputError, Scenario
from mjtactile.commands import arguments as arg
from mjtactile.commands import scenario
from mjtactile.commands.output import (
    insert_table,
    new_run_folder,
    print_result,
    require_markers,
    stdout_to_stderr,
)
from mjtactile.core import resources
from mjtactile.recording.files import write_json

if TYPE_CHECKING:
    from mjtactile.evaluate.pool import Running

DESCRIPTION = """\
Run many grasps over seeds, objects and randomized conditions. Report the success rate of a
controller with 95 % intervals; compare several controllers and test whether the difference is
significant.

All controllers run the same episodes: the same objects with the same seeds. --randomization
samples deviations of object, sensors and gripper from their files; the sensing still assumes
the files. A controller fails if it raises, hangs, or is stopped by the
supervisor; a failed simulation is an error and counts separately. Each finished episode is a
line in DIR/episodes.jsonl with the command that repeats it alone; --resume continues a stopped
run. The lines do not depend on the number of workers."""
EPILOG = """\
examples:
  mjtactile evaluate --episodes 30
      adaptive; egg, strawberry and vial in turn
  mjtactile evaluate --controller gentle --controller mine.py --episodes 100 --out runs/eval
  mjtactile evaluate --objects 'egg,random,my/*.xml' --episodes 200 --out runs/eval --resume
  mjtactile evaluate --randomization my_world.toml
      `mjtactile new variation my_world` writes one
  mjtactile evaluate --episodes 800 --shard 2/8 --out runs/part2  one of eight machines
  mjtactile evaluate --episodes 4000 --backend dask --scheduler tcp://head:8786 --out runs/big
  mjtactile evaluate --suite v1 --controller mine.py --episodes 50 --out runs/mine
      all tasks, against the shipped controllers (docs/validation/controller_comparison.md)
  mjtactile evaluate --suite v1 --resume --out runs/mine    compares existing results again
  mjtactile evaluate --screening-sample 100 --episodes 3000 --objects random --out runs/screened
      all episodes at low fidelity (--effects=-mesh,-pipeline); the failures and 100 successes
      again at full fidelity, with the rate of differing outcomes
  mjtactile evaluate --merge runs/part1 runs/part2 --out runs/all
"""
_OBJECTS = "egg,strawberry,vial"
_DEFAULT = Scenario(randomization="default")


def _shard(text: str) -> tuple[int, int]:
    part, _, parts = text.partition("/")
    if not (part.isdigit() and parts.isdigit() and 1 <= int(part) <= int(parts)):
        raise argparse.ArgumentTypeError(f"{text!r} is not K/N with K from 1 to N, such as 2/8")
    return int(part), int(parts)


ARGUMENTS = (
    arg.option(
        "--controller NAME",
        "shipped name or FILE.py; repeatable, to compare controllers (default: adaptive)",
        action="append",
    ),
    arg.option(
        "--objects A,B,…",
        "shipped names, FILE.xml, 'my/*.xml', random (a different object each time), grasped "
        "in turn (default: egg,strawberry,vial)",
    ),
    arg.option("--episodes N", "number of episodes for each controller", 30, type=arg.integer(1)),
    *scenario.arguments(_DEFAULT, leave_out=("object", "controller")),
    arg.option(
        "--workers N",
        "number of parallel processes (default: one per processor)",
        type=arg.integer(1),
    ),
    arg.option(
        "--backend B",
        "executor of the episodes: processes (local; the default) or dask (a cluster)",
        "processes",
    ),
    arg.option("--scheduler ADDRESS", "address of the dask scheduler, such as tcp://host:8786"),
    arg.option("--shard K/N", "run only part K of N", "1/1", type=_shard),
    arg.flag("--resume", "continue the evaluation in the folder"),
    arg.option("--merge DIR", "merge parts of one evaluation instead", nargs="+", type=Path),
    arg.flag(
        "--partial",
        "with --merge: merge also if episodes are missing; --resume in the new folder runs them",
    ),
    arg.flag(
        "--record",
        "keep the recording of each episode in DIR/recordings, for `export` (100 MB per "
        "episode; 1 without images)",
    ),
    arg.option(
        "--suite SUITE",
        "run a suite of tasks with fixed seeds (v1, v2, or FILE.json) and compare with its "
        "included results; with --resume, use the results in the folder",
    ),
    arg.option(
        "--screening-sample N",
        "run all episodes with --effects=-mesh,-pipeline, then repeat its failures and N of "
        "its successes in full; one report of both (screen.md, screen.json)",
        type=arg.integer(0),
    ),
    arg.option(
        "--worst N",
        "number of episodes shown with images in the report; they are run again at the end "
        "(default: up to 10 that failed, and a tenth of the others)",
        type=arg.integer(0),
    ),
    arg.out("folder for the results (default: runs/<time>-evaluate)"),
    arg.option(
        "--readme FILE.md",
        "also insert the table into this file, between <!-- bench:evaluate --> and <!-- /bench -->",
        type=Path,
    ),
)


def _objects(text: str) -> list[str]:
    """Return object names and files from a comma-separated list.

    A pattern represents all matching files. The shell does not expand a pattern behind a comma.
    """
    found = []
    for name in (part.strip() for part in text.split(",")):
        anchor = Path(name).anchor
        if set("*?[") & set(name):
            files = sorted(map(str, Path(anchor).glob(name[len(anchor) :])))
        else:
            files = [name]
        if not files:
            raise InputError("no file matches this pattern", source=name, field="--objects")
        found += files
    return found


def run(options: argparse.Namespace) -> int:
    from mjtactile.evaluate.run import write_report
    from mjtactile.evaluate.statistics import table
    from mjtactile.runtime.progress import Progress

    if options.partial and not options.merge:
        raise InputError("this option requires --merge", field="--partial")
    if options.suite is not None:
        return _against(options)
    if options.screening_sample is not None:
        return _screen(options)
    if options.readme is not None:
        require_markers(options.readme, "evaluate")
    with _folder(options) as out:
        summary = _evaluate(options, out)
    write_json(out / "summary.json", summary)
    (out / "summary.md").write_text(table(summary), encoding="utf-8")
    if options.readme is not None:
        insert_table(options.readme, "evaluate", table(summary))
    only = options.controller or resources.names("controllers", ".py") if options.merge else None
    with stdout_to_stderr():
        write_report(out, options.worst, Progress().message, only=only)
    print_result(
        options, summary, f"{table(summary)}\nwritten to {out}; open {out / 'report.html'}"
    )
    return 0


def _folder(options: argparse.Namespace) -> contextlib.AbstractContextManager[Path]:
    """Provide the folder of the results. Raises InputError for --resume without it."""
    if options.out is not None:
        return contextlib.nullcontext(options.out)
    if options.resume:
        raise InputError("which folder?", field="--resume", choices=["--resume --out DIR"])
    return new_run_folder("evaluate")


def _screen(options: argparse.Namespace) -> int:
    """Run all episodes at low fidelity. Repeat the failures and a sample of the successes at full
    fidelity."""
    from mjtactile.evaluate import two_stage_screening as screens

    for name, left in (("merge", None), ("shard", (1, 1)), ("record", False), ("readme", None)):
        if getattr(options, name) != left:
            raise InputError(
                "this option cannot be combined with --screening-sample", field=f"--{name}"
            )
    if options.out is None:
        raise InputError(
            "this option requires an output folder",
            field="--screening-sample",
            choices=["--screening-sample N --out DIR"],
        )
    with stdout_to_stderr():
        common, controllers = _scenario_of(options)
        default_objects = _OBJECTS if options.scenario is None else common.object
        objects = _objects(options.objects or default_objects)
        result = screens.screen(
            options.out,
            common,
            sample=options.screening_sample,
            controllers=controllers,
            count=options.episodes,
            objects=objects,
            running=_running(options),
        )
    text = screens.table(result)
    write_json(options.out / "screen.json", result)
    (options.out / "screen.md").write_text(text, encoding="utf-8")
    print_result(options, result, f"{text}\nwritten to {options.out}")
    return 0


_FIXED = (
    "task",
    "objects",
    "scenario",
    "sensor",
    "rig",
    "seed",
    "accuracy",
    "effects",
    "randomization",
    "contact_shapes",
)
"""Options that a suite specifies itself."""


def _against(options: argparse.Namespace) -> int:
    """Run a suite, and compare."""
    from mjtactile.evaluate import benchmark_suite as suites

    for name in _FIXED:
        if getattr(options, name) is not None:
            raise InputError(f"the suite {options.suite!r} fixes this option", field=f"--{name}")
    suite = suites.load_suite(options.suite)
    with _folder(options) as out, stdout_to_stderr():
        if options.controller or not options.resume:
            suites.run_suite(
                suite,
                out,
                controllers=options.controller or [_DEFAULT.controller],
                count=options.episodes,
                running=_running(options),
            )
        result = suites.compare(suite, out)
    table = suites.table(suite, result)
    write_json(out / f"{suite.name}.json", result)
    (out / f"{suite.name}.md").write_text(table, encoding="utf-8")
    print_result(options, result, f"{table}\nwritten to {out}")
    return 0


def _evaluate(options: argparse.Namespace, out: Path) -> dict[str, Any]:
    from mjtactile.evaluate.run import evaluate, merge

    with stdout_to_stderr():
        if options.merge:
            return merge(options.merge, out, partial=options.partial)
        common, controllers = _scenario_of(options)
        default_objects = _OBJECTS if options.scenario is None else common.object
        objects = _objects(options.objects or default_objects)
        return evaluate(
            out,
            common,
            count=options.episodes,
            controllers=controllers,
            objects=objects,
            shard=options.shard,
            record=options.record,
            running=replace(
                _running(options), backend=options.backend, scheduler=options.scheduler or ""
            ),
        )


def _scenario_of(options: argparse.Namespace) -> tuple[Scenario, list[str]]:
    """Return the scenario of all episodes, and the controllers."""
    named = options.controller or []
    single = argparse.Namespace(**{**vars(options), "controller": named[0] if named else None})
    common = scenario.scenario_of(single, _DEFAULT)
    return common, named or [common.controller]


def _running(options: argparse.Namespace) -> Running:
    """Return the run settings for episodes from the options shared by all kinds of evaluation."""
    from mjtactile.evaluate.pool import Running
    from mjtactile.runtime.progress import Progress

    return Running(workers=options.workers, resume=options.resume, notify=Progress().message)
