"""Control tables of the emulated servos, independent of the driver's data.

Source: "Control Table of EEPROM Area" and "... of RAM Area" of the e-manual,
https://emanual.robotis.com/docs/en/dxl/x/MODEL/, read in November 2026
(github.com/ROBOTIS-GIT/emanual, docs/en/dxl/x/MODEL.md). A test compares addresses with the SDK.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, replace

from mjtactile.core.errors import InputError

EEPROM_END = 64
TURNS_MAX = 1_048_575  # ticks: "Goal Position", modes 4 and 5, -256 to 256 turns
HOMING_JOINT_MAX = 1024  # ticks: "Homing Offset", a larger one is ignored in mode 3
# indexed by the value of "Baud Rate"
BAUDS = (9600, 57600, 115200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)
# "Operating Mode"
POSITION_MODES = (3, 4, 5)
MODES = (0, 1, 3, 4, 5, 16)
GOALS = ("Goal PWM", "Goal Current", "Goal Velocity", "Goal Position")
GAINS = ("Velocity I Gain", "Velocity P Gain", *(f"Position {kind} Gain" for kind in "DIP"))
BACKED_UP = (
    *GAINS,
    *("Feedforward 2nd Gain", "Feedforward 1st Gain", "Profile Acceleration", "Profile Velocity"),
)
"""RAM entries of "Control Table Backup" (Protocol 2.0, 0x20), with EEPROM and indirect ones."""

Bound = int | str  # a number, or the register that holds it ("-PWM Limit": its negative)


@dataclass(frozen=True)
class TableEntry:
    """One register. `low` to `high` or one of `choices` may be written; else it is read-only."""

    address: int
    size: int
    name: str
    default: int = 0
    low: Bound | None = None
    high: Bound | None = None
    choices: frozenset[int] = frozenset()

    @property
    def writable(self) -> bool:
        return self.low is not None or bool(self.choices)

    @property
    def signed(self) -> bool:
        return str(self.low).startswith("-") or self.name == "Goal Position"


@dataclass(frozen=True)
class _Model:
    """Values of a model's page, in its units: size 330, 430 or 540, supply, V, and initial values.

    Voltage limits are in 0.1 V. `gains` are in the order of `GAINS`. `slope` is "PWM Slope".
    """

    size: int
    volts: float
    temperature: int
    volt_max: int
    volt_min: int
    volt_low: int
    current: int
    velocity: int
    shutdown: int
    gains: tuple[int, int, int, int, int]
    slope: int | None = None


_XM = (1920, 100, 0, 0, 800)
_MODELS: Mapping[str, _Model] = {
    "XL330-M077": _Model(330, 5.0, 70, 70, 35, 31, 1750, 1620, 53, (400, 40, 0, 400, 400), 140),
    "XL330-M288": _Model(330, 5.0, 70, 70, 35, 31, 1750, 445, 53, (1600, 180, 0, 0, 400), 140),
    "XC330-T181": _Model(330, 11.1, 70, 140, 55, 55, 910, 510, 52, (1200, 40, 0, 0, 900), 255),
    "XC330-T288": _Model(330, 11.1, 70, 140, 55, 55, 910, 320, 52, (1200, 40, 0, 0, 900), 255),
    "XC330-M181": _Model(330, 5.0, 70, 70, 35, 31, 2352, 545, 52, (1400, 100, 500, 0, 1200), 140),
    "XC330-M288": _Model(330, 5.0, 70, 70, 35, 31, 2352, 350, 52, (1600, 50, 500, 0, 1100), 140),
    "XM430-W350": _Model(430, 12.0, 80, 160, 95, 95, 1193, 200, 52, _XM),
    "XM430-W210": _Model(430, 12.0, 80, 160, 95, 95, 1193, 330, 52, _XM),
    "XM540-W270": _Model(540, 12.0, 80, 160, 95, 95, 2047, 128, 52, _XM),
    "XM540-W150": _Model(540, 12.0, 80, 160, 95, 95, 2047, 230, 52, _XM),
}
# "Drive Mode": reverse, (slave,) time-based profile, torque on by goal
_DRIVE_BITS = {330: 0b1101, 430: 0b1101, 540: 0b1111}
# "Protocol Type"
_PROTOCOLS = {330: frozenset((2, 20, 21, 22)), 430: frozenset((1, 2)), 540: frozenset((1, 2))}
_INDIRECT = {  # first indirect address, first indirect data, how many
    330: ((168, 208, 20),),
    430: ((168, 224, 28), (578, 634, 28)),
    540: ((168, 224, 28), (578, 634, 28)),
}
_SHUTDOWN_BITS = 0b111101  # "Shutdown": bits 1, 6 and 7 are unused
INEFFECTIVE_WATCHDOG = {(330, 51)}
"""Size and firmware of servos that report a watchdog trip but continue to turn.

