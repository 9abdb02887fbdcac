"""`RigFile`: which camera, valve and servos a rig has, read from a TOML file and checked. The format: docs/hardware.md.

Every quantity is SI inside; the file's keys carry the unit.
"""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mjtactile import resources
from mjtactile.errors import InputError

FINGERS = ("left", "right")


@dataclass(frozen=True)
class BusConfig:
    """Serial bus of the servos: `port`, `baud`, `reply_timeout` s on top of the wire's own time, `watchdog` s after which
    a servo that hears nothing stops by itself, `fast_sync`: ask all servos in one reply packet (newer firmware),
    `host_timeout` s after which a control loop that calls no more counts as hung: the watchdogs are then let trip."""

    port: str
    baud: int = 1_000_000
    reply_timeout: float = 0.008
    watchdog: float = 0.1
    fast_sync: bool = False
    host_timeout: float = 0.25


@dataclass(frozen=True)
class ServoConfig:
    """One jaw servo. `opening_part` m of the gripper's opening belong to this servo at `zero_ticks`; see
    `mjtactile.devices.geometry` for `law`, `per_rad` (m/rad) and `table` (rad, m). `torque_per_A` N m/A (None: data sheet).
    """

    id: int
    model: str
    law: str = "rack"
    per_rad: float = 0.012
    opening_part: float = 0.0
    zero_ticks: int = 2048
    table: tuple[tuple[float, float], ...] = ()
    torque_per_A: float | None = None
    position_p_gain: int | None = None


@dataclass(frozen=True)
class LiftConfig:
    """What lifts the hand: `"servo"` (rack of `per_rad` m/rad, `travel` m) or `"none"`: nothing does; the height that was
    asked for is reported as reached at `speed` m/s."""

    kind: str = "none"
    speed: float = 0.05
    travel: float = 0.15
    id: int = 3
    model: str = ""
    per_rad: float = 0.02
    torque_max: float = 1.0


@dataclass(frozen=True)
class GripperConfig:
    """Jaws: `opening` m (lowest, highest), `force_max` N on each finger, `speed_max` m/s of the opening."""

    opening: tuple[float, float]
    servos: tuple[ServoConfig, ...]
    force_max: float = 8.0
    speed_max: float = 0.1


@dataclass(frozen=True)
class CameraConfig:
    """One finger's camera. `source`: a device file or a stream's address. None of a control: leave it as it is.

    `fourcc` is asked of a V4L2 camera; of a stream (ffmpeg) it says what comes: "MJPG" is decoded straight to grey.
    `timestamps`: "kernel" (V4L2's, on the monotonic clock) or "arrival" (streams, which carry none).
    `delay` s from capture to arrival for "arrival"."""

    finger: str
    source: str
    width: int
    height: int
    rate: float
    backend: str = "v4l2"
    fourcc: str | None = "MJPG"
    exposure: float | None = None
    gain: float | None = None
    white_balance: float | None = None
    timestamps: str = "kernel"
    delay: float = 0.0


@dataclass(frozen=True)
class ValveConfig:
    """Valve of one finger's chamber: `channel` on the board at `port` which speaks `dialect`; `pressure_max` Pa gauge is
    set in the board, `heartbeat` s is the silence after which the board vents, `reply_timeout` s what an answer to the
    heartbeat's questions may take, `supply_gauge` Pa of a board that cannot regulate."""

    finger: str
    port: str
    dialect: str = "ctrlp"
    channel: int = 1
    baud: int = 115200
    pressure_max: float = 3000.0
    heartbeat: float = 0.25
    reply_timeout: float = 0.03
    supply_gauge: float | None = None


@dataclass(frozen=True)
class EmulatorConfig:
    """How to start the emulated hardware; the ports of such a file are "emulator"."""

    servo_model: str = "XL330-M288"
    usb_latency: float = 1e-3
    dialect: str = "ctrlp"


@dataclass(frozen=True)
class RigFile:
    """A whole rig. `emulator` is None for real hardware."""

    name: str
    path: Path
    bus: BusConfig
    gripper: GripperConfig
    lift: LiftConfig
    cameras: tuple[CameraConfig, ...]
    valves: tuple[ValveConfig, ...]
    emulator: EmulatorConfig | None = None
    calibration: Mapping[str, str] = field(default_factory=dict)


