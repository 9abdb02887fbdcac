"""Checks of the servos against the rig file, and of their bus."""

from __future__ import annotations

import contextlib
import statistics
import time
from collections.abc import Iterator

from mjtactile.core.errors import DeviceError
from mjtactile.devices.discovery import BAUDS, servos_at
from mjtactile.devices.dynamixel.bus import BusError, DynamixelBus
from mjtactile.devices.dynamixel.servo import REQUIRED, ServoReport, read_report
from mjtactile.devices.dynamixel.servo_models import MODELS, NO_CURRENT_CONTROL
from mjtactile.rig.doctor_finding import Finding
from mjtactile.rig.file import BusConfig, RigFile

# maximum round trip time, s, for three servos at 1 Mbaud with latency_timer = 1; the driver's
# default timer is 16 ms
_ROUND_TRIP_GOOD = 4e-3


_HOT = 60.0  # degrees C; X series shut down at 70


def check_servos(rig_file: RigFile) -> Iterator[Finding]:
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
    requested = {servo.id: servo.model for servo in rig_file.gripper.servos}
    if rig_file.lift.kind == "servo":
        requested[rig_file.lift.id] = rig_file.lift.model
    try:
        answering = []
        for servo, model in requested.items():
            findings = list(check_servo(bus, servo, model))
            yield from findings
            if not any("does not answer" in f.text for f in findings):
                answering.append(servo)
        if answering:
            yield _round_trip(bus, answering, config)
    finally:
        bus.close()
    if not answering:
        yield from _search_servos(config)


def check_servo(bus: DynamixelBus, servo: int, model: str) -> Iterator[Finding]:
    """Check one servo against the rig file."""
    subject = f"servo {servo}"
    try:
        model_number, _ = bus.ping(servo)
        report = read_report(bus, servo)
    except BusError as error:
        yield Finding(
            "bad",
            subject,
            f"does not answer ({error.reason})",
            "check power, cable, id and baud rate; see the search below",
        )
        return
    yield _identity(subject, model_number, report, model)
    yield from _check_settings(subject, report)
    if report.hardware_error:
        yield Finding(
            "bad",
            subject,
            f"has latched {report.hardware_error}",
            "find the cause, then switch its power off and on",
        )
    if report.temperature >= _HOT:
        yield Finding(
            "warn", subject, f"is hot: {report.temperature:.0f} C", "let it cool; lower force_max_N"
        )


def _check_settings(subject: str, report: ServoReport) -> Iterator[Finding]:
    """Check a servo's settings, and that its firmware can stop it."""
    for name, requested, meaning in REQUIRED:
        if report.settings.get(name, requested) != requested:
            yield Finding(
                "bad",
                subject,
                f"{name} is {report.settings[name]}, must be {requested}: {meaning}",
                "set it with Dynamixel Wizard",
            )
    if report.model in MODELS and not MODELS[report.model].watchdog_stops(report.firmware):
        yield Finding(
            "warn",
            subject,
            f"firmware {report.firmware}: its bus watchdog detects a lost host, but does not "
            "stop the servo",
            "update the firmware with Dynamixel Wizard; until then the servo keeps its last "
            "goal and force when the host is lost",
        )


def _identity(subject: str, model_number: int, report: ServoReport, model: str) -> Finding:
    """Compare the responding servo with the rig file's `model`."""
    text = (
        f"{report.model}, firmware {report.firmware}, mode {report.operating_mode}, "
        f"{report.voltage:.1f} V, "
        f"{report.temperature:.0f} C, torque {'on' if report.torque_on else 'off'}"
    )
    if report.model in MODELS:
        stops = MODELS[report.model].watchdog_stops(report.firmware)
        text += f", without a host it {'holds its place' if stops else 'goes on to its last goal'}"
    if model_number in NO_CURRENT_CONTROL:
        return Finding(
            "bad", subject, f"{text}: it cannot limit its force", f"use one of {', '.join(MODELS)}"
        )
    if report.model != model:
        return Finding(
            "bad",
            subject,
            f"{text}: the rig file specifies {model}",
            "correct the model in the rig file, or the ids",
        )
    return Finding("ok", subject, text)


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
            "use a shorter cable, termination and a good ground, or a longer reply_timeout_ms",
        )
    if median > _ROUND_TRIP_GOOD:
        return Finding(
            "warn", "servo bus", text, "baud 1000000 and latency timer 1 ms reduce it to 1 to 3 ms"
        )
    return Finding("ok", "servo bus", text)


def _search_servos(config: BusConfig) -> Iterator[Finding]:
    """Search for servos with other ids and baud rates by pings; this takes some seconds."""
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
        "check their power supply; USB does not power servos",
    )
