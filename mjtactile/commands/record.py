"""`mjtactile record`: record all data of a rig without moving it."""

from __future__ import annotations

import argparse
import contextlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjtactile import DeviceError, InputError, Recorder, Scenario, resolve_scenario, rig_names
from mjtactile.commands import arguments as arg
from mjtactile.commands import scenario
from mjtactile.commands.option_rules import Rule
from mjtactile.commands.output import output_folder, print_flags, print_json, stdout_to_stderr
from mjtactile.core import resources
from mjtactile.recording.observer import Observer, Observers
from mjtactile.runtime.progress import Progress
from mjtactile.types import Command, Observation

if TYPE_CHECKING:
    from mjtactile import SensorDesign, Session
    from mjtactile.recording.stage_protocol import Stage
    from mjtactile.runtime.cycle import Cycle

DESCRIPTION = """\
Record a rig whose jaws hold position and force. First each sensor takes its references (valve
open, then inflated and sealed), without contact. Then press the membranes by hand, put weights
on them, or shake the gripper. Every image is stored losslessly, with capture time, pressures,
servo states, estimated forces, versions, and the text of the sensor and rig files.

With --protocol an operator or a stage moves an indenter. Each move is announced when it is due,
and stored in the recording for `mjtactile fit`. The rig "stage" is one simulated sensor under a
simulated stage, which runs the protocol itself.

The recording replays through the same pipeline to the same numbers, bit for bit
(--rig replay:DIR)."""
EPILOG = """\
examples:
  mjtactile record --rig my_gripper.toml --seconds 30 --out runs/manually
  mjtactile record --rig emulated --out runs/idle
  mjtactile record --rig my_gripper.toml --protocol press --indenter sphere:8 --pressure-kPa 0.5 \\
      --seconds 11 --out runs/press_05
  mjtactile record --rig stage --as-built odd.toml --protocol press --indenter sphere:8 --seconds \\
      11 --out runs/press
  mjtactile record --rig replay:runs/idle --out runs/again           the same numbers again
  mjtactile record --rig replay:runs/idle --contact-shapes --out runs/shapes
      the same images, with force and slip from contact shapes
  mjtactile grasp --rig replay:runs/idle --controller my_controller.py    its commands

A protocol is a CSV file with the columns time_s,depth_mm,shear_mm,speed_mm_s,force_N
(docs/how-to/identify.md). The format of recordings: docs/reference/recording_format.md.
Two cameras of 640 x 480 pixels at 30 Hz need 9 MB per second. exit codes: 0 recorded,
2 bad input, 3 a device failed, a fault, or Ctrl-C; the data recorded before are kept.
"""

ARGUMENTS = (
    arg.option("--rig RIG", f"rig to record: {', '.join(rig_names())}, stage", required=True),
    arg.out("folder for the recording", required=True),
    arg.option(
        "--seconds S",
        "duration after the references, at most that of a replayed recording",
        10.0,
        type=arg.number(0, 86400, above=True),
    ),
    scenario.FRAMES,
    arg.sensor("sensor on each finger (default: dense; of a replay: the recorded one)", None),
    arg.option(
        "--object NAME|FILE.xml",
        "sim and emulated: object on the table: "
        f"{', '.join(resources.names('models/objects', '.xml'))} (default: egg)",
    ),
    arg.option(
        "--pressure-kPa P",
        "working pressure of this recording (default: the sensor file's supply)",
        dest="pressure",
        type=arg.number(-50, 100),
    ),
    arg.option(
        "--protocol NAME|FILE.csv",
        "protocol to run meanwhile: "
        f"{', '.join(resources.names('models/protocols', '.csv'))}, or your own",
    ),
    arg.option(
        "--indenter SHAPE",
        "indenter of the protocol, as in `mjtactile press`: sphere:8, part.stl, … (default: a "
        "sphere for the frame's size)",
    ),
    arg.option("--position-mm X_mm,Y_mm", "position of the indenter", "0,0", type=arg.pair),
    arg.option("--finger NAME", "finger under the indenter", "left"),
    arg.option(
        "--as-built FILE.toml",
        "stage: as-built sensor to simulate; the recording names only --sensor",
        type=Path,
    ),
    arg.flag("--load-cell", "stage: also record the load cell in each hold"),
    arg.flag(
        "--contact-shapes",
        "force and slip from the contact shape in every image; also of a recording",
    ),
    scenario.TIME_SCALE,
    arg.option(
        "--seed N", "sim and emulated: placement and noise (default: 0)", type=arg.integer(0)
    ),
)
RULES = (
    Rule(
        ("--indenter", "--position-mm", "--finger", "--load-cell"),
        lambda given: given.protocol is not None,
        "without --protocol",
    ),
    Rule(("--as-built", "--load-cell"), lambda given: given.rig == "stage", "without --rig stage"),
    Rule(
        ("--object", "--finger", "--time-scale"),
        lambda given: given.rig != "stage",
        "with --rig stage, one simulated sensor",
    ),
)

