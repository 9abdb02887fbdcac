"""One emulated X-series servo: its registers, its rules, and its requested drive.

Each rule names its heading in the e-manual, or another source. The pages are
https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/ and .../xm430-w350/. The tables are in
`mjtactile.emulator.control_table`.
"""

from __future__ import annotations

import math

from mjtactile.core import scaled_clock
from mjtactile.emulator import control_table as ct
from mjtactile.emulator.motor_profile import FAR, MotorDrive
from mjtactile.emulator.registers import RANGE_ERROR, RESULT_FAIL, TRIPPED
from mjtactile.emulator.servo_registers import ServoRegisters

_RPM_UNIT = 0.229 * 2 * math.pi / 60  # rad/s
_ACCELERATION_UNIT = 214.577 * 2 * math.pi / 3600  # rad/s^2: "Profile Acceleration(108)", rev/min^2
_PWM_FULL = 885
_OVERHEATING = 0x04
_OVERLOAD = 0x20
_REBOOT_TIME = 0.3  # silence after a restart, s
_NO_LOAD_SPEED = 6.0  # speed of a shaft without load, rad/s, about 60 rev/min
# C; K of final rise at the largest current; s
_AMBIENT = 25.0
_HEATING = 45.0
_COOLING_TIME = 60.0
# overload error: fraction of the largest current, and its duration, s
_OVERLOAD_FRACTION = 0.6
_OVERLOAD_TIME = 3.0
TRIPS = ("brake", "limp")
"""Reactions to a tripped watchdog. The manual states that the servo "will stop" (Bus Watchdog(98)).
Users observed no torque in modes 0 and 16, and a held position in the others ("brake"). "limp": no
torque in any mode."""
_FREE_MODES = (0, 16)


