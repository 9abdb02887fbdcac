"""`mjtactile record`: watch a rig without moving it, and keep everything it says."""

from __future__ import annotations

import argparse
import contextlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjtactile import InputError, Recorder, rig_names
from mjtactile.commands import ranges
from mjtactile.commands.output import output_folder, print_json, stdout_to_stderr
from mjtactile.core import resources
from mjtactile.run.progress import Progress
from mjtactile.types import Command, Observation

if TYPE_CHECKING:
    from mjtactile import Session
    from mjtactile.run.loop import Cycle

DESCRIPTION = """\
Record an episode in which nothing is commanded: the jaws hold where they stand, with the force
they hold with when a rig is connected; press the membranes by hand, put weights on, shake it.
First every sensor measures itself (valve open, then inflated and sealed): nothing may touch it
then. Every image is kept losslessly, with its time of capture, pressures, servo states, forces
felt, versions, and the text of the sensor and rig files.

The recording replays through the same chain to the same numbers, bit for bit (--rig replay:DIR)."""
EPILOG = """\
examples:
  mjtactile record --rig my_gripper.toml --seconds 30 --out runs/by_hand
  mjtactile record --rig emulated --out runs/idle
  mjtactile record --rig replay:runs/idle --out runs/again           the same numbers again
  mjtactile grasp --rig replay:runs/idle --controller my_controller.py    what would it have wanted?

The format: docs/recording.md. Two cameras of 640 x 480 pixels at 30 Hz take 9 MB a second.
exit codes: 0 recorded, 2 bad input, 3 a device failed, a fault, or Ctrl-C; what was recorded until then is kept.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--rig", required=True, metavar="RIG", help=f"what to record: {', '.join(rig_names())}")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the recording")
    parser.add_argument("--seconds", type=float, default=10.0, metavar="S",
                        help="length after the references, at most a recording's (default: 10)")
    ranges.add_frames_argument(parser)
    parser.add_argument("--sensor", default="dense", metavar="NAME|FILE.toml", help="on each finger (default: dense)")
    parser.add_argument("--object", default="egg", metavar="NAME|FILE.xml", help="sim and emulated: what stands on the table: "
                        f"{', '.join(resources.names('models/objects', '.xml'))} (default: egg)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="sim and emulated: placement and noise (default: 0)")


@dataclass
class Monitor:
    """A controller that leaves everything as it is for `seconds` s."""

    seconds: float
    path: Path = Path("monitor")

    def step(self, observation: Observation) -> Command:
        """The last command again; "done" when the time is over, by the rig's own clock."""
        last = observation.command
        start = last.memory.get("start", observation.time)
        is_over = observation.time + 0.5 * observation.period >= start + self.seconds
        return replace(last, phase="done" if is_over else "approach", memory={"start": start})


def run(options: argparse.Namespace) -> int:
    from mjtactile import load_sensor, open_session

    if not 0 < options.seconds <= 86400:
        raise InputError(f"{options.seconds:g} is outside 0 to 86400", field="--seconds")
    design = load_sensor(options.sensor)
    progress = Progress()
    with (output_folder(options.out, "recording") as folder, stdout_to_stderr(), contextlib.closing(progress),
          contextlib.ExitStack() as later):  # what is left when the rig is switched off
        with open_session(options.rig, design, object_name=options.object, seed=options.seed, workers=0,
                          say=progress.message) as session:
            header = {"object": options.object if session.rig.scene is not None else None, "sensor": options.sensor,
                      "controller": "monitor", "rig": options.rig, "seed": options.seed, "design": design.name}
            recorder = later.enter_context(Recorder(folder / "recording", header, frames=options.frames))
            result = _record(session, recorder, options.seconds, progress)
        recorder.close(outcome="recorded")
    result |= {"rig": options.rig, "sensor": design.name, "out": options.out}
    if options.json:
        print_json(result)
    else:
        print(f"{result['cycles']} cycles in {result['seconds']:.2f} s, {result['unknown']} with an unknown force; felt "
              f"{result['force_min_N']:.3f} to {result['force_max_N']:.3f} N\n  recorded in {options.out}/recording")
    return 0


def _record(session: Session, recorder: Recorder, seconds: float, progress: Progress) -> dict[str, Any]:
    """References, then the watch."""
    import numpy as np

    forces, times = [], []

    def on_cycle(cycle: Cycle) -> None:
        recorder.add(cycle)
        forces.append([t.force_normal for t in cycle.touch])
        times.append(cycle.time)
        progress.update(cycle.sent.phase, cycle.time, float(np.mean(forces[-1])))

    recorder.patience = session.patience
    session.take_references(recorder)
    seconds = min(seconds, session.rig.length)
    session.run(Monitor(seconds), time_limit=seconds + 60, on_cycle=on_cycle)
    known = np.array(forces)[np.isfinite(forces).all(axis=1)] if forces else np.zeros((0, 1))
    low, high = (float(known.min()), float(known.max())) if known.size else (float("nan"),) * 2
    return {"cycles": len(forces), "seconds": times[-1] - times[0] if times else 0.0, "unknown": len(forces) - len(known),
            "force_min_N": low, "force_max_N": high}
