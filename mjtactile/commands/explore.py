"""`mjtactile explore`: touch an unknown object at several positions until its surface is
estimated."""

from __future__ import annotations

import argparse
import contextlib
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjtactile import InputError, Recorder, Scenario, load_recording
from mjtactile.commands import arguments as arg
from mjtactile.commands import scenario
from mjtactile.commands.option_rules import Rule
from mjtactile.commands.output import (
    output_folder,
    print_flags,
    print_json,
    save_plot,
    stdout_to_stderr,
)
from mjtactile.core import foreign_file, signals
from mjtactile.recording.files import write_json
from mjtactile.runtime.progress import Progress

if TYPE_CHECKING:
    from mjtactile.explore.exploration import ExplorationGoal, ExplorationResult

DESCRIPTION = """\
Touch an unknown object at several positions, each where the estimated surface is most
uncertain, and fuse the measurements (points, normals, curvatures, compliance) into one surface
with its uncertainty. The object is held on a simulated stage, which turns it over one sensor
and lowers it until the requested force is measured."""
EPILOG = """\
examples:
  mjtactile explore --object egg --out runs/egg_shape
      explore.html (interactive), explore.png, explore.json, surface.ply, surface.stl
  mjtactile explore --object my_fruit.xml --touches 20 --accuracy-mm 0.3 --force-N 0.2
  mjtactile explore --object egg --out runs/egg_shape --touches 20 --resume
      continues a finished or interrupted run; touched.jsonl stores every touch
  mjtactile explore --setup gripper --object egg --touches 8 --out runs/egg_grip
      the simulated gripper grasps it where it stands, at different heights and yaw angles
  mjtactile explore --rig my_gripper.toml --touches 4 --out runs/mine
  mjtactile explore --rig my_gripper.toml --touches 8 --rotation-deg 90 --resume --out runs/mine
      a real or an emulated gripper grasps it at up to four heights; then you turn the object
  mjtactile explore --input runs/egg_shape --input runs/probe --out runs/both
      fuses earlier touches without new ones. Recorded grips of any two-finger rig (`probe`,
      `grasp` or `explore --out`, `record`) count as grips of the same object, turned by
      --rotation-deg; each recorded load of `record --protocol` counts as one touch

Positions are in mm in the holder's frame. The surface is a parametric shape (ellipsoid,
cylinder, truncated cone, box, or a free form, selected by evidence) plus a Gaussian process of
the residual; needs manifold3d: pip install 'mjtactile[explore]'. Keys that end in _true exist
only in simulation.
exit codes: 0 explored, 1 no surface found, 2 bad input, 3 interrupted (touches are kept) or
the simulation failed.
"""
_RESULTS = ("explore.json", "explore.html", "explore.png", "surface.ply", "surface.stl")
_TOUCHED = "touched.jsonl"
_DEFAULT = Scenario(object="egg")
_NOT_REQUESTED = ("controller", "effects", "randomization", "task", "contact_shapes")

ARGUMENTS = (
    *scenario.arguments(_DEFAULT, leave_out=_NOT_REQUESTED),
    scenario.TIME_SCALE,
    arg.choice(
        "--setup",
        ["stage", "gripper"],
        "carrier: a simulated stage that turns the object over one sensor (default), or the "
        "two fingers of --rig, which grasp it where it stands, at different heights and, in "
        "simulation, yaw angles (default if --rig is given)",
    ),
    arg.option("--touches N", "maximum number of touches", 12, type=arg.integer(1)),
    arg.option(
        "--accuracy-mm MM",
        "stop when the estimated sd of the surface is below this value, root mean square "
        "(default: use all --touches)",
        0.0,
        type=arg.number(0),
    ),
    arg.option(
        "--force-N N",
        "maximum estimated contact force; above half of the object's breaking force it is refused",
        0.3,
        dest="force",
        type=arg.number(0.1, 2),
    ),
    arg.repeated(
        "--input RUN",
        "fuse an earlier exploration or a recorded grip instead of touching; repeatable",
        dest="sources",
        type=Path,
    ),
    arg.repeated(
        "--rotation-deg DEG",
        "rotation of the object about the vertical since the first grips, counter-clockwise "
        "from above: of a real or an emulated rig, or of each --input in turn (default: 0)",
        dest="turns",
        type=arg.number(),
    ),
    arg.flag("--resume", "continue the exploration in --out"),
    arg.out("folder for the surface, its HTML report and its JSON"),
)
RULES = (
    Rule(("--input",), lambda given: not given.resume, "with --resume"),
    Rule(
        (
            "--setup",
            "--touches",
            "--accuracy-mm",
            "--force-N",
            "--object",
            "--seed",
            "--time-scale",
        ),
        lambda given: not given.sources,
        "with --input, which fuses earlier touches",
    ),
)


