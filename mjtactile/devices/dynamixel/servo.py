"""One servo on a bus: its registers, start-up sequence, last reported state, and torque off.

Sequence and registers: https://emanual.robotis.com/docs/en/dxl/x/xm430-w350/ and .../xl330-m288/. A
servo is never rebooted from here: a reboot drops the held object. State after the loss of the host:
docs/decisions/0019-host-failure.md.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

from mjtactile.core.errors import DeviceError
from mjtactile.devices.dynamixel.bus import BusError, DynamixelBus, Reply
from mjtactile.devices.dynamixel.servo_models import (
    CURRENT_BASED_POSITION,
    EEPROM_END,
    MODEL_BY_NUMBER,
    NO_CURRENT_CONTROL,
    VELOCITY_UNIT,
    WATCHDOG_TRIPPED,
    WATCHDOG_UNIT,
    ServoModel,
    describe_hardware_error,
    require_model,
    signed,
)

# present current, velocity, position, …, voltage, temperature: one block
STATE_START = 126
STATE_SIZE = 21
# watchdog time before the first command, s: taking references can block the interpreter for longer
# than 0.1 s
WATCHDOG_IDLE = 2.0
_OFF_ATTEMPTS = _READ_ATTEMPTS = 3
REQUIRED = (  # register, required value, and effect of any other value
    ("Drive Mode", 0, "reversed, time-based, or automatic torque"),
    ("Status Return Level", 2, "silent"),
    (
        "Homing Offset",
        0,
        "with one, a tripped watchdog makes the motor turn (DynamixelSDK issue 584); zero_ticks in "
        "the rig file does the same",
    ),
    ("Startup Configuration", 0, "torque, or old settings, at power-on"),
)
_log = logging.getLogger(__name__)
_Answer = TypeVar("_Answer")


class ServoFault(DeviceError):
    """A servo has latched a hardware error and cut its torque; `servo` is its id."""

    def __init__(self, message: str, servo: int):
        super().__init__(message)
        self.servo = servo


_TRIPPED = "bus watchdog (the host was silent for too long)"


@dataclass
class Servo:
    """Last reported state of one servo, and the transactions with it alone."""

    bus: DynamixelBus
    id: int
    model: ServoModel
    ticks: int = 0
    rad_per_s: float = 0.0
    current: float = 0.0
    voltage: float = math.nan
    temperature: float = math.nan
    failures: int = 0
    last_failure: str = ""
    goal_ticks: int = 0
    goal_current_units: int = 1
    current_limit_units: int = 1
    watchdog_units: int = 0
    faults: list[str] = field(default_factory=list)
    _cleared: str = field(default="", init=False)

    @property
    def where(self) -> str:
        return f"servo {self.id} on {self.bus.name}"

    # -- registers

    def get(self, name: str) -> int:
        """Read one register. Raises BusError."""
        register = self.model.table[name]
        return self._ask(
            lambda: self.bus.read(self.id, register.address, register.size).value(0, register.size)
        )

    def _ask(self, question: Callable[[], _Answer]) -> _Answer:
        """Return the answer to a query, repeated if the reply is lost. Raises BusError."""
        for attempt in range(_READ_ATTEMPTS):
            try:
                return question()
            except BusError as error:
                if attempt == _READ_ATTEMPTS - 1 or error.reason in ("refused", "lost"):
                    raise
        raise AssertionError

    def set(self, name: str, value: int) -> None:
        """Write a register, unless it has the value already, and read it back."""
        register = self.model.table[name]
        unsigned = value & ((1 << 8 * register.size) - 1)
        if register.address < EEPROM_END and self.get(name) == unsigned:
            return
        try:
            self.bus.write(self.id, register.address, register.size, value)
        except BusError as error:
            if error.reason not in ("no reply", "corrupt", "short"):
                raise DeviceError(f"{self.where}: {name} = {value}: {error}") from error
        found = self.get(name)  # also detects if a write without an answer has arrived
        if found != unsigned:
            raise DeviceError(f"{self.where}: {name} was set to {value} but reads {found}")

    # -- connecting

    def check_identity(self, baud: int) -> None:
        """Reject another model, a latched error, or settings that change values' meaning."""
        try:
            model_number, firmware = self._ask(lambda: self.bus.ping(self.id))
        except BusError as error:
            raise DeviceError(
                f"{self.where} does not answer ({error}): is it powered, and are id and baud "
                f"rate ({baud}) right? `mjtactile doctor` searches for servos"
            ) from error
        model = require_model(model_number, self.where)
        if model.name != self.model.name:
            raise DeviceError(
                f"{self.where} is a {model.name}, but the rig file specifies {self.model.name}"
            )
        bits = self.get("Hardware Error Status")
        if bits:
            raise ServoFault(
                f"{self.where} has latched {describe_hardware_error(bits)}: find the cause, "
                "then switch its power off and on (mjtactile never reboots it)",
                self.id,
            )
        for name, requested, meaning in REQUIRED:
            found = read_setting(self.bus, self.id, self.model, name)
            if found != requested:
                raise DeviceError(
                    f"{self.where}: {name} is {found} ({meaning}), must be {requested}; set it "
                    "with Dynamixel Wizard"
                )
        if not self.model.watchdog_stops(firmware):
            _log.warning(
                "%s has firmware %d, whose bus watchdog does not stop it: when the host is "
                "lost, it keeps its last goal and force; update it with Dynamixel Wizard",
                self.where,
                firmware,
            )

    def prepare(
        self,
        find_place: Callable[[int], None],
        limit: int,
        first_current: Callable[[Servo], int],
        p_gain: int | None,
    ) -> None:
        """Switch the torque on in current-based position mode, at rest. Limits and watchdog are set
        first: if the host is lost, the servo is off or has both. Writing the mode resets gains and
        goals.

        `find_place` receives the present position (ticks) before the torque is on. `limit` is the
        largest goal current (units) of any command. `first_current` returns the goal current until
        the first command.
        """
        self.set("Bus Watchdog", 0)  # one that has tripped makes the goals read-only
        self.set("Torque Enable", 0)
        self.set("Operating Mode", CURRENT_BASED_POSITION)
        self.current_limit_units = limit
        self.set("Current Limit", limit)  # a goal current is reset to this value
        self.set("Return Delay Time", 0)
        find_place(signed(self.get("Present Position"), 4))
        self.goal_current_units = min(first_current(self), limit)
        self._hold_position(p_gain)
        self.set("Torque Enable", 1)
        self._hold_position(p_gain)  # again, since switching the torque on may reset values

    def _hold_position(self, p_gain: int | None) -> None:
        if p_gain is not None:
            self.set("Position P Gain", p_gain)
        self.set("Profile Acceleration", 0)
        self.set("Profile Velocity", 0)  # the control loop limits the speed
        self.set("Goal Current", self.goal_current_units)
        self.ticks = self.goal_ticks = signed(self.get("Present Position"), 4)
        self.set("Goal Position", self.goal_ticks)
        self.set_watchdog(WATCHDOG_IDLE)

    def set_watchdog(self, seconds: float) -> None:
        """Set the duration of silence on the bus, s, after which the servo stops by itself."""
        self.watchdog_units = max(1, round(seconds / WATCHDOG_UNIT))
        self.set("Bus Watchdog", self.watchdog_units)

    # -- every cycle

    def accept(self, reply: Reply) -> None:
        """Store one reply to a read of the state block."""
        self.failures = 0
        self.current = signed(reply.value(0, 2), 2) * self.model.ampere_per_unit
        self.rad_per_s = signed(reply.value(2, 4), 4) * VELOCITY_UNIT
        self.ticks = signed(reply.value(6, 4), 4)
        self.voltage = 0.1 * reply.value(18, 2)
        self.temperature = float(reply.value(20, 1))
        if reply.alert:
            self.note_alert()

    def note_alert(self) -> None:
        """Query the hardware error as soon as the alert bit is set."""
        try:
            text = describe_hardware_error(self.get("Hardware Error Status"))
        except BusError as error:
            text = f"an alert that could not be read ({error.reason})"
        self._note_fault(text)

    def poll(self) -> None:
        """Check the watchdog, which the state block does not contain.

        It may have tripped, or an unnoticed restart may have reset it to 0. A tripped watchdog is
        cleared. Until then the servo accepts no goal, and the gripper could not retreat. The fault
        is then raised once, so that later states verify the retreat. Raises BusError.
        """
        register = self.model.table["Bus Watchdog"]
        reply = self.bus.read(self.id, register.address, register.size)
        if reply.alert:
            self.note_alert()
        elif reply.value(0, 1) == WATCHDOG_TRIPPED:
            self._note_fault(_TRIPPED)
            for value in (0, self.watchdog_units):
                self.bus.write(self.id, register.address, register.size, value)
            self._cleared = _TRIPPED
        elif reply.value(0, 1) != self.watchdog_units:
            self._note_fault("restart (its watchdog is off: did its voltage drop?)")

    def _note_fault(self, fault: str) -> None:
        if fault not in self.faults:
            self.faults.append(fault)

    def raise_fault(self, failures_max: int) -> None:
        """Raise ServoFault, or DeviceError for `failures_max` lost replies in a row."""
        if self.faults:
            text = f"{self.where} reports {' and '.join(self.faults)}"
            self.faults = [fault for fault in self.faults if fault != self._cleared]
            self._cleared = ""
            raise ServoFault(text, self.id)
        if self.failures >= failures_max:
            raise DeviceError(f"{self.where}: {self.last_failure} {self.failures} times in a row")

    # -- ending

    def torque_off(self) -> str:
        """Switch the torque off, with retries; return "" when confirmed, else the error."""
        address = self.model.table["Torque Enable"].address
        reason = ""
        for _ in range(_OFF_ATTEMPTS):
            try:
                self.bus.write(self.id, address, 1, 0)
                return ""
            except BusError as error:
                reason = str(error)
                if error.reason in ("refused", "lost"):
                    break
            except Exception as error:  # noqa: BLE001
                # after any error, the next motor must still be switched off
                reason = f"{type(error).__name__}: {error}"
        return reason


