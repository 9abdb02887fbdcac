"""The nouns: a `Finger` is one sensor that can be asked, a `Rig` is what a controller drives."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from mjtactile.core.calibration import Calibration, pressure_reading
from mjtactile.core.design import SensorDesign
from mjtactile.core.types import DEFAULT_GOAL, PressureReading, TaskGoal, ValveState
from mjtactile.rig.command_limits import CommandLimits
from mjtactile.rig.protocols import CameraDevice, Clock, Gripper, Valve


@dataclass(frozen=True)
class Finger:
    """One sensor of a rig, and what was measured of it.

    Attributes:
        name: Such as "left".
        design: What it was built as.
        camera: Its camera.
        valve: None: it has none that obeys, and its chamber is sealed by hand.
        calibration: None: nothing was measured.
    """

    name: str
    design: SensorDesign
    camera: CameraDevice
    valve: Valve | None = None
    calibration: Calibration | None = None

    def pressure(self, reading: float | None) -> float:
        """Find the gauge pressure of the inflated chamber.

        Args:
            reading: What its sensor shows, Pa; None: it has none.

        Returns:
            Pa; without a sensor, the supply's.
        """
        if reading is None:
            return self.design.chamber.supply_gauge
        return reading if self.calibration is None else self.calibration.pressure(reading)

    def follow(self, gauge_pressure: float | None) -> None:
        """Have the valve keep the chamber at a pressure.

        Args:
            gauge_pressure: Pa; the gauge's zero is added to it. None: seal the chamber as it is.

        Raises:
            DeviceError: The valve does not obey.
        """
        if self.valve is None:
            return
        measured = None if self.calibration is None else self.calibration.valve
        zero = 0.0 if measured is None else measured.offset
        self.valve.follow(None if gauge_pressure is None else gauge_pressure + zero)

    def reading(self, valve: ValveState | None) -> PressureReading | None:
        """Find what the chamber's gauge says.

        Args:
            valve: The valve's state, which has the reading; None: the finger has no valve.

        Returns:
            The reading, its zero taken off; None: there is no gauge, or it is silent.
        """
        return None if valve is None else pressure_reading(valve, self.calibration)


@dataclass(frozen=True)
class Rig:
    """A gripper with one or more fingers.

    Attributes:
        name: Of the backend.
        fingers: In the order in which an observation has their touch.
        gripper: The jaws, and what lifts the hand.
        clock: The rig's time; in simulation, waiting on it is what moves the world.
        limits: What commands are cut to.
        close: Brings everything to its safe state and lets go of it; called on every exit path.
        host_timeout: s without a call after which the devices take the loop for dead and stop by
            themselves; inf: this world waits, as the simulated one and a replay do.
        length: s from the first cycle to the last: a recording ends, a world does not.
        varied: In a simulated world that is not as its files say: the values drawn for it, by name,
            in the files' units.
        simulated: How a world is simulated: `mesh`, `timestep_ms`, and each of the `effects`, on or
            off, why, and its price.
        flags: What makes the numbers of a simulation worse than usual, so far: the kind of doubt
            and its reason; of a replay those that were recorded.
        told: What the task asks of the robot.
        touch_is_synthetic: Whether its cameras hand over touch in place of images
            (`FingerSnapshot`).
        scene: The simulated world, for scoring alone; None on a real rig. Sensing and controllers
            never see a `Rig`.
        truth: What really happens in an emulated world, likewise; None elsewhere.
    """

    name: str
    fingers: tuple[Finger, ...]
    gripper: Gripper
    clock: Clock
    limits: CommandLimits
    close: Callable[[], None]
    host_timeout: float = math.inf
    length: float = math.inf
    varied: Mapping[str, Any] = field(default_factory=dict)
    simulated: Mapping[str, Any] = field(default_factory=dict)
    flags: Callable[[], Mapping[str, str]] = dict
    scene: Any = None
    truth: Callable[[], Mapping[str, Any]] | None = None
    told: TaskGoal = DEFAULT_GOAL
    touch_is_synthetic: bool = False

    @cached_property
    def period(self) -> float:
        """Control period, s: one frame of the slowest camera."""
        return 1.0 / min(finger.design.camera.rate for finger in self.fingers)

    @cached_property
    def cameras(self) -> tuple[CameraDevice, ...]:
        """The cameras, in the order of their fingers."""
        return tuple(finger.camera for finger in self.fingers)

    @cached_property
    def valves(self) -> tuple[Valve, ...]:
        """The valves that obey, in the order of their fingers."""
        return tuple(finger.valve for finger in self.fingers if finger.valve is not None)

    def readings(self, valves: Sequence[ValveState]) -> tuple[PressureReading | None, ...]:
        """Find what each finger's gauge says.

        Args:
            valves: The states of all valves, in the order of their fingers.

        Returns:
            One reading a finger; None without a gauge.
        """
        states = iter(valves)
        return tuple(
            finger.reading(next(states, None) if finger.valve is not None else None)
            for finger in self.fingers
        )


def make_fingers(
    names: tuple[str, ...],
    designs: tuple[SensorDesign, ...],
    cameras: tuple[CameraDevice, ...],
    valves: tuple[Valve, ...] = (),
    calibrations: tuple[Calibration | None, ...] = (),
) -> tuple[Finger, ...]:
    """Fingers from their parts, all in the same order; no valves, or one for each, and so with
    calibrations."""
    nothing = (None,) * len(names)
    parts = zip(names, designs, cameras, valves or nothing, calibrations or nothing, strict=True)
    return tuple(Finger(*part) for part in parts)
