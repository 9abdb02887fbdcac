"""`mjtactile summary`: the page of a recorded run."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from mjtactile import InputError, Recording, load_recording
from mjtactile.commands import arguments as arg
from mjtactile.commands.output import print_flags, print_json, print_problems, stdout_to_stderr
from mjtactile.core import foreign_file
from mjtactile.recording.decimated_history import DecimatedHistory
from mjtactile.runtime.progress import Progress

SIMULATES = False
DESCRIPTION = """\
Write the page of a recorded run as one file: forces and other values over time, to zoom and
read; camera images with a slider; the membrane surfaces, to rotate. Where all images were kept,
the values are estimated again from them."""
EPILOG = """\
examples:
  mjtactile summary runs/still                     writes runs/still/summary.html
  mjtactile summary runs/egg --out egg.html
  mjtactile summary runs/egg --shape --out egg.html   with the contact shape of each finger

`mjtactile grasp` and `mjtactile probe --out` write it automatically. exit codes: 0 written,
2 bad input.
"""

ARGUMENTS = (
    arg.positional("source", "RUN", "a run's folder, or a recording", type=Path),
    arg.flag(
        "--shape",
        "also estimate and show the contact shape of each finger, which takes at least a "
        "tenth of a second per moment shown",
    ),
    arg.out("(default: RUN/summary.html)", "FILE.html"),
)


def run(options: argparse.Namespace) -> int:
    from mjtactile.report.page import write_page
    from mjtactile.report.summary import replay_estimate, with_shapes

    recording = load_recording(options.source)
    path = options.out or options.source / "summary.html"
    if not foreign_file.is_dir(path.parent):
        raise InputError("no such folder", source=path.parent, field="--out")
    strip = DecimatedHistory()
    with stdout_to_stderr():
        Progress(quiet=options.json).message(f"{len(recording)} cycles")
        estimated = replay_estimate(recording, strip.add)
        kept = with_shapes(recording, strip.kept) if options.shape else strip.kept
        write_page(path, recording, kept, _summary(options.source, recording))
    result = {
        "out": str(path),
        "cycles": len(recording),
        "shown": len(strip.kept),
        "re_estimate": estimated,
        "flags": recording.flags,
        "problems": recording.problems,
    }
    if options.json:
        print_json(result)
    else:
        print(f"{result['cycles']} cycles, {result['shown']} of them shown")
        if not estimated:
            print("  no surfaces: they need the images of all cycles and of the references")
        print_problems(recording)
        print(f"  written to {path}")
        print_flags(recording.flags)
    return 0


def _summary(folder: Path, recording: Recording) -> dict[str, Any]:
    """Return the result stored by the run's command, if available."""
    known = {
        key: Path(str(recording.header[key])).stem
        for key in ("object", "sensor")
        if key in recording.header
    }
    known |= {key: recording.notes[key] for key in ("outcome", "error") if key in recording.notes}
    for name in ("summary.json", "probe.json"):
        if foreign_file.is_file(folder / name):
            known |= json.loads((folder / name).read_text(encoding="utf-8"))
    return known
