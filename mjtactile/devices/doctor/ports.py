"""Checks of a serial port: existence, permission and latency."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from mjtactile.rig.doctor_finding import Finding


def check_port(subject: str, path: str, *, fix: bool) -> Iterator[Finding]:
    """Check that the port is accessible and does not delay received data by 16 ms."""
    if "://" in path:
        return
    if not Path(path).exists():
        yield Finding(
            "bad",
            subject,
            f"{path} does not exist",
            "check the connection; `ls -l /dev/serial/by-id` lists the names that stay the "
            "same; write one of them into the rig file",
        )
        return
    if not os.access(path, os.R_OK | os.W_OK):
        group = group_of(path)
        yield Finding(
            "bad",
            subject,
            f"{path} is not accessible to this user",
            f"sudo usermod -aG {group} $USER, then log in again",
        )
        return
    timer = Path("/sys/bus/usb-serial/devices") / Path(path).resolve().name / "latency_timer"
    if timer.is_file():
        yield from _check_latency(subject, timer, fix=fix)


def _check_latency(subject: str, timer: Path, *, fix: bool) -> Iterator[Finding]:
    value = timer.read_text().strip()
    if value == "1":
        yield Finding("ok", subject, "latency timer 1 ms")
        return
    if fix:
        with contextlib.suppress(OSError):
            timer.write_text("1")
            yield Finding(
                "ok",
                subject,
                f"latency timer was {value} ms, now 1 ms until the adapter is unplugged",
            )
            return
    yield Finding(
        "warn",
        subject,
        f"latency timer is {value} ms: each reading takes that long",
        'permanently: a udev rule ACTION=="add", SUBSYSTEM=="usb-serial", '
        'DRIVER=="ftdi_sio", ATTR{latency_timer}="1" in '
        "/etc/udev/rules.d/99-latency.rules; for now: --fix as root",
    )


def group_of(path: str) -> str:
    with contextlib.suppress(KeyError, OSError, ImportError):
        import grp

        return grp.getgrgid(Path(path).stat().st_gid).gr_name
    return "dialout"
