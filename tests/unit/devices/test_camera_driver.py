"""The camera driver with a capture object that behaves like V4L2: controls reset, clamped values,
kernel times."""

import contextlib
import threading
from dataclasses import replace

import cv2
import numpy as np
import pytest

from mjtactile.core import scaled_clock
from mjtactile.core.errors import DeviceError
from mjtactile.devices.camera.opencv import OpenCvCamera
from mjtactile.devices.rig import FrameClock
from mjtactile.emulator.mjpeg_server import StreamServer
from mjtactile.rig.file import CameraConfig
from tests.emulated import wait_for

pytestmark = pytest.mark.clock

CONFIG = CameraConfig(
    "left",
    "/dev/video9",
    64,
    48,
    100.0,
    exposure=100.0,
    gain=10.0,
    white_balance=4600.0,
    fourcc="MJPG",
)
STREAM_PROPS = {
    cv2.CAP_PROP_FOURCC,
    cv2.CAP_PROP_FRAME_WIDTH,
    cv2.CAP_PROP_FRAME_HEIGHT,
    cv2.CAP_PROP_BUFFERSIZE,
    cv2.CAP_PROP_FPS,
}


class V4l2:
    """A UVC camera as the kernel shows it. `clamp` maps a property to the largest value that it
    takes."""

    def __init__(self, clamp=None, clock_offset=0.0):
        self.values = {cv2.CAP_PROP_AUTO_EXPOSURE: 3.0, cv2.CAP_PROP_AUTO_WB: 1.0}
        self.order = []
        self.clamp = clamp or {}
        self.offset = clock_offset
        self.rng = np.random.default_rng(0)
        self.number = 0
        self.mode = "live"
        self.released = False
        self.pixels = self.view()
        self.time = scaled_clock.monotonic()
        self.gate = scaled_clock.Event()

    def view(self):
        return self.rng.integers(0, 255, (48, 64, 3), dtype=np.uint8)

    def isOpened(self):
        return self.mode != "absent"

    def get(self, propId):
        if propId == cv2.CAP_PROP_POS_MSEC:
            return 1e3 * (self.time + self.offset)
        return self.values.get(propId, 0.0)

    def set(self, propId, value):
        self.order.append(propId)
        if propId in STREAM_PROPS:  # a change of the stream resets the controls
            self.values |= {
                cv2.CAP_PROP_AUTO_EXPOSURE: 3.0,
                cv2.CAP_PROP_EXPOSURE: 166.0,
                cv2.CAP_PROP_AUTO_WB: 1.0,
            }
        if propId == cv2.CAP_PROP_EXPOSURE and self.values[cv2.CAP_PROP_AUTO_EXPOSURE] != 1:
            return True  # silently ignored
        self.values[propId] = min(value, self.clamp.get(propId, value))
        return True

    def read(self):
        scaled_clock.sleep(0.01)
        if self.mode in ("gone", "absent"):
            return False, None
        if self.mode == "stopped":
            self.gate.wait()
            return False, None
        if self.mode == "live":
            self.pixels = self.view()
        self.time = scaled_clock.monotonic() - 0.004
        self.number += 1
        return True, self.pixels

    def release(self):
        self.released = True


@pytest.fixture
def device():
    device = V4l2()
    yield device
    device.mode = "gone"
    device.gate.set()


@pytest.fixture
def camera(device):
    camera = OpenCvCamera(CONFIG, capture=lambda: device)
    yield camera
    device.mode = "gone"
    device.gate.set()
    camera.close()
    assert device.released


def test_stream_settings_come_first_and_controls_last(camera, device):
    last_stream = max(i for i, prop in enumerate(device.order) if prop in STREAM_PROPS)
    first_control = min(i for i, prop in enumerate(device.order) if prop not in STREAM_PROPS)
    assert last_stream < first_control
    assert device.values[cv2.CAP_PROP_AUTO_EXPOSURE] == 1
    assert device.values[cv2.CAP_PROP_EXPOSURE] == 100
    assert (device.values[cv2.CAP_PROP_AUTO_WB], device.values[cv2.CAP_PROP_GAIN]) == (0, 10)


