"""Register values of an emulated servo and their dependencies."""

from __future__ import annotations

import math
import threading

from mjtactile.core import scaled_clock
from mjtactile.devices.dynamixel.servo_models import MODELS
from mjtactile.emulator import control_table as ct
from mjtactile.emulator.motor_profile import Path
from mjtactile.emulator.registers import INSTRUCTION_ERROR, Registers

_TICKS_PER_RAD = 4096 / (2 * math.pi)
_FIRMWARE = {330: 52, 430: 46, 540: 46}


class ServoRegisters(Registers):
    """The control table of a servo whose shaft is at `angle` rad; `firmware` None: the newest.
    Times are monotonic s. Thread-safe."""

    def __init__(self, model: str, angle: float, firmware: int | None):
        super().__init__(model)
        self.model = MODELS[model]
        self._firmware = _FIRMWARE[self._table.size] if firmware is None else firmware
        self._backup: dict[str, int] = {}
        self._lock = threading.RLock()
        self._lost_turns = 0.0  # full turns lost at power-up, rad
        self.angle = angle
        self._path = Path(angle)
        self._registered: tuple[int, bytes] | None = None
        self.last_packet = scaled_clock.monotonic()

    def _publish(self) -> None:
        """Write the measured values into their registers."""
        raise NotImplementedError

    # -- registers

    def read(self, address: int, size: int) -> tuple[int, bytes]:
        with self._lock:
            self._publish()
            return super().read(address, size)

    def write(self, address: int, data: bytes, *, ram_only: bool = False) -> int:
        with self._lock:
            return super().write(address, data, ram_only=ram_only)

    def register(self, address: int, data: bytes) -> int:
        """Store a write until `act` (Protocol 2.0, "Reg Write")."""
        with self._lock:
            _, error = self._checked(address, data)
            if not error:
                self._registered = address, data
                self.set("Registered Instruction", 1)
            return error

    def act(self) -> int:
        """Execute the registered write; without one, it is an instruction error."""
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
            self.last_packet = scaled_clock.monotonic()

    def _torque_on(self) -> None:
        if self.get("Operating Mode") == 3:
            # Present Position(132): "When torque is turned on in Position Control Mode"
            self._reset_turns()
        self._path.start(self.angle)
        self.set("Goal Position", self._ticks())

    # -- values

    def _defaults(self, eeprom: bool, keep: tuple[str, ...] = ()) -> None:
        for field in self._table.fields.values():
            if (field.address < ct.EEPROM_END) == eeprom and field.name not in keep:
                self.set(field.name, field.default)
        if eeprom:
            self.set("Model Number", self.model.number)
            self.set("Firmware Version", self._firmware)

    def _mode_defaults(self) -> None:
        """Reset gains, limits and goals after a change of the mode.

        "Switching Operating Mode will reset gains … profile generator and limits will also be
        reset", Operating Mode(11).
        """
        for name in ct.BACKED_UP:
            self.set(name, self._table.fields[name].default)
        self.set("Goal PWM", self.get("PWM Limit"))
        self.set("Goal Current", self.get("Current Limit"))
        self.set("Goal Velocity", 0)
        if self.get("Operating Mode") == 3:
            self._reset_turns()
        self._path.start(self.angle)
        self.set("Goal Position", self._ticks())

    def _reset_turns(self) -> None:
        self._lost_turns = (
            math.floor(self._direction * self.angle * _TICKS_PER_RAD / 4096) * 2 * math.pi
        )

    @property
    def _direction(self) -> int:
        """ "Normal/Reverse Mode", Drive Mode(10)."""
        return -1 if self.get("Drive Mode") & 0x01 else 1

    @property
    def _homing(self) -> int:
        """Homing Offset(20), ticks, in use; too large ones have no effect in mode 3."""
        offset = self.get_signed("Homing Offset")
        if self.get("Operating Mode") == 3 and abs(offset) > ct.HOMING_JOINT_MAX:
            return 0
        return offset

    def _ticks(self, angle: float | None = None) -> int:
        """Return the shaft position in register units, ticks."""
        angle = self.angle if angle is None else angle
        return round((self._direction * angle - self._lost_turns) * _TICKS_PER_RAD) + self._homing

    def _angle(self, ticks: int) -> float:
        return self._direction * ((ticks - self._homing) / _TICKS_PER_RAD + self._lost_turns)

    def _is_backed_up(self, field: ct.TableEntry) -> bool:
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
