"""Simulated sensor on a stand, an indenter on a stage that follows a protocol, and its recording.

The recording has the format of `mjtactile record` on a real rig: images, pressures, times and stage
moves. It contains no true sensor parameters: `as_built` may differ from the sensor file named in
the recording.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.status import Status, StatusCode
from mjtactile.core.types import Command, GripperState, Image, Touch, ValveState
from mjtactile.recording.stage_protocol import Move, Stage, describe
from mjtactile.recording.writer import Recorder
from mjtactile.sim.rendering.renderer import Renderer
from mjtactile.sim.scenes.indentation import Indenter, PressWorld
from mjtactile.sim.scenes.stage import StageDrive, current

PRESSURE_NOISE = 5.0  # standard deviation, Pa; same value as in the emulated valve board
LOAD_CELL_NOISE = 2e-3  # standard deviation of a reading, N
_LARGEST_STEP = 4e-3  # limit of the time step, s
# readings of the load cell at the end of a hold
_REFERENCE_IMAGES = 10
_LOADS = 10
_NOT_DETECTED = Status(StatusCode.NOT_ESTIMATED, "recorded on a stage without a sensing pipeline")
_NO_GRIPPER = GripperState(math.nan, math.nan, math.nan, math.nan)
_NO_COMMAND = Command(0.0, 0.0)

NOTHING = Stage("sphere:8", (0.0, 0.0), (Move(0.0),))
"""Stage without contact."""

Notify = Callable[[str], None]


@dataclass(frozen=True)
class _Cycle:
    """One cycle in the form that a `Recorder` requires."""

    time: float
    images: tuple[Image, ...]
    valves: tuple[ValveState, ...]
    touch: tuple[Touch, ...]
    gripper: GripperState = _NO_GRIPPER
    sent: Command = _NO_COMMAND
    perception_ms: float = 0.0


class StageWorld:
    """Test sensor on its stand, with camera, pressure sensor and the stage's load cell."""

    def __init__(self, as_built: SensorDesign, stage: Stage, *, seed: int = 0, **world: Any):
        """Build the scene; `world` are arguments of `PressWorld`, such as the mesh."""
        self.period = 1 / as_built.camera.rate
        timestep = self.period / math.ceil(self.period / _LARGEST_STEP)
        self.world = PressWorld(
            as_built, Indenter.parse(stage.indenter), at=stage.at, timestep=timestep, **world
        )
        self._renderer = Renderer(as_built, seed=seed)
        self._rng = np.random.default_rng(seed)

    def inflate(self, gauge_pressure: float, *, seal: bool) -> None:
        self.world.inflate(gauge_pressure, seal=seal)

    def image(self) -> Image:
        return self._renderer.render(*self.world.marker_poses(0), self.world.time)

    def pressure(self) -> float:
        """Return the reading of the pressure sensor, Pa."""
        return self.world.sensors[0].gauge_pressure + float(self._rng.normal(0.0, PRESSURE_NOISE))

    def load(self) -> float:
        """Return the reading of the load cell, N, positive in compression."""
        return -float(self.world.drive_force[2]) + float(self._rng.normal(0.0, LOAD_CELL_NOISE))

    def cycle(self) -> _Cycle:
        """Return the current readings of the devices."""
        image = self.image()
        time = self.world.time
        valve = ValveState(self.world.sensors[0].valve_is_open, self.pressure(), time, 0.0)
        touch = Touch(time, 0.0, math.nan, math.nan, False, status=_NOT_DETECTED)
        return _Cycle(time, (image,), (valve,), (touch,))


def record_stage(
    as_built: SensorDesign,
    stage: Stage,
    recorder: Recorder,
    *,
    seconds: float,
    seed: int = 0,
    load_cell: bool = False,
    notify: Notify = lambda _: None,
    **world: Any,
) -> int:
    """Record references and `seconds` s of moves, with a load cell; return the cycles."""
    bench = StageWorld(as_built, stage, seed=seed, **world)
    recorder.note(fingers=["left"], stage=stage.note())
    notify("reference: flat, valve open")
    bench.inflate(0.0, seal=False)
    recorder.add_reference("flat", [[bench.image() for _ in range(_REFERENCE_IMAGES)]], [0.0])
    notify("reference: inflated, no contact")
    bench.inflate(as_built.chamber.supply_gauge, seal=True)
    readings = [bench.pressure() for _ in range(_REFERENCE_IMAGES)]
    recorder.add_reference(
        "rest", [[bench.image() for _ in range(_REFERENCE_IMAGES)]], [float(np.mean(readings))]
    )
    cycles = round(seconds / bench.period)
    loads = [[] for _ in stage.moves]
    drive = StageDrive(bench.world, stage.moves)
    for cycle in range(cycles):
        number = current(stage.moves, cycle * bench.period)
        if number is not None:
            if not loads[number]:
                notify(describe(stage.moves[number]))
            loads[number].append(bench.load())
        recorder.add(bench.cycle())
        drive.advance_to((cycle + 1) * bench.period)
    if flags := bench.world.flags:
        recorder.note(flags=flags)
    if load_cell:
        recorder.note(
            stage=stage.with_forces(
                [float(np.mean(shown[-_LOADS:])) if shown else math.nan for shown in loads]
            ).note()
        )
    return cycles
