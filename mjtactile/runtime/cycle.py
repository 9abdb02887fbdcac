"""The control cycle, step by step: images, touch, observation, command. The control loop and the
Gymnasium environment step the same one."""

from __future__ import annotations

import math
import time as wall
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from mjtactile.core.errors import DeviceError, InputError, SimulationError
from mjtactile.core.status import Status, StatusCode
from mjtactile.core.types import Command, GripperState, Image, Observation, Touch, ValveState
from mjtactile.recording.observer import Observer
from mjtactile.rig.finger import Rig
from mjtactile.runtime.perception_threads import unknown_touch
from mjtactile.runtime.references import patient_read
from mjtactile.runtime.set_down import SetDown
from mjtactile.runtime.supervisor import Supervisor

# Timeout of perception and controller in a world that waits, s; on a real rig it is a fraction of
# host_timeout
WAIT_TIME = 10.0
# 0.1 s of 0.25 s, so that the devices never treat the loop as stopped
_PERCEPTION_FRACTION = 0.4
_UNKNOWN_GRIPPER = GripperState(math.nan, math.nan, math.nan, math.nan)


@dataclass(frozen=True, eq=False)
class Cycle:
    """Recorded data of one cycle; memories contain serializable entries only."""

    time: float
    images: tuple[Image, ...]
    touch: tuple[Touch, ...]
    gripper: GripperState
    valves: tuple[ValveState, ...]
    requested: Command
    sent: Command
    camera_ms: float
    perception_ms: float
    controller_ms: float
    state: str = "running"
    reason: str = ""
    last: Command | None = None


class Perceiving(Protocol):
    """Sensing pipelines of all fingers (`Perceivers`, `PerceptionPool`)."""

    def perceive(
        self, images: Any, now: float, timeout: float, readings: Any
    ) -> tuple[Touch, ...]: ...


@dataclass(eq=False)
class ControlCycle:
    """State of a rig between two commands, with its newest images, touch and device states.

    A cycle consists of `read_sensors`, `observe`, and `send` with the requested command. Without
    images the force is unknown. Any other failure makes the supervisor take over.

    Attributes:
        last: The previous command.
        now: Time of the images on the rig's clock, s.
        failure: The error that caused the retreat, raised after it; None: no error, or a device
            fault.
        left_out: Entries of `Command.memory` that cannot be recorded, as reported once.
        set_down: Decision about the set-down of the object.
    """

    rig: Rig
    perceptions: Perceiving
    supervisor: Supervisor
    observer: Observer
    last: Command
    now: float
    images: tuple[Image, ...] = ()
    touch: tuple[Touch, ...] = ()
    valves: tuple[ValveState, ...] = ()
    gripper: GripperState = _UNKNOWN_GRIPPER
    failure: Exception | None = None
    camera_ms: float = 0.0
    perception_ms: float = 0.0
    left_out: tuple[str, ...] = ()
    set_down: SetDown = field(default_factory=SetDown)
    _blind: str = field(default="", init=False)
    _seen: float = field(default=0.0, init=False)

    @classmethod
    def start(
        cls, rig: Rig, perceptions: Perceiving, supervisor: Supervisor, observer: Observer
    ) -> ControlCycle:
        """Create the first cycle, in which jaws and lift hold their current positions."""
        state = rig.gripper.state()
        last = Command(opening=state.opening, force_limit=None, lift_height=state.lift_height)
        now = rig.clock.now()
        supervisor.arm(now)
        set_down = SetDown(rig.goal.place_height)
        return cls(rig, perceptions, supervisor, observer, last, now, set_down=set_down)

    def read_sensors(self) -> None:
        """Read the newest images and the valve states. A simulated world is paused meanwhile."""
        start = wall.perf_counter()
        self._blind = self._take_images()
        self._seen = wall.perf_counter()
        self.camera_ms = 1e3 * (self._seen - start)
        self.now = self.rig.clock.now()
        self.attempt(self.rig.gripper.request_state)
        if not self.attempt(self._read_valves):
            self.valves = tuple(
                replace(valve, gauge_pressure=None, time=math.nan, age=math.nan)
                for valve in self.valves
            )
        self.attempt(self.observer.on_images)

    def observe(self) -> Observation:
        """Estimate the touch from the images and return the controller's observation."""
        if self._blind:
            self._touch_unknown(Status(StatusCode.NO_IMAGE, self._blind))
        elif not self.attempt(self._perceive):
            self._touch_unknown(Status(StatusCode.PERCEPTION_TIMEOUT, self.supervisor.reason))
        if not self.attempt(self._read_gripper):
            self.gripper = _UNKNOWN_GRIPPER
        self.attempt(lambda: self.observer.on_touches(self.now, self.touch))
        self.perception_ms = 1e3 * (wall.perf_counter() - self._seen)
        rig = self.rig
        return Observation(
            self.now, rig.period, self.touch, self.gripper, self.valves, self.last, rig.goal
        )

    def send(self, requested: Command) -> Command:
        """Send the command `requested` after supervisor and limits, and return the sent command.

        If no device responds, it is the previous command, and the devices' own watchdogs act. A
        command that cannot be executed starts the retreat.
        """
        try:
            self.last = self._send(requested)
        except SimulationError:  # without a world, the object cannot be set down
            raise
        except DeviceError as error:
            self.supervisor.latch(str(error), self.now, "the last command was not carried out")
        except Exception as error:  # noqa: BLE001  # values that a controller made past their checks
            retreats = self.supervisor.state in ("safe", "latched")
            self.start_retreat(error)
            if not retreats:
                return self.send(self.last)
            self.supervisor.latch(str(error), self.now, "the last command was not carried out")
        self.set_down.watch(self.touch, self.last)
        return self.last

    def start_retreat(self, error: Exception) -> None:
        """Start the retreat because of `error`, unless it is already in progress.

        The error is raised after the retreat.
        """
        if self.supervisor.state != "safe":
            self.failure = error
            self.supervisor.make_safe(str(error), self.now)

    def attempt(self, act: Callable[[], None]) -> bool:
        """Run a function that may fail; returns True on success.

        A failure starts the retreat, which sets the held object down instead of dropping it.
        """
        try:
            act()
        except SimulationError:  # without a world, the object cannot be set down
            raise
        except DeviceError as error:
            self.supervisor.make_safe(str(error), self.now)
        except Exception as error:  # noqa: BLE001
            # includes errors in this package or in an observer
            self.start_retreat(error)
        else:
            return True
        return False

    def _take_images(self) -> str:
        """Read the images and return the camera error, or "". The first images are mandatory."""
        rig = self.rig
        if not self.images:
            first = (patient_read(camera, rig.clock, rig.period) for camera in rig.cameras)
            self.images = tuple(first)
            return ""
        try:
            self.images = tuple(camera.read() for camera in rig.cameras)
        except DeviceError as error:
            return str(error)
        return ""

    def _read_valves(self) -> None:
        self.valves = tuple(valve.state() for valve in self.rig.valves)

    def _read_gripper(self) -> None:
        self.gripper = self.rig.gripper.state()

    def _perceive(self) -> None:
        timeout = min(_PERCEPTION_FRACTION * self.rig.host_timeout, WAIT_TIME)
        readings = self.rig.readings(self.valves)
        self.touch = self.perceptions.perceive(self.images, self.now, timeout, readings)

    def _touch_unknown(self, status: Status) -> None:
        self.touch = tuple(unknown_touch(image, self.now, status) for image in self.images)

    def _send(self, requested: Command) -> Command:
        rig = self.rig
        requested = requested.checked()
        _check_pressures(rig, requested)
        allowed = self.supervisor.decide(
            self.now,
            requested,
            self.last,
            self.touch,
            self.valves,
            _measured(self.gripper.lift_height),
            _measured(self.gripper.opening),
        )
        last = _rate_limit_start(rig, allowed, self.last, self.valves)
        limited = rig.limits.apply(allowed, last, rig.period)
        sent = rig.gripper.command(limited)
        self.attempt(lambda: _send_pressures(rig, limited, self.last))
        kept = (allowed.phase, allowed.memory, allowed.reason)
        if (sent.phase, sent.memory, sent.reason) == kept:
            return sent
        return replace(sent, phase=allowed.phase, memory=allowed.memory, reason=allowed.reason)


