"""What `mjtactile doctor` looks at. Each check returns findings in plain words with a remedy; none
moves anything."""

from __future__ import annotations

import contextlib
import os
import statistics
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from mjtactile.core import pace
from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.errors import DeviceError
from mjtactile.core.types import Image
from mjtactile.devices.camera.opencv import OpenCvCamera
from mjtactile.devices.camera.v4l2 import video_devices
from mjtactile.devices.dynamixel.bus import BusError, DynamixelBus
from mjtactile.devices.dynamixel.gripper import read_report
from mjtactile.devices.dynamixel.servo import REQUIRED
from mjtactile.devices.dynamixel.tables import MODELS, NO_CURRENT_CONTROL
from mjtactile.devices.listing import BAUDS, serial_ports, servos_at
from mjtactile.devices.valve.driver import connect_valves
from mjtactile.rig.file import BusConfig, CameraConfig, RigFile, load_rig_file
from mjtactile.rig.finding import Finding
from mjtactile.rig.sensors import calibration_findings, finger_design

# s for three servos at 1 Mbaud with latency_timer = 1; 16 ms is the driver's default timer
_ROUND_TRIP_GOOD = 4e-3
# times the data sheet's torque per ampere; gears' friction takes up to 20 % of it
_TORQUE_OFF_MOST = 1.5
_MAY_FALL = "what is held in the air falls when the host is lost: servos that brake, or a cup"
_HOT = 60.0  # degrees C; X series shut down at 70
_CAMERA_TIME = 2.0  # s that pictures of a camera are counted

Look = Callable[[str, SensorDesign, Image], Iterable[Finding]]
"""What is found in a picture of the camera of that name, with that sensor before it."""


def _look_at_nothing(what: str, design: SensorDesign, image: Image) -> Iterable[Finding]:
    return ()


def examine(
    rig: str | None, *, sensor: str = "dense", fix: bool = False, look: Look = _look_at_nothing
) -> list[Finding]:
    """All findings; `sensor` is on fingers of which the rig file does not say it, and `look` what
    is asked of a picture of each. Raises InputError for a rig file that is wrong itself."""
    findings = [*_plugged_in()]
    if rig is None:
        return findings
    rig_file = load_rig_file(rig)
    findings += calibration_findings(rig_file, load_sensor(sensor))
    findings += _check_torques(rig_file)
    findings += _check_host_loss(rig_file)
    if rig_file.emulator is not None:
        return [
            *findings,
            Finding(
                "ok",
                rig_file.name,
                "is emulated: nothing to be plugged in",
                "`mjtactile emulate --out FILE.toml` starts it; then "
                "`mjtactile doctor --rig FILE.toml`",
            ),
        ]
    ports = [*_check_port("servo bus", rig_file.bus.port, fix=fix)]
    findings += ports if _has_bad(ports) else [*ports, *_check_servos(rig_file)]
    ports = []
    for port in dict.fromkeys(valve.port for valve in rig_file.valves):
        ports += _check_port("valve board", port, fix=fix)
    findings += ports if _has_bad(ports) else [*ports, *_check_valves(rig_file)]
    for camera in rig_file.cameras:
        design = finger_design(camera, load_sensor(sensor))
        findings += _check_camera(camera, design, look)
    return findings


def _check_torques(rig_file: RigFile) -> Iterator[Finding]:
    """Torque per ampere that no specimen of the model can have: forces would be off by as much."""
    for servo in rig_file.gripper.servos:
        model = MODELS.get(servo.model)
        if model is None or servo.torque_per_A is None:
            continue
        ratio = servo.torque_per_A / model.torque_per_A
        if not 1 / _TORQUE_OFF_MOST <= ratio <= _TORQUE_OFF_MOST:
            yield Finding(
                "bad",
                f"servo {servo.id}",
                f"torque_Nm_per_A = {servo.torque_per_A:g}, but the data sheet of the "
                f"{servo.model} says {model.torque_per_A:g}: forces are {ratio:.2g} times what "
                "they should be",
                "leave the line out, or measure it: mjtactile calibrate gripper",
            )


