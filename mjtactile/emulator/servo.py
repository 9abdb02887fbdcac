"""One emulated X-series servo: its registers, its rules, and the drive that its registers ask for.

Behaviour after https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/: EEPROM locked while torque is on, goals checked
against limits, defaults restored by a change of operating mode, latched hardware errors that cut the torque until a
reboot, bus watchdog that makes goals read-only, turns forgotten without power.
"""

from __future__ import annotations

import math
import threading
import time
from dataclasses import dataclass

from mjtactile.devices.dynamixel.tables import MODELS, load_table

_TICKS_PER_RAD = 4096 / (2 * math.pi)
_RPM_UNIT = 0.229 * 2 * math.pi / 60  # rad/s
RESULT_FAIL, INSTRUCTION_ERROR, CRC_ERROR, RANGE_ERROR, LENGTH_ERROR, LIMIT_ERROR, ACCESS_ERROR = range(1, 8)
_VOLTAGE, _OVERHEATING, _OVERLOAD = 0x01, 0x04, 0x20
_READ_ONLY = {"Model Number", "Model Information", "Firmware Version", "Registered Instruction", "Hardware Error Status",
              "Realtime Tick", "Moving", "Moving Status", "Present PWM", "Present Current", "Present Velocity",
              "Present Position", "Velocity Trajectory", "Position Trajectory", "Present Input Voltage",
              "Present Temperature"}
_GOALS = {"Goal PWM", "Goal Current", "Goal Velocity", "Goal Position"}
_RANGES = {"ID": (0, 252), "Baud Rate": (0, 7), "Return Delay Time": (0, 254), "Drive Mode": (0, 13),
           "Status Return Level": (0, 2), "Torque Enable": (0, 1), "LED": (0, 1), "Temperature Limit": (0, 100),
           "Bus Watchdog": (0, 127), "PWM Limit": (0, 885), "Position P Gain": (0, 16383), "Position I Gain": (0, 16383),
           "Position D Gain": (0, 16383)}
_MODES = {0, 1, 3, 4, 5, 16}
_BAUDS = {9600: 0, 57600: 1, 115200: 2, 1_000_000: 3, 2_000_000: 4, 3_000_000: 5, 4_000_000: 6}
_REBOOT_TIME = 0.3  # s of silence
_AMBIENT, _HEATING, _COOLING_TIME = 25.0, 45.0, 60.0  # C; K of final rise at the largest current; s
_OVERLOAD_SHARE, _OVERLOAD_TIME = 0.6, 3.0  # of the largest current, for so long: latches


@dataclass(frozen=True)
class Drive:
    """What the motor does now: goal angle rad (turns counted), and the most torque it may use, N m (0: torque off)."""

    goal: float
    torque_max: float