@pytest.mark.parametrize(
    ("prop", "largest", "name"),
    [
        (cv2.CAP_PROP_FRAME_WIDTH, 32, "width"),
        (cv2.CAP_PROP_FPS, 30, "rate"),
        (cv2.CAP_PROP_EXPOSURE, 50, "exposure"),
        (cv2.CAP_PROP_GAIN, 5, "gain"),
        (cv2.CAP_PROP_FOURCC, 1, "FOURCC"),
        (cv2.CAP_PROP_WB_TEMPERATURE, 4000, "white balance"),
    ],
)
def test_a_setting_that_the_camera_ignored_is_refused(prop, largest, name):
    device = V4l2(clamp={prop: largest})
    with pytest.raises(DeviceError, match=f"left camera /dev/video9: {name} was set to"):
        OpenCvCamera(CONFIG, capture=lambda: device)
    assert device.released


def test_image_time_is_that_of_the_kernel(camera):
    image = camera.read()
    assert 0.004 <= scaled_clock.monotonic() - image.time < 5.0  # captured 4 ms before it arrived


def test_a_kernel_clock_other_than_the_monotonic_clock_is_refused():
    device = V4l2(clock_offset=1.7e9)
    with pytest.raises(DeviceError, match="not on the monotonic clock"):
        OpenCvCamera(CONFIG, capture=lambda: device)


def test_read_returns_the_newest_image(camera):
    first = camera.read()
    assert camera.wait_newer(first.time, 5.0)
    assert camera.read().time > first.time
    assert camera.read().pixels.shape == (48, 64)


@pytest.mark.parametrize(
    ("flipped", "turned"),
    [
        ("no", lambda grey: grey),
        ("left-right", np.fliplr),
        ("top-bottom", np.flipud),
        ("both", lambda grey: np.rot90(grey, 2)),
    ],
)
def test_a_flipped_image_is_corrected(device, flipped, turned):
    device.mode = "still"
    config = replace(CONFIG, flipped=flipped)
    with contextlib.closing(OpenCvCamera(config, capture=lambda: device)) as camera:
        observed = camera.read().pixels
        device.mode = "gone"
    assert np.array_equal(observed, turned(cv2.cvtColor(device.pixels, cv2.COLOR_BGR2GRAY)))


def test_a_frozen_camera_is_an_error(camera, device):
    device.mode = "frozen"  # new times, the same pixels
    assert wait_for(lambda: camera.counters.duplicates > 8)
    with pytest.raises(DeviceError, match="frozen"):
        camera.read()


def test_a_camera_that_stops_is_stale(camera, device):
    device.mode = "stopped"
    scaled_clock.sleep(0.1)  # ten periods
    with pytest.raises(DeviceError, match="stale"):
        camera.read()


def test_an_unplugged_camera_is_an_error(camera, device, monkeypatch):
    monkeypatch.setattr("os.getloadavg", lambda: (0.5, 0.5, 0.5))
    device.mode = "gone"
    assert wait_for(lambda: camera._error is not None)
    with pytest.raises(DeviceError, match=r"no images for \d+ ms: was it unplugged\?$"):
        camera.read()


def test_on_a_busy_computer_images_may_be_late(camera, device, monkeypatch):
    monkeypatch.setattr("os.getloadavg", lambda: (40.0, 1.0, 1.0))
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    device.mode = "gone"
    assert wait_for(lambda: camera._error is not None)
    with pytest.raises(
        DeviceError,
        match=r"unplugged.* Or are they late. 40 programs compete for this computer's 2 processors",
    ):
        camera.read()


def test_lost_images_are_counted(camera):
    camera.counters.dropped = 0
    camera._count(0.041)  # four periods: three images are missing
    assert camera.counters.dropped >= 3


def test_a_missing_camera_is_named():
    device = V4l2()
    device.mode = "absent"
    with pytest.raises(DeviceError, match="left camera /dev/video9 cannot be opened"):
        OpenCvCamera(CONFIG, capture=lambda: device)


def test_an_image_size_other_than_requested_is_an_error():
    device = V4l2()
    device.view = lambda: np.zeros((24, 32, 3), np.uint8)
    with pytest.raises(DeviceError, match="32 x 24 pixels"):
        OpenCvCamera(CONFIG, capture=lambda: device)


