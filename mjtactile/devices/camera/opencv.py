"""`OpenCvCamera`: a UVC camera through V4L2 (or a network stream).

Size, FOURCC and buffer size reset the stream and its controls, so they come first; exposure, gain
and white balance come last. Drivers clamp values although `set` returns True: each is read back.
Automatic controls cause drift of the forces, so each is switched off. Images queue in the driver's
buffers; a thread reads all of them and keeps the newest.
"""

from __future__ import annotations

import logging
import math
import os
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile.core import foreign_file, scaled_clock
from mjtactile.core.errors import DeviceError
from mjtactile.core.types import Image
from mjtactile.rig.file import CameraConfig

_log = logging.getLogger(__name__)
# wait for the first image, s; USB cameras take up to 2 s to start their stream
_FIRST_IMAGE_TIME = 4.0
_STALE_PERIODS = 3.0  # maximum age of a valid image, in periods
_OPEN_TIME_MS = 5000
_READ_TIME_MS = 1000
_KERNEL_AGE_MAX = 5.0  # limit of a kernel timestamp's age, s; a larger one is from another clock
# V4L2_EXPOSURE_MANUAL, V4L2_EXPOSURE_APERTURE_PRIORITY
_AUTO_EXPOSURE_MANUAL = 1
_AUTO_EXPOSURE_AUTO = 3


class Capture(Protocol):
    """Part of the interface of `cv2.VideoCapture` that is used here."""

    def isOpened(self) -> bool: ...
    def get(self, propId: int) -> float: ...
    def set(self, propId: int, value: float) -> bool: ...
    def read(self) -> Any: ...
    def release(self) -> None: ...


_FLIPS = {"left-right": 1, "top-bottom": 0, "both": -1}
"""Flip codes of OpenCV for `CameraConfig.flipped`."""


@dataclass
class CameraCounters:
    """Counts of received, missing (by their time) and repeated (identical) images."""

    images: int = 0
    dropped: int = 0
    duplicates: int = 0
    intervals: list[float] = field(default_factory=list)


