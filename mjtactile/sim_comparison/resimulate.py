"""Simulation of a recording, observed by the rig's sensing pipeline.

It repeats the same commands at the same times, or the same moves of a stage.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.scenario import Scenario
from mjtactile.core.types import Array, Command, Image, PressureReading
from mjtactile.experiments.motion_stage import record_stage
from mjtactile.export.episode import RecordedEpisode
from mjtactile.recording.observer import Observer
from mjtactile.recording.reader import Recording
from mjtactile.recording.stage_protocol import Stage, stage_from_note
from mjtactile.rig.as_built_sensor import NOMINAL, AsBuiltSensor, true_design
from mjtactile.rig.domain_randomization import UNCHANGED, SampledWorld
from mjtactile.rig.file import load_sim_rig
from mjtactile.runtime.session import Session
from mjtactile.sensing.stateful_pipeline import StatefulPipeline
from mjtactile.sim.rig import build_sim_rig, start_of
from mjtactile.sim_comparison.signals import CollectedSignals, Signals, gauges

Amounts = Mapping[str, Sequence[float]]
"""Map from cause to its amount, SI, on each finger; one value for the gripper or the object."""
_NOT_SAMPLED = "-images"  # markers with the errors of an image replace images: same result, faster


@dataclass(frozen=True)
class GripperReplay:
    """Simulated gripper that receives the recorded commands of `folder`.

    Attributes:
        folder: The recording.
        scenario: The simulated scenario: rig, object, sensor and seed.
        until: Time from the first cycle, s, after which data are ignored.
    """

    folder: Path
    scenario: Scenario
    until: float = math.inf

    def run(self, amounts: Amounts) -> Signals:
        """Simulate the recording with these amounts of each cause.

        Returns:
            The signals of the simulated rig.

        Raises:
            InputError: The simulated rig has a different number of fingers.
        """
        episode = RecordedEpisode(self.folder)
        count = len(episode.fingers)
        file = load_sim_rig(self.scenario.rig)
        if len(file.fingers) != count:
            raise InputError(
                f"the recording has {count} fingers, the simulated rig {len(file.fingers)}",
                source=self.scenario.rig,
                field="--rig",
            )
        names = [finger.name for finger in file.fingers]
        rig = build_sim_rig(self.scenario, file=file, sampled=self._sampled_world(amounts, names))
        try:
            session = Session(rig, threads=0)
            session.take_references()
            offset = float(amounts.get("opening", (0.0,))[0])
            return _follow(session, episode.recording, offset, self.until)
        finally:
            rig.close()

    def _sampled_world(self, amounts: Amounts, names: Sequence[str]) -> SampledWorld:
        pose, _ = start_of(self.scenario.seed)
        along = float(amounts.get("along", (0.0,))[0])
        mass = float(amounts.get("mass", (0.0,))[0])
        item = replace(UNCHANGED, place=(pose[0] + along, pose[1]), mass=mass)
        as_built = tuple(
            replace(_as_built_sensor(amounts, k), finger=name) for k, name in enumerate(names)
        )
        return SampledWorld(object=item, as_built=as_built)


@dataclass(frozen=True)
class StageReplay:
    """Sensor under a simulated stage that repeats the moves of `folder`.

    Attributes:
        folder: The recording.
        until: Time from the first cycle, s, after which data are ignored.
    """

    folder: Path
    until: float = math.inf

    def run(self, amounts: Amounts) -> Signals:
        """Simulate the recording with these amounts of each cause.

        Returns:
            The signals of the simulated sensor.
        """
        episode = RecordedEpisode(self.folder)
        stage = stage_from_note(episode.recording.notes["stage"], self.folder)
        as_built = _as_built_sensor(amounts, 0)
        true = true_design(episode.design, as_built)
        leaking = replace(true.chamber, leak_conductance=true.chamber.leak_conductance)
        leaking = replace(leaking, leak_conductance=leaking.leak_conductance + as_built.leak)
        offset = float(amounts.get("touch", (0.0,))[0])
        watch = _Watch(episode.design, as_built.valve_zero)
        times = episode.recording.columns["time"]
        seconds = min(float(times[-1] - times[0]), self.until) + 1 / episode.design.camera.rate
        record_stage(
            replace(true, chamber=leaking),
            _deeper(stage, offset),
            watch,  # type: ignore[arg-type]  # an observer is all that it needs
            seconds=seconds,
        )
        return watch.gathered.signals()


class _Watch(Observer):
    """Sensing pipeline that observes the recording of a stage."""

    def __init__(self, design: SensorDesign, zero: float):
        self._perception = StatefulPipeline.of(design, None, contact_shapes=False)
        self._zero = zero
        self.gathered = CollectedSignals([design.markers.count])

    def add_reference(
        self, stage: str, images: Sequence[Sequence[Image]], gauge_pressure: Sequence[Any]
    ) -> None:
        if stage == "flat":
            self._perception.measure_flat_reference(list(images[0]))
        else:
            self._perception.measure_rest_reference(list(images[0]), gauge_pressure[0] + self._zero)

    def add(self, cycle: Any, view: Any = None, **truth: Any) -> None:
        valve = cycle.valves[0]
        shown = valve.gauge_pressure + self._zero
        reading = PressureReading(shown, 5.0, valve.time)
        touch = self._perception.perceive(cycle.images[0], cycle.time, reading)
        self.gathered.add(cycle.time, (touch,), (shown,))


def _deeper(stage: Stage, offset: float) -> Stage:
    moves = tuple(
        replace(move, depth=move.depth + offset) if move.touches else move for move in stage.moves
    )
    return replace(stage, moves=moves)


def _as_built_sensor(amounts: Amounts, finger: int) -> AsBuiltSensor:
    def own(name: str) -> float:
        given = amounts.get(name, ())
        return float(given[finger]) if finger < len(given) else 0.0

    return replace(
        NOMINAL,
        leak=max(own("leak"), 0.0),
        stiffness_fraction=own("stiffness"),
        pre_stretch=own("pre_stretch"),
        creep=max(own("creep"), 0.0),
        friction_fraction=own("friction"),
        valve_zero=own("gauge"),
        focal_fraction=own("focal"),
    )


def _follow(session: Session, recording: Recording, offset: float, until: float) -> Signals:
    """Send the recorded commands at their times, with openings increased by `offset` m."""
    times = recording.columns["time"] - recording.columns["time"][0]
    last = min(float(times[-1]), until)
    gathered = CollectedSignals([finger.design.markers.count for finger in session.rig.fingers])
    start = session.rig.clock.now()
    with session.steps() as steps:
        for _ in range(round(last / session.rig.period) + 1):
            observed = steps.observe()
            now = observed.time - start
            gathered.add(now, observed.touch, gauges(observed.valves))
            steps.send(_command(recording, times, now, offset))
    return gathered.signals()


def _command(recording: Recording, times: Array, now: float, offset: float) -> Command:
    """Return the recorded command of the cycle nearest to `now` s."""
    k = int(np.abs(times - now).argmin())
    sent = recording.command(k)
    return replace(
        sent,
        opening=max(sent.opening + offset, 0.0),
        phase="release" if sent.phase in ("done", "abort") else sent.phase,
        memory={},
        reason="",
    )


def without_rendering(effects: str) -> str:
    """Return `effects` without images; the simulation's own ellipse errors replace them."""
    return _NOT_SAMPLED if effects in ("", "auto") else f"{effects},{_NOT_SAMPLED}"