Source: https://forum.robotis.com/t/watchdog-of-xc330-t288-t-does-not-stop-motor/4814.
"""

_FIELDS = (
    TableEntry(0, 2, "Model Number"),
    TableEntry(2, 4, "Model Information"),
    TableEntry(6, 1, "Firmware Version"),
    TableEntry(7, 1, "ID", 1, 0, 252),
    TableEntry(8, 1, "Baud Rate", 1, 0, 7),
    TableEntry(9, 1, "Return Delay Time", 250, 0, 254),
    TableEntry(10, 1, "Drive Mode"),
    TableEntry(11, 1, "Operating Mode", 3, choices=frozenset(MODES)),
    TableEntry(12, 1, "Secondary(Shadow) ID", 255, 0, 255),
    TableEntry(13, 1, "Protocol Type", 2),
    TableEntry(20, 4, "Homing Offset", 0, -1_044_479, 1_044_479),
    TableEntry(24, 4, "Moving Threshold", 10, 0, 1023),
    TableEntry(31, 1, "Temperature Limit", 0, 0, 100),
    TableEntry(32, 2, "Max Voltage Limit"),
    TableEntry(34, 2, "Min Voltage Limit"),
    TableEntry(36, 2, "PWM Limit", 885, 0, 885),
    TableEntry(38, 2, "Current Limit"),
    TableEntry(44, 4, "Velocity Limit"),
    TableEntry(48, 4, "Max Position Limit", 4095, 0, 4095),
    TableEntry(52, 4, "Min Position Limit", 0, 0, 4095),
    TableEntry(60, 1, "Startup Configuration", 0, 0, 3),
    TableEntry(63, 1, "Shutdown"),
    TableEntry(64, 1, "Torque Enable", 0, 0, 1),
    TableEntry(65, 1, "LED", 0, 0, 1),
    TableEntry(68, 1, "Status Return Level", 2, 0, 2),
    TableEntry(69, 1, "Registered Instruction"),
    TableEntry(70, 1, "Hardware Error Status"),
    TableEntry(76, 2, "Velocity I Gain", 0, 0, 16383),
    TableEntry(78, 2, "Velocity P Gain", 0, 0, 16383),
    TableEntry(80, 2, "Position D Gain", 0, 0, 16383),
    TableEntry(82, 2, "Position I Gain", 0, 0, 16383),
    TableEntry(84, 2, "Position P Gain", 0, 0, 16383),
    TableEntry(88, 2, "Feedforward 2nd Gain", 0, 0, 16383),
    TableEntry(90, 2, "Feedforward 1st Gain", 0, 0, 16383),
    TableEntry(98, 1, "Bus Watchdog", 0, 0, 127),
    TableEntry(100, 2, "Goal PWM", 0, "-PWM Limit", "PWM Limit"),
    TableEntry(102, 2, "Goal Current", 0, "-Current Limit", "Current Limit"),
    TableEntry(104, 4, "Goal Velocity", 0, "-Velocity Limit", "Velocity Limit"),
    TableEntry(108, 4, "Profile Acceleration", 0, 0, 32767),
    TableEntry(112, 4, "Profile Velocity", 0, 0, 32767),
    # in modes 4 and 5: TURNS_MAX
    TableEntry(116, 4, "Goal Position", 0, "Min Position Limit", "Max Position Limit"),
    TableEntry(120, 2, "Realtime Tick"),
    TableEntry(122, 1, "Moving"),
    TableEntry(123, 1, "Moving Status"),
    TableEntry(124, 2, "Present PWM"),
    TableEntry(126, 2, "Present Current"),
    TableEntry(128, 4, "Present Velocity"),
    TableEntry(132, 4, "Present Position"),
    TableEntry(136, 4, "Velocity Trajectory"),
    TableEntry(140, 4, "Position Trajectory"),
    TableEntry(144, 2, "Present Input Voltage"),
    TableEntry(146, 1, "Present Temperature"),
    TableEntry(147, 1, "Backup Ready"),
)


class ControlTable:
    """Registers of a model, by name and address; `indirect`: indirect address of each datum."""

    def __init__(self, model: str):
        if model not in _MODELS:
            message = f"the emulator does not support the servo {model!r}"
            raise InputError(message, field="model", choices=_MODELS)
        row = _MODELS[model]
        self.size = row.size
        self.volts = row.volts
        values = _model_values(row)
        fields = [replace(field, **values.get(field.name, {})) for field in _FIELDS]
        if row.slope is not None:
            fields.append(TableEntry(62, 1, "PWM Slope", row.slope, 1, 255))
        for i in (1, 2, 3) if row.size == 540 else ():
            fields.append(TableEntry(55 + i, 1, f"External Port Mode {i}", 3, 0, 3))
            fields.append(TableEntry(150 + 2 * i, 2, f"External Port Data {i}", 0, 0, 65535))
        self.indirect: dict[int, int] = {}
        last = max(data + count for _, data, count in _INDIRECT[row.size]) - 1
        for block, (address, data, count) in enumerate(_INDIRECT[row.size]):
            for i in range(count):
                index = i + 1 + 28 * block
                name = f"Indirect Address {index}"
                pointer = address + 2 * i
                fields.append(TableEntry(pointer, 2, name, data + i, EEPROM_END, last))
                fields.append(TableEntry(data + i, 1, f"Indirect Data {index}", 0, 0, 255))
                self.indirect[data + i] = pointer
        self.fields = {field.name: field for field in fields}
        self.at = {field.address: field for field in fields}
        self.defined = frozenset(
            a for field in fields for a in range(field.address, field.address + field.size)
        )


def _model_values(row: _Model) -> dict[str, dict[str, object]]:
    """Return the model's values that replace those of the common fields."""
    volts: dict[str, object] = {"low": row.volt_low, "high": row.volt_max}
    velocity_max = 2047 if row.size == 330 else 1023
    bits = _DRIVE_BITS[row.size]
    gains: dict[str, dict[str, object]] = {
        name: {"default": gain} for name, gain in zip(GAINS, row.gains, strict=True)
    }
    shutdown = frozenset(v for v in range(64) if v & ~_SHUTDOWN_BITS == 0)
    return {
        "Baud Rate": {"high": 6 if row.size == 330 else 7},
        "Drive Mode": {"choices": frozenset(v for v in range(16) if v & ~bits == 0)},
        "Protocol Type": {"choices": _PROTOCOLS[row.size]},
        "Temperature Limit": {"default": row.temperature},
        "Max Voltage Limit": {"default": row.volt_max, **volts},
        "Min Voltage Limit": {"default": row.volt_min, **volts},
        "Current Limit": {"default": row.current, "low": 0, "high": row.current},
        "Velocity Limit": {"default": row.velocity, "low": 0, "high": velocity_max},
        "Shutdown": {"default": row.shutdown, "choices": shutdown},
        **gains,
    }


@functools.cache
def control_table(model: str) -> ControlTable:
    """Return the control table of a model. Raises InputError for an unknown model."""
    return ControlTable(model)
