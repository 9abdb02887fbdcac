"""`mjtactile grasp`: one complete grasp from the empty gripper to the placed object, and its
report."""

from __future__ import annotations

import argparse
import contextlib
import math
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjtactile import (
    InputError,
    Interrupted,
    MjtactileError,
    Observer,
    Recorder,
    Scenario,
    load_recording,
)
from mjtactile.commands import arguments as arg
from mjtactile.commands import effects, scenario
from mjtactile.commands.option_rules import Rule, replays
from mjtactile.commands.output import (
    new_run_folder,
    output_folder,
    print_flags,
    print_json,
    require_new,
    stdout_to_stderr,
)
from mjtactile.core import foreign_file, signals
from mjtactile.recording.decimated_history import DecimatedHistory
from mjtactile.recording.files import to_json, write_json
from mjtactile.runtime.grasp import fidelity_notes
from mjtactile.runtime.held_contact import EXPLAINED
from mjtactile.runtime.progress import Progress

if TYPE_CHECKING:
    from mjtactile.report.figure_process import FigureWriter

DESCRIPTION = """\
Close a gripper on an object, estimate the contact through the membrane camera of each finger,
regulate the force, lift, hold for 2 s, set down. Writes a folder with summary.json,
summary.png, summary.html (zoomable and rotatable; works offline) and a recording."""
EPILOG = """\
examples:
  mjtactile grasp
  mjtactile grasp --object vial --sensor paper16 --seed 1
  mjtactile grasp --object my_fruit.xml --controller my_controller.py --out runs/fruit
  mjtactile grasp --scenario my_scene.toml         `mjtactile new scenario my_scene` writes one
  mjtactile grasp --scenario runs/egg/summary.json --seed 4
      the same run with another seed
  mjtactile grasp --json > result.json
  mjtactile grasp --video egg.mp4
      scene, cameras and forces, synchronized with the simulated time
  mjtactile grasp --live rerun             watch it in Rerun; foxglove: in Foxglove
  mjtactile grasp --live rerun:egg.rrd     or store it for later
  mjtactile grasp --workers 0              all in one process: same results

The result (--json, summary.json) contains: outcome ("held", "dropped", "crushed", "fault",
"not held: set down": the run ended early, with the object set down; on a rig without ground
truth "not set down": the run ended while the raised gripper held the object; "device_fault" if
a device was the cause),
peak_force_N and hold_force_N (estimated), peak_force_true_N, hold_force_true_N and slip_mm_true
(ground truth, simulation only), contacts (of each finger at the end of the hold: "kind",
"kind_resolved" (false: fewer than 15 cells of the simulated mesh), "probability", "misfit" (mean
square of the residuals over their sd), "curvatures_1_m", "curvatures_sd_1_m", "area_mm2",
"area_interval_mm2" of 68 %; a misfit above 2: of the pressure; "status"; null: no contact),
real_time_factor, frames, perception_ms_median, object, sensor, controller, seed,
success_criterion, the whole "scenario"; "outcome_from" ("ground truth", "estimates", or
"recording" for a replay, with the recorded names in "recorded"); "flags", the
conditions that reduce the accuracy of the simulation, by kind
(docs/reference/status_and_flags.md); a "reason" if known.
exit codes: 0 held, 1 dropped, crushed, not set down, or set down early, 2 bad input, 3 a device
(also if the object was set down because of it) or the simulation failed, or Ctrl-C.
"""
EXIT_CODES = {"held": 0, "dropped": 1, "crushed": 1, "not set down": 1}
EXIT_CODES |= {"not held: set down": 1, "fault": 3}
_RESULTS = ("summary.json", "summary.png", "summary.html")
_MEASURED = (
    "peak_force_N",
    "peak_force_true_N",
    "hold_force_N",
    "hold_force_true_N",
    "slip_mm_true",
    "real_time_factor",
    "frames",
    "perception_ms_median",
)


ARGUMENTS = (
    *scenario.arguments(),
    scenario.TIME_SCALE,
    effects.ESTIMATE,
    arg.option(
        "--workers N",
        "number of workers that process camera images in parallel to the control loop: "
        "processes in simulation, threads on a real rig; at most one per camera; the result "
        "does not depend on it (default: one per camera, limited by the processors)",
        type=arg.integer(0, 8),
    ),
    scenario.FRAMES,
    arg.option(
        "--video FILE",
        "also write a video: .mp4, .gif or .webp (pip install 'mjtactile[video]')",
        type=Path,
    ),
    arg.option(
        "--live VIEWER",
        "show the run live: rerun (the open viewer, or a new one), "
        "rerun+http://HOST:9876/proxy, foxglove (it connects to ws://localhost:8765), "
        "foxglove:PORT, or write rerun:FILE.rrd, foxglove:FILE.mcap (pip install "
        "'mjtactile[live]')",
    ),
    arg.out("folder for the results (default: runs/<time>-<object>)"),
)
RULES = (
    Rule(
        ("--video",),
        lambda given: given.frames > 0 and "-images" not in _effects(given),
        "without camera images: --frames none or --effects=-images",
    ),
    Rule(
        ("--object",),
        lambda given: not replays(given),
        "with --rig replay: the object is the recorded one",
    ),
)