class Section:
    """A table of a TOML file that is read once, field by field; `done` complains about what nobody asked for."""

    def __init__(self, table: Mapping[str, Any], label: str, source: str):
        self._table, self._label, self._source = table, label, source
        self._asked: list[str] = []

    def fail(self, key: str, message: str, choices: Iterable[object] | None = None) -> InputError:
        return InputError(message, source=self._source, field=f"{self._label}.{key}" if self._label else key, choices=choices)

    def _get(self, key: str, default: Any) -> Any:
        self._asked.append(key)
        if key in self._table:
            return self._table[key]
        if default is ...:
            like = [other for other in self._table if other.rsplit("_", 1)[0] == key.rsplit("_", 1)[0] and "_" in key]
            raise self.fail(key, f"missing field; there is {like[0]!r}: wrong unit?" if like else "missing field")
        return None

    def number(self, key: str, low: float, high: float, scale: float = 1.0, default: Any = ...) -> Any:
        """A finite number within [low, high] (in the file's unit), times `scale`."""
        value = self._get(key, default)
        if value is None:
            return default
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.fail(key, f"{value!r} is not a number")
        if not math.isfinite(value) or not low <= value <= high:
            raise self.fail(key, f"{value!r} is outside {low:g} to {high:g}")
        return value * scale

    def whole(self, key: str, low: int, high: int, default: Any = ...) -> Any:
        value = self._get(key, default)
        if value is None:
            return default
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.fail(key, f"{value!r} is not a whole number")
        if not low <= value <= high:
            raise self.fail(key, f"{value!r} is outside {low} to {high}")
        return value

    def text(self, key: str, choices: Iterable[str] | None = None, default: Any = ...) -> Any:
        value = self._get(key, default)
        if value is None:
            return default
        if not isinstance(value, str) or not value:
            raise self.fail(key, f"{value!r} is not text", choices)
        if choices is not None and value not in (choices := list(choices)):
            raise self.fail(key, f"{value!r} is unknown", choices)
        return value

    def flag(self, key: str, default: bool) -> bool:
        value = self._get(key, default)
        if value is None:
            return default
        if not isinstance(value, bool):
            raise self.fail(key, f"{value!r} is not true or false")
        return value

    def pairs(self, key: str) -> tuple[tuple[float, float], ...]:
        """A list of [x, y] pairs of finite numbers."""
        value = self._get(key, ...)
        good = isinstance(value, list) and all(
            isinstance(pair, list) and len(pair) == 2
            and all(isinstance(x, (int, float)) and math.isfinite(x) for x in pair) for pair in value)
        if not good:
            raise self.fail(key, f"{value!r} is not a list of [x, y] pairs")
        return tuple((float(x), float(y)) for x, y in value)

    def section(self, key: str, required: bool = True) -> Section | None:
        value = self._get(key, ... if required else None)
        if value is None:
            return None
        if not isinstance(value, Mapping):
            raise self.fail(key, "not a section")
        return Section(value, f"{self._label}.{key}" if self._label else key, self._source)

    def sections(self, key: str, low: int = 1, high: int = 2) -> list[Section]:
        value = self._get(key, None if low == 0 else ...)
        value = [] if value is None else value
        if not isinstance(value, list) or not all(isinstance(item, Mapping) for item in value):
            raise self.fail(key, "not a list of sections; write [[…]]")
        if not low <= len(value) <= high:
            raise self.fail(key, f"{len(value)} of them, expected {low} to {high}")
        label = f"{self._label}.{key}" if self._label else key
        return [Section(item, f"{label}[{i}]", self._source) for i, item in enumerate(value)]

    def done(self) -> None:
        """Raise InputError for a field that is not known."""
        for key in self._table:
            if key in self._asked:
                continue
            stem = {k.rsplit("_", 1)[0]: k for k in self._asked if "_" in k}.get(key.rsplit("_", 1)[0])
            near = stem or next(iter(difflib.get_close_matches(key, self._asked, 1)), None)
            hint = f", wrong unit? write it as {stem!r}" if stem else f", did you mean {near!r}?" if near else ""
            raise self.fail(key, f"unknown field{hint}", self._asked)


def load_rig_file(name_or_path: str | Path) -> RigFile:
    """Read a rig by shipped name or from a TOML file. Raises InputError naming file, field, value and valid choices."""
    path = resources.find(name_or_path, "models/rigs", ".toml")
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"not valid TOML: {error}", source=path) from error
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", source=path) from error
    return rig_from_table(table, path)


def rig_from_table(table: Mapping[str, Any], path: Path) -> RigFile:
    """Validate a parsed TOML table; see `load_rig_file`."""
    root = Section(table, "", str(path))
    name = root.text("name", default=path.stem)
    emulator = root.section("emulator", required=False)
    bus, gripper, lift = (root.section(key) for key in ("bus", "gripper", "lift"))
    assert bus and gripper and lift
    cameras, valves = root.sections("camera"), root.sections("valve", low=0)
    root.done()
    rig = RigFile(name, path, _bus(bus), _gripper(gripper), _lift(lift), tuple(map(_camera, cameras)),
                  tuple(map(_valve, valves)), _emulator(emulator) if emulator else None)
    _check(rig, root)
    return rig


def _check(rig: RigFile, root: Section) -> None:
    """What joins several sections: one camera and at most one valve a finger, servo ids all different."""
    ids = [servo.id for servo in rig.gripper.servos] + ([rig.lift.id] if rig.lift.kind == "servo" else [])
    if len(set(ids)) != len(ids):
        raise root.fail("gripper.servo", f"servo ids {ids} are not all different")
    for key, parts in (("camera", rig.cameras), ("valve", rig.valves)):
        fingers = [part.finger for part in parts]
        if fingers != list(FINGERS[: len(fingers)]):
            raise root.fail(key, f"fingers {fingers} should be {list(FINGERS[:len(fingers)])}, in this order")
    if rig.valves and len(rig.valves) != len(rig.cameras):
        raise root.fail("valve", f"{len(rig.valves)} valves for {len(rig.cameras)} cameras")


