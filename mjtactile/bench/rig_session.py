"""A session of the emulated rig for `mjtactile bench rig`: emulator, rig, and sensing chains with references."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from mjtactile import control
from mjtactile.design import SensorDesign, load_sensor
from mjtactile.emulator.process import EmulatorProcess
from mjtactile.emulator.rig import build_emulated_rig
from mjtactile.errors import DeviceError
from mjtactile.rig import Rig
from mjtactile.rigfile import RigFile, load_rig_file
from mjtactile.safety import Supervisor
from mjtactile.sensing.pipeline import SensorPipeline
from mjtactile.types import Command, Markers, Observation

SENSOR, OBJECT = "paper16", "egg"
_INFLATE_TIME = 0.8  # s for the chambers to fill and settle


def design_at(rate: float) -> SensorDesign:
    """The benchmark's sensor with a camera of `rate` Hz."""
    design = load_sensor(SENSOR)
    return replace(design, camera=replace(design.camera, rate=rate))


@dataclass
class Closing:
    """A controller that closes by `speed` m a cycle, and never ends by itself."""

    speed: float = 5e-5
    path: Path = Path("bench")

    def step(self, observation: Observation) -> Command:
        return replace(observation.command, opening=observation.command.opening - self.speed, force_limit=2.0)


class Enough(Exception):
    """Ends a run from within `on_cycle`."""


class Bench:
    """An emulator that outlives rigs connected to it: to start one takes longer than most faults."""

    def __init__(self, name: str, design: SensorDesign, *, object_name: str = OBJECT, seed: int = 0):
        self.rig_file: RigFile = load_rig_file(name)
        self.design, self.object_name, self.seed = design, object_name, seed
        self.process = EmulatorProcess(self.rig_file, design, object_name=object_name, seed=seed)
        self._rest: list[tuple[Any, Markers, float]] = []

    def connect(self) -> Rig:
        return build_emulated_rig(self.rig_file, self.design, object_name=self.object_name, seed=self.seed, emulator=self.process)

    def pipelines(self, rig: Rig) -> list[SensorPipeline]:
        """Chains with references; those of the first rig are used again, as a calibration is."""
        chains = [SensorPipeline(self.design) for _ in rig.cameras]
        if not self._rest:
            rests: list[tuple[Markers, float]] = []
            control.take_references(rig, chains, on_reference=lambda *_: None)
            shots = control.settled_images(rig)
            for chain, images, valve in zip(chains, shots, rig.valves, strict=True):
                pressure = valve.state().pressure_gauge or self.design.chamber.supply_gauge
                rests.append((chain.take_rest(images, pressure), pressure))
            self._rest = [(chain.flat, *rest) for chain, rest in zip(chains, rests, strict=True)]
            return chains
        for valve in rig.valves:
            valve.open(self.design.chamber.supply_gauge)
        rig.clock.wait_until(rig.clock.now() + _INFLATE_TIME)
        for valve in rig.valves:
            valve.close()
        for chain, (flat, markers, pressure) in zip(chains, self._rest, strict=True):
            chain.flat = flat
            chain.set_rest(markers, pressure)
        return chains

    def close(self) -> None:
        self.process.close()


def drive(bench: Bench, controller: Any, on_cycle: Callable[[control.Cycle], None], *, supervisor: Supervisor | None = None,
          time_limit: float = 60.0, on_ready: Callable[[Rig], None] = lambda _: None) -> str:
    """Connect, take references, run until `on_cycle` raises Enough or a fault ends it; what ended it ("" for Enough)."""
    rig = bench.connect()
    try:
        chains = bench.pipelines(rig)
        on_ready(rig)
        control.run(rig, chains, controller, time_limit=time_limit, on_cycle=on_cycle, supervisor=supervisor)
    except Enough:
        return ""
    except DeviceError as error:
        return str(error)
    finally:
        with contextlib.suppress(DeviceError):  # what was unplugged cannot be switched off
            rig.close()
    return "the controller ended"