def run(options: argparse.Namespace) -> int:
    _check(options)
    if options.resume:
        return _explore(options, options.out)
    if options.out is None:
        return _explore(options, None)
    with output_folder(options.out, *_RESULTS, _TOUCHED, "recording") as out:
        return _explore(options, out)


def _check(options: argparse.Namespace) -> None:
    if options.sources and len(options.turns) > len(options.sources):
        text = f"{len(options.turns)} rotations are given for {len(options.sources)} inputs"
        raise InputError(text, field="--rotation-deg")
    if options.resume and (options.out is None or not foreign_file.is_file(options.out / _TOUCHED)):
        raise InputError(f"this option requires --out DIR with {_TOUCHED} in it", field="--resume")


def _explore(options: argparse.Namespace, out: Path | None) -> int:
    progress = Progress(quiet=options.json)
    with stdout_to_stderr():
        requested = scenario.scenario_of(options, _DEFAULT)
        scenario.apply_time_scale(options.time_scale, requested.rig)
        _use_replay_as_source(options, requested)
        found, summary = (
            _fused(options) if options.sources else _live(options, requested, out, progress)
        )
        if out is not None and found.patches:
            _write(out, found, summary)
    if options.json:
        print_json(summary)
    else:
        _print(summary, out)
    if found.outcome == "interrupted":
        return signals.EXIT_CODE
    return 0 if found.patches else 1


def _fused(options: argparse.Namespace) -> tuple[ExplorationResult, dict[str, Any]]:
    from mjtactile.explore.exploration import PatchStore, explored
    from mjtactile.explore.from_recording import patches_of_recording
    from mjtactile.recording.recorded_sensors import recorded_sensors

    patches = []
    turns = [*options.turns, *[0.0] * len(options.sources)]
    for group, source in enumerate(options.sources):
        if foreign_file.is_file(source / _TOUCHED):
            patches += PatchStore(source / _TOUCHED).read()
        else:
            yaw = math.radians(turns[group])
            recording = load_recording(source)
            recorded_sensors(
                recording, options.sensor
            )  # raises if the sensor is not the recorded one
            patches += patches_of_recording(recording, 1000 * (group + 1), yaw)
    if not patches:
        raise InputError(
            "the inputs contain no touches", source=options.sources[0], field="--input"
        )
    if options.out is not None:
        kept = PatchStore(options.out / _TOUCHED)
        for patch in patches:
            kept.write(patch)
    found = explored(patches, "fused", len(patches), {})
    return found, found.summary()


def _use_replay_as_source(options: argparse.Namespace, requested: Scenario) -> None:
    """Add a replayed recording to the sources, so that its images are evaluated again."""
    from mjtactile.explore.gripper_exploration import recorded_folder

    folder = recorded_folder(requested)
    if folder is not None:
        options.sources = [*options.sources, folder]


def _live(
    options: argparse.Namespace, requested: Scenario, out: Path | None, progress: Progress
) -> tuple[ExplorationResult, dict[str, Any]]:
    from mjtactile.explore.exploration import ExplorationGoal, PatchStore

    store = None if out is None else PatchStore(out / _TOUCHED)
    known = store.read() if store is not None and options.resume else []
    goal = ExplorationGoal(options.touches, 1e-3 * options.accuracy_mm, options.force)
    keep = store.write if store is not None else lambda _: None
    on = _holder(options, requested)
    with signals.deferred() as stop:
        explore = _explorer(on, options, out, lambda: stop.asked)
        found, true = explore(requested, goal, known=known, notify=progress.message, keep=keep)
        stop.asked = False  # the exploration ended in order and reports so
    names = {"object": Path(requested.object).stem, "sensor": requested.design().name}
    return found, {**names, "seed": requested.seed, **found.summary(), **true}


