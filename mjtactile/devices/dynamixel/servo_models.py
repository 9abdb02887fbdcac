"""Properties of each servo model for the driver: registers and units.

The registers are read from the tables shipped with the SDK. These tables give addresses, but no
usable current unit (1.0 "raw", or "N/m"). The mA per unit are therefore defined here. They come
from the "Goal Current" entry of each model's page at https://emanual.robotis.com/docs/en/dxl/x/.
Torque over current are the stall values of the same page's specifications. The sources of all
values: docs/how-to/hardware.md.
"""

from __future__ import annotations

import functools
import importlib.util
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from mjtactile.core.errors import DeviceError

TICKS_PER_RAD = 4096 / (2 * math.pi)
VELOCITY_UNIT = 0.229 * 2 * math.pi / 60  # rad/s, "Present Velocity"
WATCHDOG_UNIT = 0.020  # unit of "Bus Watchdog", s
CURRENT_BASED_POSITION = 5  # "Operating Mode"
EEPROM_END = 64  # registers below are kept without power and locked while torque is on

WATCHDOG_TRIPPED = 0xFF  # "Bus Watchdog" reads -1
_STARTUP = ("Startup Configuration", 60, 1)  # from the e-manual's tables; those of the SDK lack it
_INEFFECTIVE_WATCHDOG = {51}  # firmware of all 330 sizes: forum.robotis.com, topic 4814

HARDWARE_ERRORS = {
    0: "input voltage",
    2: "overheating",
    3: "motor encoder",
    4: "electrical shock",
    5: "overload",
}
"""Bits of "Hardware Error Status" (70)."""


@dataclass(frozen=True)
class ServoModel:
    """Servo model: units and limits of its current, and its torque.

    `ampere_per_unit` applies to goal and present current. `current_max_units` is the maximum of
    Current Limit. `torque_per_A`, N m/A, is at the shaft. It is stall torque over stall current of
    the data sheet, accurate to 20 %. `calibrate gripper` measures it.
    """

    number: int
    name: str
    ampere_per_unit: float
    current_max_units: int
    torque_per_A: float

    @property
    def table(self) -> Mapping[str, Register]:
        return load_table(self.name.lower().replace("-", "_"))

    def watchdog_stops(self, firmware: int) -> bool:
        """Return False for the one firmware whose bus watchdog trips, but lets the motor turn."""
        return "330" not in self.name or firmware not in _INEFFECTIVE_WATCHDOG


@dataclass(frozen=True)
class Register:
    """Address and size (bytes) of one entry of a control table."""

    address: int
    size: int


def _rows() -> tuple[ServoModel, ...]:
    return (
        # model number, name, A per unit, largest current limit, N m per A
        ServoModel(1190, "XL330-M077", 1.00e-3, 1750, 0.146),  # 0.215 N m, 1.47 A at 5 V
        ServoModel(1200, "XL330-M288", 1.00e-3, 1750, 0.354),  # 0.52 N m, 1.47 A at 5 V
        ServoModel(1210, "XC330-T181", 1.00e-3, 910, 0.95),  # 0.76 N m, 0.80 A at 11.1 V
        ServoModel(1220, "XC330-T288", 1.00e-3, 910, 1.15),  # 0.92 N m, 0.80 A at 11.1 V
        ServoModel(1230, "XC330-M181", 1.00e-3, 2352, 0.333),  # 0.60 N m, 1.80 A at 5 V
        ServoModel(1240, "XC330-M288", 1.00e-3, 2352, 0.517),  # 0.93 N m, 1.80 A at 5 V
        ServoModel(1020, "XM430-W350", 2.69e-3, 1193, 1.78),  # 4.1 N m, 2.3 A at 12 V
        ServoModel(1030, "XM430-W210", 2.69e-3, 1193, 1.30),  # 3.0 N m, 2.3 A at 12 V
        ServoModel(1120, "XM540-W270", 2.69e-3, 2047, 2.41),  # 10.6 N m, 4.4 A at 12 V
        ServoModel(1130, "XM540-W150", 2.69e-3, 2047, 1.66),  # 7.3 N m, 4.4 A at 12 V
    )


MODELS: Mapping[str, ServoModel] = {model.name: model for model in _rows()}
MODEL_BY_NUMBER: Mapping[int, ServoModel] = {model.number: model for model in MODELS.values()}
NO_CURRENT_CONTROL: Mapping[int, str] = {
    30: "MX-28",
    350: "XL320",
    1060: "XL430-W250",
    1070: "XC430-W150",
    1080: "XC430-W240",
    1090: "2XL430-W250",
    1160: "2XC430-W250",
}
"""Models that cannot limit their force: no current-based modes, no Goal Current."""


def require_model(model_number: int, where: str) -> ServoModel:
    """Return the model with this number. Raises DeviceError without force limit or units."""
    if model_number in NO_CURRENT_CONTROL:
        raise DeviceError(
            f"{where} is a {NO_CURRENT_CONTROL[model_number]}, which has no goal current and "
            f"cannot limit its force; use one of {', '.join(MODELS)}"
        )
    if model_number not in MODEL_BY_NUMBER:
        raise DeviceError(
            f"{where} has model number {model_number}, whose current unit is not known; use one of "
            f"{', '.join(MODELS)}"
        )
    return MODEL_BY_NUMBER[model_number]


@functools.cache
def load_table(stem: str) -> Mapping[str, Register]:
    """Read registers by name from the SDK's `<stem>.model`. Raises DeviceError."""
    # located, not imported: only its tables are required
    package = importlib.util.find_spec("dynamixel_easy_sdk")
    folders = [] if package is None else list(package.submodule_search_locations or [])
    path = next(
        (p for f in folders if (p := Path(f) / "control_table" / f"{stem}.model").is_file()), None
    )
    if path is None:
        raise DeviceError(
            f"dynamixel-sdk ships no control table {stem}.model; is its version 4.1 or newer?"
        )
    table: dict[str, Register] = {}
    inside = False
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.startswith("["):
            inside = line.strip() == "[control table]"
        elif inside and len(parts := line.split("\t")) == 3 and parts[0].isdigit():
            table[parts[2].strip()] = Register(int(parts[0]), int(parts[1]))
    name, address, size = _STARTUP
    table[name] = Register(address, size)
    return table


def signed(value: int, size: int) -> int:
    """Read the unsigned `value` of `size` bytes as two's complement."""
    return value - (1 << 8 * size) if value >= 1 << (8 * size - 1) else value


def describe_hardware_error(bits: int) -> str:
    """Describe the set bits of Hardware Error Status in words."""
    names = [HARDWARE_ERRORS.get(i, f"bit {i}") for i in range(8) if bits >> i & 1]
    return " and ".join(names) or "alert without a reason"
