"""`RigFile`: which camera, valve and servos a rig has, read from a TOML file and checked. The
format: docs/hardware.md.

Every quantity is SI inside; the file's keys carry the unit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mjtactile.core import resources
from mjtactile.core.errors import InputError
from mjtactile.core.toml import Section, read_toml
from mjtactile.core.types import FINGERS
from mjtactile.rig.simulated import SimRigFile, sim_rig_from_table
from mjtactile.rig.specimen import SpecimenConfig, read_specimen

_PORT_SCHEMES = ("socket", "rfc2217")


@dataclass(frozen=True)
class BusConfig:
    """Serial bus of the servos: `port`, `baud`, `reply_timeout` s on top of the wire's own time,
    `watchdog` s after which a servo that hears nothing stops by itself, `fast_sync`: ask all servos
    in one reply packet (newer firmware), `host_timeout` s after which a control loop that calls no
    more counts as hung: the watchdogs are then let trip."""

    port: str
    baud: int = 1_000_000
    reply_timeout: float = 0.008
    watchdog: float = 0.1
    fast_sync: bool = False
    host_timeout: float = 0.25


@dataclass(frozen=True)
class ServoConfig:
    """One jaw servo. `opening_part` m of the gripper's opening belong to this servo at
    `zero_ticks`; see `mjtactile.devices.dynamixel.jaws` for `law`, `per_rad` (m/rad) and `table`
    (rad, m). `torque_per_A` N m/A (None: data sheet).
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
    """What lifts the hand: `"servo"` (rack of `per_rad` m/rad, `travel` m) or `"none"`: nothing
    does; the height that was asked for is reported as reached at `speed` m/s."""

    kind: str = "none"
    speed: float = 0.05
    travel: float = 0.15
    id: int = 3
    model: str = ""
    per_rad: float = 0.02
    torque_max: float = 1.0


@dataclass(frozen=True)
class GripperConfig:
    """Jaws: `opening` m (lowest, highest), `force_max` N on each finger, `speed_max` m/s of the
    opening; `calibration` is the file that `calibrate gripper` writes (None: none is named)."""

    opening: tuple[float, float]
    servos: tuple[ServoConfig, ...]
    force_max: float = 8.0
    speed_max: float = 0.1
    calibration: Path | None = None


@dataclass(frozen=True)
class CameraConfig:
    """One finger's camera. `source`: a device file or a stream's address. None of a control: leave
    it as it is.

    `backend`: "v4l2", "ffmpeg" or a driver that somebody registered as an entry point of
    `mjtactile.cameras`. `fourcc` is asked of a V4L2 camera; of a stream (ffmpeg) it says what
    comes: "MJPG" is decoded straight to grey. `timestamps`: "kernel" (V4L2's, on the monotonic
    clock) or "arrival" (streams, which carry none). `delay` s from capture to arrival for
    "arrival". `sensor` is the finger's own sensor file and `calibration` what was measured of it
    (None: none is named)."""

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
    sensor: str | None = None
    calibration: Path | None = None


@dataclass(frozen=True)
class ValveConfig:
    """Valve of one finger's chamber: `channel` on the board at `port` (firmware/valve);
    `pressure_max` Pa gauge is set in the board, `heartbeat` s is the silence after which the board
    vents, `reply_timeout` s what an answer to the heartbeat's questions may take, `supply_gauge` Pa
    of a board without a sensor."""

    finger: str
    port: str
    channel: int = 1
    baud: int = 115200
    pressure_max: float = 3000.0
    heartbeat: float = 0.25
    reply_timeout: float = 0.03
    supply_gauge: float | None = None


@dataclass(frozen=True)
class EmulatorConfig:
    """How to start the emulated hardware; the ports of such a file are "emulator". `torque_share`:
    how much more torque per ampere its servos give than their data sheet says; `servo_firmware`
    None: the newest; `watchdog`: what a tripped bus watchdog leaves of a servo, held where it is
    ("brake") or free ("limp")."""

    usb_latency: float = 1e-3
    valve_sensors: bool = True
    torque_share: float = 0.0
    servo_firmware: int | None = None
    watchdog: str = "brake"
    specimens: tuple[SpecimenConfig, ...] = ()

    def specimen(self, finger: str) -> SpecimenConfig:
        """That finger's; one like the sensor file where nothing else is said."""
        return next((s for s in self.specimens if s.finger == finger), SpecimenConfig(finger))


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

    @property
    def backend(self) -> str:
        """Which builder of rigs this file is for (see `mjtactile.rig.registry`)."""
        return "devices" if self.emulator is None else "emulator"


