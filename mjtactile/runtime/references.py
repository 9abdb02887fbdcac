"""Reference states for zeroing each sensor: membrane flat, then inflated, without contact."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from mjtactile.core import signals
from mjtactile.core.errors import DeviceError
from mjtactile.core.types import Image
from mjtactile.rig.finger import Finger
from mjtactile.rig.protocols import CameraDevice, Clock

REFERENCE_IMAGES = 10  # averaging ten takes the reference's noise to a third of an image's
SETTLE_TIME = 0.5  # settling time of the membrane after a valve change, s
PATIENCE = 2.0  # maximum wait for an image before any motion, s

Shots = list[list[Image]]
"""Images of every finger."""


@dataclass(frozen=True, eq=False)
class ReferenceImages:
    """Images of the membranes in one reference state, without contact.

    Attributes:
        stage: "flat" (valves open to the air) or "rest" (inflated and sealed).
        images: One list per finger.
        gauge_pressure: One per valve, Pa; None: no pressure sensor.
    """

    stage: str
    images: Shots
    gauge_pressure: list[float | None]


def take_references(
    fingers: Sequence[Finger], clock: Clock, notify: Callable[[str], None] = lambda _: None
) -> Iterator[ReferenceImages]:
    """Set the membranes to each of their two reference states and take images there.

    Yield "flat", then "rest". The second state starts after the caller has processed the first. A
    sensor that fails its flat reference is therefore not inflated. `say` receives messages about
    the next state. Raises DeviceError if a device does not answer.
    """
    valves = [finger.valve for finger in fingers if finger.valve is not None]
    notify("reference: flat, valve open")
    for valve in valves:
        valve.open(0.0)
    yield ReferenceImages("flat", settled_images(fingers, clock), [0.0 for _ in valves])
    notify("reference: inflated, no contact")
    inflate(fingers, clock)
    readings: list[list[float | None]] = []
    images = settled_images(
        fingers, clock, lambda: readings.append([v.state().gauge_pressure for v in valves])
    )
    yield ReferenceImages("rest", images, [_mean(each) for each in zip(*readings, strict=True)])


def inflate(fingers: Sequence[Finger], clock: Clock) -> None:
    """Fill every chamber to its supply's pressure and seal it."""
    for finger in fingers:
        if finger.valve is not None:
            finger.valve.open(finger.design.chamber.supply_gauge)
    clock.wait_until(clock.now() + SETTLE_TIME)
    for finger in fingers:
        if finger.valve is not None:
            finger.valve.close()


def settled_images(
    fingers: Sequence[Finger], clock: Clock, with_each: Callable[[], None] = lambda: None
) -> Shots:
    """Wait until all motion has settled, then take REFERENCE_IMAGES images of each camera.

    `with_each` is called after each of them.
    """
    period = control_period(fingers)
    clock.wait_until(clock.now() + SETTLE_TIME)
    shots: Shots = [[] for _ in fingers]
    for _ in range(REFERENCE_IMAGES):
        signals.check()
        for finger, images in zip(fingers, shots, strict=True):
            images.append(patient_read(finger.camera, clock, period))
        with_each()
        clock.wait_until(clock.now() + period)
    return shots


def _mean(readings: Sequence[float | None]) -> float | None:
    """Return the mean of the known pressure readings; None without any."""
    known = [reading for reading in readings if reading is not None]
    return math.fsum(known) / len(known) if known else None


def patient_read(camera: CameraDevice, clock: Clock, period: float) -> Image:
    """Read an image before any motion, and wait for a late one. Raises DeviceError if none
    arrives."""
    deadline = clock.now() + PATIENCE
    while True:
        try:
            return camera.read()
        except DeviceError:
            if clock.now() > deadline:
                raise
            clock.wait_until(clock.now() + period)


def control_period(fingers: Sequence[Finger]) -> float:
    """Return the control period, s: one frame of the slowest camera."""
    return 1.0 / min(finger.design.camera.rate for finger in fingers)