class EmulatedServo(ServoRegisters):
    """Servo that starts at the shaft angle `angle`, rad.

    `torque_fraction` is the excess of torque per ampere over the data sheet. `firmware` None is the
    newest. `trip` is one of `TRIPS`. Times are monotonic, s. Thread-safe.
    """

    def __init__(
        self,
        servo_id: int,
        model: str,
        *,
        angle: float = 0.0,
        baud: int = 1_000_000,
        torque_fraction: float = 0.0,
        firmware: int | None = None,
        trip: str = "brake",
    ):
        super().__init__(model, angle, firmware)
        self._current_max = self._table.fields["Current Limit"].default * self.model.ampere_per_unit
        self._torque_per_A = (1 + torque_fraction) * self.model.torque_per_A  # actual value, N m/A
        self._trip = trip
        self._temperature = _AMBIENT
        self._overload_time = 0.0
        self._silent_until = 0.0
        self.speed = 0.0
        self.current = 0.0
        self.stop_time: float | None = None
        """Time of the last bus watchdog trip (monotonic), s; None without a trip."""
        self._defaults(True)
        self.set("ID", servo_id)
        self.set("Baud Rate", ct.BAUDS.index(baud))
        self._power_up()

    def _power_up(self) -> None:
        """Reset RAM to its defaults, clear the turn count and switch torque off.

        "Startup Configuration(60)" may override this.
        """
        self._defaults(False)
        self._registered = None
        self.set("Present Input Voltage", round(10 * self._table.volts))
        self.set("Backup Ready", int(bool(self._backup)))
        self._overload_time = 0.0
        self._reset_turns()
        self._mode_defaults()
        startup = self.get("Startup Configuration")
        if startup & 0x02:
            self._restore(ram=True)
        if startup & 0x01:
            self.set("Torque Enable", 1)
        self._publish()

    # -- instructions

    def is_silent(self, now: float) -> bool:
        return now < self._silent_until

    def reboot(self, now: float) -> None:
        """Restart: clear latched errors and the turn count, and stay silent for a while."""
        with self._lock:
            self._power_up()
            self._silent_until = now + _REBOOT_TIME

    def factory_reset(self, option: int, now: float) -> int:
        """Execute "Factory Reset": 0xFF all, 1 all but the id, 2 all but id and baud rate."""
        keep = {0xFF: (), 0x01: ("ID",), 0x02: ("ID", "Baud Rate")}.get(option)
        if keep is None:
            return RANGE_ERROR
        with self._lock:
            self._defaults(True, keep)
            self.reboot(now)
        return 0

    def clear(self) -> int:
        """Execute "Clear", which resets the turn count.

        It "can only be applied when DYNAMIXEL is stopped".
        """
        with self._lock:
            self._publish()
            if self.get("Moving"):
                return RESULT_FAIL
            self._reset_turns()
            self._path.start(self.angle)
            self.set("Goal Position", self._ticks())
            return 0

    def back_up(self, option: int, now: float) -> int:
        """Execute "Control Table Backup", with torque off only: 1 stores, 2 restores and
        reboots."""
        with self._lock:
            if (
                self.get("Torque Enable")
                or option not in (1, 2)
                or option == 2
                and not self._backup
            ):
                return RESULT_FAIL
            if option == 1:
                self._backup = {
                    f.name: self.get(f.name)
                    for f in self._table.fields.values()
                    if self._is_backed_up(f)
                }
                self.set("Backup Ready", 1)
            else:
                self._restore(ram=False)
                self.reboot(now)
            return 0

    # -- life

    def raise_error(self, bits: int) -> None:
        """Latch a hardware error; torque goes off if the Shutdown register names it."""
        with self._lock:
            self.set("Hardware Error Status", self.get("Hardware Error Status") | bits)
            if bits & self.get("Shutdown"):
                self.set("Torque Enable", 0)

    def brown_out(self) -> None:
        """Restart after a dip of the supply voltage."""
        with self._lock:
            self._power_up()

    def check_watchdog(self, now: float) -> None:
        """Trip if torque is on and no packet arrived within the bus watchdog's time."""
        with self._lock:
            watchdog = self.get("Bus Watchdog")
            if self.tripped:
                self._drift()
            elif (
                watchdog and self.get("Torque Enable") and now - self.last_packet > 0.020 * watchdog
            ):
                self.set("Bus Watchdog", TRIPPED)
                self.stop_time = now
                # "When it stops, the Profile Acceleration(108) and Profile Velocity(112) are
                # applied as '0'."
                self.set("Profile Acceleration", 0)
                self.set("Profile Velocity", 0)
                if not self._ignores_watchdog:
                    self.set("Goal Velocity", 0)
                    self.set("Goal Position", self._ticks())
                    self._path.start(self.angle)

    def _drift(self) -> None:
        """Update the goal position after a trip, as reported for a servo with a homing offset.

        Quote: "the goal position gets updated to a value that is not the current position … This
        will keep happening indefinitely" (github.com/ROBOTIS-GIT/DynamixelSDK/issues/584, modes
        with positions).
        """
        if (
            self._homing
            and not self._ignores_watchdog
            and self.get("Operating Mode") in ct.POSITION_MODES
        ):
            self.set("Goal Position", self._ticks() - self._homing)

    @property
    def _ignores_watchdog(self) -> bool:
        return (self._table.size, self.get("Firmware Version")) in ct.INEFFECTIVE_WATCHDOG

    def drive(self) -> MotorDrive:
        """Return the drive that the registers request."""
        with self._lock:
            mode = self.get("Operating Mode")
            if not self.get("Torque Enable"):
                return MotorDrive(self.angle, 0.0)
            if (
                self.tripped
                and not self._ignores_watchdog
                and (self._trip == "limp" or mode in _FREE_MODES)
            ):
                return MotorDrive(self.angle, 0.0)
            full = self._current_max * self._torque_per_A
            # "directly controls" current or PWM, at any position
            if mode in _FREE_MODES:
                goal = self.get_signed("Goal Current" if mode == 0 else "Goal PWM")
                torque = abs(goal) * (self._torque_per_unit if mode == 0 else full / _PWM_FULL)
                return MotorDrive(self.angle + math.copysign(FAR, self._direction * goal), torque)
            # "sets a limit to current in Current-based … mode"
            name = "Goal Current" if mode == 5 else "Current Limit"
            torque = min(
                abs(self.get_signed(name)) * self._torque_per_unit,
                abs(self.get_signed("Goal PWM")) / _PWM_FULL * full,
            )
            return MotorDrive(self._path.angle if mode == 1 else self._planned(), torque)

    @property
    def _torque_per_unit(self) -> float:
        return self.model.ampere_per_unit * self._torque_per_A

    def _planned(self) -> float:
        """Return the profile's angle, rad; without a profile, the goal ("Step Instruction")."""
        if self.get("Profile Velocity"):
            return self._path.angle
        return self._angle(self.get_signed("Goal Position"))

    def _plan_path(self, period: float) -> None:
        """Move along the trajectory of the profile."""
        acceleration = self.get("Profile Acceleration") * _ACCELERATION_UNIT
        if self.get("Operating Mode") == 1:
            self._path.turn(
                self._direction * self.get_signed("Goal Velocity") * _RPM_UNIT, acceleration, period
            )
            return
        goal = self._angle(self.get_signed("Goal Position"))
        velocity = self.get("Profile Velocity")
        # "Time-based Profile": from start to goal in so many ms
        if self.get("Drive Mode") & 0x04 and velocity:
            self._path.follow(
                goal, max(abs(goal - self._path.origin), 1e-9) / (1e-3 * velocity), 0.0, period
            )
        else:
            self._path.follow(goal, velocity * _RPM_UNIT, acceleration, period)

    def turn(self, period: float) -> None:
        """Move the shaft without a mechanism towards its goal, at most at the no-load speed."""
        drive = self.drive()
        maximum = _NO_LOAD_SPEED * period if drive.torque_max > 0 else 0.0
        step = min(max(drive.goal - self.angle, -maximum), maximum)
        self.follow_load(self.angle + step, step / period, 0.0, period)

    def follow_load(self, angle: float, speed: float, torque: float, period: float) -> None:
        """Set the shaft's angle, rad, speed, rad/s, and torque, N m, from the mechanism."""
        with self._lock:
            self.angle = angle
            self.speed = speed
            self.current = torque / self._torque_per_A
            if self.get("Torque Enable"):
                self._plan_path(period)
            else:
                self._path.start(angle)
            self._warm(period)

    def _warm(self, period: float) -> None:
        """Update the winding temperature, a first-order lag, and the overload timer."""
        fraction = abs(self.current) / self._current_max
        final = _AMBIENT + _HEATING * fraction**2
        self._temperature += (final - self._temperature) * min(1.0, period / _COOLING_TIME)
        self._overload_time = self._overload_time + period if fraction > _OVERLOAD_FRACTION else 0.0
        if self._overload_time > _OVERLOAD_TIME:
            self.raise_error(_OVERLOAD)
        if self._temperature > self.get("Temperature Limit"):
            self.raise_error(_OVERHEATING)

    def heat(self, celsius: float) -> None:
        """Set the temperature (a fault on request)."""
        with self._lock:
            self._temperature = celsius

    def _publish(self) -> None:
        """Write the measured values into the registers."""
        in_position_mode = self.get("Operating Mode") in ct.POSITION_MODES
        ongoing = bool(self.get("Torque Enable") and in_position_mode and self._path.speed)
        velocity = round(self._direction * self.speed / _RPM_UNIT)
        arrived = abs(self._ticks() - self.get_signed("Goal Position")) <= 10
        self.set("Present Position", self._ticks())
        self.set("Present Velocity", velocity)
        self.set(
            "Present Current", round(self._direction * self.current / self.model.ampere_per_unit)
        )
        self.set(
            "Present PWM", round(_PWM_FULL * self._direction * self.current / self._current_max)
        )
        self.set("Present Temperature", round(self._temperature))
        self.set("Velocity Trajectory", round(self._direction * self._path.speed / _RPM_UNIT))
        self.set("Position Trajectory", self._ticks(self._path.angle))
        # Moving(122)
        self.set("Moving", int(ongoing or abs(velocity) > self.get("Moving Threshold")))
        profile = 0
        if self.get("Profile Velocity"):
            profile = 0x30 if self.get("Profile Acceleration") else 0x10
        self.set("Moving Status", profile | ongoing << 1 | (arrived and in_position_mode))
        self.set("Realtime Tick", int(scaled_clock.monotonic() * 1e3) % 32768)
