"""`DynamixelGripper`: jaw servos (and a lift) in current-based position mode, in SI units.

Recipe and registers: https://emanual.robotis.com/docs/en/dxl/x/xm430-w350/ and .../xl330-m288/. The bus and its traps:
`mjtactile.devices.dynamixel_bus`. A servo is never rebooted from here: a reboot lets go of what is held.
"""

from __future__ import annotations

import contextlib
import logging
import math
import threading
import time
from dataclasses import dataclass, field

from mjtactile.devices.dynamixel_bus import BusError, DynamixelBus, Reply
from mjtactile.devices.dynamixel_tables import (
    CURRENT_BASED_POSITION,
    EEPROM_END,
    MODEL_BY_NUMBER,
    NO_CURRENT_CONTROL,
    TICKS_PER_RAD,
    VELOCITY_UNIT,
    WATCHDOG_UNIT,
    ServoModel,
    describe_hardware_error,
    require_model,
    signed,
)
from mjtactile.devices.geometry import JawGeometry, find_model
from mjtactile.devices.shutdown import signals_later
from mjtactile.errors import DeviceError
from mjtactile.rigfile import BusConfig, GripperConfig, LiftConfig
from mjtactile.types import Command, GripperState

_log = logging.getLogger(__name__)
_STATE_START, _STATE_SIZE = 126, 21  # present current, velocity, position, …, voltage, temperature: one block
_GOAL_START = 102  # goal current, velocity, profile acceleration, profile velocity, goal position: one block
_FAILURES_MAX = 3  # cycles in a row without a servo's reply before it counts as lost
_WATCHDOG_IDLE = 2.0  # s, before the first command: taking references can hold the interpreter for longer than 0.1 s
_SILENCE_IDLE = 30.0  # s without any call, before the first command (references are being taken)
_POLL_EVERY = 3  # readings: with three servos each is asked every ninth, five times a second
_OFF_ATTEMPTS = _READ_ATTEMPTS = 3


class ServoFault(DeviceError):
    """A servo has latched a hardware error and cut its torque; `servo` is its id."""

    def __init__(self, message: str, servo: int):
        super().__init__(message)
        self.servo = servo


@dataclass
class _Servo:
    """One servo as last heard of."""

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
    faults: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class ServoReport:
    """What a servo says about itself: volt, degrees Celsius, latched errors in words ("" for none)."""

    id: int
    model: str
    firmware: int
    operating_mode: int
    voltage: float
    temperature: float
    hardware_error: str
    torque_on: bool