def read_rig_file(name_or_path: str | Path) -> RigFile | SimRigFile:
    """Read a rig by shipped name or from a TOML file; a simulated one is known by its section
    [sim].

    Raises InputError naming file, field, value and valid choices.
    """
    path = resources.find(name_or_path, "models/rigs", ".toml")
    table = read_toml(path)
    return sim_rig_from_table(table, path) if "sim" in table else rig_from_table(table, path)


def load_rig_file(name_or_path: str | Path) -> RigFile:
    """Like `read_rig_file`, for jobs that need devices, real or emulated. Raises InputError for a
    simulated rig."""
    rig = read_rig_file(name_or_path)
    if isinstance(rig, SimRigFile):
        raise InputError("is simulated: it has no devices", source=rig.path, field="[sim]")
    return rig


def load_sim_rig(name_or_path: str | Path) -> SimRigFile:
    """Like `read_rig_file`, for the simulator. Raises InputError for a rig of devices."""
    rig = read_rig_file(name_or_path)
    if isinstance(rig, RigFile):
        raise InputError("is not simulated: the section is missing", source=rig.path, field="[sim]")
    return rig


def rig_from_table(table: Mapping[str, Any], path: Path) -> RigFile:
    """Validate a parsed TOML table of devices; see `read_rig_file`."""
    root = Section(table, "", str(path))
    name = root.text("name", default=path.stem)
    emulator = root.optional("emulator")
    bus, gripper, lift = (root.section(key) for key in ("bus", "gripper", "lift"))
    cameras = root.sections("camera")
    valves = root.sections("valve", low=0)
    root.done()
    folder = path.parent
    rig = RigFile(
        name,
        path,
        _bus(bus),
        _gripper(gripper, folder),
        _lift(lift),
        tuple(_camera(c, folder) for c in cameras),
        tuple(map(_valve, valves)),
        _emulator(emulator) if emulator else None,
    )
    _check(rig, root)
    return rig


def _check(rig: RigFile, root: Section) -> None:
    """What joins several sections: one camera and at most one valve a finger, servo ids all
    different."""
    ids = [servo.id for servo in rig.gripper.servos] + (
        [rig.lift.id] if rig.lift.kind == "servo" else []
    )
    if len(set(ids)) != len(ids):
        raise root.fail("gripper.servo", f"servo ids {ids} are not all different")
    for key, parts in (("camera", rig.cameras), ("valve", rig.valves)):
        fingers = [part.finger for part in parts]
        if fingers != list(FINGERS[: len(fingers)]):
            raise root.fail(
                key, f"fingers {fingers} should be {list(FINGERS[: len(fingers)])}, in this order"
            )
    if rig.valves and len(rig.valves) != len(rig.cameras):
        raise root.fail("valve", f"{len(rig.valves)} valves for {len(rig.cameras)} cameras")


def _bus(section: Section) -> BusConfig:
    config = BusConfig(
        port=section.text("port"),
        baud=section.whole("baud", 9600, 4_000_000, default=1_000_000),
        reply_timeout=section.number("reply_timeout_ms", 0.5, 100, 1e-3, default=0.008),
        # register 98: 1 to 127 units of 20 ms
        watchdog=section.number("watchdog_ms", 20, 2540, 1e-3, default=0.1),
        fast_sync=section.flag("fast_sync", False),
        host_timeout=section.number("host_timeout_ms", 50, 60000, 1e-3, default=0.25),
    )
    section.done()
    return config


def _servo(section: Section) -> ServoConfig:
    law = section.text("law", ("rack", "crank", "table"), default="rack")
    if law == "table":
        per_rad = 0.0
        table = tuple((math.radians(a), 1e-3 * x) for a, x in section.pairs("table_deg_mm"))
    else:
        per_rad = section.number("mm_per_rad", -500, 500, 1e-3)
        table = ()
    config = ServoConfig(
        id=section.whole("id", 0, 252),
        model=section.text("model"),
        law=law,
        per_rad=per_rad,
        table=table,
        opening_part=section.number("opening_part_mm", -500, 500, 1e-3, default=0.0),
        zero_ticks=section.whole("zero_ticks", -1_048_575, 1_048_575, default=2048),
        torque_per_A=section.number("torque_Nm_per_A", 1e-3, 100, default=None),
        position_p_gain=section.whole("position_p_gain", 0, 16383, default=None),
    )
    section.done()
    return config


def _beside(folder: Path, name: str | None) -> Path | None:
    """A file that a rig file names, relative to where that stands."""
    return None if name is None else folder / name


