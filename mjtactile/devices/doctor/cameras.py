"""Cameras: settings, rate, age, and light."""

from __future__ import annotations

import os
import statistics
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from mjtactile.core import foreign_file, scaled_clock
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import DeviceError
from mjtactile.core.types import Image
from mjtactile.devices.camera.opencv import OpenCvCamera
from mjtactile.devices.doctor.ports import group_of
from mjtactile.rig.doctor_finding import Finding
from mjtactile.rig.file import CameraConfig

_CAMERA_TIME = 2.0  # duration of counting a camera's images, s


ViewCheck = Callable[[str, SensorDesign, Image], Iterable[Finding]]
"""Check of an image from a camera, given its name and the sensor in front of it."""


def check_camera(
    config: CameraConfig, design: SensorDesign, check_view: ViewCheck
) -> Iterator[Finding]:
    """Check a camera: settings, then rate, age and jitter over two seconds, then the image."""
    subject = f"camera {config.finger}"
    try:
        camera = OpenCvCamera(config)
    except DeviceError as error:
        yield Finding("bad", subject, str(error), _camera_remedy(config))
        return
    try:
        ages = []
        end = scaled_clock.monotonic() + _CAMERA_TIME
        last = 0.0
        while scaled_clock.monotonic() < end:
            if camera.wait_newer(last, 0.5):
                image = camera.read()
                last = image.time
                ages.append(scaled_clock.monotonic() - last)
        yield _rate_finding(subject, camera, ages)
        yield _light_finding(subject, camera)
        yield from check_view(subject, design, camera.read())
    except DeviceError as error:
        yield Finding("bad", subject, str(error))
    finally:
        camera.close()


def _rate_finding(subject: str, camera: OpenCvCamera, ages: list[float]) -> Finding:
    counters = camera.counters
    config = camera.config
    if len(counters.intervals) < 3:
        return Finding(
            "bad",
            subject,
            f"{counters.images} images in {_CAMERA_TIME:g} s",
            "use another cable or USB port",
        )
    rate = 1 / statistics.mean(counters.intervals)
    jitter = statistics.pstdev(counters.intervals)
    text = (
        f"{rate:.1f} images per second, jitter {1e3 * jitter:.1f} ms, age "
        f"{1e3 * statistics.median(ages):.1f} ms, {counters.dropped} lost, "
        f"{counters.duplicates} duplicated"
    )
    if rate < 0.9 * config.rate:
        return Finding(
            "bad",
            subject,
            f"{text}: the rig file specifies {config.rate:g}",
            "use a shorter exposure (it must fit into the period), MJPG, or a separate USB "
            "controller",
        )
    return Finding("warn" if counters.duplicates else "ok", subject, text)


def _light_finding(subject: str, camera: OpenCvCamera) -> Finding:
    pixels = camera.read().pixels
    mean = float(pixels.mean())
    white = float((pixels >= 254).mean())
    if mean < 20:
        return Finding(
            "bad",
            subject,
            f"dark: mean gray level {mean:.0f}",
            "check the LEDs; raise exposure_100us",
        )
    if white > 0.05:
        return Finding(
            "bad",
            subject,
            f"{100 * white:.0f} % of the image is saturated",
            "lower exposure_100us or gain",
        )
    return Finding("ok", subject, f"mean gray level {mean:.0f}, {100 * white:.1f} % saturated")


def _camera_remedy(config: CameraConfig) -> str:
    if config.source.startswith("/dev") and not foreign_file.exists(Path(config.source)):
        return (
            "`ls -l /dev/v4l/by-id` lists the names that stay the same; write one of them "
            "into the rig file"
        )
    if config.source.startswith("/dev") and not os.access(config.source, os.R_OK | os.W_OK):
        return f"sudo usermod -aG {group_of(config.source)} $USER, then log in again"
    return "`v4l2-ctl -d DEVICE --list-formats-ext --list-ctrls` lists the supported values"