def _effects(options: argparse.Namespace) -> list[str]:
    return [part.replace(" ", "") for part in (options.effects or "").split(",")]


def run(options: argparse.Namespace) -> int:
    from mjtactile.report.figure_process import figure_writer_process

    _check_video(options.video)
    if options.rig is not None:
        scenario.apply_time_scale(options.time_scale, options.rig)
    requested = scenario.scenario_of(options)
    scenario.apply_time_scale(options.time_scale, requested.rig)
    progress = Progress()  # checks if stderr is a terminal
    live = _live_views(options.live, progress)
    if options.out is None:
        folder = new_run_folder(scenario.stem(requested))
    else:
        folder = output_folder(options.out, *_RESULTS, "recording")
    with live as views, folder as out, stdout_to_stderr(), figure_writer_process() as figure:
        summary = _run_and_report(requested, options, out, progress, views, figure)
    # the exit code reports the outcome even if stdout is closed
    with contextlib.suppress(BrokenPipeError):
        if options.json:
            print_json(summary)
        else:
            _print_summary(summary, out)
    return exit_code(summary)


def exit_code(summary: Mapping[str, Any]) -> int:
    """Return the exit code of a run; that of a device fault if one was the cause."""
    return EXIT_CODES["fault" if summary.get("device_fault") else summary["outcome"]]


@contextlib.contextmanager
def _live_views(target: str | None, progress: Progress) -> Iterator[list[Observer]]:
    """Provide the live viewers of the run, if any."""
    if target is None:
        yield []
        return
    from mjtactile import LiveView  # takes a while to import

    with LiveView(target, progress.message) as live:
        yield [live]
    if live.left_out:
        progress.message(
            f"--live: {live.left_out} cycles were left out because the viewer was too slow"
        )


def _run_and_report(
    requested: Scenario,
    options: argparse.Namespace,
    out: Path,
    progress: Progress,
    views: list[Observer],
    figure: FigureWriter,
) -> dict[str, Any]:
    """Run the grasp and write its report.

    A failed run is also reported. The error then carries the summary.
    """
    # imported before the run, after which no file descriptors may be left
    from mjtactile.report import summary as _  # noqa: F401
    from mjtactile.runtime.grasp import run_grasp

    recorder: Recorder | None = None
    try:
        with signals.deferred():  # no signal may leave the opened file unclosed
            recorder = Recorder(out / "recording", requested.header(), frames=options.frames)
            recorder.views = [] if options.video else None
            recorder.strip = DecimatedHistory()
        summary = run_grasp(
            requested,
            [recorder, progress, *views],
            workers=options.workers,
            error_estimate=options.error_estimate,
        ).summary()
    except (Exception, KeyboardInterrupt) as error:
        progress.close()
        if recorder is None:
            raise
        if recorder.never_started(error):
            recorder.discard()
            raise
        _report_fault(error, recorder, out, requested, figure)
        raise
    progress.close()
    recorder.close(outcome=summary["outcome"])
    if recorder.problem:
        summary["recording_problem"] = recorder.problem
    _write_report(out, recorder, summary, figure)
    if options.video:
        _record_video(options.video, out, recorder, progress)
    return summary


def _record_video(path: Path, out: Path, recorder: Recorder, progress: Progress) -> None:
    """Write a video of the run; a failure does not change the run's outcome."""
    from mjtactile.report.video import write_video

    try:
        write_video(path, load_recording(out), recorder.views or (), notify=progress.message)
    except (MjtactileError, OSError) as error:
        print(f"mjtactile: warning: {path} was not written: {error}", file=sys.stderr)


def _check_video(path: Path | None) -> None:
    """Raise InputError if the video cannot be written. This is checked before the run."""
    from importlib.util import find_spec

    from mjtactile.report import video

    if path is None:
        return
    if path.suffix not in (".mp4", ".gif", ".webp"):
        message = f"{path.suffix or 'no suffix'!r} is not a supported video format"
        raise InputError(message, source=path, field="--video", choices=[".mp4", ".gif", ".webp"])
    if not foreign_file.is_dir(path.parent):
        raise InputError("the folder does not exist", source=path.parent, field="--video")
    if not video.is_own(path):
        require_new(path, "--video")
    if find_spec("av") is None:
        raise InputError("PyAV is not installed: pip install 'mjtactile[video]'", field="--video")