@pytest.mark.parametrize("fourcc", ["MJPG", None])
def test_a_stream_over_http_is_read(fourcc):
    """The path of the emulated rig: MJPEG on loopback, decoded here or by FFmpeg."""
    server = StreamServer(("left",))
    stop = scaled_clock.Event()
    rng = np.random.default_rng(0)
    base = cv2.GaussianBlur(rng.integers(60, 200, (48, 64)).astype(np.float32), (0, 0), 3)

    def publish():
        while not stop.wait(0.02):
            server.publish(
                "left", np.clip(base + rng.normal(0, 2, base.shape), 0, 255).astype(np.uint8)
            )

    thread = threading.Thread(target=publish)
    thread.start()
    config = CameraConfig(
        "left",
        server.url("left"),
        64,
        48,
        5.0,
        backend="ffmpeg",
        timestamps="arrival",
        fourcc=fourcc,
    )
    try:
        camera = OpenCvCamera(config)
        try:
            view = camera.read().pixels.astype(float)
            # noise of 2 DN and JPEG's loss at quality 98, below 2 DN
            assert np.sqrt(np.mean((view - base) ** 2)) < 4.0
        finally:
            camera.close()
    finally:
        stop.set()
        thread.join()
        server.close()


def test_a_stream_without_jpeg_images_is_reported(device):
    config = CameraConfig(
        "left", "rtsp://there", 64, 48, 5.0, backend="ffmpeg", timestamps="arrival", fourcc="MJPG"
    )
    device.view = lambda: np.zeros((1, 500), np.uint8)  # a packet of another codec
    with pytest.raises(DeviceError, match=r"no JPEG.*fourcc"):
        OpenCvCamera(config, capture=lambda: device)


def test_a_cycle_starts_with_an_image_or_after_the_time_limit(device):
    """The clock of the loop returns when an image has arrived, at the latest half a period after
    the requested time."""
    camera = OpenCvCamera(CONFIG, capture=lambda: device)
    try:
        period = 0.05
        clock = FrameClock([camera], period)
        for _ in range(5):
            goal = clock.now() + period
            observed = camera.newest_time
            clock.wait_until(goal)
            assert clock.now() >= goal - period / 2 - 1e-3  # the sleep's own resolution
            assert camera.newest_time > observed
        device.mode = "stopped"
        goal = clock.now() + period
        clock.wait_until(goal)  # the last image may still arrive
        clock.wait_until(clock.now() + period)
        # the loop continues without images; 1 s for a busy computer
        assert clock.now() < goal + 3 * period + 1.0
    finally:
        device.mode = "gone"
        device.gate.set()
        camera.close()


class Beat:
    """Camera that sends an image every `period` s, on its own clock, which advances only for
    waiting callers."""

    def __init__(self, period, phase):
        self.period = period
        self.phase = phase
        self.now = 10.0

    def sleep_until(self, deadline):
        self.now = max(self.now, deadline)

    @property
    def newest_time(self):
        return self.phase + self.period * np.floor((self.now - self.phase) / self.period + 1e-9)

    def wait_newer(self, than, timeout):
        if self.newest_time <= than:
            self.now = min(self.newest_time + self.period, self.now + timeout)


@pytest.mark.parametrize("phase", [0.0, 0.3, 0.6, 0.9])
@pytest.mark.parametrize("rate", [0.98, 1.0, 1.02])
def test_the_loop_synchronizes_with_its_camera(rate, phase, monkeypatch):
    """The loop synchronizes with its camera from any phase: each image is taken on arrival, once.

    Neither has exactly its stated rate.
    """
    camera = Beat(1 / rate, phase)
    monkeypatch.setattr("mjtactile.devices.rig._sleep_until", camera.sleep_until)
    clock = FrameClock([camera], 1.0)  # type: ignore[list-item]
    clock.now = lambda: camera.now
    deadline = camera.now
    taken = []
    for _ in range(100):
        # as the control loop has it
        deadline = min(max(deadline, camera.now - 1.0), camera.now) + 1.0
        camera.now += 0.6  # its work
        clock.wait_until(deadline)
        taken.append((camera.now, camera.newest_time))
    observed = np.array(taken[10:])
    # rounding: without falling into step up to 0.5
    np.testing.assert_allclose(observed[:, 0], observed[:, 1], atol=1e-6)
    np.testing.assert_allclose(np.diff(observed[:, 1]), 1 / rate, atol=1e-6)
