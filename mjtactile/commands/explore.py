"""`mjtactile explore`: touch an unknown object here and there until its surface is known."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjtactile import InputError, Scenario, load_recording
from mjtactile.commands import plots, ranges, scenario
from mjtactile.commands.output import output_folder, print_flags, print_json, stdout_to_stderr
from mjtactile.core import signals
from mjtactile.recording.files import write_json
from mjtactile.run.progress import Progress

if TYPE_CHECKING:
    from mjtactile.explore.run import Explored

DESCRIPTION = """\
Touch an unknown object at a few places, each where its surface is least known so far, and fuse
what was felt (points, normals, curvatures, how far it gave way) into one surface that says how
well it is known. It rests in a holder on a simulated stage that turns it over one sensor and
lowers it until the wanted force is felt, no further."""
EPILOG = """\
examples:
  mjtactile explore --object egg --out runs/egg_shape
      explore.html (to turn), explore.png, explore.json, surface.ply, surface.stl
  mjtactile explore --object my_fruit.xml --touches 20 --accuracy-mm 0.3 --force-N 0.2
  mjtactile explore --object egg --out runs/egg_shape --touches 20 --resume
      goes on where it ended, or was interrupted: touched.jsonl has every touch
  mjtactile explore --on gripper --object egg --touches 8 --out runs/egg_grip
      the simulated hand grips it where it stands, at other heights and turns
  mjtactile explore --from runs/egg_shape --from runs/probe --out runs/both
      fuses what was touched before; touches nothing. Recorded grips of any rig of two fingers
      (`probe` or `grasp --out`) count as grips of the same object, which nobody turned