_SENSOR = "dense"


@dataclass
class Monitor:
    """Controller that repeats the last command for `seconds` s."""

    seconds: float
    path: Path = Path("monitor")

    def step(self, observation: Observation) -> Command:
        """Return the last command again; "done" after the duration by the rig's own clock."""
        last = observation.command
        start = last.memory.get("start", observation.time)
        is_over = observation.time + 0.5 * observation.period >= start + self.seconds
        return replace(last, phase="done" if is_over else "approach", memory={"start": start})


def run(options: argparse.Namespace) -> int:
    from mjtactile import load_sensor

    scenario.apply_time_scale(options.time_scale, options.rig)
    design = _at_pressure(load_sensor(options.sensor or _SENSOR), options.pressure)
    stage = _stage(options, design)
    progress = Progress()
    with (
        output_folder(options.out, "recording") as folder,
        stdout_to_stderr(),
        contextlib.closing(progress),
        contextlib.ExitStack() as later,
    ):  # remaining work after the rig is switched off
        recording = folder / "recording"
        if options.rig == "stage":
            result: dict[str, Any] = _on_stage(options, design, stage, recording, progress)
        else:
            result = _on_rig(options, design, stage, recording, progress, later)
    result = {"sensor": design.name} | result | {"rig": options.rig, "out": options.out}
    if options.json:
        print_json(result)
        return 0
    print_flags(result["flags"])
    for problem in result.get("recorded", {}).get("problems", ()):
        print(f"  recording {problem}")
    if "unknown" not in result:
        print(f"{result['cycles']} cycles\n  recorded in {options.out}/recording")
    else:
        print(
            f"{result['cycles']} cycles in {result['seconds']:.2f} s, {result['unknown']} "
            f"with an unknown force; estimated {result['force_min_N']:.3f} to "
            f"{result['force_max_N']:.3f} N\n"
            f"  recorded in {options.out}/recording"
        )
    return 0


def _stage(options: argparse.Namespace, design: SensorDesign) -> Stage | None:
    """Return the stage with its checked protocol; None without one."""
    from mjtactile.recording.stage_protocol import Stage, protocol_indenter, read_moves

    if options.contact_shapes and options.rig == "stage":
        raise InputError(
            "a stage records images without estimates; `mjtactile explore --input RUN` "
            "estimates the shape of the indenter",
            field="--contact-shapes",
        )
    if options.protocol is None:
        return None
    x, y = options.position_mm
    side = min(design.frame.length, design.frame.width)
    indenter = options.indenter or protocol_indenter(options.protocol, side)
    return Stage(indenter, (1e-3 * x, 1e-3 * y), read_moves(options.protocol))


def _at_pressure(design: SensorDesign, pressure_kPa: float | None) -> SensorDesign:
    if pressure_kPa is None:
        return design
    return replace(design, chamber=replace(design.chamber, supply_gauge=1e3 * pressure_kPa))


def _on_stage(
    options: argparse.Namespace,
    design: SensorDesign,
    stage: Stage | None,
    folder: Path,
    progress: Progress,
) -> dict[str, Any]:
    from mjtactile import load_sensor
    from mjtactile.experiments.motion_stage import NOTHING, record_stage

    if options.as_built is None:
        true = design
    else:
        true = _at_pressure(load_sensor(options.as_built), options.pressure)
    header = {
        "object": None,
        "sensor": options.sensor or _SENSOR,
        "controller": "stage",
        "rig": "stage",
        "seed": options.seed or 0,
        "design": design.name,
    }
    with Recorder(folder, header, frames=options.frames) as recorder:
        cycles = record_stage(
            true,
            stage or NOTHING,
            recorder,
            seconds=options.seconds,
            seed=options.seed or 0,
            load_cell=options.load_cell,
            notify=progress.message,
        )
        recorder.close(outcome="recorded")
    return {"cycles": cycles, "seconds": options.seconds, "flags": recorder.flags}


