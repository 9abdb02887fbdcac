"""`DynamixelGripper`: jaw servos (and a lift) in current-based position mode, in SI units.

The bus and its traps: `mjtactile.devices.dynamixel.bus`; one servo's registers and recipe:
`...dynamixel.servo`.
"""

from __future__ import annotations

import contextlib
import logging
import math
import threading
from dataclasses import replace

from mjtactile.core import scaled_clock
from mjtactile.core.errors import DeviceError
from mjtactile.core.signals import deferred
from mjtactile.core.types import Command, GripperState
from mjtactile.devices.dynamixel.bus import BusError, DynamixelBus
from mjtactile.devices.dynamixel.jaw_kinematics import JawGeometry, find_model
from mjtactile.devices.dynamixel.servo import (
    STATE_SIZE,
    STATE_START,
    Servo,
    ServoFault,
    ServoReport,
    read_report,
)
from mjtactile.devices.dynamixel.servo_models import TICKS_PER_RAD
from mjtactile.rig.command_limits import UNLIMITED
from mjtactile.rig.file import BusConfig, GripperConfig, LiftConfig
from mjtactile.rig.play_compensation import PlayCompensation

__all__ = ["DynamixelGripper", "ServoFault", "ServoReport", "read_report"]
_log = logging.getLogger(__name__)
# goal current, velocity, profile acceleration, profile velocity, goal position: one block
_GOAL_START = 102
_LEAD_TIME = 0.1  # maximum lead of a closing jaw's goal, s at the largest speed
# unanswered queries in a row before a servo counts as lost: one cycle of two, and another
_FAILURES_MAX = 3
_FIRST_FORCE_FRACTION = 0.25  # fraction of the largest force until a command sets another limit
_SILENCE_IDLE = 30.0  # allowed silence before the first command, s (references are being taken)