class EmulatedServo:
    """`angle` rad it wakes up at; `torque_share` more torque per ampere than the data sheet says; `now` is monotonic s.
    Thread-safe."""

    def __init__(self, servo_id: int, model: str, *, angle: float = 0.0, baud: int = 1_000_000, voltage: float = 5.0,
                 torque_share: float = 0.0):
        self.model = MODELS[model]
        self._torque_per_A = (1 + torque_share) * self.model.torque_per_A  # N m/A, really
        self._table = load_table(model.lower().replace("-", "_"))
        self._by_address = {r.address: (n, r.size) for n, r in self._table.items() if not n.startswith("Indirect")}
        self._memory = bytearray(1024)
        self._lock = threading.RLock()
        self._lost_turns = 0.0  # rad that the encoder forgot at power-up
        self._temperature, self._overload_time = _AMBIENT, 0.0
        self._silent_until = 0.0
        self.angle, self.speed, self.current = angle, 0.0, 0.0
        self.last_packet = time.monotonic()
        self.stop_time: float | None = None
        """When the bus watchdog stopped it (monotonic s), None if it did not."""
        self._factory(servo_id, baud, voltage)
        self._power_up()

    # -- registers -----------------------------------------------------------------------------------------------

    def get(self, name: str) -> int:
        """A register as an unsigned number."""
        register = self._table[name]
        return int.from_bytes(self._memory[register.address : register.address + register.size], "little")

    def set(self, name: str, value: int) -> None:
        """Set a register from inside, without any rule."""
        register = self._table[name]
        data = (int(value) & ((1 << 8 * register.size) - 1)).to_bytes(register.size, "little")
        self._memory[register.address : register.address + register.size] = data

    @property
    def id(self) -> int:
        return self._memory[7]

    @property
    def alert(self) -> int:
        return 0x80 if self.get("Hardware Error Status") else 0

    def read(self, address: int, size: int) -> tuple[int, bytes]:
        """Error number and data, as a status packet says them."""
        with self._lock:
            if size == 0 or address + size > len(self._memory):
                return LENGTH_ERROR, b""
            return 0, bytes(self._memory[address : address + size])

    def write(self, address: int, data: bytes) -> int:
        """Write one or several registers in a row, all or none; returns the error number of the status packet."""
        with self._lock:
            fields = []
            end = address + len(data)
            if not data or end > len(self._memory):
                return LENGTH_ERROR
            while address < end:
                name, size = self._by_address.get(address, ("", 0))
                if not name or address + size > end:
                    return LENGTH_ERROR if name else ACCESS_ERROR
                value = int.from_bytes(data[len(data) - (end - address) : len(data) - (end - address) + size], "little")
                error = self._check(name, address, size, value)
                if error:
                    return error
                fields.append((name, value))
                address += size
            for name, value in fields:
                self._apply(name, value)
            return 0

    def _check(self, name: str, address: int, size: int, value: int) -> int:
        if name in _READ_ONLY:
            return ACCESS_ERROR
        if address < 64 and self.get("Torque Enable"):
            return ACCESS_ERROR
        if name in _GOALS and self.get("Bus Watchdog") == 0xFF:
            return RANGE_ERROR  # "goal values become read-only"
        if name == "Torque Enable" and value == 1 and self.get("Hardware Error Status"):
            return RESULT_FAIL
        if name == "Operating Mode":
            return 0 if value in _MODES else RANGE_ERROR
        signed = value - (1 << 8 * size) if value >> (8 * size - 1) else value
        low, high = self._range(name)
        return 0 if low <= signed <= high else RANGE_ERROR

    def _range(self, name: str) -> tuple[int, int]:
        if name == "Current Limit":
            return 0, self.model.current_max_units
        if name == "Goal Current":
            limit = self.get("Current Limit")
            return -limit, limit
        if name == "Goal Velocity":
            limit = self.get("Velocity Limit")
            return -limit, limit
        if name == "Goal Position" and self.get("Operating Mode") == 3:
            return self.get("Min Position Limit"), self.get("Max Position Limit")
        if name == "Goal Position":
            return -1_048_575, 1_048_575
        return _RANGES.get(name, (-(1 << 31), 1 << 31))

    def _apply(self, name: str, value: int) -> None:
        before = self.get(name)
        self.set(name, value)
        if name == "Operating Mode":
            self._mode_defaults()
        elif name == "Torque Enable" and value and not before:
            self.set("Goal Position", self._ticks())
        elif name == "Bus Watchdog":
            self.last_packet = time.monotonic()

    def _factory(self, servo_id: int, baud: int, voltage: float) -> None:
        for name, value in {
            "Model Number": self.model.number, "Firmware Version": 52, "ID": servo_id, "Baud Rate": _BAUDS.get(baud, 3),
            "Return Delay Time": 250, "Operating Mode": 3, "Protocol Type": 2, "Temperature Limit": 70,
            "Max Voltage Limit": round(voltage * 10 * 1.4), "Min Voltage Limit": round(voltage * 10 * 0.7), "PWM Limit": 885,
            "Current Limit": self.model.current_max_units, "Velocity Limit": 445, "Max Position Limit": 4095,
            "Shutdown": 0x35, "Present Input Voltage": round(voltage * 10),
        }.items():  # fmt: skip
            self.set(name, value)

    def _power_up(self) -> None:
        """RAM to its defaults, torque off, turns forgotten."""
        for address, (name, _) in self._by_address.items():
            if address >= 64 and name not in ("Present Input Voltage",):
                self.set(name, 0)
        self.set("Status Return Level", 2)
        self._lost_turns = math.floor((self.angle * _TICKS_PER_RAD) / 4096) * 2 * math.pi
        self._overload_time = 0.0
        self._mode_defaults()
        self._publish()

    def _mode_defaults(self) -> None:
        for name, value in (("Position P Gain", 400), ("Position I Gain", 0), ("Position D Gain", 0), ("Goal PWM", 885),
                            ("Goal Current", self.get("Current Limit")), ("Goal Velocity", 0), ("Profile Velocity", 0),
                            ("Profile Acceleration", 0), ("Goal Position", self._ticks())):
            self.set(name, value)

    def _ticks(self) -> int:
        return round((self.angle - self._lost_turns) * _TICKS_PER_RAD)

    # -- life ----------------------------------------------------------------------------------------------------

    def is_silent(self, now: float) -> bool:
        return now < self._silent_until

    def reboot(self, now: float) -> None:
        """Restart: clears latched errors, forgets turns, is silent for a while."""
        with self._lock:
            self._power_up()
            self._silent_until = now + _REBOOT_TIME

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

    def look_at_watchdog(self, now: float) -> None:
        """Stop if nothing was heard for the bus watchdog's time."""
        with self._lock:
            watchdog = self.get("Bus Watchdog")
            if watchdog not in (0, 0xFF) and now - self.last_packet > 0.020 * watchdog:
                self.set("Bus Watchdog", 0xFF)
                self.stop_time = now

    def drive(self) -> Drive:
        """The drive that the registers ask for now."""
        with self._lock:
            mode = self.get("Operating Mode")
            if not self.get("Torque Enable") or self.get("Bus Watchdog") == 0xFF or mode not in (3, 4, 5):
                return Drive(self.angle, 0.0)
            units = self.get("Goal Current") if mode == 5 else self.get("Current Limit")
            units = units - 0x10000 if units >= 0x8000 else units
            goal = self.get("Goal Position")
            goal = goal - (1 << 32) if goal >= 1 << 31 else goal
            ampere = abs(units) * self.model.ampere_per_unit
            return Drive(goal / _TICKS_PER_RAD + self._lost_turns, ampere * self._torque_per_A)

    def feel(self, angle: float, speed: float, torque: float, period: float) -> None:
        """What the mechanism does to the shaft: angle rad, speed rad/s, and the torque N m that the motor gives now."""
        with self._lock:
            self.angle, self.speed = angle, speed
            self.current = torque / self._torque_per_A
            self._warm(period)
            self._publish()

    def _warm(self, period: float) -> None:
        """Winding temperature of first order, and the overload timer."""
        share = abs(self.current) / (self.model.current_max_units * self.model.ampere_per_unit)
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
        self.set("Present Position", self._ticks())
        self.set("Present Velocity", round(self.speed / _RPM_UNIT))
        self.set("Present Current", round(self.current / self.model.ampere_per_unit))
        self.set("Present Temperature", round(self._temperature))
        self.set("Moving", int(abs(self.speed) > 5 * _RPM_UNIT))
        self.set("Realtime Tick", int(time.monotonic() * 1e3) % 32768)
