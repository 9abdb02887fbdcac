"""Tests of the images that `locate` accepts, and of its messages about others."""

import cv2
import numpy as np
import pytest

from benchmarks.paper import marker_accuracy, marker_scenes
from mjtactile.core.errors import InputError
from mjtactile.sensing.image import markers
from mjtactile.sensing.pose.circles_from_images import load_image, locate


@pytest.mark.parametrize(
    "bad",
    [
        np.zeros((480, 640)),
        np.zeros((480, 640, 2), np.uint8),
        np.zeros((4, 4), np.uint8),
        np.zeros(7, np.uint8),
    ],
)
def test_bad_arrays(bad):
    with pytest.raises(InputError):
        markers.detect(bad)


def test_bad_polarity():
    with pytest.raises(InputError, match="dark, bright"):
        markers.detect(np.zeros((48, 64), np.uint8), polarity="grey")


def test_image_files_can_be_read(tmp_path):
    circles = marker_scenes.random_circles(marker_accuracy.CAMERA, np.random.default_rng(5))
    image = marker_scenes.image(marker_accuracy.CAMERA, circles)
    records = locate(image, marker_accuracy.CAMERA, marker_accuracy.RADIUS)
    for name, pixels in (
        ("a.png", image),
        ("b.tiff", image.astype(np.uint16) * 257),
        ("c.png", np.dstack([image] * 4)),
    ):
        cv2.imwrite(str(tmp_path / name), pixels)
        again = locate(load_image(tmp_path / name), marker_accuracy.CAMERA, marker_accuracy.RADIUS)
        assert len(again) == len(records) == 16
    assert set(records[0]) == {
        "uv_px",
        "ellipse_px",
        "center_mm",
        "cov_center_mm2",
        "normal",
        "preferred_probability",
        "center_alt_mm",
        "cov_center_alt_mm2",
        "normal_alt",
        "status",
    }
    complete = (tmp_path / "a.png").read_bytes()
    for name, data in (
        ("empty.png", b""),
        ("text.png", b"not an image"),
        ("short.png", complete[:200]),
    ):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(InputError, match="corrupt"):
            load_image(tmp_path / name)
    with pytest.raises(InputError, match="cannot be read"):
        load_image(tmp_path / "missing.png")
