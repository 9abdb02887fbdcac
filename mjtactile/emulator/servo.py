"""One emulated X-series servo: its registers, its rules, and the drive that its registers ask for.

Each rule names the heading of the e-manual under which it stands
(https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/ and .../xm430-w350/), or where else it was
reported. The tables: `mjtactile.emulator.control_table`.
"""

from __future__ import annotations

import math
import threading

from mjtactile.core import pace
from mjtactile.devices.dynamixel.tables import MODELS
from mjtactile.emulator import control_table as ct
from mjtactile.emulator.motion import FAR, Drive, Path
from mjtactile.emulator.registers import (
    INSTRUCTION_ERROR,
    RANGE_ERROR,
    RESULT_FAIL,
    TRIPPED,
    Registers,
)

_TICKS_PER_RAD = 4096 / (2 * math.pi)
_RPM_UNIT = 0.229 * 2 * math.pi / 60  # rad/s
_ACCELERATION_UNIT = 214.577 * 2 * math.pi / 3600  # rad/s^2: "Profile Acceleration(108)", rev/min^2
_PWM_FULL = 885
_OVERHEATING = 0x04
_OVERLOAD = 0x20
_FIRMWARE = {330: 52, 430: 46, 540: 46}
_REBOOT_TIME = 0.3  # s of silence
_NO_LOAD_SPEED = 6.0  # rad/s of a shaft that nothing holds, about 60 rev/min
# C; K of final rise at the largest current; s
_AMBIENT = 25.0
_HEATING = 45.0
_COOLING_TIME = 60.0
# of the largest current, for so long: latches
_OVERLOAD_SHARE = 0.6
_OVERLOAD_TIME = 3.0
TRIPS = ("brake", "limp")
"""What a tripped watchdog does. The manual says that the servo "will stop" (Bus Watchdog(98));
users found it free in modes 0 and 16, and held where it was in the others ("brake"); "limp" is a
servo that is free in all of them."""
_FREE_MODES = (0, 16)