def _on_rig(
    options: argparse.Namespace,
    design: SensorDesign,
    stage: Stage | None,
    folder: Path,
    progress: Progress,
    later: contextlib.ExitStack,
) -> dict[str, Any]:
    from mjtactile import open_session

    values = {
        "object": options.object,
        "seed": options.seed,
        "sensor": options.sensor,
        "controller": "monitor",
    }
    given = {name: value for name, value in values.items() if value is not None}
    requested = Scenario(rig=options.rig, contact_shapes=options.contact_shapes, **given)
    resolved = resolve_scenario(requested, tuple(given))
    # at the requested pressure, unless the fingers name their own sensor
    named = resolved.sensor == requested.sensor
    built = replace(resolved, sensor=design) if named else resolved
    with open_session(built, workers=0, notify=progress.message) as session:
        header = resolved.header() | {"design": built.design().name}
        del header["command"]  # the recording does not contain a grasp
        if session.rig.scene is None and not session.rig.recorded:
            header["object"] = None
        for finger in session.rig.fingers if options.pressure is not None else ():
            if finger.design.chamber.supply_gauge != design.chamber.supply_gauge:
                message = f"finger {finger.name!r} has its own sensor file, which sets its pressure"
                raise InputError(message, field="--pressure-kPa")
        recorder = later.enter_context(Recorder(folder, header, frames=options.frames))
        if stage is not None:
            recorder.note(stage=stage.note() | {"finger": options.finger})
        result = _record(session, recorder, options.seconds, progress, stage)
    recorder.close(outcome="recorded")
    if session.rig.recorded:
        result |= {"sensor": resolved.names()["sensor"], "recorded": dict(session.rig.recorded)}
    return result


class _RecordObserver(Observer):
    """Observer that stores the estimated forces and announces the protocol's moves at their
    times."""

    def __init__(self, progress: Progress, stage: Stage | None):
        self.forces: list[list[float]] = []
        self.times: list[float] = []
        self._progress = progress
        self._left = list(stage.moves if stage else ())

    def add(self, cycle: Cycle, view: Any = None, **truth: Any) -> None:
        from mjtactile.recording.stage_protocol import describe

        self.forces.append([touch.force_normal for touch in cycle.touch])
        self.times.append(cycle.time)
        while self._left and cycle.time - self.times[0] >= self._left[0].time - 1e-9:
            self._progress.message(describe(self._left.pop(0)))


class _Monitored(Observers):
    """Observers of the cycles of `Monitor`; not of a retreat after it."""

    is_over: bool = False

    def on_images(self) -> None:
        if not self.is_over:
            super().on_images()

    def add(self, cycle: Cycle, view: Any = None, **truth: Any) -> None:
        if not self.is_over:
            super().add(cycle, view, **truth)
        self.is_over = cycle.sent.phase == "done" or self.is_over


def _record(
    session: Session, recorder: Recorder, seconds: float, progress: Progress, stage: Stage | None
) -> dict[str, Any]:
    """Take references, then record; the protocol's moves are announced at their times."""
    import numpy as np

    watching = _RecordObserver(progress, stage)
    recorder.start(session)
    session.take_references(recorder)
    seconds = min(seconds, session.rig.length)
    monitored = _Monitored([recorder, watching, progress])
    try:
        session.run(Monitor(seconds), time_limit=seconds + 60, observer=monitored)
    except DeviceError:
        # a recording cannot lower a gripper that was raised at the end of the requested part
        if not (monitored.is_over and session.rig.recorded):
            raise
    forces = watching.forces
    times = watching.times
    known = np.array(forces)[np.isfinite(forces).all(axis=1)] if forces else np.zeros((0, 1))
    low, high = (float(known.min()), float(known.max())) if known.size else (float("nan"),) * 2
    return {
        "cycles": len(forces),
        "seconds": times[-1] - times[0] if times else 0.0,
        "unknown": len(forces) - len(known),
        "force_min_N": low,
        "force_max_N": high,
        "flags": session.flags,
    }