class DynamixelGripper:
    """Connected jaws of a rig file's gripper, holding their position with torque on.

    Raises DeviceError at connect when a servo does not answer or differs from the file's model. It
    also raises it for a servo that cannot limit its force or has a latched error. Further causes
    are a position outside the gripper's range and a setting that is not kept.
    """

    def __init__(
        self, bus: BusConfig, gripper: GripperConfig, lift: LiftConfig, *, source: str = "rig"
    ):
        self.geometry = JawGeometry(gripper, source)
        self.config = gripper
        self._play = PlayCompensation(gripper.backlash)
        self._bus_config = bus
        self._lift_config = lift
        lift_model = find_model(lift.model, source, "lift.model") if lift.kind == "servo" else None
        self._lift_zero_ticks = 0
        self._lift_goal = 0.0
        self._limits = replace(
            UNLIMITED, opening=gripper.opening, force=gripper.force_max, lift=(0.0, lift.travel)
        )
        self._sent = Command(gripper.opening[1], _FIRST_FORCE_FRACTION * gripper.force_max)
        self._closed = scaled_clock.Event()
        self._lock = threading.RLock()
        self._last_call = scaled_clock.monotonic()
        self._silence = _SILENCE_IDLE
        self._state_time = self._bus_time = self._sent_time = -math.inf
        self._request_time: float | None = None  # s; the answers wait in the port's buffer
        self._poll_index = 0
        self._commanded = False
        self._keeper = threading.Thread(target=self._keep_alive, name="dynamixel", daemon=True)
        self.bus = DynamixelBus(bus.port, bus.baud, reply_timeout=bus.reply_timeout)
        self._jaws = {
            s.config.id: Servo(self.bus, s.config.id, s.model) for s in self.geometry.servos
        }
        self._servos = dict(self._jaws)
        if lift_model is not None:
            self._servos[lift.id] = Servo(self.bus, lift.id, lift_model)
        try:
            self._prepare()
            self._refresh()
        except BaseException:
            self.close(quiet=True)
            raise
        self._keeper.start()

    def _prepare(self) -> None:
        """Check all servos, then turn their torque on."""
        for servo in self._servos.values():
            servo.check_identity(self._bus_config.baud)
        for servo in self._servos.values():
            servo.prepare(
                lambda ticks, s=servo: self._find_place(s, ticks),
                self._current_limit(servo),
                self._first_current,
                self._p_gain(servo),
            )

    # -- the rig's protocol

    def request_state(self) -> None:
        """Request the state of all servos, for `state`. Raises DeviceError."""
        with self._lock:
            self._last_call = scaled_clock.monotonic()
            self._request_all()

    def state(self) -> GripperState:
        """Return the state from the replies to `request_state`, which is called if necessary.

        Raises DeviceError when a servo is lost, ServoFault when one reports a hardware error.
        """
        with self._lock:
            self._last_call = scaled_clock.monotonic()
            self._refresh()
            if not self._commanded:
                self._poll_one()
            self._commanded = False
            for servo in self._servos.values():
                servo.raise_fault(_FAILURES_MAX)
            ticks = {i: s.ticks for i, s in self._jaws.items()}
            return GripperState(
                opening=self._play.opening(self.geometry.opening(ticks)),
                speed=self.geometry.speed(ticks, {i: s.rad_per_s for i, s in self._jaws.items()}),
                effort=self.geometry.effort(ticks, {i: s.current for i, s in self._jaws.items()}),
                lift_height=self._lift_height(),
                time=self._state_time,
                age=scaled_clock.monotonic() - self._state_time,
            )

    def command(self, command: Command) -> Command:
        """Send goals to all servos in one packet; return the sent command, after limits.

        A servo rounds to its own position unit (0.02 mm here). The returned command is not rounded:
        otherwise a controller with steps below half a unit would never move. While closing, no
        servo's goal leads its position by more than the jaw's travel in 0.1 s. A servo that moves
        on to its goal after the loss of the host stops there. Raises DeviceError when the port is
        lost.
        """
        with self._lock:
            self._arm()
            self._last_call = scaled_clock.monotonic()
            sent = self._sent = self._limits.clip(command.completed(self._sent))
            low, high = self.config.opening
            goals = self.geometry.goals(
                min(max(self._play.motor_goal(sent.opening), low), high),
                {i: s.ticks for i, s in self._jaws.items()},
                _LEAD_TIME * self.config.speed_max,
            )
            for jaw in self.geometry.servos:
                servo = self._jaws[jaw.config.id]
                servo.goal_ticks = goals[servo.id]
                servo.goal_current_units = min(
                    jaw.current_units(self._force_limit, servo.ticks), servo.current_limit_units
                )
            self._command_lift(sent.lift_height)
            self._send_goals()
            self._commanded = True
            self._sent_time = scaled_clock.monotonic()
            self._poll_one()  # at this point of the cycle it delays no image
            return sent

    @property
    def _force_limit(self) -> float:
        """Force limit on each jaw, N, of the last command."""
        limit = self._sent.force_limit
        assert limit is not None
        return limit

    @property
    def sent_time(self) -> float:
        """Monotonic time at which the last command was handed to the port, s."""
        return self._sent_time

    @property
    def positions(self) -> dict[int, tuple[int, float]]:
        """Last position, ticks within the gripper's turn, and current, A, of jaw servos by id."""
        turns = {jaw.config.id: jaw.revolution_offset_ticks for jaw in self.geometry.servos}
        return {i: (servo.ticks + turns[i], servo.current) for i, servo in self._jaws.items()}

    def close(self, *, quiet: bool = False) -> None:
        """Switch the torque off on every servo, even after a failure of one, then release the port.
        Later calls do nothing.

        Raises DeviceError naming the servos whose torque could not be switched off, unless `quiet`
        (then it is logged).
        """
        if self._closed.is_set():
            return
        self._closed.set()
        with deferred():
            self._finish(quiet)

    def _finish(self, quiet: bool) -> None:
        with self._lock:
            failed = {
                servo.id: reason
                for servo in self._servos.values()
                if (reason := servo.torque_off())
            }
            self.bus.close()
        if self._keeper.is_alive():
            self._keeper.join()
        if failed:
            text = (
                f"torque of servo {', '.join(map(str, failed))} on {self.bus.name} could not be "
                f"switched off ({'; '.join(failed.values())}); its bus watchdog stops it. Cut its "
                "power before touching it"
            )
            _log.error(text)
            if not quiet:
                raise DeviceError(text)

    # -- connecting

    def _find_place(self, servo: Servo, ticks: int) -> None:
        """Determine the servo's turn from the possible range of its jaw."""
        if servo.id not in self._jaws:
            self._lift_zero_ticks = ticks  # the lift's height is relative to its current position
            return
        jaw = next(j for j in self.geometry.servos if j.config.id == servo.id)
        low, high = (limit / len(self._jaws) for limit in self.config.opening)
        try:
            jaw.set_revolution_offset(ticks, low, high)
        except ValueError as error:
            raise DeviceError(
                f"{servo.where} stands at {ticks} ticks: {error} turn puts its jaw within "
                f"{low * 1e3:g} to {high * 1e3:g} mm; is its horn mounted as the rig file "
                "specifies?"
            ) from error

    def _p_gain(self, servo: Servo) -> int | None:
        if servo.id in self._jaws:
            return next(
                j.config.position_p_gain for j in self.geometry.servos if j.config.id == servo.id
            )
        return None

    def _current_limit(self, servo: Servo) -> int:
        """Return the maximum goal current of a servo in model units."""
        if servo.id in self._jaws:
            jaw = next(j for j in self.geometry.servos if j.config.id == servo.id)
            low, high = (limit / len(self._jaws) for limit in self.config.opening)
            return jaw.current_limit(self.config.force_max, low, high)
        units = (
            self._lift_config.torque_max / servo.model.torque_per_A / servo.model.ampere_per_unit
        )
        return int(min(max(1, units), servo.model.current_max_units))

    def _first_current(self, servo: Servo) -> int:
        """Return the current limit until the first command: a lift must carry its gripper."""
        if servo.id in self._jaws:
            jaw = next(j for j in self.geometry.servos if j.config.id == servo.id)
            return jaw.current_units(self._force_limit, servo.ticks)
        return servo.current_limit_units

    # -- every cycle

    def _request_all(self) -> None:
        """Request the state of all servos in one transaction, unless a request is pending."""
        if self._request_time is None:
            self._bus_time = requested = scaled_clock.monotonic()
            self.bus.request_many(
                list(self._servos), STATE_START, STATE_SIZE, fast=self._bus_config.fast_sync
            )
            self._request_time = requested

    def _refresh(self) -> None:
        """Collect the replies of all servos and record the errors of each."""
        self._request_all()
        requested = self._request_time
        self._request_time = None
        replies, failures = self.bus.answers(
            list(self._servos), STATE_SIZE, fast=self._bus_config.fast_sync
        )
        for servo_id, reply in replies.items():
            self._servos[servo_id].accept(reply)
        lost = [
            error
            for servo_id, error in failures.items()
            if not self._reread(self._servos[servo_id], error)
        ]
        # Servos measure after the request, so that the reported age is an upper bound.
        self._state_time = self._state_time if lost or requested is None else requested

    def _reread(self, servo: Servo, error: BusError) -> bool:
        """Query a servo again, once, after a lost or damaged reply; return True if it answered."""
        servo.failures = servo.failures + 1
        servo.last_failure = error.reason
        if servo.failures >= _FAILURES_MAX:
            return False
        try:
            servo.accept(self.bus.read(servo.id, STATE_START, STATE_SIZE, again=True))
        except BusError as second:
            if second.reason == "lost":
                raise
            servo.failures = servo.failures + 1
            servo.last_failure = second.reason
            return False
        return True

    def _poll_one(self) -> None:
        """Query one servo per call, in turn, for values outside of the state block."""
        self._poll_index += 1
        servo = list(self._servos.values())[self._poll_index % len(self._servos)]
        if not servo.failures:  # a silent servo has already delayed the cycle
            with contextlib.suppress(BusError):
                servo.poll()

    def _send_goals(self) -> None:
        """Write goal current, velocity, profile and position in one sync write."""
        self._bus_time = scaled_clock.monotonic()
        blocks = {
            s.id: s.goal_current_units.to_bytes(2, "little")
            + bytes(12)
            + s.goal_ticks.to_bytes(4, "little", signed=True)
            for s in self._servos.values()
        }
        self.bus.write_many(_GOAL_START, blocks)

    def _arm(self) -> None:
        """Set bus watchdogs and host timeout to the rig file's values at the first command."""
        if self._silence != self._bus_config.host_timeout:
            for servo in self._servos.values():
                servo.set_watchdog(self._bus_config.watchdog)
            self._silence = self._bus_config.host_timeout

    # -- the lift

    def _command_lift(self, height: float) -> None:
        config = self._lift_config
        self._lift_goal = height
        if config.kind == "servo":
            servo = self._servos[config.id]
            servo.goal_ticks = self._lift_zero_ticks + round(
                height / config.per_rad * TICKS_PER_RAD
            )

    def _lift_height(self) -> float:
        """Return the gripper's height above its start, m; commanded without a lift servo."""
        if self._lift_config.kind == "servo":
            servo = self._servos[self._lift_config.id]
            return (servo.ticks - self._lift_zero_ticks) / TICKS_PER_RAD * self._lift_config.per_rad
        return self._lift_goal

    # -- keep-alive

    def _keep_alive(self) -> None:
        """Reset the bus watchdog while the loop runs: see `BusConfig.host_timeout`."""
        interval = self._bus_config.watchdog / 4
        while not self._closed.wait(interval):
            with self._lock:
                now = scaled_clock.monotonic()
                if (
                    self._closed.is_set()
                    or now - self._last_call > self._silence
                    or now - self._bus_time < interval
                ):
                    continue
                # the loop's next call encounters the same fault and raises it
                with contextlib.suppress(DeviceError):
                    self._refresh()
                    self._poll_one()
