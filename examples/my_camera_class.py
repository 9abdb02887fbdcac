"""Custom camera on a finger: any class with `read`, named in the rig file and found by an entry
point.

In your package's pyproject.toml:

    [project.entry-points."mjtactile.cameras"]
    newest = "my_camera_class:NewestFrame"

In the finger's part of the rig file:

    [[camera]]
    backend = "newest"

Then `mjtactile doctor`, `record` and `grasp` use it like the shipped ones. This one reads a network
stream with OpenCV.
"""

import threading

import cv2

import mjtactile


class NewestFrame:
    """Camera that returns the newest frame of a stream.

    `config` holds the rig file's entry of this camera: finger, source, width, height, rate, delay
    and more.
    """

    def __init__(self, config):
        self._config = config
        self._capture = cv2.VideoCapture(config.source, cv2.CAP_FFMPEG)
        if not self._capture.isOpened():
            raise mjtactile.DeviceError(f"{config.finger} camera {config.source} is not there")
        self._newest = None
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._keep_newest, daemon=True)
        self._thread.start()

    def _keep_newest(self):
        while not self._closed.is_set():
            arrived, frame = self._capture.read()
            if arrived:  # captured `delay` s before, on the rig's clock
                gray = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
                self._newest = mjtactile.Image(gray, mjtactile.monotonic() - self._config.delay)

    def read(self):
        """Return the newest image; a stale image is an error."""
        image = self._newest
        if image is None or mjtactile.monotonic() - image.time > 0.15:
            raise mjtactile.DeviceError(
                f"{self._config.finger} camera {self._config.source} is stale"
            )
        return image

    def close(self):
        """Stop the thread and close the stream; called on every exit."""
        self._closed.set()
        self._thread.join(1.0)
        self._capture.release()