@dataclass(frozen=True)
class ServoReport:
    """Voltage, V, temperature, degrees Celsius, latched errors, `settings` of `REQUIRED`."""

    id: int
    model: str
    firmware: int
    operating_mode: int
    voltage: float
    temperature: float
    hardware_error: str
    torque_on: bool
    settings: Mapping[str, int]


def read_report(bus: DynamixelBus, servo: int) -> ServoReport:
    """Read the properties of one servo without changing any setting. Raises BusError."""
    model_number, firmware = bus.ping(servo)
    if model_number in MODEL_BY_NUMBER:
        name = MODEL_BY_NUMBER[model_number].name
    else:
        name = NO_CURRENT_CONTROL.get(model_number, f"model {model_number}")
    error = bus.read(servo, 70, 1).value(0, 1)
    power = bus.read(servo, 144, 3)
    model = MODEL_BY_NUMBER.get(model_number)
    if model is None:
        settings = {}
    else:
        settings = {name: read_setting(bus, servo, model, name) for name, _, _ in REQUIRED}
    return ServoReport(
        servo,
        name,
        firmware,
        bus.read(servo, 11, 1).value(0, 1),
        0.1 * power.value(0, 2),
        float(power.value(2, 1)),
        describe_hardware_error(error) if error else "",
        bool(bus.read(servo, 64, 1).value(0, 1)),
        settings,
    )


def read_setting(bus: DynamixelBus, servo: int, model: ServoModel, name: str) -> int:
    """Read one register, signed where it is wide; 0 if the firmware does not have it."""
    register = model.table[name]
    for attempt in range(_READ_ATTEMPTS):
        try:
            value = bus.read(servo, register.address, register.size).value(0, register.size)
            return signed(value, register.size) if register.size == 4 else value
        except BusError as error:
            if error.reason == "refused":
                return 0
            if attempt == _READ_ATTEMPTS - 1 or error.reason == "lost":
                raise
    raise AssertionError
