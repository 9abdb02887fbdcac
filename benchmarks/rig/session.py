"""A session of the emulated rig for `mjtactile bench rig`: emulator, rig, and sensing pipelines
with references."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.errors import DeviceError
from mjtactile.core.types import Command, Observation
from mjtactile.emulator.process import EmulatorProcess
from mjtactile.emulator.rig import build_emulated_rig
from mjtactile.rig.file import RigFile, load_rig_file
from mjtactile.rig.finger import Rig
from mjtactile.runtime.cycle import Cycle
from mjtactile.runtime.references import inflate
from mjtactile.runtime.session import Session
from mjtactile.runtime.supervisor import Supervisor
from mjtactile.sensing.pipeline import SensingPipeline
from mjtactile.sensing.pipeline_state import PipelineState
from mjtactile.sensing.stateful_pipeline import StatefulPipeline

SENSOR = "paper16"
OBJECT = "egg"


def design_at(rate: float) -> SensorDesign:
    """Return the benchmark's sensor with a camera of `rate` Hz."""
    design = load_sensor(SENSOR)
    return replace(design, camera=replace(design.camera, rate=rate))


@dataclass
class Closing:
    """A controller that closes by `speed` m per cycle, without end."""

    speed: float = 5e-5
    path: Path = Path("bench")

    def step(self, observation: Observation) -> Command:
        return replace(
            observation.command, opening=observation.command.opening - self.speed, force_limit=2.0
        )


class EndOfRun(BaseException):
    """Signal from `on_cycle` that ends a run at once; with an Exception the jaws would first
    retreat."""


class Bench:
    """An emulator that outlives the rigs connected to it, since its start takes longer than most
    faults."""

    def __init__(
        self,
        name: str,
        design: SensorDesign,
        *,
        object_name: str = OBJECT,
        seed: int = 0,
        emulator: Mapping[str, object] = MappingProxyType({}),
    ):
        """Start an emulator; `emulator` overrides fields of the rig file's [emulator]."""
        file = load_rig_file(name)
        assert file.emulator is not None
        self.rig_file: RigFile = replace(file, emulator=replace(file.emulator, **emulator))
        self.design = design
        self.object_name = object_name
        self.seed = seed
        self.process = EmulatorProcess(self.rig_file, design, object_name=object_name, seed=seed)
        self._states: list[PipelineState] = []

    def connect(self) -> Rig:
        return build_emulated_rig(
            self.rig_file,
            self.design,
            object_name=self.object_name,
            seed=self.seed,
            emulator=self.process,
        )

    def session(self, rig: Rig) -> Session:
        """Return a session with references.

        Later sessions use the references of the first rig, like a calibration.
        """
        if not self._states:
            session = Session(rig)
            session.take_references()
            self._states = [
                perception.state
                for perception in session.perceptions
                if isinstance(perception, StatefulPipeline)
            ]
            return session
        sensing_pipeline = SensingPipeline(self.design)
        session = Session(
            rig, [StatefulPipeline(sensing_pipeline, state) for state in self._states]
        )
        inflate(rig.fingers, rig.clock)
        return session

    def close(self) -> None:
        self.process.close()


def drive(
    bench: Bench,
    controller: Any,
    on_cycle: Callable[[Cycle], None],
    *,
    supervisor: Supervisor | None = None,
    time_limit: float = 60.0,
    on_ready: Callable[[Rig], None] = lambda _: None,
) -> str:
    """Connect, take references, and run until `on_cycle` raises EndOfRun or a fault ends the run.

    Return the reason of the end ("" for EndOfRun).
    """
    try:
        rig = bench.connect()
    except DeviceError as error:
        return str(error)
    try:
        session = bench.session(rig)
        on_ready(rig)
        session.run(controller, time_limit=time_limit, on_cycle=on_cycle, supervisor=supervisor)
    except EndOfRun:
        return ""
    except DeviceError as error:
        return str(error)
    finally:
        with contextlib.suppress(DeviceError):  # an unplugged device cannot be switched off
            rig.close()
    return "the controller ended"