def _bus(section: Section) -> BusConfig:
    config = BusConfig(
        port=section.text("port"),
        baud=section.whole("baud", 9600, 4_000_000, default=1_000_000),
        reply_timeout=section.number("reply_timeout_ms", 0.5, 100, 1e-3, default=0.008),
        watchdog=section.number("watchdog_ms", 20, 2540, 1e-3, default=0.1),  # register 98: 1 to 127 units of 20 ms
        fast_sync=section.flag("fast_sync", False),
        host_timeout=section.number("host_timeout_ms", 50, 60000, 1e-3, default=0.25))
    section.done()
    return config


def _servo(section: Section) -> ServoConfig:
    law = section.text("law", ("rack", "crank", "table"), default="rack")
    if law == "table":
        per_rad, table = 0.0, tuple((math.radians(a), 1e-3 * x) for a, x in section.pairs("table_deg_mm"))
    else:
        per_rad, table = section.number("mm_per_rad", -500, 500, 1e-3), ()
    config = ServoConfig(
        id=section.whole("id", 0, 252), model=section.text("model"), law=law, per_rad=per_rad, table=table,
        opening_part=section.number("opening_part_mm", -500, 500, 1e-3, default=0.0),
        zero_ticks=section.whole("zero_ticks", -1_048_575, 1_048_575, default=2048),
        torque_per_A=section.number("torque_Nm_per_A", 1e-3, 100, default=None),
        position_p_gain=section.whole("position_p_gain", 0, 16383, default=None))
    section.done()
    return config


def _gripper(section: Section) -> GripperConfig:
    low = section.number("opening_min_mm", 0, 1000, 1e-3, default=0.0)
    high = section.number("opening_max_mm", 0, 1000, 1e-3)
    if high <= low:
        raise section.fail("opening_max_mm", f"{high * 1e3:g} is not above opening_min_mm = {low * 1e3:g}")
    servos = tuple(map(_servo, section.sections("servo")))
    config = GripperConfig(
        (low, high), servos, force_max=section.number("force_max_N", 0.1, 500, default=8.0),
        speed_max=section.number("speed_max_mm_s", 0.1, 1000, 1e-3, default=0.1))
    section.done()
    return config


def _lift(section: Section) -> LiftConfig:
    kind = section.text("kind", ("servo", "none"))
    speed = section.number("speed_max_mm_s", 0.1, 1000, 1e-3, default=0.05)
    if kind == "none":
        config = LiftConfig(kind, speed)
    else:
        config = LiftConfig(
            kind, speed, travel=section.number("travel_mm", 0, 2000, 1e-3), id=section.whole("id", 0, 252),
            model=section.text("model"), per_rad=section.number("mm_per_rad", -500, 500, 1e-3),
            torque_max=section.number("torque_max_Nm", 0.01, 100))
    section.done()
    return config


def _camera(section: Section) -> CameraConfig:
    config = CameraConfig(
        finger=section.text("finger", FINGERS), source=section.text("source"),
        width=section.whole("width_px", 16, 8192), height=section.whole("height_px", 16, 8192),
        rate=section.number("rate_Hz", 0.1, 2000), backend=section.text("backend", ("v4l2", "ffmpeg"), default="v4l2"),
        fourcc=section.text("fourcc", default=None),
        exposure=section.number("exposure_100us", 0, 1e6, default=None),
        gain=section.number("gain", 0, 1e6, default=None),
        white_balance=section.number("white_balance_K", 1000, 20000, default=None),
        timestamps=section.text("timestamps", ("kernel", "arrival"), default="kernel"),
        delay=section.number("delay_ms", 0, 1000, 1e-3, default=0.0))
    section.done()
    return config


def _valve(section: Section) -> ValveConfig:
    config = ValveConfig(
        finger=section.text("finger", FINGERS), port=section.text("port"), dialect=section.text("dialect", default="ctrlp"),
        channel=section.whole("channel", 1, 99, default=1), baud=section.whole("baud", 300, 4_000_000, default=115200),
        pressure_max=section.number("pressure_max_kPa", 0.01, 1000, 1e3),
        heartbeat=section.number("heartbeat_ms", 20, 60000, 1e-3, default=0.25),
        reply_timeout=section.number("reply_timeout_ms", 1, 1000, 1e-3, default=0.03),
        supply_gauge=section.number("supply_kPa", -100, 1000, 1e3, default=None))
    section.done()
    return config


def _emulator(section: Section) -> EmulatorConfig:
    config = EmulatorConfig(
        servo_model=section.text("servo_model", default="XL330-M288"),
        usb_latency=section.number("usb_latency_ms", 0, 100, 1e-3, default=1e-3),
        dialect=section.text("dialect", default="ctrlp"))
    section.done()
    return config