def _check_host_loss(rig_file: RigFile) -> Iterator[Finding]:
    """What becomes of what is held when the host is late or gone."""
    what = "lost host"
    heartbeat = min((valve.heartbeat for valve in rig_file.valves), default=0.0)
    chambers = f"chambers vent {1e3 * heartbeat:.0f} ms after the last line"
    if not rig_file.valves:
        chambers = "chambers stay as they are: no valve board"
    elif rig_file.hold:
        chambers = f"chambers stay sealed for {rig_file.hold:g} s, then vent slowly"
    text = f'on_host_loss = "{rig_file.on_host_loss}": {chambers}'
    if rig_file.emulator is not None and rig_file.emulator.watchdog == "limp":
        yield Finding("warn", what, f"{text}; the servos go limp and hold nothing", _MAY_FALL)
    elif rig_file.lift.kind == "servo":
        remedy = "a lift that must not fall needs a brake or a counterweight"
        yield Finding("ok", what, f"{text}; jaws and lift stay as each servo does, below", remedy)
    else:
        yield Finding("ok", what, f"{text}; jaws stay as each servo does, below")


def _has_bad(findings: list[Finding]) -> bool:
    return any(finding.level == "bad" for finding in findings)


def _plugged_in() -> Iterator[Finding]:
    """The same ports and cameras that `mjtactile devices` lists; nobody is asked."""
    ports = serial_ports(ask=False)
    for port in ports:
        yield Finding("ok", "serial port", f"{port.path} ({port.description})")
    cameras = video_devices()
    for camera in cameras:
        yield Finding("ok", "camera", f"{camera.path} ({camera.name})")
    if not ports:
        yield Finding(
            "warn",
            "serial ports",
            "none found",
            "plug the adapters in; in a container, pass their devices through",
        )
    if not cameras:
        yield Finding(
            "warn",
            "cameras",
            "none found",
            "plug them in; in a container, pass their devices through",
        )


def _check_port(what: str, path: str, *, fix: bool) -> Iterator[Finding]:
    """That the port is there, may be used, and does not wait 16 ms to hand over what it
    received."""
    if "://" in path:
        return
    if not Path(path).exists():
        yield Finding(
            "bad",
            what,
            f"{path} is not there",
            "is it plugged in? `ls -l /dev/serial/by-id` shows the names that stay the same; write "
            "one of them into the rig file",
        )
        return
    if not os.access(path, os.R_OK | os.W_OK):
        group = _group(path)
        yield Finding(
            "bad",
            what,
            f"{path} may not be used by this user",
            f"sudo usermod -aG {group} $USER, then log in again",
        )
        return
    timer = Path("/sys/bus/usb-serial/devices") / Path(path).resolve().name / "latency_timer"
    if timer.is_file():
        yield from _check_latency(what, timer, fix=fix)


def _check_latency(what: str, timer: Path, *, fix: bool) -> Iterator[Finding]:
    value = timer.read_text().strip()
    if value == "1":
        yield Finding("ok", what, "latency timer 1 ms")
        return
    if fix:
        with contextlib.suppress(OSError):
            timer.write_text("1")
            yield Finding(
                "ok", what, f"latency timer was {value} ms, is 1 ms until it is unplugged"
            )
            return
    yield Finding(
        "warn",
        what,
        f"latency timer is {value} ms: each reading takes that long",
        'for good: a udev rule ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", '
        'ATTR{latency_timer}="1" in /etc/udev/rules.d/99-latency.rules; for '
        "now: --fix as root",
    )


def _group(path: str) -> str:
    with contextlib.suppress(KeyError, OSError, ImportError):
        import grp

        return grp.getgrgid(Path(path).stat().st_gid).gr_name
    return "dialout"


def _check_servos(rig_file: RigFile) -> Iterator[Finding]:
    config = rig_file.bus
    try:
        bus = DynamixelBus(config.port, config.baud, reply_timeout=config.reply_timeout)
    except DeviceError as error:
        yield Finding(
            "bad",
            "servo bus",
            str(error),
            "close the program that uses it (Dynamixel Wizard, another run)",
        )
        return
    wanted = {servo.id: servo.model for servo in rig_file.gripper.servos}
    if rig_file.lift.kind == "servo":
        wanted[rig_file.lift.id] = rig_file.lift.model
    try:
        answering = []
        for servo, model in wanted.items():
            findings = list(_check_servo(bus, servo, model))
            yield from findings
            if not any("does not answer" in f.text for f in findings):
                answering.append(servo)
        if answering:
            yield _round_trip(bus, answering, config)
    finally:
        bus.close()
    if not answering:
        yield from _search_servos(config)