def _gripper(section: Section, folder: Path) -> GripperConfig:
    low = section.number("opening_min_mm", 0, 1000, 1e-3, default=0.0)
    high = section.number("opening_max_mm", 0, 1000, 1e-3)
    if high <= low:
        raise section.fail(
            "opening_max_mm", f"{high * 1e3:g} is not above opening_min_mm = {low * 1e3:g}"
        )
    servos = tuple(map(_servo, section.sections("servo")))
    config = GripperConfig(
        (low, high),
        servos,
        force_max=section.number("force_max_N", 0.1, 500, default=8.0),
        speed_max=section.number("speed_max_mm_s", 0.1, 1000, 1e-3, default=0.1),
        calibration=_beside(folder, section.text("calibration", default=None)),
    )
    section.done()
    return config


def _lift(section: Section) -> LiftConfig:
    kind = section.text("kind", ("servo", "none"))
    speed = section.number("speed_max_mm_s", 0.1, 1000, 1e-3, default=0.05)
    if kind == "none":
        config = LiftConfig(kind, speed)
    else:
        config = LiftConfig(
            kind,
            speed,
            travel=section.number("travel_mm", 0, 2000, 1e-3),
            id=section.whole("id", 0, 252),
            model=section.text("model"),
            per_rad=section.number("mm_per_rad", -500, 500, 1e-3),
            torque_max=section.number("torque_max_Nm", 0.01, 100),
        )
    section.done()
    return config


def _camera(section: Section, folder: Path) -> CameraConfig:
    sensor = section.text("sensor", default=None)  # a shipped name, or a file
    config = CameraConfig(
        finger=section.text("finger", FINGERS),
        source=section.text("source"),
        width=section.whole("width_px", 16, 8192),
        height=section.whole("height_px", 16, 8192),
        rate=section.number("rate_Hz", 0.1, 2000),
        backend=section.text("backend", default="v4l2"),
        fourcc=section.text("fourcc", default=None),
        exposure=section.number("exposure_100us", 0, 1e6, default=None),
        gain=section.number("gain", 0, 1e6, default=None),
        white_balance=section.number("white_balance_K", 1000, 20000, default=None),
        timestamps=section.text("timestamps", ("kernel", "arrival"), default="kernel"),
        delay=section.number("delay_ms", 0, 1000, 1e-3, default=0.0),
        sensor=str(folder / sensor) if sensor is not None and sensor.endswith(".toml") else sensor,
        calibration=_beside(folder, section.text("calibration", default=None)),
    )
    section.done()
    return config


def _valve(section: Section) -> ValveConfig:
    config = ValveConfig(
        finger=section.text("finger", FINGERS),
        port=_valve_port(section),
        channel=section.whole("channel", 1, 99, default=1),
        baud=section.whole("baud", 300, 4_000_000, default=115200),
        pressure_max=section.number("pressure_max_kPa", 0.01, 1000, 1e3),
        heartbeat=section.number("heartbeat_ms", 20, 60000, 1e-3, default=0.25),
        reply_timeout=section.number("reply_timeout_ms", 1, 1000, 1e-3, default=0.03),
        supply_gauge=section.number("supply_kPa", -100, 1000, 1e3, default=None),
    )
    section.done()
    return config


def _valve_port(section: Section) -> str:
    """A device file, or one of two of pyserial's URLs: others of them write to files that a rig
    file names."""
    port = section.text("port")
    scheme, separator, _ = port.partition("://")
    if separator and scheme not in _PORT_SCHEMES:
        raise section.fail(
            "port",
            f"{port!r} is neither a device nor {' or '.join(s + '://' for s in _PORT_SCHEMES)}",
        )
    return port


def _emulator(section: Section) -> EmulatorConfig:
    config = EmulatorConfig(
        usb_latency=section.number("usb_latency_ms", 0, 100, 1e-3, default=1e-3),
        valve_sensors=section.flag("valve_sensors", True),
        torque_share=section.number("torque_percent", -50, 100, 1e-2, default=0.0),
        servo_firmware=section.whole("servo_firmware", 1, 255, default=None),
        watchdog=section.text("watchdog", ("brake", "limp"), default="brake"),
        specimens=_specimens(section.optional("specimen")),
    )
    section.done()
    return config


def _specimens(section: Section | None) -> tuple[SpecimenConfig, ...]:
    """`[emulator.specimen.left]` and so on, of the fingers that have one."""
    if section is None:
        return ()
    found = [(finger, section.optional(finger)) for finger in FINGERS]
    section.done()
    return tuple(read_specimen(finger, own) for finger, own in found if own is not None)