def _report_fault(
    error: BaseException, recorder: Recorder, out: Path, requested: Scenario, figure: FigureWriter
) -> None:
    """Save the data recorded in a failed run and report its location."""
    stopped = isinstance(error, (Interrupted, KeyboardInterrupt))
    reason = "interrupted" if stopped else " ".join(str(error).split())
    summary = {
        "outcome": "fault",
        **dict.fromkeys(_MEASURED),
        "frames": recorder.cycles,
        "flags": recorder.flags,
        **requested.names(),
        "error": reason,
        "scenario": requested.to_dict(),
    }
    error.summary = to_json(summary)  # type: ignore[attr-defined]  # cli prints it with --json
    recorder.close(outcome="fault", error=reason)
    # plots take too long for a user who stopped the run
    _write_report(out, recorder, summary, None if stopped else figure)
    with contextlib.redirect_stdout(sys.stderr):
        print_flags(recorder.flags)
    if recorder.cycles:
        print(f"mjtactile: {recorder.cycles} recorded cycles are kept in {out}", file=sys.stderr)


def _write_report(
    out: Path, recorder: Recorder, summary: dict[str, Any], figure: FigureWriter | None
) -> None:
    """Write summary.json, and plots and a web page if `figure` is given. A failure to write does
    not change the run's outcome."""
    from mjtactile.report.summary import write_plots

    try:
        write_json(out / "summary.json", summary)
        problems = [] if figure is None else write_plots(out, recorder, summary, figure)
    except (MjtactileError, OSError) as error:
        problems = [error]
    for problem in problems:
        print(f"mjtactile: warning: the report is incomplete: {problem}", file=sys.stderr)


_CLEAR = 0.9  # minimum probability of a kind of contact that is printed as certain


def _contact_text(contact: dict[str, Any]) -> str:
    if contact["kind"] == "unknown":
        return f"unknown: {contact['status']}"
    low, high = contact["area_interval_mm2"]
    kind = f"{contact['kind']} ({100 * contact['probability']:.0f} %)"
    if contact["misfit"] > EXPLAINED:
        kind = f"kind unclear, explained by no model (nearest: {contact['kind']})"
    elif not contact["kind_resolved"]:
        kind = f"kind not resolved by the simulated mesh, likeliest {kind}"
    elif contact["probability"] < _CLEAR:
        kind = f"kind unclear, likeliest {kind}"
    elif contact["kind"] == "smooth":
        pairs = zip(contact["curvatures_1_m"], contact["curvatures_sd_1_m"], strict=True)
        kind += ", radii " + " and ".join(_radius_text(*pair) for pair in pairs)
    return f"{kind}, area {contact['area_mm2']:.0f} mm2 (68 %: {low:.0f} to {high:.0f})"


def _radius_text(curvature: float, sd: float) -> str:
    """Return the radius of a curvature, 1/m, or its lower limit where it may be straight."""
    if abs(curvature) > 2 * sd:
        return f"{1e3 / curvature:.0f} mm"
    largest = abs(curvature) + 2 * sd
    return f"above {1e3 / largest:.0f} mm" if largest > 1 else "straight"


def _print_summary(summary: dict[str, Any], out: Path) -> None:
    def newton(key: str) -> str:
        value = summary.get(key)
        if value is None or value != value:
            return "unknown"
        return f"{value:.2f} N"

    origin = {"recording": " (recorded)", "estimates": " (by estimates, without ground truth)"}
    print(f"{summary['object']}: {summary['outcome']}{origin.get(summary['outcome_from'], '')}")
    if summary.get("reason"):
        print(f"  because   {summary['reason']}")
    print(
        f"  hold      {newton('hold_force_N')} on each finger (ground truth "
        f"{newton('hold_force_true_N')})"
    )
    print(f"  peak      {newton('peak_force_N')} (ground truth {newton('peak_force_true_N')})")
    for contact in filter(None, summary.get("contacts", ())):
        print(f"  contact   {_contact_text(contact)}")
    for name, text in fidelity_notes(summary).items():
        print(f"  {name:<9} {text}")
    if math.isfinite(summary["slip_mm_true"]):
        print(f"  slip      {summary['slip_mm_true']:.2f} mm (ground truth)")
    if "force_error_estimate_N" in summary:
        print(
            "  estimate  force error of the simulation about "
            f"{1e3 * summary['force_error_estimate_N']:.0f} mN"
        )
    for problem in summary.get("recorded", {}).get("problems", ()):
        print(f"  recording {problem}")
    print_flags(summary["flags"])
    speed = summary["real_time_factor"]
    spent = summary["perception_ms_median"]
    print(
        f"  speed     {speed:.2f} x real time; perception takes {spent:.1f} ms per cycle (median)"
    )
    results = [
        name for name in ("summary.html", "summary.png", "summary.json") if (out / name).exists()
    ]
    print(f"  results   {out}/{', '.join([*results, 'recording/'])}")
