"""`mjtactile grasp`: one grasp from the empty hand to the object put down, and its report."""

from __future__ import annotations

import argparse
import datetime
import math
import sys
from pathlib import Path
from typing import Any

from mjtactile import report, resources
from mjtactile.commands import effects
from mjtactile.commands.output import prepare_folder, print_json, stdout_to_stderr
from mjtactile.errors import InputError, MjtactileError
from mjtactile.progress import Progress
from mjtactile.recording import Recorder, load_recording, write_json
from mjtactile.rig import rig_names

HELP = "grasp a fragile object, lift it, hold it, set it down"
DESCRIPTION = """\
Close a two-finger gripper on an object, feel the touch through the membrane cameras,
regulate the force, lift, hold for 2 s, set down. Writes a folder with summary.json,
summary.png and a recording."""
EPILOG = """\
examples:
  mjtactile grasp
  mjtactile grasp --object vial --sensor paper16 --seed 1
  mjtactile grasp --object my_fruit.xml --controller my_controller.py --out runs/fruit
  mjtactile grasp --json > result.json
  mjtactile grasp --workers 0              all in one process: least memory, the same numbers

The result (--json, summary.json) says: outcome ("held", "dropped", "crushed", "fault"), peak_force_N and
hold_force_N as felt, peak_force_true_N, hold_force_true_N and slip_mm_true as they were (simulation only),
real_time_factor, frames, perception_ms_median, object, sensor, controller, seed.
exit codes: 0 held, 1 dropped or crushed, 2 bad input, 3 a device or the simulation failed, or Ctrl-C.
"""
EXIT_CODES = {"held": 0, "dropped": 1, "crushed": 1, "fault": 3}
_MEASURED = ("peak_force_N", "peak_force_true_N", "hold_force_N", "hold_force_true_N", "slip_mm_true", "real_time_factor",
             "frames", "perception_ms_median")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    def shipped(kind: str, suffix: str) -> str:
        return ", ".join(resources.names(kind, suffix))

    parser.add_argument("--object", default="egg", metavar="NAME|FILE.xml",
                        help=f"what to grasp: {shipped('models/objects', '.xml')}, or your own MJCF file (default: egg)")
    parser.add_argument("--sensor", default="dense", metavar="NAME|FILE.toml",
                        help=f"on each finger: {shipped('models/sensors', '.toml')}, or your own file (default: dense)")
    parser.add_argument("--controller", default="gentle", metavar="NAME|FILE.py",
                        help=f"grasp controller: {shipped('controllers', '.py')}, or your own file (default: gentle)")
    parser.add_argument("--rig", default="sim", metavar="RIG",
                        help=f"what to run it on: {', '.join(rig_names())} (default: sim)")
    parser.add_argument("--seed", type=_seed, default=0, metavar="N",
                        help="seed of the camera noise and of where the object stands (default: 0)")
    effects.add_shared_arguments(parser)
    effects.add_estimate_argument(parser)
    parser.add_argument("--workers", type=_count, metavar="N", help="processes that look at the camera images beside the control "
                        "loop, at most one a camera; the result is the same with any number, 0 needs the least memory "
                        "(default: one a camera on a computer with two processors or more, else 0)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder for the results (default: runs/<time>-<object>)")


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 up")
    return int(text)


def _count(text: str) -> int:
    if text not in ("0", "1", "2"):
        raise argparse.ArgumentTypeError(f"{text!r} is not 0, 1 or 2: there are two cameras")
    return int(text)


def run(options: argparse.Namespace) -> int:
    name = Path(options.object).stem
    out = options.out or Path("runs") / f"{datetime.datetime.now():%Y%m%d-%H%M%S}-{name}"
    made = [folder for folder in (out, *out.parents) if not folder.exists()]
    prepare_folder(out)
    try:
        with stdout_to_stderr():
            summary = _run_and_report(options, out, Progress())
    except InputError:
        for folder in made:  # leave nothing behind for a run that never began
            if not any(folder.iterdir()):
                folder.rmdir()
        raise
    if options.json:
        print_json(summary)
    else:
        _print_summary(summary, out)
    return EXIT_CODES[summary["outcome"]]


def _header(options: argparse.Namespace) -> dict[str, Any]:
    return {key: getattr(options, key) for key in ("object", "sensor", "controller", "rig", "seed")}


def _manner(options: argparse.Namespace) -> dict[str, Any]:
    return {key: getattr(options, key) for key in ("accuracy", "effects", "error_estimate", "workers")}


def _run_and_report(options: argparse.Namespace, out: Path, progress: Progress) -> dict[str, Any]:
    """Run the grasp and write its report, also of a run that failed half-way; the error then carries its summary."""
    from mjtactile.grasp import GraspOptions, run_grasp

    header = _header(options)
    recorder = Recorder(out / "recording", header)
    try:
        summary = run_grasp(GraspOptions(**header, **_manner(options)), recorder=recorder, progress=progress).summary()
    except (Exception, KeyboardInterrupt) as error:
        progress.close()
        if isinstance(error, InputError) and recorder.cycles == 0:
            recorder.discard()
            raise
        _report_fault(error, recorder, out, header)
        raise
    progress.close()
    recorder.close(outcome=summary["outcome"])
    _write_report(out, recorder, summary)
    return summary


def _report_fault(error: BaseException, recorder: Recorder, out: Path, header: dict[str, Any]) -> None:
    """Keep what a failed run recorded and say where it is."""
    reason = "interrupted" if isinstance(error, KeyboardInterrupt) else " ".join(str(error).split())
    names = {key: Path(header[key]).stem for key in ("object", "sensor", "controller")}
    summary = {"outcome": "fault", **dict.fromkeys(_MEASURED), "frames": recorder.cycles, **names, "seed": header["seed"],
               "error": reason}
    error.summary = summary  # type: ignore[attr-defined]  # cli prints it with --json
    recorder.close(outcome="fault", error=reason)
    _write_report(out, recorder, summary)
    if recorder.cycles:
        print(f"mjtactile: {recorder.cycles} cycles were recorded and are kept in {out}", file=sys.stderr)


def _write_report(out: Path, recorder: Recorder, summary: dict[str, Any]) -> None:
    """Write summary.json, then the picture; a picture that cannot be drawn does not lose the run."""
    write_json(out / "summary.json", summary)
    try:
        report.write_figure(out / "summary.png", load_recording(out), recorder.snapshot, summary)
    except MjtactileError as error:
        print(f"mjtactile: warning: summary.png was not written: {error}", file=sys.stderr)


def _print_summary(summary: dict[str, Any], out: Path) -> None:
    def newton(key: str) -> str:
        value = summary.get(key)
        return "unknown" if value is None or value != value else f"{value:.2f} N"

    print(f"{summary['object']}: {summary['outcome']}")
    print(f"  holding   {newton('hold_force_N')} on each finger (true {newton('hold_force_true_N')})")
    print(f"  at most   {newton('peak_force_N')} (true {newton('peak_force_true_N')})")
    if math.isfinite(summary["slip_mm_true"]):
        print(f"  slipped   {summary['slip_mm_true']:.2f} mm (true)")
    if "force_error_estimate_N" in summary:
        print(f"  estimate  the simulated force is off by about {1e3 * summary['force_error_estimate_N']:.0f} mN")
    speed, spent = summary["real_time_factor"], summary["perception_ms_median"]
    print(f"  speed     {speed:.2f} x real time; perception takes {spent:.1f} ms a cycle (median)")
    print(f"  results   {out}/summary.json, summary.png, recording/")
