"""`mjtactile export`: recordings as data sets of other formats."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjtactile import InputError
from mjtactile.commands import arguments as arg
from mjtactile.commands.option_rules import Rule
from mjtactile.commands.output import complete_folder, print_result, stdout_to_stderr
from mjtactile.runtime.progress import Progress

if TYPE_CHECKING:
    from mjtactile.export.episode import RecordedEpisode

SIMULATES = False
DESCRIPTION = """\
Write recordings in the format of other tools: LeRobotDataset v3 for learning, MCAP with
Foxglove's schemas, a ROS 2 bag, or Rerun files for viewing. Except for Rerun, the export
contains all data that the format supports: images, estimated wrenches with their standard
deviations, states, commands, units, frames, calibrations, and the reasons for unknown values.
For a recording with all of its images, the membrane surface and its markers are computed again
from them. Damaged lines, images and recordings are left out and counted; the data set appears
when it is complete."""
EPILOG = """\
examples:
  mjtactile grasp --out runs/egg && mjtactile export runs/egg --format lerobot --out data/egg
  mjtactile export runs/many --format lerobot --images png --out data/many
      each recording in the folder is an episode
  mjtactile export runs/many --outcome held --format lerobot --out data/held
  mjtactile export runs/egg --format mcap --out data/egg_mcap              one file per episode
  mjtactile export runs/egg --format rerun --out data/egg_rrd && rerun data/egg_rrd/*.rrd
  mjtactile export runs/egg --format rosbag2 --out data/egg_bag
      ros2 bag play data/egg_bag/episode_000000

Needs `pip install 'mjtactile[data]'`, for Rerun 'mjtactile[live]'. See docs/how-to/export.md.
exit codes: 0 written, 2 bad input.
"""
FORMATS = {
    "lerobot": ("data", "pyarrow", "av"),
    "mcap": ("data", "foxglove"),
    "rerun": ("live", "rerun"),
    "rosbag2": ("data", "rosbags"),
}
"""Formats with the pip extra that installs their packages, and the modules of these packages."""
_WRITTEN = (
    "meta",
    "data",
    "videos",
    "references",
    "mjtactile_msgs",
    "episode_000000",
    "episode_000000.mcap",
    "episode_000000.rrd",
)

ARGUMENTS = (
    arg.positional(
        "source", "RUN", "recording, run, or folder of these; each is an episode", type=Path
    ),
    arg.choice("--format", FORMATS, "output format", required=True),
    arg.out("folder for the data set; nothing is overwritten", required=True),
    arg.choice(
        "--images",
        ("video", "png", "none"),
        "lerobot: lossless H.264 (default), PNG in the parquet files, or no images",
        "video",
    ),
    arg.option(
        "--crf N",
        "lerobot: H.264 quality: 0 lossless (default), 18-30 small files",
        0,
        type=arg.integer(0, 51),
    ),
    arg.option("--outcome NAME", "only recordings with this outcome, such as held"),
    arg.option("--task TEXT", 'lerobot: description of the task (default: "grasp the OBJECT")'),
)
RULES = (
    Rule(
        ("--images", "--crf", "--task"),
        lambda given: given.format == "lerobot",
        "without --format lerobot",
    ),
    Rule(("--crf",), lambda given: given.images == "video", "without --images video"),
)


def run(options: argparse.Namespace) -> int:
    _require_packages(options.format)
    from mjtactile.export.episode import find_episodes

    progress = Progress(quiet=options.json)
    left_out: list[str] = []
    episodes = find_episodes(options.source, left_out.append, outcome=options.outcome)
    problems = {
        str(episode.recording.folder): found
        for episode in episodes
        if (found := [*episode.recording.problems, *_camera_problems(options, episode)])
    }
    with complete_folder(options.out, *_WRITTEN) as out, stdout_to_stderr():
        result = _write(options, episodes, out, progress, left_out.append)
    result |= {"format": options.format, "out": str(options.out)}
    result |= {"left_out": left_out, "problems": problems}
    noun = "episode" if result["episodes"] == 1 else "episodes"
    lines = [f"{result['episodes']} {noun}, {result['frames']} frames"]
    lines += [f"  left out  {reason}" for reason in left_out]
    lines += [f"  {folder}: {'; '.join(found)}" for folder, found in problems.items()]
    print_result(options, result, "\n".join([*lines, f"  written to {options.out}"]))
    return 0


def _camera_problems(options: argparse.Namespace, episode: RecordedEpisode) -> list[str]:
    """Return the problems of the camera geometry, which LeRobot data sets do not contain."""
    return [] if options.format == "lerobot" else episode.camera_problems


def _write(
    options: argparse.Namespace,
    episodes: list[Any],
    out: Path,
    progress: Progress,
    leave_out: Callable[[str], None],
) -> dict[str, Any]:
    if options.format == "lerobot":
        from mjtactile.export.lerobot import dataset

        return dataset.write(
            episodes,
            out,
            images=options.images,
            crf=options.crf,
            task=options.task,
            notify=progress.message,
            leave_out=leave_out,
        )
    if options.format == "mcap":
        from mjtactile.export import mcap

        return mcap.write(episodes, out, notify=progress.message, leave_out=leave_out)
    if options.format == "rerun":
        from mjtactile.export import rrd

        return rrd.write(episodes, out, notify=progress.message, leave_out=leave_out)
    from mjtactile.export import rosbag2

    return rosbag2.write(episodes, out, notify=progress.message, leave_out=leave_out)


def _require_packages(name: str) -> None:
    """Raise InputError if the packages of a format are not installed."""
    import importlib.util

    extra, *modules = FORMATS[name]
    missing = [module for module in modules if importlib.util.find_spec(module) is None]
    if missing:
        message = f"{name!r} requires {', '.join(missing)}: pip install 'mjtactile[{extra}]'"
        raise InputError(message, field="--format")