def _check_servo(bus: DynamixelBus, servo: int, model: str) -> Iterator[Finding]:
    """One servo against what the file says."""
    what = f"servo {servo}"
    try:
        number, _ = bus.ping(servo)
        report = read_report(bus, servo)
    except BusError as error:
        yield Finding(
            "bad",
            what,
            f"does not answer ({error.reason})",
            "power, cable, id and baud rate: see the search below",
        )
        return
    text = (
        f"{report.model}, firmware {report.firmware}, mode {report.operating_mode}, "
        f"{report.voltage:.1f} V, "
        f"{report.temperature:.0f} C, torque {'on' if report.torque_on else 'off'}"
    )
    if report.model in MODELS:
        stops = MODELS[report.model].watchdog_stops(report.firmware)
        text += f", without a host it {'holds its place' if stops else 'goes on to its last goal'}"
    if number in NO_CURRENT_CONTROL:
        yield Finding(
            "bad", what, f"{text}: it cannot limit its force", f"use one of {', '.join(MODELS)}"
        )
    elif report.model != model:
        yield Finding(
            "bad",
            what,
            f"{text}: the rig file says {model}",
            "write the right model into the rig file, or mend the ids",
        )
    else:
        yield Finding("ok", what, text)
    for name, wanted, meaning in REQUIRED:
        if report.settings.get(name, wanted) != wanted:
            yield Finding(
                "bad",
                what,
                f"{name} is {report.settings[name]}, must be {wanted}: {meaning}",
                "set it with Dynamixel Wizard",
            )
    if report.model in MODELS and not MODELS[report.model].watchdog_stops(report.firmware):
        yield Finding(
            "warn",
            what,
            f"firmware {report.firmware}: its bus watchdog notes a dead host, and stops nothing",
            "update the firmware with Dynamixel Wizard; until then a dead host "
            "leaves it at its last goal and force",
        )
    if report.hardware_error:
        yield Finding(
            "bad",
            what,
            f"has latched {report.hardware_error}",
            "find the cause, take its power off and on",
        )
    if report.temperature >= _HOT:
        yield Finding(
            "warn", what, f"is hot: {report.temperature:.0f} C", "let it cool; lower force_max_N"
        )


def _round_trip(bus: DynamixelBus, servos: list[int], config: BusConfig) -> Finding:
    times = []
    lost = 0
    for _ in range(100):
        start = time.perf_counter()
        _, failures = bus.read_many(servos, 126, 21, fast=config.fast_sync)
        times.append(time.perf_counter() - start)
        lost += bool(failures)
    median = statistics.median(times)
    worst = max(times)
    text = (
        f"reading {len(servos)} servos takes {1e3 * median:.1f} ms (worst {1e3 * worst:.1f} "
        f"ms), {lost} of 100 replies lost"
    )
    if lost:
        return Finding(
            "warn",
            "servo bus",
            text,
            "shorter cable, termination, a good ground; or a longer reply_timeout_ms",
        )
    if median > _ROUND_TRIP_GOOD:
        return Finding(
            "warn", "servo bus", text, "baud 1000000 and latency timer 1 ms make it 1 to 3 ms"
        )
    return Finding("ok", "servo bus", text)


def _search_servos(config: BusConfig) -> Iterator[Finding]:
    """Nobody answered: look for servos with other ids and baud rates. Takes some seconds; pings
    change nothing."""
    bauds = (config.baud, *(baud for baud in BAUDS if baud != config.baud))
    with contextlib.suppress(DeviceError):
        baud, found = servos_at(config.port, bauds, reply_time=config.reply_timeout)
        if found:
            yield Finding(
                "warn",
                "servo bus",
                f"servos {list(found)} answer at {baud} baud",
                "write these into the rig file, or change the servos with Dynamixel Wizard",
            )
            return
    yield Finding(
        "bad",
        "servo bus",
        "no servo answers at any baud rate (ids 0 to 20)",
        "is their power on? USB powers none",
    )