class EmulatedServo(Registers):
    """`angle` rad it wakes up at; `torque_share` more torque per ampere than the data sheet says;
    `firmware` None: the newest; `trip` one of `TRIPS`. Times are monotonic s. Thread-safe."""

    def __init__(
        self,
        servo_id: int,
        model: str,
        *,
        angle: float = 0.0,
        baud: int = 1_000_000,
        torque_share: float = 0.0,
        firmware: int | None = None,
        trip: str = "brake",
    ):
        super().__init__(model)
        self.model = MODELS[model]
        self._current_max = self._table.fields["Current Limit"].default * self.model.ampere_per_unit
        self._torque_per_A = (1 + torque_share) * self.model.torque_per_A  # N m/A, really
        self._firmware = _FIRMWARE[self._table.size] if firmware is None else firmware
        self._trip = trip
        self._backup: dict[str, int] = {}
        self._lock = threading.RLock()
        self._lost_turns = 0.0  # rad that the encoder forgot at power-up
        self._temperature = _AMBIENT
        self._overload_time = 0.0
        self._silent_until = 0.0
        self.angle = angle
        self.speed = 0.0
        self.current = 0.0
        self._path = Path(angle)
        self._registered: tuple[int, bytes] | None = None
        self.last_packet = pace.monotonic()
        self.stop_time: float | None = None
        """When the bus watchdog tripped (monotonic s), None if it did not."""
        self._defaults(True)
        self.set("ID", servo_id)
        self.set("Baud Rate", ct.BAUDS.index(baud))
        self._power_up()

    # -- registers
    # --------------------------------------------------------------------------------

    def read(self, address: int, size: int) -> tuple[int, bytes]:
        with self._lock:
            self._publish()
            return super().read(address, size)

    def write(self, address: int, data: bytes, *, ram_only: bool = False) -> int:
        with self._lock:
            return super().write(address, data, ram_only=ram_only)

    def register(self, address: int, data: bytes) -> int:
        """Keep a write until `act` (Protocol 2.0, "Reg Write")."""
        with self._lock:
            _, error = self._checked(address, data)
            if not error:
                self._registered = address, data
                self.set("Registered Instruction", 1)
            return error

    def act(self) -> int:
        """Carry out what was registered; "Action has been used without Reg Write" is an instruction
        error."""
        with self._lock:
            if self._registered is None:
                return INSTRUCTION_ERROR
            address, data = self._registered
            self._registered = None
            self.set("Registered Instruction", 0)
            return self.write(address, data)

    def _apply(self, name: str, value: int) -> None:
        before = self.get(name)
        self.set(name, value)
        if name == "Operating Mode":
            self._mode_defaults()
        elif name == "Torque Enable" and value and not before:
            self._torque_on()
        elif name in ct.GOALS and self.get("Drive Mode") & 0x08 and not self.get("Torque Enable"):
            self.set("Torque Enable", 1)  # "Torque On by Goal Update", Drive Mode(10)
        elif name == "Bus Watchdog":
            self.last_packet = pace.monotonic()

    def _torque_on(self) -> None:
        if self.get("Operating Mode") == 3:
            # "When torque is turned on in Position Control Mode", Present Position(132)
            self._forget_turns()
        self._path.start(self.angle)
        self.set("Goal Position", self._ticks())

    # -- values
    # --------------------------------------------------------------------------------

    def _defaults(self, eeprom: bool, keep: tuple[str, ...] = ()) -> None:
        for field in self._table.fields.values():
            if (field.address < ct.EEPROM_END) == eeprom and field.name not in keep:
                self.set(field.name, field.default)
        if eeprom:
            self.set("Model Number", self.model.number)
            self.set("Firmware Version", self._firmware)

    def _power_up(self) -> None:
        """RAM to its defaults, turns forgotten, torque off; unless "Startup Configuration(60)" says
        otherwise."""
        self._defaults(False)
        self._registered = None
        self.set("Present Input Voltage", round(10 * self._table.volts))
        self.set("Backup Ready", int(bool(self._backup)))
        self._overload_time = 0.0
        self._forget_turns()
        self._mode_defaults()
        startup = self.get("Startup Configuration")
        if startup & 0x02:
            self._restore(ram=True)
        if startup & 0x01:
            self.set("Torque Enable", 1)
        self._publish()

    def _mode_defaults(self) -> None:
        """ "Switching Operating Mode will reset gains … profile generator and limits will also be
        reset", Operating Mode(11)."""
        for name in ct.BACKED_UP:
            self.set(name, self._table.fields[name].default)
        self.set("Goal PWM", self.get("PWM Limit"))
        self.set("Goal Current", self.get("Current Limit"))
        self.set("Goal Velocity", 0)
        if self.get("Operating Mode") == 3:
            self._forget_turns()
        self._path.start(self.angle)
        self.set("Goal Position", self._ticks())

    def _forget_turns(self) -> None:
        self._lost_turns = (
            math.floor(self._direction * self.angle * _TICKS_PER_RAD / 4096) * 2 * math.pi
        )

    @property
    def _direction(self) -> int:
        """ "Normal/Reverse Mode", Drive Mode(10)."""
        return -1 if self.get("Drive Mode") & 0x01 else 1

    @property
    def _homing(self) -> int:
        """ticks that are added to the actual position (Homing Offset(20)); too large ones count for
        nothing in mode 3."""
        offset = self.get_signed("Homing Offset")
        if self.get("Operating Mode") == 3 and abs(offset) > ct.HOMING_JOINT_MAX:
            return 0
        return offset

    def _ticks(self, angle: float | None = None) -> int:
        """Position of the shaft as its registers say it."""
        angle = self.angle if angle is None else angle
        return round((self._direction * angle - self._lost_turns) * _TICKS_PER_RAD) + self._homing

    def _angle(self, ticks: int) -> float:
        return self._direction * ((ticks - self._homing) / _TICKS_PER_RAD + self._lost_turns)

    # -- instructions
    # --------------------------------------------------------------------------------

    def is_silent(self, now: float) -> bool:
        return now < self._silent_until

    def reboot(self, now: float) -> None:
        """Restart: clears latched errors, forgets turns, is silent for a while."""
        with self._lock:
            self._power_up()
            self._silent_until = now + _REBOOT_TIME

    def factory_reset(self, option: int, now: float) -> int:
        """ "Factory Reset": 0xFF all, 1 all but the id, 2 all but id and baud rate."""
        keep = {0xFF: (), 0x01: ("ID",), 0x02: ("ID", "Baud Rate")}.get(option)
        if keep is None:
            return RANGE_ERROR
        with self._lock:
            self._defaults(True, keep)
            self.reboot(now)
        return 0

    def clear(self) -> int:
        """ "Clear": the turns are forgotten; "can only be applied when DYNAMIXEL is stopped"."""
        with self._lock:
            self._publish()
            if self.get("Moving"):
                return RESULT_FAIL
            self._forget_turns()
            self._path.start(self.angle)
            self.set("Goal Position", self._ticks())
            return 0

    def back_up(self, option: int, now: float) -> int:
        """ "Control Table Backup": 1 stores, 2 restores and reboots; "works properly only if Torque
        Enable … is set as '0'"."""
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

    def _is_backed_up(self, field: ct.Field) -> bool:
        return (
            field.writable
            and field.address < ct.EEPROM_END
            or field.name in ct.BACKED_UP
            or field.name.startswith("Indirect Address")
        )

    def _restore(self, *, ram: bool) -> None:
        for name, value in self._backup.items():
            if (self._table.fields[name].address >= ct.EEPROM_END) == ram:
                self.set(name, value)

    # -- life
    # --------------------------------------------------------------------------------

    def raise_error(self, bits: int) -> None:
        """Latch a hardware error; torque goes off if the Shutdown register names it."""
        with self._lock:
            self.set("Hardware Error Status", self.get("Hardware Error Status") | bits)
            if bits & self.get("Shutdown"):
                self.set("Torque Enable", 0)

    def brown_out(self) -> None:
        """The supply dipped: a restart that nobody asked for."""
        with self._lock:
            self._power_up()

    def check_watchdog(self, now: float) -> None:
        """Trip if nothing was heard for the bus watchdog's time; it "monitors … when Torque
        Enable(64) is '1'"."""
        with self._lock:
            watchdog = self.get("Bus Watchdog")
            if self.tripped:
                self._drift()
            elif (
                watchdog and self.get("Torque Enable") and now - self.last_packet > 0.020 * watchdog
            ):
                self.set("Bus Watchdog", TRIPPED)
                self.stop_time = now
                # "When it stops, the Profile Acceleration(108) and
                self.set("Profile Acceleration", 0)
                self.set("Profile Velocity", 0)  # Profile Velocity(112) are applied as '0'."
                if not self._ignores_watchdog:
                    self.set("Goal Velocity", 0)
                    self.set("Goal Position", self._ticks())
                    self._path.start(self.angle)

    def _drift(self) -> None:
        """With a homing offset "the goal position gets updated to a value that is not the current
        position … This will keep happening indefinitely"
        (github.com/ROBOTIS-GIT/DynamixelSDK/issues/584, modes with positions)."""
        if (
            self._homing
            and not self._ignores_watchdog
            and self.get("Operating Mode") in ct.POSITION_MODES
        ):
            self.set("Goal Position", self._ticks() - self._homing)

    @property
    def _ignores_watchdog(self) -> bool:
        return (self._table.size, self.get("Firmware Version")) in ct.WATCHDOG_GOES_ON

    def drive(self) -> Drive:
        """The drive that the registers ask for now."""
        with self._lock:
            mode = self.get("Operating Mode")
            if not self.get("Torque Enable"):
                return Drive(self.angle, 0.0)
            if (
                self.tripped
                and not self._ignores_watchdog
                and (self._trip == "limp" or mode in _FREE_MODES)
            ):
                return Drive(self.angle, 0.0)
            full = self._current_max * self._torque_per_A
            # "directly controls" current or PWM: pulls with that, wherever it gets to
            if mode in _FREE_MODES:
                goal = self.get_signed("Goal Current" if mode == 0 else "Goal PWM")
                torque = abs(goal) * (self._torque_per_unit if mode == 0 else full / _PWM_FULL)
                return Drive(self.angle + math.copysign(FAR, self._direction * goal), torque)
            # "sets a limit to current in Current-based … mode"
            name = "Goal Current" if mode == 5 else "Current Limit"
            torque = min(
                abs(self.get_signed(name)) * self._torque_per_unit,
                abs(self.get_signed("Goal PWM")) / _PWM_FULL * full,
            )
            return Drive(self._path.angle if mode == 1 else self._planned(), torque)

    @property
    def _torque_per_unit(self) -> float:
        return self.model.ampere_per_unit * self._torque_per_A

    def _planned(self) -> float:
        """Where the profile has got to; without one the goal itself ("Profile not used (Step
        Instruction)")."""
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
        """The shaft without any mechanism: it goes where it is driven, at most as fast as without
        load."""
        drive = self.drive()
        most = _NO_LOAD_SPEED * period if drive.torque_max > 0 else 0.0
        step = min(max(drive.goal - self.angle, -most), most)
        self.follow_load(self.angle + step, step / period, 0.0, period)

    def follow_load(self, angle: float, speed: float, torque: float, period: float) -> None:
        """What the mechanism does to the shaft: angle rad, speed rad/s, and the torque N m that the
        motor gives now."""
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
        """Winding temperature of first order, and the overload timer."""
        share = abs(self.current) / self._current_max
        final = _AMBIENT + _HEATING * share**2
        self._temperature += (final - self._temperature) * min(1.0, period / _COOLING_TIME)
        self._overload_time = self._overload_time + period if share > _OVERLOAD_SHARE else 0.0
        if self._overload_time > _OVERLOAD_TIME:
            self.raise_error(_OVERLOAD)
        if self._temperature > self.get("Temperature Limit"):
            self.raise_error(_OVERHEATING)

    def heat(self, celsius: float) -> None:
        """Set the temperature (a fault on request)."""
        with self._lock:
            self._temperature = celsius

    def _publish(self) -> None:
        """What the servo measures, into its registers."""
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
        self.set("Realtime Tick", int(pace.monotonic() * 1e3) % 32768)