def _holder(options: argparse.Namespace, requested: Scenario) -> str:
    """Return the carrier of the sensor: "stage", "gripper" (simulated) or "hand" (of an emulated or
    a real rig)."""
    from mjtactile.explore.gripper_exploration import is_simulated

    if options.setup == "stage" and requested.rig != "sim":
        message = f"the stage is simulated and cannot be used with the rig {requested.rig!r}"
        raise InputError(message, field="--setup", choices=["--setup gripper"])
    if options.setup != "gripper" and requested.rig == "sim":
        on = "stage"
    else:
        on = "gripper" if is_simulated(requested) else "operator"
    if len(options.turns) > (on == "operator"):
        raise InputError(
            "too many rotations are given: one applies to the object of a real or an "
            "emulated rig, or to each --input; a simulation turns the object itself",
            field="--rotation-deg",
        )
    return on


def _explorer(
    on: str, options: argparse.Namespace, out: Path | None, stopped: Callable[[], bool]
) -> Callable[..., tuple[ExplorationResult, dict[str, Any]]]:
    """Return the exploration function, which also returns the errors relative to ground truth, if
    known."""
    from mjtactile.explore.gripper_exploration import explore_by_gripper
    from mjtactile.explore.simulated import explore_in_gripper, explore_on_stage

    if on == "stage":
        return partial(explore_on_stage, stopped=stopped)
    if on == "gripper":
        return partial(explore_in_gripper, stopped=stopped)

    def in_gripper(
        requested: Scenario, goal: ExplorationGoal, **arguments: Any
    ) -> tuple[ExplorationResult, dict[str, Any]]:
        yaw = math.radians(sum(options.turns))
        with contextlib.ExitStack() as stack:
            recorder = None
            if out is not None:
                folder = _unused(out / "recording")
                header = requested.header() | {"controller": "explore"}
                recorder = stack.enter_context(Recorder(folder, header))
            found = explore_by_gripper(requested, goal, yaw=yaw, observer=recorder, **arguments)
        return found, {}

    return in_gripper


def _unused(folder: Path) -> Path:
    """Return the folder. If it exists already, append a number to its name."""
    names = [folder, *(folder.with_name(f"{folder.name}_{number}") for number in range(2, 100))]
    return next(name for name in names if not foreign_file.exists(name))


def _write(out: Path, found: ExplorationResult, summary: dict[str, Any]) -> None:
    from mjtactile.explore.html_report import plot, write_page
    from mjtactile.explore.surface_export import write_ply, write_stl

    write_ply(out / "surface.ply", found)
    write_stl(out / "surface.stl", found)
    write_page(out / "explore.html", found, summary)
    save_plot(out / "explore.png", lambda figure: plot(figure, found), (9.0, 4.4))
    write_json(out / "explore.json", summary)


def _print(summary: dict[str, Any], out: Path | None) -> None:
    print(f"{summary.get('object', 'fused')}: {summary['patches']} patches, {summary['outcome']}")
    if not summary["patches"]:
        return
    sizes = zip(summary["size_mm"], summary["size_sd_mm"], strict=True)
    size = " x ".join(
        f"{value:.1f}" + (f" (+- {sd:.1f})" if sd > 0.1 else "") for value, sd in sizes
    )
    print(f"  size         {size} mm, {summary['volume_mL']:.1f} mL")
    body = summary["body"]
    likely = summary["body_probabilities"][body]
    print(f"  shape        {body}, probability {likely:.2f}")
    print(
        f"  surface sd   {summary['surface_sd_mm']:.2f} mm, maximum "
        f"{summary['surface_sd_worst_mm']:.2f} mm"
    )
    if summary["stiffness_N_m"] == summary["stiffness_N_m"]:
        print(f"  stiffness    {summary['stiffness_N_m']:.0f} N/m at the touched positions")
    elif summary["stiffness_min_N_m"] == summary["stiffness_min_N_m"]:
        print(f"  stiffness    above {summary['stiffness_min_N_m']:.0f} N/m")
    if "surface_error_mm_true" in summary:
        print(
            f"  true error   {summary['surface_error_mm_true']:.2f} mm, of the size "
            f"{100 * summary['size_error_true']:.1f} %"
        )
    print_flags(summary["flags"])
    if out is not None:
        print(f"  results      {out}/explore.html, surface.ply, explore.json")
