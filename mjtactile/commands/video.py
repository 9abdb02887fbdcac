"""`mjtactile video`: a video of a recorded run."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from mjtactile import InputError, load_recording
from mjtactile.commands import arguments as arg
from mjtactile.commands.output import (
    print_flags,
    print_json,
    print_problems,
    require_new,
    stdout_to_stderr,
)
from mjtactile.core import foreign_file
from mjtactile.runtime.progress import Progress

SIMULATES = False
DESCRIPTION = """\
Render a video of a recorded run: each camera image with the fitted ellipses (red: not
trusted), the estimates, and the forces over time, synchronous with the run's clock.
`mjtactile grasp --video FILE` also shows the simulated scene."""
EPILOG = """\
examples:
  mjtactile video runs/grasp                        writes runs/grasp/video.mp4
  mjtactile video runs/grasp --out egg.gif --speed 2
  mjtactile video runs/grasp --start 2 --seconds 6 --out egg.webp
  mjtactile grasp --video egg.mp4                   with the scene

Needs `pip install 'mjtactile[video]'`. exit codes: 0 written, 2 bad input.
"""


ARGUMENTS = (
    arg.positional("source", "RUN", "a run's folder, or a recording", type=Path),
    arg.out(
        ".mp4 (30 images per second), .gif or .webp (10 and 15, half the size) (default: "
        "RUN/video.mp4); only an earlier video of this command is overwritten",
        "FILE",
    ),
    arg.option(
        "--speed X", "playback speed, relative to real time", 1.0, type=arg.number(0.001, 1000)
    ),
    arg.option("--start S", "skip the first S seconds", 0.0, type=arg.number(0, 1e6)),
    arg.option("--seconds S", "duration to render (default: all)", math.inf, type=arg.POSITIVE),
)


def run(options: argparse.Namespace) -> int:
    from mjtactile.report.video import is_own, write_video

    recording = load_recording(options.source)
    path = options.out or options.source / "video.mp4"
    if not foreign_file.is_dir(path.parent):
        raise InputError("no such folder", source=path.parent, field="--out")
    if not is_own(path):
        require_new(path)
    with stdout_to_stderr():
        result = write_video(
            path,
            recording,
            speed=options.speed,
            start=options.start,
            seconds=options.seconds,
            notify=Progress(quiet=options.json).message,
        )
    result |= {"out": str(path), "flags": recording.flags, "problems": recording.problems}
    if options.json:
        print_json(result)
    else:
        print(
            f"{result['seconds']:.1f} s, {result['frames']} images of {result['width_px']} x "
            f"{result['height_px']} pixels\n"
            f"  written to {path}"
        )
        print_problems(recording)
        print_flags(recording.flags)
    return 0
