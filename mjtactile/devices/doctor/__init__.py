"""Checks of `mjtactile doctor`. Each check returns findings as text with a remedy, and moves no
device."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator

from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.errors import DeviceError
from mjtactile.core.types import Image
from mjtactile.devices.camera.v4l2 import video_devices
from mjtactile.devices.discovery import serial_ports
from mjtactile.devices.doctor.cameras import ViewCheck, check_camera
from mjtactile.devices.doctor.ports import check_port
from mjtactile.devices.doctor.servos import check_servos
from mjtactile.devices.dynamixel.servo_models import MODELS
from mjtactile.devices.valve.driver import connect_valves
from mjtactile.rig.doctor_finding import Finding
from mjtactile.rig.file import RigFile, load_rig_file
from mjtactile.rig.sensors import calibration_findings, finger_design

# maximum ratio to the data sheet's torque per ampere; gear friction takes up to 20 % of it
_TORQUE_OFF_MAX = 1.5
_FALL_WARNING = "a held object falls when the host is lost: use servos that brake, or a cup below"


def _check_empty_view(subject: str, design: SensorDesign, image: Image) -> Iterable[Finding]:
    return ()


def examine(
    rig: str | None,
    *,
    sensor: str = "dense",
    fix: bool = False,
    check_view: ViewCheck = _check_empty_view,
) -> list[Finding]:
    """Return all findings for a rig.

    `sensor` applies to fingers without a sensor in the rig file. `check_view` checks an image of
    each finger. Raises InputError for an invalid rig file.
    """
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
                "is emulated: no device needs to be connected",
                "`mjtactile emulate --out FILE.toml` starts it; then "
                "`mjtactile doctor --rig FILE.toml`",
            ),
        ]
    ports = [*check_port("servo bus", rig_file.bus.port, fix=fix)]
    findings += ports if _has_bad(ports) else [*ports, *check_servos(rig_file)]
    ports = []
    for port in dict.fromkeys(valve.port for valve in rig_file.valves):
        ports += check_port("valve board", port, fix=fix)
    findings += ports if _has_bad(ports) else [*ports, *_check_valves(rig_file)]
    for camera in rig_file.cameras:
        design = finger_design(camera, load_sensor(sensor))
        findings += check_camera(camera, design, check_view)
    return findings


def _check_torques(rig_file: RigFile) -> Iterator[Finding]:
    """Report a torque per ampere outside of the servo model's range."""
    for servo in rig_file.gripper.servos:
        model = MODELS.get(servo.model)
        if model is None or servo.torque_per_A is None:
            continue
        ratio = servo.torque_per_A / model.torque_per_A
        if not 1 / _TORQUE_OFF_MAX <= ratio <= _TORQUE_OFF_MAX:
            yield Finding(
                "bad",
                f"servo {servo.id}",
                f"torque_Nm_per_A = {servo.torque_per_A:g}, but the data sheet of the "
                f"{servo.model} has {model.torque_per_A:g}: forces are {ratio:.2g} times "
                "their correct value",
                "remove the line, or measure it: mjtactile calibrate gripper",
            )


def _check_host_loss(rig_file: RigFile) -> Iterator[Finding]:
    """Report the effect of a late or lost host on a held object."""
    subject = "lost host"
    heartbeat = min((valve.heartbeat for valve in rig_file.valves), default=0.0)
    chambers = f"chambers vent {1e3 * heartbeat:.0f} ms after the last line"
    if not rig_file.valves:
        chambers = "chambers stay as they are: no valve board"
    elif rig_file.hold:
        chambers = f"chambers stay sealed for {rig_file.hold:g} s, then vent slowly"
    text = f'on_host_loss = "{rig_file.on_host_loss}": {chambers}'
    if rig_file.emulator is not None and rig_file.emulator.watchdog == "limp":
        yield Finding(
            "warn",
            subject,
            f"{text}; the servos switch their torque off and hold nothing",
            _FALL_WARNING,
        )
    elif rig_file.lift.kind == "servo":
        remedy = "a lift that must not fall needs a brake or a counterweight"
        yield Finding("ok", subject, f"{text}; for jaws and lift see each servo below", remedy)
    else:
        yield Finding("ok", subject, f"{text}; for the jaws see each servo below")


def _has_bad(findings: list[Finding]) -> bool:
    return any(finding.level == "bad" for finding in findings)


def _plugged_in() -> Iterator[Finding]:
    """List the same ports and cameras as `mjtactile devices`, without queries."""
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


def _check_valves(rig_file: RigFile) -> Iterator[Finding]:
    """Check handshake, limits and a reading of each valve, which stays vented."""
    if not rig_file.valves:
        return
    try:
        boards, valves = connect_valves(rig_file.valves, rig_file.hold)
    except DeviceError as error:
        yield Finding(
            "bad",
            "valve board",
            str(error),
            "check port and baud in the rig file, that firmware/valve is on the board, and "
            "that no other program uses the port",
        )
        return
    try:
        for valve in valves:
            subject = f"valve {valve.config.finger}"
            try:
                state = valve.state()
            except DeviceError as error:
                yield Finding("bad", subject, str(error))
                continue
            if state.gauge_pressure is None:
                pressure = "no pressure sensor"
            else:
                pressure = f"{state.gauge_pressure:.0f} Pa"
            board = f"firmware {valve.board.firmware}"
            yield Finding("ok", subject, f"{board}, channel {valve.config.channel}, {pressure}")
    finally:
        for board in boards:
            with contextlib.suppress(DeviceError):
                board.close()