class OpenCvCamera:
    """One finger's camera, streaming. `capture` replaces `cv2.VideoCapture` in tests.

    Raises DeviceError if it is missing, has another image size, or refuses a control.
    """

    def __init__(self, config: CameraConfig, *, capture: Callable[[], Capture] | None = None):
        self.config = config
        self.name = f"{config.finger} camera {config.source}"
        self.counters = CameraCounters()
        self._period = 1.0 / config.rate
        # decoding a JPEG to gray takes 1.2 ms; FFmpeg takes 1.9 ms, since it decodes the colors
        self._is_raw = config.backend == "ffmpeg" and config.fourcc == "MJPG"
        self._condition = threading.Condition()
        self._newest: Image | None = None
        self._fresh_time = -math.inf  # time of the last change of the image
        self._error: str | None = None
        self._stopping = scaled_clock.Event()
        self._capture = (capture or self._open)()
        try:
            if not self._capture.isOpened():
                hint = "is it plugged in, and may this user read it (group video)?"
                raise DeviceError(f"{self.name} cannot be opened: {hint}")
            if config.backend == "v4l2":
                self._configure()
            self._thread = threading.Thread(target=self._read_loop, name=self.name, daemon=True)
            self._thread.start()
        except BaseException:
            self._capture.release()
            raise
        self._await_first()

    def read(self) -> Image:
        """Return the newest image, with its monotonic capture time, s. Raises DeviceError."""
        with self._condition:
            image = self._newest
            fresh = self._fresh_time
            error = self._error
        if error is not None:
            raise DeviceError(f"{self.name}: {error}")
        assert image is not None
        now = scaled_clock.monotonic()
        age = now - image.time
        unchanged = now - fresh
        maximum = _STALE_PERIODS * self._period + self.config.delay
        if age > maximum:
            raise DeviceError(f"{self.name} is stale: its last image is {1e3 * age:.0f} ms old")
        if unchanged > maximum:
            raise DeviceError(f"{self.name} is frozen: the same image for {1e3 * unchanged:.0f} ms")
        return image

    def wait_newer(self, than: float, timeout: float) -> bool:
        """Wait for an image captured after `than` s; False if none arrives in `timeout` s."""
        with self._condition:
            return self._condition.wait_for(
                lambda: (
                    self._error is not None or self._newest is not None and self._newest.time > than
                ),
                scaled_clock.wall(timeout),
            )

    @property
    def newest_time(self) -> float:
        """Capture time of the newest image, monotonic, s."""
        with self._condition:
            return -math.inf if self._newest is None else self._newest.time

    def close(self) -> None:
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()
        self._capture.release()

    # -- settings

    def _open(self) -> Capture:
        config = self.config
        if config.backend == "ffmpeg":
            settings = {
                cv2.CAP_PROP_OPEN_TIMEOUT_MSEC: round(scaled_clock.wall(_OPEN_TIME_MS)),
                cv2.CAP_PROP_READ_TIMEOUT_MSEC: round(scaled_clock.wall(_READ_TIME_MS)),
                cv2.CAP_PROP_N_THREADS: 1,  # each further thread would hold back an image
            }
            if self._is_raw:
                settings[cv2.CAP_PROP_FORMAT] = -1  # a JPEG is passed on undecoded
            flat = [number for item in settings.items() for number in item]
            return cv2.VideoCapture(config.source, cv2.CAP_FFMPEG, flat)
        if not foreign_file.exists(Path(config.source)):
            hint = "`mjtactile doctor` lists the connected cameras"
            raise DeviceError(f"{self.name} is not connected; {hint}")
        return cv2.VideoCapture(config.source, cv2.CAP_V4L2)

    def _configure(self) -> None:
        config = self.config
        if config.fourcc:
            self._set("FOURCC", cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*config.fourcc))
        self._set("width", cv2.CAP_PROP_FRAME_WIDTH, config.width)
        self._set("height", cv2.CAP_PROP_FRAME_HEIGHT, config.height)
        self._set("rate", cv2.CAP_PROP_FPS, config.rate, tolerance=0.02 * config.rate)
        # if it is ignored, the thread empties the buffers anyway
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        if config.exposure is not None:
            # some drivers ignore "manual" unless the automatic was on before
            self._capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, _AUTO_EXPOSURE_AUTO)
            self._set("manual exposure", cv2.CAP_PROP_AUTO_EXPOSURE, _AUTO_EXPOSURE_MANUAL)
            # drivers round to their step
            self._set("exposure", cv2.CAP_PROP_EXPOSURE, config.exposure, tolerance=1.0)
        if config.white_balance is not None:
            self._set("automatic white balance", cv2.CAP_PROP_AUTO_WB, 0)
            kelvin = config.white_balance
            self._set("white balance", cv2.CAP_PROP_WB_TEMPERATURE, kelvin, tolerance=10.0)
        if config.gain is not None:
            self._set("gain", cv2.CAP_PROP_GAIN, config.gain, tolerance=0.5)

    def _set(self, setting: str, prop: int, value: float, *, tolerance: float = 0.0) -> None:
        self._capture.set(prop, value)
        actual = self._capture.get(prop)
        if not math.isfinite(actual) or abs(actual - value) > tolerance:
            text = _fourcc if setting == "FOURCC" else "{:g}".format
            raise DeviceError(
                f"{self.name}: {setting} was set to {text(value)} but is {text(actual)}; "
                "`mjtactile doctor` shows how to list the supported values"
            )

    # -- the reader

    def _read_loop(self) -> None:
        failures = 0
        while not self._stopping.is_set():
            try:
                good, pixels = self._capture.read()
                if good and self._is_raw:
                    pixels = cv2.imdecode(pixels, cv2.IMREAD_GRAYSCALE)
            except cv2.error as error:
                good = False
                pixels = None
                _log.debug("%s: %s", self.name, error)
            if good and pixels is not None:
                failures = 0
                self._accept(pixels)
                continue
            failures += 1
            # one broken JPEG is a lost image; three failures in a row are a lost camera
            if failures >= 3:
                reason = self._no_image_reason()
                if good and self._is_raw:
                    reason = 'it sends no JPEG; remove fourcc = "MJPG" from the rig file'
                self._fail(reason)
                return

    def _accept(self, pixels: NDArray) -> None:
        arrival = scaled_clock.monotonic()
        gray = cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY) if pixels.ndim == 3 else pixels
        if gray.shape != (self.config.height, self.config.width):
            self._fail(
                f"it sends {gray.shape[1]} x {gray.shape[0]} pixels, but the rig file "
                f"specifies {self.config.width} x {self.config.height}"
            )
            return
        flip = _FLIPS.get(self.config.flipped)
        if flip is not None:
            gray = cv2.flip(gray, flip)
        captured = self._capture_time(arrival)
        with self._condition:
            last = self._newest
            # Sensor noise makes real images differ, except all-white and all-black ones.
            is_uniform = gray.min() == gray.max()
            same = last is not None and np.array_equal(gray, last.pixels) and not is_uniform
            self.counters.images += 1
            if last is not None:
                self._count(captured - last.time)
            if same:
                self.counters.duplicates += 1
            else:
                self._fresh_time = captured
            self._newest = Image(gray, captured)
            self._condition.notify_all()

    def _count(self, interval: float) -> None:
        self.counters.dropped += max(0, round(interval / self._period) - 1)
        self.counters.intervals.append(interval)
        del self.counters.intervals[:-1000]

    def _capture_time(self, arrival: float) -> float:
        """Return the kernel's V4L2 time, or the arrival minus the stream's known delay."""
        if self.config.timestamps == "arrival":
            return arrival - self.config.delay
        kernel = 1e-3 * self._capture.get(cv2.CAP_PROP_POS_MSEC)
        if 0 <= arrival - kernel < _KERNEL_AGE_MAX:
            return kernel
        self._fail(
            f"its kernel timestamps ({kernel:.3f} s) are not on the monotonic clock "
            f'({arrival:.3f} s); write timestamps = "arrival" and the delay into the rig file'
        )
        return arrival

    def _no_image_reason(self) -> str:
        silent = scaled_clock.monotonic() - self.newest_time
        load = os.getloadavg()[0]
        processors = os.cpu_count() or 1
        since = f" for {1e3 * silent:.0f} ms" if math.isfinite(silent) else ""
        busy = ""
        if load > processors:
            cause = f"{load:.0f} programs compete for this computer's {processors} processors"
            busy = f" Or are they late? {cause}"
        return f"it has sent no images{since}: was it unplugged?{busy}"

    def _fail(self, reason: str) -> None:
        with self._condition:
            self._error = self._error or reason
            self._condition.notify_all()

    def _await_first(self) -> None:
        with self._condition:
            self._condition.wait_for(
                lambda: self._newest is not None or self._error is not None,
                scaled_clock.wall(_FIRST_IMAGE_TIME),
            )
            if self._newest is not None and self._error is None:
                return
            reason = self._error or f"no image within {_FIRST_IMAGE_TIME:g} s"
        self.close()
        raise DeviceError(f"{self.name}: {reason}")


def _fourcc(value: float) -> str:
    return "".join(chr(int(value) >> 8 * i & 0xFF) for i in range(4))
