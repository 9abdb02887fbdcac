"""Rig data types: a `Finger` is one sensor with its devices, a `Rig` is a complete gripper."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from mjtactile.core.calibration import Calibration, pressure_reading
from mjtactile.core.design import SensorDesign
from mjtactile.core.flags import Flags
from mjtactile.core.signature_checks import FINITE, validated
from mjtactile.core.types import PressureReading, TaskGoal, ValveState
from mjtactile.rig.command_limits import CommandLimits
from mjtactile.rig.protocols import CameraDevice, Clock, Gripper, Valve
from mjtactile.rig.workload import Workload


@validated()
@dataclass(frozen=True)
class Finger:
    """One sensor of a rig with its calibration.

    Attributes:
        name: Name such as "left".
        design: Nominal design of the sensor.
        camera: Its camera.
        valve: Its controlled valve; None: the chamber is sealed manually.
        calibration: Its measured calibration; None: not measured.
    """

    name: str
    design: SensorDesign
    camera: CameraDevice
    valve: Valve | None = None
    calibration: Calibration | None = None

    @validated()
    def pressure(self, reading: float | None) -> float:
        """Return the gauge pressure of the inflated chamber.

        Args:
            reading: Pressure sensor reading, Pa; None: no sensor.

        Returns:
            Calibrated gauge pressure, Pa; without a sensor, the supply pressure.
        """
        if reading is None:
            return self.design.chamber.supply_gauge
        return reading if self.calibration is None else self.calibration.pressure(reading)

    @validated(gauge_pressure=FINITE)
    def regulate_pressure(self, gauge_pressure: float | None) -> None:
        """Command the valve to regulate the chamber pressure.

        Args:
            gauge_pressure: Pa; the zero of the pressure sensor is added to it. None: seal the
                chamber.

        Raises:
            DeviceError: The valve does not respond.
        """
        if self.valve is None:
            return
        measured = None if self.calibration is None else self.calibration.valve
        zero = 0.0 if measured is None else measured.offset
        self.valve.regulate_pressure(None if gauge_pressure is None else gauge_pressure + zero)

    @validated()
    def pressure_reading(self, valve: ValveState | None) -> PressureReading | None:
        """Return the corrected reading of the chamber's pressure sensor.

        Args:
            valve: State of the valve, which contains the reading; None: the finger has no valve.

        Returns:
            The reading minus its zero offset; None: there is no pressure sensor, or no reading.
        """
        return None if valve is None else pressure_reading(valve, self.calibration)


@dataclass(frozen=True)
class Rig:
    """Gripper with one or more fingers.

    Attributes:
        name: Name of the backend.
        fingers: The fingers, in the order of their touch in an observation.
        gripper: The jaws and the lift.
        clock: Clock of the rig; in simulation, waiting on it advances the world.
        limits: Limits that apply to commands.
        close: Function that brings everything to its safe state and releases it; called on every
            exit path.
        host_timeout: Time without a call after which the devices stop by themselves, s; inf: the
            world waits, as in simulation and replay.
        length: Time from the first to the last cycle, s; finite for a recording only.
        randomized: Values sampled for a randomized simulated world, by name, in the files' units.
        simulated: Settings of a simulation: `mesh`, `timestep_ms`, and each of the `effects` with
            state, reason and cost.
        recorded: Names and outcome of a replayed run (`Recording.facts`); empty elsewhere.
        flags: Reasons for reduced simulation accuracy so far, by kind of model error; in a replay
            the recorded ones.
        goal: Goal of the task.
        grip_force_available: Function of the opening, m, that returns the maximum closing force on
            each finger at rest, N; None: unknown.
        workload: Function that returns the wall times and contacts of a simulation; None: a real
            rig.
        touch_is_synthetic: True if its cameras return touch in place of images (`FingerSnapshot`).
        scene: The simulated world, for scoring only; None on a real rig. Sensing and controllers
            have no access to a `Rig`.
        truth: Ground truth of an emulated world, also for scoring only; None elsewhere.
    """

    name: str
    fingers: tuple[Finger, ...]
    gripper: Gripper
    clock: Clock
    limits: CommandLimits
    close: Callable[[], None]
    host_timeout: float = math.inf
    length: float = math.inf
    randomized: Mapping[str, Any] = field(default_factory=dict)
    simulated: Mapping[str, Any] = field(default_factory=dict)
    recorded: Mapping[str, Any] = field(default_factory=dict)
    flags: Callable[[], Flags] = dict
    scene: Any = None
    truth: Callable[[], Mapping[str, Any]] | None = None
    goal: TaskGoal = field(default_factory=TaskGoal)
    grip_force_available: Callable[[float], float] | None = None
    workload: Callable[[], Workload] | None = None
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
        """Return the corrected pressure readings of all fingers.

        Args:
            valves: The states of all valves, in the order of their fingers.

        Returns:
            One reading per finger; None without a pressure sensor.
        """
        states = iter(valves)
        return tuple(
            finger.pressure_reading(next(states, None) if finger.valve is not None else None)
            for finger in self.fingers
        )


def make_fingers(
    names: tuple[str, ...],
    designs: tuple[SensorDesign, ...],
    cameras: tuple[CameraDevice, ...],
    valves: tuple[Valve, ...] = (),
    calibrations: tuple[Calibration | None, ...] = (),
) -> tuple[Finger, ...]:
    """Create fingers from their parts, all in the same order. Valves and calibrations are one per
    finger, or none."""
    empty = (None,) * len(names)
    parts = zip(names, designs, cameras, valves or empty, calibrations or empty, strict=True)
    return tuple(Finger(*part) for part in parts)