def _check_valves(rig_file: RigFile) -> Iterator[Finding]:
    """Handshake, limits and a reading of each; connecting sets limits and heartbeat, and leaves
    every valve vented."""
    if not rig_file.valves:
        return
    try:
        boards, valves = connect_valves(rig_file.valves, rig_file.hold)
    except DeviceError as error:
        yield Finding(
            "bad",
            "valve board",
            str(error),
            "port and baud in the rig file; is firmware/valve on the board? "
            "another program on the port?",
        )
        return
    try:
        for valve in valves:
            what = f"valve {valve.config.finger}"
            try:
                state = valve.state()
            except DeviceError as error:
                yield Finding("bad", what, str(error))
                continue
            if state.pressure_gauge is None:
                pressure = "no pressure sensor"
            else:
                pressure = f"{state.pressure_gauge:.0f} Pa"
            board = f"firmware {valve.board.firmware}"
            yield Finding("ok", what, f"{board}, channel {valve.config.channel}, {pressure}")
    finally:
        for board in boards:
            with contextlib.suppress(DeviceError):
                board.close()


def _check_camera(config: CameraConfig, design: SensorDesign, look: Look) -> Iterator[Finding]:
    """Settings by read-back, then rate, age and jitter over two seconds, then what a picture
    shows."""
    what = f"camera {config.finger}"
    try:
        camera = OpenCvCamera(config)
    except DeviceError as error:
        yield Finding("bad", what, str(error), _camera_remedy(config))
        return
    try:
        ages = []
        end = pace.monotonic() + _CAMERA_TIME
        last = 0.0
        while pace.monotonic() < end:
            if camera.wait_newer(last, 0.5):
                image = camera.read()
                last = image.time
                ages.append(pace.monotonic() - last)
        yield _rate_finding(what, camera, ages)
        yield _light_finding(what, camera)
        yield from look(what, design, camera.read())
    except DeviceError as error:
        yield Finding("bad", what, str(error))
    finally:
        camera.close()


def _rate_finding(what: str, camera: OpenCvCamera, ages: list[float]) -> Finding:
    counters = camera.counters
    config = camera.config
    if len(counters.intervals) < 3:
        return Finding(
            "bad",
            what,
            f"{counters.pictures} pictures in {_CAMERA_TIME:g} s",
            "another cable or USB port",
        )
    rate = 1 / statistics.mean(counters.intervals)
    jitter = statistics.pstdev(counters.intervals)
    text = (
        f"{rate:.1f} pictures a second, jitter {1e3 * jitter:.1f} ms, age "
        f"{1e3 * statistics.median(ages):.1f} ms, "
        f"{counters.dropped} lost, {counters.duplicates} twice"
    )
    if rate < 0.9 * config.rate:
        return Finding(
            "bad",
            what,
            f"{text}: the rig file says {config.rate:g}",
            "a shorter exposure (it must fit into the period), MJPG, or its own USB controller",
        )
    return Finding("warn" if counters.duplicates else "ok", what, text)


def _light_finding(what: str, camera: OpenCvCamera) -> Finding:
    pixels = camera.read().pixels
    mean = float(pixels.mean())
    white = float((pixels >= 254).mean())
    if mean < 20:
        return Finding(
            "bad",
            what,
            f"dark: mean grey level {mean:.0f}",
            "are the LEDs on? raise exposure_100us",
        )
    if white > 0.05:
        return Finding(
            "bad",
            what,
            f"{100 * white:.0f} % of the picture is saturated",
            "lower exposure_100us or gain",
        )
    return Finding("ok", what, f"mean grey level {mean:.0f}, {100 * white:.1f} % saturated")


def _camera_remedy(config: CameraConfig) -> str:
    if config.source.startswith("/dev") and not Path(config.source).exists():
        return (
            "`ls -l /dev/v4l/by-id` shows the names that stay the same; write one of them into "
            "the rig file"
        )
    if config.source.startswith("/dev") and not os.access(config.source, os.R_OK | os.W_OK):
        return f"sudo usermod -aG {_group(config.source)} $USER, then log in again"
    return "`v4l2-ctl -d DEVICE --list-formats-ext --list-ctrls` shows what it can do"
