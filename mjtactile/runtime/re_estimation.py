"""Touch estimated again from the images of a recording."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from mjtactile.core.calibration import Calibration
from mjtactile.core.design import SensorDesign
from mjtactile.core.scenario import Scenario
from mjtactile.core.types import Image, Touch
from mjtactile.recording.reader import Recording
from mjtactile.rig.registry import build_rig
from mjtactile.runtime.session import Session
from mjtactile.sensing.settings import DEFAULTS, Settings
from mjtactile.sensing.stateful_pipeline import StatefulPipeline


def replay_session(
    recording: Recording, *, settings: Settings = DEFAULTS, contact_shapes: bool | None = None
) -> Session:
    """Return a session on the recorded rig, with its references.

    Raises InputError for a missing image or sensor file.
    """
    rig = build_rig(Scenario(rig=f"replay:{recording.folder}"))
    session = Session(rig, settings=settings, contact_shapes=contact_shapes)
    session.take_references()
    return session


def replay_touches(recording: Recording, session: Session) -> Iterator[tuple[Touch, ...]]:
    """Yield the touch of each finger in every cycle, from its recorded image; () without images."""
    for cycle, images in enumerate(recording.images()):
        time = float(recording.column("time")[cycle, 0])
        readings = session.rig.readings(recording.valves(cycle))
        touches = tuple(
            perception.perceive(image, time, reading)
            for perception, image, reading in zip(
                session.perceptions, images, readings, strict=False
            )
        )
        session.monitor.on_touches(time, touches)
        yield touches


def zeroed_pipeline(
    design: SensorDesign,
    calibration: Calibration | None,
    flat: Sequence[Image],
    rest: Sequence[Image],
    reading: float | None,
) -> StatefulPipeline:
    """Return a sensing pipeline with references from these images.

    `reading` is the pressure sensor's value in the rest images, Pa (None, NaN: no sensor). Raises
    DeviceError when the images do not agree with the sensor file.
    """
    perception = StatefulPipeline.of(design, calibration, contact_shapes=False)
    perception.measure_flat_reference(flat)
    if reading is None or math.isnan(reading):
        gauge = design.chamber.supply_gauge
    else:
        gauge = reading if calibration is None else calibration.pressure(reading)
    perception.measure_rest_reference(rest, gauge)
    return perception
