"""Result of a membrane estimation, and the context of the image that it is made from."""

from __future__ import annotations

from dataclasses import dataclass

from mjtactile.core.types import Markers, PressureReading
from mjtactile.sensing.force.linearization import Shape
from mjtactile.sensing.force.rest_equilibrium import InverseRest
from mjtactile.sensing.pipeline_state import PipelineState, Reference


@dataclass(frozen=True, eq=False)
class Estimate:
    """Membrane `shape` estimated from the `markers`, relative to the sensor at `rest`.

    `state` contains the gas state. It follows from pressure sensor and shape. If two shapes explain
    the markers, `other` is the less likely one. Its squared difference, times `other_weight`, is
    added to the covariance. The weight is p (1 - p) for a probability p, else 1.

    `pressure_gap`, Pa, is the measured minus the estimated gauge pressure, beyond sensor noise.
    It is 0 without a pressure sensor. `on_frame` is True if a face rests on the frame.
    """

    markers: Markers
    shape: Shape
    rest: InverseRest
    state: PipelineState
    other: Shape | None = None
    other_weight: float = 1.0
    pressure_gap: float = 0.0
    on_frame: bool = False


@dataclass(frozen=True, eq=False)
class ImageContext:
    """Context of one image: sensor at rest, capture time, s, and newest pressure reading, if
    any."""

    reference: Reference
    time: float
    reading: PressureReading | None
