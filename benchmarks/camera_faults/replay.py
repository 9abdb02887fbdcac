"""One finger's grasp, kept in memory and evaluated again with modified images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from benchmarks.camera_faults.fault_kinds import ALWAYS, REFERENCES, Kind
from mjtactile.core.calibration import pressure_reading
from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.errors import DeviceError
from mjtactile.core.scenario import Scenario
from mjtactile.core.types import Image, PressureReading, Touch
from mjtactile.recording.observer import Observer
from mjtactile.runtime.grasp import run_grasp
from mjtactile.sensing.stateful_pipeline import StatefulPipeline
from mjtactile.sim.rendering.image_faults import FaultyImage


@dataclass(eq=False)
class Grasp(Observer):
    """Recorded images and pressure readings of one finger, and the true normal force on it, N."""

    design: SensorDesign
    references: dict[str, list[Image]] = field(default_factory=dict)
    pressure: float = 0.0
    images: list[Image] = field(default_factory=list)
    readings: list[PressureReading | None] = field(default_factory=list)
    true: list[float] = field(default_factory=list)

    def add_reference(
        self, stage: str, images: Sequence[Sequence[Image]], gauge_pressure: Sequence[float | None]
    ) -> None:
        self.references[stage] = list(images[0])
        self.pressure = float(gauge_pressure[0] or 0.0)

    def add(self, cycle: Any, view: Any = None, **truth: Any) -> None:
        self.images.append(cycle.images[0])
        self.readings.append(pressure_reading(cycle.valves[0]))
        self.true.append(truth["force_normal_true"][0])


def record(sensor: str, seed: int) -> Grasp:
    """Record the grasp of an egg without faults."""
    grasp = Grasp(load_sensor(sensor))
    run_grasp(Scenario(object="egg", controller="gentle", sensor=sensor, seed=seed), [grasp])
    return grasp


@dataclass(frozen=True)
class ReplayResult:
    """Result of one fault kind: the touches, or the reason why the references were `refused`."""

    touches: tuple[Touch, ...] = ()
    refused: str = ""


def replay_faults(
    grasp: Grasp, kind: Kind, *, gauges: Sequence[bool] = (True, False)
) -> list[ReplayResult]:
    """Evaluate the grasp with that fault, with and without pressure readings.

    One pass over the images serves both.
    """
    camera = FaultyImage(kind.faults, kind.seed)
    before = kind.when in (ALWAYS, REFERENCES)
    after = kind.when != REFERENCES

    def shown(images: Sequence[Image], on: bool) -> list[Image]:
        return [camera(image) if on else image for image in images]

    perception = StatefulPipeline.of(grasp.design, contact_shapes=False)
    try:
        perception.measure_flat_reference(shown(grasp.references["flat"], before))
        perception.measure_rest_reference(shown(grasp.references["rest"], before), grasp.pressure)
    except DeviceError as error:
        refused = ReplayResult(refused=" ".join(str(error).split()))
        return [refused for _ in gauges]
    pipelines = [
        StatefulPipeline(perception.pipeline, perception.state, contact_shapes=False)
        for _ in gauges
    ]
    touches: list[list[Touch]] = [[] for _ in gauges]
    for image, reading in zip(grasp.images, grasp.readings, strict=True):
        altered = camera(image) if after else image
        for sensing_pipeline, found, gauge in zip(pipelines, touches, gauges, strict=True):
            touch = sensing_pipeline.perceive(altered, image.time, reading if gauge else None)
            found.append(replace(touch, traction=None, surface=None))  # they are large
    return [ReplayResult(tuple(found)) for found in touches]