class DynamixelGripper:
    """The jaws of a rig file's gripper, connected: ready to hold where they stand, torque on.

    Raises DeviceError at connect when a servo does not answer, is another model than the file says, cannot limit its
    force, has a latched error, stands outside the gripper's range, or does not keep a setting.
    """

    def __init__(self, bus: BusConfig, gripper: GripperConfig, lift: LiftConfig, *, source: str = "rig"):
        self.geometry = JawGeometry(gripper, source)
        self.config, self._bus_config, self._lift_config = gripper, bus, lift
        self._jaws = {s.config.id: _Servo(s.config.id, s.model) for s in self.geometry.servos}
        self._servos = dict(self._jaws)
        if lift.kind == "servo":
            self._servos[lift.id] = _Servo(lift.id, find_model(lift.model, source, "lift.model"))
        self._lift_zero_ticks = 0
        self._lift_goal, self._lift_time = 0.0, time.monotonic()
        self._closed = threading.Event()
        self._lock = threading.RLock()
        self._last_call, self._silence = time.monotonic(), _SILENCE_IDLE
        self._state_time = self._bus_time = -math.inf
        self._poll_turn = 0
        self._lost: DeviceError | None = None
        self._keeper = threading.Thread(target=self._keep_alive, name="dynamixel", daemon=True)
        self.bus = DynamixelBus(bus.port, bus.baud, reply_timeout=bus.reply_timeout)
        try:
            for servo in self._servos.values():
                self._check_identity(servo)
            for servo in self._servos.values():
                self._prepare(servo)
            self._refresh()
        except BaseException:
            self.close(quiet=True)
            raise
        self._keeper.start()

    # -- the rig's protocol --------------------------------------------------------------------------------------

    def state(self) -> GripperState:
        """Ask all servos now. Raises DeviceError when one is lost, ServoFault when one reports a hardware error."""
        with self._lock:
            self._last_call = time.monotonic()
            self._refresh()
            self._raise_trouble()
            ticks = {i: s.ticks for i, s in self._jaws.items()}
            return GripperState(
                opening=self.geometry.opening(ticks),
                speed=self.geometry.speed(ticks, {i: s.rad_per_s for i, s in self._jaws.items()}),
                effort=self.geometry.effort(ticks, {i: s.current for i, s in self._jaws.items()}),
                lift_height=self._lift_height())

    def command(self, command: Command) -> Command:
        """Send goals to all servos in one packet; returns what was sent, after limits.

        A servo rounds to its own position unit (0.02 mm here). That is not in what is returned: a controller that steps
        from the last command by less than half a unit would never get anywhere.
        A force limit of 0 leaves the servos' limits as they were. Raises DeviceError when the port is lost.
        """
        with self._lock:
            self._arm()
            self._last_call = time.monotonic()
            low, high = self.config.opening
            opening = min(max(command.opening, low), high)
            force = min(max(command.force_limit, 0.0), self.config.force_max)
            goals = self.geometry.goals(opening)
            for jaw in self.geometry.servos:
                servo = self._jaws[jaw.config.id]
                servo.goal_ticks = goals[servo.id]
                if force > 0:
                    servo.goal_current_units = jaw.current_units(force, servo.ticks)
            height = self._command_lift(command.lift_height)
            self._send_goals()
            return Command(opening, force, height, command.phase, command.memory)

    @property
    def reading_time(self) -> float:
        """Monotonic time of the last state, s."""
        return self._state_time

    def close(self, *, quiet: bool = False) -> None:
        """Torque off on every servo, also after one of them failed; then let go of the port. Later calls do nothing.

        Raises DeviceError naming the servos whose torque could not be switched off, unless `quiet` (then it is logged).
        """
        if self._closed.is_set():
            return
        self._closed.set()
        with signals_later():
            self._finish(quiet)

    def _finish(self, quiet: bool) -> None:
        with self._lock:
            failed = {servo.id: reason for servo in self._servos.values() if (reason := self._torque_off(servo))}
            self.bus.close()
        if self._keeper.is_alive():
            self._keeper.join()
        if failed:
            text = (f"torque of servo {', '.join(map(str, failed))} on {self.bus.name} could not be switched off "
                    f"({'; '.join(failed.values())}); its bus watchdog stops it. Cut its power before touching it")
            _log.error(text)
            if not quiet:
                raise DeviceError(text)

    # -- connecting ----------------------------------------------------------------------------------------------

    def _check_identity(self, servo: _Servo) -> None:
        """Refuse another model than the file's, a latched error, or settings that change what numbers mean."""
        where = f"servo {servo.id} on {self.bus.name}"
        try:
            number, _ = self.bus.ping(servo.id)
        except BusError as error:
            raise DeviceError(f"{where} does not answer ({error}): is it powered, and are id and baud rate "
                              f"({self._bus_config.baud}) right? `mjtactile doctor` looks for servos") from error
        model = require_model(number, where)
        if model.name != servo.model.name:
            raise DeviceError(f"{where} is a {model.name}, but the rig file says {servo.model.name}")
        bits = self._get(servo, "Hardware Error Status")
        if bits:
            raise ServoFault(f"{where} has latched {describe_hardware_error(bits)}: find the cause, then take its power off "
                             "and on (it is never rebooted from here)", servo.id)
        for name, wanted, meaning in (("Drive Mode", 0, "reversed or time-based"), ("Status Return Level", 2, "silent")):
            found = self._get(servo, name)
            if found != wanted:
                raise DeviceError(f"{where}: {name} is {found} ({meaning}), must be {wanted}; set it with Dynamixel Wizard")

    def _prepare(self, servo: _Servo) -> None:
        """Torque on in current-based position mode, standing still. Writing the mode resets gains and goals."""
        self._set(servo, "Bus Watchdog", 0)  # one that has tripped makes the goals read-only
        self._set(servo, "Torque Enable", 0)
        self._set(servo, "Operating Mode", CURRENT_BASED_POSITION)
        self._set(servo, "Current Limit", servo.model.current_max_units)
        self._set(servo, "Return Delay Time", 0)
        self._find_place(servo)
        self._set(servo, "Torque Enable", 1)
        gain = self._p_gain(servo)
        if gain is not None:
            self._set(servo, "Position P Gain", gain)
        self._set(servo, "Profile Acceleration", 0)
        self._set(servo, "Profile Velocity", 0)  # the control loop limits the speed
        servo.goal_current_units = self._first_current(servo)
        self._set(servo, "Goal Current", servo.goal_current_units)
        servo.ticks = servo.goal_ticks = signed(self._get(servo, "Present Position"), 4)
        self._set(servo, "Goal Position", servo.goal_ticks)
        self._set(servo, "Bus Watchdog", _watchdog_units(_WATCHDOG_IDLE))

    def _find_place(self, servo: _Servo) -> None:
        """Which turn the servo is in, from where its jaw can be."""
        ticks = signed(self._get(servo, "Present Position"), 4)
        if servo.id not in self._jaws:
            self._lift_zero_ticks = ticks  # the lift's height is measured from where it stands
            return
        jaw = next(j for j in self.geometry.servos if j.config.id == servo.id)
        low, high = (limit / len(self._jaws) for limit in self.config.opening)
        try:
            jaw.set_turn_offset(ticks, low, high)
        except ValueError as error:
            raise DeviceError(
                f"servo {servo.id} on {self.bus.name} stands at {ticks} ticks: {error} turn puts its jaw within "
                f"{low * 1e3:g} to {high * 1e3:g} mm; is its horn mounted as the rig file says?") from error

    def _p_gain(self, servo: _Servo) -> int | None:
        if servo.id in self._jaws:
            return next(j.config.position_p_gain for j in self.geometry.servos if j.config.id == servo.id)
        return None

    def _first_current(self, servo: _Servo) -> int:
        """Enough to hold still until the first command: a lift carries its hand, jaws are gentle."""
        if servo.id in self._jaws:
            jaw = next(j for j in self.geometry.servos if j.config.id == servo.id)
            return jaw.current_units(0.25 * self.config.force_max, servo.ticks)
        units = self._lift_config.torque_max / servo.model.torque_per_A / servo.model.ampere_per_unit
        return int(min(max(1, units), servo.model.current_max_units))

    def _get(self, servo: _Servo, name: str) -> int:
        """Read one register; reading again changes nothing, so a lost reply is asked for again."""
        register = servo.model.table[name]
        for attempt in range(_READ_ATTEMPTS):
            try:
                return self.bus.read(servo.id, register.address, register.size).value(0, register.size)
            except BusError as error:
                if attempt == _READ_ATTEMPTS - 1 or error.reason in ("refused", "lost"):
                    raise
        raise AssertionError

    def _set(self, servo: _Servo, name: str, value: int) -> None:
        """Write a register and read it back. EEPROM is spared when it has the value already."""
        register = servo.model.table[name]
        unsigned = value & ((1 << 8 * register.size) - 1)
        if register.address < EEPROM_END and self._get(servo, name) == unsigned:
            return
        try:
            self.bus.write(servo.id, register.address, register.size, value)
        except BusError as error:
            if error.reason not in ("no reply", "corrupt", "short"):
                raise DeviceError(f"servo {servo.id} on {self.bus.name}: {name} = {value}: {error}") from error
        found = self._get(servo, name)  # also tells whether a write whose answer was lost has arrived
        if found != unsigned:
            raise DeviceError(f"servo {servo.id} on {self.bus.name}: {name} was set to {value} but reads {found}")

    # -- every cycle ---------------------------------------------------------------------------------------------

    def _refresh(self) -> None:
        """Read all servos in one transaction and note what is wrong with which."""
        self._bus_time = time.monotonic()
        try:
            replies, failures = self.bus.read_many(list(self._servos), _STATE_START, _STATE_SIZE, fast=self._bus_config.fast_sync)
        except BusError as error:
            self._lost = error
            raise
        for servo_id, reply in replies.items():
            self._take(self._servos[servo_id], reply)
        for servo_id, error in failures.items():
            servo = self._servos[servo_id]
            servo.failures, servo.last_failure = servo.failures + 1, error.reason
        self._state_time = time.monotonic() if not failures else self._state_time
        self._poll_one()

    def _take(self, servo: _Servo, reply: Reply) -> None:
        servo.failures = 0
        servo.current = signed(reply.value(0, 2), 2) * servo.model.ampere_per_unit
        servo.rad_per_s = signed(reply.value(2, 4), 4) * VELOCITY_UNIT
        servo.ticks = signed(reply.value(6, 4), 4)
        servo.voltage, servo.temperature = 0.1 * reply.value(18, 2), float(reply.value(20, 1))
        if reply.alert:
            self._note_alert(servo)

    def _note_alert(self, servo: _Servo) -> None:
        """The alert bit is set: ask at once which error it is."""
        try:
            text = describe_hardware_error(self._get(servo, "Hardware Error Status"))
        except BusError as error:
            text = f"an alert that could not be read ({error.reason})"
        if text not in servo.faults:
            servo.faults.append(text)

    def _poll_one(self) -> None:
        """Now and then ask one servo for what the block does not hold: a brown-out resets a servo in silence."""
        self._poll_turn += 1
        if self._poll_turn % _POLL_EVERY:
            return
        servo = list(self._servos.values())[self._poll_turn // _POLL_EVERY % len(self._servos)]
        with contextlib.suppress(BusError):
            block = self.bus.read(servo.id, 64, 35)  # 64 torque, 70 hardware error, 98 bus watchdog
            if block.value(6, 1):
                self._note_alert(servo)
            elif block.value(34, 1) == 0xFF:
                servo.faults.append("bus watchdog (the host was silent for too long)")
            elif not block.value(0, 1):
                servo.faults.append("restart (its torque is off: did its voltage drop?)")

    def _raise_trouble(self) -> None:
        for servo in self._servos.values():
            if servo.faults:
                raise ServoFault(f"servo {servo.id} on {self.bus.name} reports {' and '.join(servo.faults)}", servo.id)
            if servo.failures >= _FAILURES_MAX:
                raise DeviceError(f"servo {servo.id} on {self.bus.name}: {servo.last_failure} {servo.failures} times in a row")

    def _send_goals(self) -> None:
        """One sync write of goal current, velocity, profile and position; goals are never written partly."""
        self._bus_time = time.monotonic()
        blocks = {s.id: s.goal_current_units.to_bytes(2, "little") + bytes(12) + s.goal_ticks.to_bytes(4, "little", signed=True)
                  for s in self._servos.values()}
        self.bus.write_many(_GOAL_START, blocks)

    def _arm(self) -> None:
        """At the first command, the bus watchdogs get the rig file's time, and a silent host is given no more than that."""
        if self._silence != self._bus_config.host_timeout:
            for servo in self._servos.values():
                self._set(servo, "Bus Watchdog", _watchdog_units(self._bus_config.watchdog))
            self._silence = self._bus_config.host_timeout

    # -- the lift ------------------------------------------------------------------------------------------------

    def _command_lift(self, height: float) -> float:
        config = self._lift_config
        self._lift_height()  # brings an imaginary lift up to now
        height = min(max(height, 0.0), config.travel)
        self._lift_goal = height
        if config.kind == "servo":
            servo = self._servos[config.id]
            servo.goal_ticks = self._lift_zero_ticks + round(height / config.per_rad * TICKS_PER_RAD)
        return height

    def _lift_height(self) -> float:
        """Height of the hand above where it started, m. Without a lift: the height asked for, as the rig file says."""
        if self._lift_config.kind == "servo":
            servo = self._servos[self._lift_config.id]
            return (servo.ticks - self._lift_zero_ticks) / TICKS_PER_RAD * self._lift_config.per_rad
        return self._lift_goal

    # -- staying alive, and ending -------------------------------------------------------------------------------

    def _keep_alive(self) -> None:
        """Feed the bus watchdog between the loop's calls, but only while the loop lives: see `BusConfig.host_timeout`."""
        interval = self._bus_config.watchdog / 4
        while not self._closed.wait(interval):
            with self._lock:
                now = time.monotonic()
                if self._closed.is_set() or now - self._last_call > self._silence or now - self._bus_time < interval:
                    continue
                with contextlib.suppress(DeviceError):  # the loop's next call meets the same trouble and raises it
                    self._refresh()

    def _torque_off(self, servo: _Servo) -> str:
        """Switch one servo's torque off, trying again on a lost reply; "" when it was confirmed, else what went wrong."""
        address, reason = servo.model.table["Torque Enable"].address, ""
        for _ in range(_OFF_ATTEMPTS):
            try:
                self.bus.write(servo.id, address, 1, 0)
                return ""
            except BusError as error:
                reason = str(error)
                if error.reason in ("refused", "lost"):
                    break
            except Exception as error:  # noqa: BLE001  # whatever it is, the next motor must still be switched off
                reason = f"{type(error).__name__}: {error}"
        return reason

    def reports(self) -> list[ServoReport]:
        """What each servo says about itself, for `mjtactile doctor`."""
        with self._lock:
            return [read_report(self.bus, servo.id) for servo in self._servos.values()]


def _watchdog_units(seconds: float) -> int:
    return max(1, round(seconds / WATCHDOG_UNIT))


def read_report(bus: DynamixelBus, servo: int) -> ServoReport:
    """Ask one servo about itself. Changes nothing. Raises BusError."""
    number, firmware = bus.ping(servo)
    name = MODEL_BY_NUMBER[number].name if number in MODEL_BY_NUMBER else NO_CURRENT_CONTROL.get(number, f"model {number}")
    error = bus.read(servo, 70, 1).value(0, 1)
    power = bus.read(servo, 144, 3)
    return ServoReport(servo, name, firmware, bus.read(servo, 11, 1).value(0, 1), 0.1 * power.value(0, 2),
                       float(power.value(2, 1)), describe_hardware_error(error) if error else "",
                       bool(bus.read(servo, 64, 1).value(0, 1)))