Places are mm in the holder's frame. The surface is a body of thirteen numbers (a superquadric
that tapers) and a Gaussian process of what it leaves over; needs manifold3d:
pip install 'mjtactile[explore]'. What ends with _true only a simulation knows.
exit codes: 0 explored, 1 nothing was found, 2 bad input, 3 interrupted (what was touched is
kept) or the simulation failed.
"""
_RESULTS = ("explore.json", "explore.html", "explore.png", "surface.ply", "surface.stl")
_TOUCHED = "touched.jsonl"
_DEFAULT = Scenario(object="egg")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    scenario.add_arguments(parser, _DEFAULT, leave_out=("controller", "effects", "vary", "task"))
    parser.add_argument(
        "--on",
        choices=["stage", "gripper"],
        default="stage",
        help="what holds it: a stage that turns it over one sensor (default), or the fingers of "
        "--rig, two, which grip it where it stands, at other heights and turns",
    )
    parser.add_argument(
        "--touches", type=int, default=12, metavar="N", help="touch at most so often (default: 12)"
    )
    parser.add_argument(
        "--accuracy-mm",
        type=ranges.finite,
        default=0.0,
        metavar="MM",
        help="stop as soon as the surface is believed to be known to so much, root mean square "
        "(default: touch as often as --touches says)",
    )
    parser.add_argument(
        "--force-N",
        dest="force",
        type=ranges.finite,
        default=0.3,
        metavar="N",
        help="press up to this felt force, at most; half of what breaks it is refused (default: "
        "0.3)",
    )
    parser.add_argument(
        "--from",
        dest="sources",
        type=Path,
        action="append",
        default=[],
        metavar="RUN",
        help="fuse what an earlier exploration touched, or a recorded grip, in place of touching; "
        "may be repeated",
    )
    parser.add_argument("--resume", action="store_true", help="go on with the exploration in --out")
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="write the surface, its page and its JSON there"
    )


def run(options: argparse.Namespace) -> int:
    _check(options)
    if options.resume:
        return _in(options, options.out)
    if options.out is None:
        return _in(options, None)
    with output_folder(options.out, *_RESULTS, _TOUCHED) as out:
        return _in(options, out)


def _check(options: argparse.Namespace) -> None:
    if options.touches < 1:
        raise InputError(f"{options.touches} is not a number from 1 up", field="--touches")
    if not 0.1 <= options.force <= 2:
        raise InputError(f"{options.force:g} is not within 0.1 and 2 N", field="--force-N")
    if options.accuracy_mm < 0:
        raise InputError(f"{options.accuracy_mm:g} is below 0", field="--accuracy-mm")
    if options.sources and options.resume:
        raise InputError("say either what to fuse or what to go on with", field="--from")
    if options.resume and (options.out is None or not (options.out / _TOUCHED).is_file()):
        raise InputError(f"needs --out DIR with {_TOUCHED} in it", field="--resume")


def _in(options: argparse.Namespace, out: Path | None) -> int:
    progress = Progress(quiet=options.json)
    with stdout_to_stderr():
        found, summary = _fused(options) if options.sources else _live(options, out, progress)
        if out is not None and found.patches:
            _write(out, found, summary)
    if options.json:
        print_json(summary)
    else:
        _print(summary, out)
    if found.outcome == "interrupted":
        return signals.EXIT_CODE
    return 0 if found.patches else 1


def _fused(options: argparse.Namespace) -> tuple[Explored, dict[str, Any]]:
    from mjtactile.explore.grip import patches_of_recording
    from mjtactile.explore.run import Store, explored

    patches = []
    for number, source in enumerate(options.sources):
        if (source / _TOUCHED).is_file():
            patches += Store(source / _TOUCHED).read()
        else:
            patches += patches_of_recording(load_recording(source), 1000 + number)
    if not patches:
        raise InputError("nothing was touched there", source=options.sources[0], field="--from")
    found = explored(patches, "fused", len(patches), {})
    return found, found.summary()


def _live(
    options: argparse.Namespace, out: Path | None, progress: Progress
) -> tuple[Explored, dict[str, Any]]:
    from mjtactile.explore.run import Store, Wanted
    from mjtactile.explore.simulated import explore_in_gripper, explore_on_stage

    wanted = scenario.scenario_of(options, _DEFAULT)
    store = None if out is None else Store(out / _TOUCHED)
    known = store.read() if store is not None and options.resume else []
    with signals.deferred() as stop:
        found, true = (explore_on_stage if options.on == "stage" else explore_in_gripper)(
            wanted,
            Wanted(options.touches, 1e-3 * options.accuracy_mm, options.force),
            known=known,
            say=progress.message,
            keep=store.write if store is not None else lambda _: None,
            stopped=lambda: stop.asked,
        )
        stop.asked = False  # it ended in order, and says so
    names = {"object": Path(wanted.object).stem, "sensor": wanted.design().name}
    return found, {**names, "seed": wanted.seed, **found.summary(), **true}


def _write(out: Path, found: Explored, summary: dict[str, Any]) -> None:
    from mjtactile.explore.files import write_ply, write_stl
    from mjtactile.explore.page import draw, write_page

    write_ply(out / "surface.ply", found)
    write_stl(out / "surface.stl", found)
    write_page(out / "explore.html", found, summary)
    plots.save(out / "explore.png", lambda figure: draw(figure, found), (9.0, 4.4))
    write_json(out / "explore.json", summary)


def _print(summary: dict[str, Any], out: Path | None) -> None:
    print(f"{summary.get('object', 'fused')}: {summary['patches']} patches, {summary['outcome']}")
    if not summary["patches"]:
        return
    size = " x ".join(f"{value:.1f}" for value in summary["size_mm"])
    print(f"  size         {size} mm, {summary['volume_mL']:.1f} mL")
    print(
        f"  known to     {summary['surface_sd_mm']:.2f} mm, where it is least known "
        f"{summary['surface_sd_worst_mm']:.2f} mm"
    )
    if summary["stiffness_N_m"] == summary["stiffness_N_m"]:
        print(f"  stiffness    {summary['stiffness_N_m']:.0f} N/m where it was touched")
    elif summary["stiffness_least_N_m"] == summary["stiffness_least_N_m"]:
        print(f"  stiffness    above {summary['stiffness_least_N_m']:.0f} N/m")
    if "surface_error_mm_true" in summary:
        print(
            f"  truly off by {summary['surface_error_mm_true']:.2f} mm, size by "
            f"{100 * summary['size_error_true']:.1f} %"
        )
    print_flags(summary["flags"])
    if out is not None:
        print(f"  results      {out}/explore.html, surface.ply, explore.json")