def _measured(value: float) -> float | None:
    """Return a value of the gripper's state, or None if it is unknown."""
    return value if math.isfinite(value) else None


def _check_pressures(rig: Rig, requested: Command) -> None:
    """Raise InputError if the rig has no controllable valve with a pressure sensor, or the number
    of pressures differs from that of its fingers."""
    if requested.gauge_pressure is None:
        return
    if rig.limits.pressure is None:
        message = (
            f"rig {rig.name!r} has no controllable valves with a pressure sensor: the "
            "pressure in its fingers cannot be changed"
        )
        raise InputError(message, source="Command", field="gauge_pressure")
    if len(requested.gauge_pressure) != len(rig.fingers):
        message = f"{len(requested.gauge_pressure)} pressures for {len(rig.fingers)} fingers"
        raise InputError(message, source="Command", field="gauge_pressure")


def _rate_limit_start(
    rig: Rig, requested: Command, last: Command, valves: Sequence[ValveState]
) -> Command:
    """Return the previous command, with pressures from which the rate limits start.

    The first pressures start at the sensor readings, or without a reading at the requested
    value.
    """
    if requested.gauge_pressure is None or last.gauge_pressure is not None:
        return last
    pairs = zip(requested.gauge_pressure, rig.readings(valves), strict=True)
    shown = tuple(valve if gauge is None else gauge.gauge_pressure for valve, gauge in pairs)
    return replace(last, gauge_pressure=shown)


def _send_pressures(rig: Rig, command: Command, last: Command) -> None:
    """Make each finger's valve follow a command, or stop its control when no pressure is commanded.

    Raises DeviceError if a valve does not respond.
    """
    if command.gauge_pressure is None and last.gauge_pressure is None:
        return
    pressures = command.gauge_pressure or (None,) * len(rig.fingers)
    for finger, pressure in zip(rig.fingers, pressures, strict=True):
        finger.regulate_pressure(pressure)
