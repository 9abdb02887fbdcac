"""`RigFile`: cameras, valves and servos of a rig, read from a TOML file and checked.

For the format see docs/how-to/hardware.md. All quantities are SI internally. The keys of the file
contain the unit, and each field defines its own (`mjtactile.core.config_fields`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mjtactile.core import resources
from mjtactile.core.config_fields import (
    DEGREE,
    KPA,
    MM,
    MS,
    PERCENT,
    entry,
    file_path,
    flag,
    given,
    integer,
    number,
    part,
    parts,
    read,
    read_fields,
    text,
)
from mjtactile.core.errors import InputError
from mjtactile.core.field_types import Pairs
from mjtactile.core.signature_checks import validated
from mjtactile.core.toml import Section, read_toml
from mjtactile.core.types import FINGERS
from mjtactile.rig.as_built_sensor import AsBuiltSensor
from mjtactile.rig.simulated import OPENING, SimRigFile, sim_rig_from_table

_PORT_SCHEMES = ("socket", "rfc2217")
_RATIO_LAWS = ("transmission", ("rack", "crank"))
_SERVO_LIFT = ("kind", ("servo",))


@dataclass(frozen=True)
class BusConfig:
    """Serial bus of the servos: `port`, `baud` and timing.

    `reply_timeout`, s, is added to the transmission time. A servo without messages stops after
    `watchdog`, s. With `fast_sync`, all servos answer in one reply packet (newer firmware). After
    `host_timeout`, s, without a call, the control loop counts as hung. The watchdogs are then
    allowed to trip.
    """

    port: str = text("port")
    baud: int = integer("baud", 9600, 4_000_000, default=1_000_000)
    reply_timeout: float = number("reply_timeout_ms", 0.5, 100, MS, default=0.008)
    # register 98: 1 to 127 units of 20 ms
    watchdog: float = number("watchdog_ms", 20, 2540, MS, default=0.1)
    fast_sync: bool = flag("fast_sync", default=False)
    host_timeout: float = number("host_timeout_ms", 50, 60000, MS, default=0.25)


@dataclass(frozen=True)
class ServoConfig:
    """One jaw servo.

    `opening_part`, m, is this servo's part of the gripper opening at `zero_ticks`. For
    `transmission`, `per_rad` (m/rad) and `table` (rad, m) see
    `mjtactile.devices.dynamixel.jaw_kinematics`. `torque_per_A` is in N m/A (None: data sheet).
    """

    id: int = integer("id", 0, 252)
    model: str = text("model")
    transmission: str = text("transmission", ("rack", "crank", "table"), default="rack")
    per_rad: float = number(
        "mm_per_rad", -500, 500, MM, default=0.0, required=True, only_if=_RATIO_LAWS
    )
    opening_part: float = number("jaw_offset_mm", -500, 500, MM, default=0.0)
    zero_ticks: int = integer("zero_ticks", -1_048_575, 1_048_575, default=2048)
    table: tuple[tuple[float, float], ...] = entry(
        Pairs(key="table_deg_mm", units=(DEGREE, MM), only_if=("transmission", ("table",))), ()
    )
    torque_per_A: float | None = number("torque_Nm_per_A", 1e-3, 100, default=None)
    position_p_gain: int | None = integer("position_p_gain", 0, 16383, default=None)


@dataclass(frozen=True)
class LiftConfig:
    """Lift of the gripper: `"servo"` (rack with `per_rad`, m/rad, and `travel`, m) or `"none"`.

    Without a lift, the requested height is reported as reached at `speed`, m/s.
    """

    kind: str = text("kind", ("servo", "none"), default="none", required=True)
    speed: float = number("speed_max_mm_s", 0.1, 1000, MM, default=0.05)
    travel: float = number(
        "travel_mm", 0, 2000, MM, default=0.15, required=True, only_if=_SERVO_LIFT
    )
    id: int = integer("id", 0, 252, default=3, required=True, only_if=_SERVO_LIFT)
    model: str = text("model", default="", required=True, only_if=_SERVO_LIFT)
    per_rad: float = number(
        "mm_per_rad", -500, 500, MM, default=0.02, required=True, only_if=_SERVO_LIFT
    )
    torque_max: float = number(
        "torque_max_Nm", 0.01, 100, default=1.0, required=True, only_if=_SERVO_LIFT
    )


@dataclass(frozen=True)
class GripperConfig:
    """Jaws of the gripper.

    `opening`, m (minimum, maximum), `force_max` on each finger, N, `speed_max` of the opening, m/s.
    `backlash`, m of the opening, is a gear play that is compensated.
    `calibration` is the file that `calibrate gripper` writes (None: not specified).
    """

    opening: tuple[float, float] = entry(OPENING)
    servos: tuple[ServoConfig, ...] = parts("servo", ServoConfig)
    force_max: float = number("force_max_N", 0.1, 500, default=8.0)
    speed_max: float = number("speed_max_mm_s", 0.1, 1000, MM, default=0.1)
    backlash: float = number("backlash_mm", 0, 5, MM, default=0.0)
    calibration: Path | None = file_path("calibration")


UNFLIPPED = "no"
FLIPS = (UNFLIPPED, "left-right", "top-bottom", "both")
"""Flips of a camera image; "both" is upside down."""


@dataclass(frozen=True)
class CameraConfig:
    """Camera of one finger.

    `source` is a device file or the address of a stream. A camera control of None is left
    unchanged. `backend` is "v4l2", "ffmpeg" or a driver registered as an entry point of
    `mjtactile.cameras`. `fourcc` is requested from a V4L2 camera. For a stream (ffmpeg) it declares
    the received format: "MJPG" is decoded directly to grayscale. `timestamps` is "kernel" (from
    V4L2, monotonic clock) or "arrival" (streams, which carry none). `delay`, s, is the time from
    capture to arrival for "arrival". `sensor` is the finger's own sensor file and `calibration` its
    measured calibration (None: not specified). `flipped` is the flip after which the sensor's x
    points right in the image and its y down.
    """

    finger: str = text("finger", FINGERS)
    source: str = text("source")
    width: int = integer("width_px", 16, 8192)
    height: int = integer("height_px", 16, 8192)
    rate: float = number("rate_Hz", 0.1, 2000)
    backend: str = text("backend", default="v4l2")
    fourcc: str | None = text("fourcc", default=None)
    exposure: float | None = number("exposure_100us", 0, 1e6, default=None)
    gain: float | None = number("gain", 0, 1e6, default=None)
    white_balance: float | None = number("white_balance_K", 1000, 20000, default=None)
    timestamps: str = text("timestamps", ("kernel", "arrival"), default="kernel")
    delay: float = number("delay_ms", 0, 1000, MS, default=0.0)
    flipped: str = text("flipped", FLIPS, default=UNFLIPPED)
    sensor: str | None = file_path("sensor", shipped=True)
    calibration: Path | None = file_path("calibration")

    def validate(self, section: Section) -> None:
        """Check that `fourcc` consists of four characters, which the driver requires."""
        code = self.fourcc
        if code is not None and not (len(code) == 4 and code.isascii() and code.isprintable()):
            raise section.fail("fourcc", f"{code!r} is not a code of four characters such as MJPG")


@dataclass(frozen=True)
class ValveConfig:
    """Valve of one finger's chamber, at `channel` of the board at `port` (firmware/valve).

    `pressure_max`, Pa gauge, is set in the board. `pressure_rate`, Pa/s, is the maximum rate for a
    controller. The board vents after `heartbeat`, s, without a message. `reply_timeout`, s, limits
    the reply to a heartbeat request. `supply_gauge`, Pa, applies to a board without a sensor.
    """

    finger: str = text("finger", FINGERS)
    port: str = text("port")
    channel: int = integer("channel", 1, 99, default=1)
    baud: int = integer("baud", 300, 4_000_000, default=115200)
    pressure_max: float = number("pressure_max_kPa", 0.01, 1000, KPA, default=3000.0, required=True)
    pressure_rate: float = number("pressure_rate_kPa_s", 0.01, 100, KPA, default=1200.0)
    heartbeat: float = number("heartbeat_ms", 20, 60000, MS, default=0.25)
    reply_timeout: float = number("reply_timeout_ms", 1, 1000, MS, default=0.03)
    supply_gauge: float | None = number("supply_kPa", -100, 1000, KPA, default=None)

    def validate(self, section: Section) -> None:
        """Check that the port is a device file, or one of two of pyserial's URLs.

        Other URLs of pyserial write to files that a rig file names.
        """
        scheme, separator, _ = self.port.partition("://")
        if separator and scheme not in _PORT_SCHEMES:
            urls = " or ".join(f"{scheme}://" for scheme in _PORT_SCHEMES)
            raise section.fail("port", f"{self.port!r} is neither a device nor {urls}")


@dataclass(frozen=True)
class EmulatorConfig:
    """Settings of the emulated hardware; ports in such a rig file are "emulator".

    `torque_fraction` is the excess of the servos' torque per ampere over the data sheet.
    `backlash`, m, is the change of opening that the shafts make before the jaws follow.
    `servo_firmware` None is the newest. `watchdog` is the state of a servo after a tripped bus
    watchdog: held in position ("brake") or free ("limp").
    """

    usb_latency: float = number("usb_latency_ms", 0, 100, MS, default=1e-3)
    valve_sensors: bool = flag("valve_sensors", default=True)
    torque_fraction: float = number("torque_percent", -50, 100, PERCENT, default=0.0)
    backlash: float = number("backlash_mm", 0, 5, MM, default=0.0)
    servo_firmware: int | None = integer("servo_firmware", 1, 255, default=None)
    watchdog: str = text("watchdog", ("brake", "limp"), default="brake")
    as_built: tuple[AsBuiltSensor, ...] = ()

    @classmethod
    def from_section(cls, section: Section) -> EmulatorConfig:
        """Read `[emulator]` with its sections `[emulator.as_built.FINGER]`."""
        values = read_fields(cls, section)
        return cls(**values, as_built=_as_built(section.optional("as_built")))

    def as_built_sensor(self, finger: str) -> AsBuiltSensor:
        """Return the as-built sensor of a finger; without an entry it equals the sensor file."""
        return next((s for s in self.as_built if s.finger == finger), AsBuiltSensor(finger))


def _as_built(section: Section | None) -> tuple[AsBuiltSensor, ...]:
    """Return the as-built sensors of the fingers that have one."""
    if section is None:
        return ()
    found = [(finger, section.optional(finger)) for finger in FINGERS]
    section.done()
    return tuple(read(AsBuiltSensor, values, finger=finger) for finger, values in found if values)


@dataclass(frozen=True)
class RigFile:
    """Complete rig of real or emulated devices.

    `emulator` is None for real hardware. `on_host_loss` selects the reaction to a late or lost
    host. "hold": chambers stay sealed for `hold_time`, s, and then vent slowly. "open": they vent
    immediately. The jaws stop in both cases, provided that their watchdogs work as specified.
    """

    name: str = text("name")
    path: Path = given()
    bus: BusConfig = part("bus", BusConfig)
    gripper: GripperConfig = part("gripper", GripperConfig)
    lift: LiftConfig = part("lift", LiftConfig)
    cameras: tuple[CameraConfig, ...] = parts("camera", CameraConfig)
    valves: tuple[ValveConfig, ...] = parts("valve", ValveConfig, low=0)
    on_host_loss: str = text("on_host_loss", ("open", "hold"), default="open")
    hold_time: float = number("host_loss_hold_s", 0.1, 600, default=10.0)
    emulator: EmulatorConfig | None = part("emulator", EmulatorConfig, default=None)

    @property
    def backend(self) -> str:
        """Backend that builds this rig (see `mjtactile.rig.registry`)."""
        return "devices" if self.emulator is None else "emulator"

    @property
    def hold(self) -> float:
        """Time that chambers stay sealed without a host after the heartbeat timeout, s."""
        return self.hold_time if self.on_host_loss == "hold" else 0.0

    def validate(self, section: Section) -> None:
        """Check for one camera and at most one valve per finger, and for distinct servo ids."""
        ids = [servo.id for servo in self.gripper.servos]
        if self.lift.kind == "servo":
            ids.append(self.lift.id)
        if len(set(ids)) != len(ids):
            raise section.fail("gripper.servo", f"servo ids {ids} are not all different")
        for key, devices in (("camera", self.cameras), ("valve", self.valves)):
            fingers = [device.finger for device in devices]
            requested = list(FINGERS[: len(fingers)])
            if fingers != requested:
                raise section.fail(key, f"fingers {fingers} should be {requested}, in this order")
            if len({_connection(device) for device in devices}) < len(devices):
                raise section.fail(key, f"two fingers have the same {key}")
        if self.valves and len(self.valves) != len(self.cameras):
            message = f"{len(self.valves)} valves for {len(self.cameras)} cameras"
            raise section.fail("valve", message)


def _connection(device: CameraConfig | ValveConfig) -> object:
    """Return the values that distinguish a device from others; of an emulated camera its finger."""
    if isinstance(device, ValveConfig):
        return device.port, device.channel
    return device.finger if device.source == "emulator" else device.source


def read_rig_file(name_or_path: str | Path) -> RigFile | SimRigFile:
    """Read a rig by shipped name or from a TOML file.

    The section [sim] identifies a simulated rig. Raises InputError naming file, field, value and
    valid choices.
    """
    path = resources.find(name_or_path, "models/rigs", ".toml")
    table = read_toml(path)
    return sim_rig_from_table(table, path) if "sim" in table else rig_from_table(table, path)


@validated()
def load_rig_file(name_or_path: str | Path) -> RigFile:
    """Read the rig file of real or emulated devices.

    Args:
        name_or_path: A shipped name, or a TOML file.

    Returns:
        The rig, SI.

    Raises:
        InputError: The file is missing or wrong, or its rig is simulated.
    """
    rig = read_rig_file(name_or_path)
    if isinstance(rig, SimRigFile):
        raise InputError("is simulated: it has no devices", source=rig.path, field="[sim]")
    return rig


def load_sim_rig(name_or_path: str | Path) -> SimRigFile:
    """Read a rig file of the simulator. Raises InputError for a rig of devices, and as
    `read_rig_file`."""
    rig = read_rig_file(name_or_path)
    if isinstance(rig, RigFile):
        raise InputError("is not simulated: the section is missing", source=rig.path, field="[sim]")
    return rig


def rig_from_table(table: Mapping[str, Any], path: Path) -> RigFile:
    """Validate a parsed TOML table of devices; `path` is its file. Raises InputError; see
    `read_rig_file`."""
    root = Section(table, "", str(path))
    return read(RigFile, root, name=root.text("name", default=path.stem), path=path)
