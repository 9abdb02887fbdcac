"""`mjtactile probe`: squeeze an object gently and report its material."""

from __future__ import annotations

import argparse
import contextlib
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjtactile import Recorder, Scenario, load_recording
from mjtactile.commands import arguments as arg
from mjtactile.commands import scenario
from mjtactile.commands.option_rules import Rule
from mjtactile.commands.output import (
    optional_folder,
    print_flags,
    print_result,
    save_plot,
    stdout_to_stderr,
)
from mjtactile.core import signals
from mjtactile.recording.decimated_history import DecimatedHistory
from mjtactile.recording.files import write_json
from mjtactile.runtime.progress import Progress

if TYPE_CHECKING:
    from mjtactile.runtime.probe import ProbeResult

DESCRIPTION = """\
Squeeze to 0.9 N, hold the jaws still for 2 s, release, wait, and touch again. Then classify
the object from the camera images alone as solid, soft or amorphous, and estimate its stiffness,
relaxation time and permanent deformation."""
EPILOG = """\
examples:
  mjtactile probe --object clay
  mjtactile probe --object my_fruit.xml --out runs/fruit
      probe.html, probe.png, probe.json, recording/
  mjtactile probe --source runs/fruit --json                the same recording, classified again

"unknown" is a valid result; status gives the reason (too little contact yet, or ambiguous).
exit codes: 0 a class was found, 1 unknown, 2 bad input, 3 a device or the simulation failed.
"""
_DEFAULT = Scenario(object="sponge", controller="probe")

ARGUMENTS = (
    *scenario.arguments(_DEFAULT, leave_out=("accuracy", "effects", "randomization", "task")),
    arg.option("--source RECORDING", "classify the images of a recorded run instead", type=Path),
    scenario.FRAMES,
    arg.out("write probe.json, probe.png, probe.html and the recording there"),
)
RULES = (
    Rule(
        (
            "--object",
            "--scenario",
            "--controller",
            "--rig",
            "--seed",
            "--contact-shapes",
            "--frames",
        ),
        lambda given: given.source is None,
        "with --source, whose recording is classified",
    ),
)


def run(options: argparse.Namespace) -> int:
    with (
        optional_folder(options.out, "probe.json", "probe.png", "probe.html", "recording") as out,
        stdout_to_stderr(),
    ):
        result = _replay(options) if options.source is not None else _live(options, out)
        if out is not None:
            write_json(out / "probe.json", {**result.summary(), "history": result.history()})
            save_plot(out / "probe.png", lambda figure: plot(figure, result), (9.0, 6.4))
    print_result(options, result.summary(), lambda: _print(result, options.out))
    return 0 if result.material.kind != "unknown" else 1


def _replay(options: argparse.Namespace) -> ProbeResult:
    from mjtactile.runtime.probe import replay_probe

    return replay_probe(load_recording(options.source), options.sensor)


def _live(options: argparse.Namespace, out: Path | None) -> ProbeResult:
    from mjtactile.report.page import write_page
    from mjtactile.runtime.probe import run_probe

    requested = scenario.scenario_of(options, _DEFAULT)
    progress = Progress(quiet=options.json)
    with contextlib.closing(progress):
        if out is None:
            return run_probe(requested, [progress])
        with (
            signals.deferred(),
            Recorder(out / "recording", requested.header(), frames=options.frames) as recorder,
        ):
            recorder.strip = DecimatedHistory()
            result = run_probe(requested, [recorder, progress])
            recorder.close(outcome=result.material.kind)
    write_page(
        out / "probe.html",
        load_recording(out),
        recorder.strip.kept,
        result.summary(),
        recorder.snapshot,
    )
    return result


def _print(result: ProbeResult, out: Path | None) -> None:
    m = result.material
    known = math.isfinite
    chances = ", ".join(f"{name} {100 * p:.0f} %" for name, p in m.probability.items())
    print(
        f"{result.names['object']}: {m.kind} ({chances})"
        + ("" if m.status == "ok" else f"; {m.status}")
    )
    if known(m.deformation):
        print(f"  deformation  {1e3 * m.deformation:.2f} mm under {m.force:.2f} N on each finger")
        print(f"  permanent    {1e3 * m.permanent_set:.2f} mm (sd {1e3 * m.permanent_set_sd:.2f})")
    if known(m.stiffness):
        print(f"  stiffness    {_range(m.stiffness, m.stiffness_interval)} N/m")
    if known(m.modulus):
        print(
            "  modulus      "
            f"{_range(1e-3 * m.modulus, [1e-3 * v for v in m.modulus_interval])} kPa, "
            "assuming flat faces"
        )
    if m.relaxation_time:
        how = "yes, without a single time constant"
        if known(m.relaxation_time):
            how = f"in {m.relaxation_time:.2f} s"
        print(f"  relaxation   {how}")
    if known(m.speed):
        print(f"  flow         {1e3 * m.speed:.2f} mm/s after the fingers stopped")
    print_flags(result.flags)
    if out is not None:
        print(f"  results      {out}/probe.html, probe.png, probe.json")


def _range(value: float, interval: Any) -> str:
    return f"{value:.3g} (68 %: {interval[0]:.3g} to {interval[1]:.3g})"


def plot(figure: Any, result: ProbeResult) -> None:
    """Plot force against deformation and against both indentations; force and width over time.

    Indentations are those of membrane and object.
    """
    s = result.squeeze
    phases = result.phases
    free = s.width[(s.force > 0.1) & (s.width == s.width)]
    width0 = max(free[:3]) if len(free) else math.nan
    curve, over_time, width, travel = figure.subplots(2, 2).ravel()
    for phase in dict.fromkeys(phases):
        rows = [i for i, name in enumerate(phases) if name == phase and s.force[i] > 0.05]
        if rows:
            curve.plot(1e3 * (width0 - s.width[rows]), s.force[rows], ".", ms=4, label=phase)
            travel.plot(1e3 * (s.opening[rows[0]] - s.opening[rows]), s.force[rows], ".", ms=4)
    curve.set(
        xlabel="object deformation, mm",
        ylabel="force per finger, N",
        title=f"{result.names['object']}: {result.material.kind}",
    )
    curve.legend()
    over_time.plot(s.time, s.force)
    over_time.set(xlabel="time, s", ylabel="force per finger, N")
    width.plot(s.time, 1e3 * s.width, ".", ms=3)
    width.set(xlabel="time, s", ylabel="object width, mm")
    travel.set(
        xlabel="closing since start of the phase, mm (object and membranes)",
        ylabel="force per finger, N",
    )
    for axes in (curve, over_time, width, travel):
        axes.grid(alpha=0.3)
