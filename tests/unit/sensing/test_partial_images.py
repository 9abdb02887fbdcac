"""Tests of images with a black, white, covered or torn part, which is reported; a hidden contact is
not "no contact"."""

import numpy as np
import pytest

from mjtactile.core import optics
from mjtactile.core.design import load_sensor
from mjtactile.core.errors import DeviceError
from mjtactile.core.status import StatusCode
from mjtactile.core.types import Image
from mjtactile.experiments.test_bench import View, take_references
from mjtactile.sim.scenes.indentation import Indenter, PressWorld

# part of the image: rows, columns
PARTS = {
    "left half": (slice(None), slice(0, 320)),
    "right half": (slice(None), slice(320, None)),
    "bottom half": (slice(240, None), slice(None)),
    "band": (slice(180, 300), slice(None)),
    "corner": (slice(0, 240), slice(0, 320)),
}


@pytest.fixture(scope="module", params=["dense", "paper16"])
def pressed(request):
    """Return an image of a ball of 4 mm radius that presses with 0.12 N, 8 mm to the right."""
    design = load_sensor(request.param)
    world = PressWorld(design, Indenter("sphere", 4e-3), at=(8e-3, 0.0))
    view = View(world, design)
    take_references(world, [view], design.chamber.supply_gauge)
    world.press(1.5e-3)
    assert view.touch().touching
    return view


# the right half hides the ball: 0.00 +- 0.01 N was reported, "ok"
@pytest.mark.parametrize("grey", [0, 255, 128])
@pytest.mark.parametrize("part", PARTS)
def test_a_part_without_markers_is_stated(pressed, part, grey):
    image = pressed.image()
    pixels = image.pixels.copy()
    pixels[PARTS[part]] = grey
    before = pressed.perception.state
    touch = pressed.perception.perceive(Image(pixels, image.time), image.time)
    pressed.perception.state = before
    assert touch.status.code == StatusCode.TOO_FEW_MARKERS
    assert "markers detected" in touch.status
    assert np.isnan(touch.force_normal)
    assert not touch.touching


# dust hides one marker, and its neighbors show the membrane there
def test_a_hidden_marker_is_no_hidden_part(pressed):
    image = pressed.image()
    pixels = image.pixels.copy()
    markers = pressed.touch().markers
    pipeline = pressed.perception.pipeline
    u, v = np.round(
        optics.project(pipeline.camera, markers.p_SM[:1] - pipeline.design.camera.p_SC)[0]
    ).astype(int)
    depth = markers.p_SM[0, 2] - pipeline.design.camera.p_SC[2]
    r = int(1.6 * pipeline.camera.fx * pipeline.design.markers.radius / depth)
    pixels[v - r : v + r + 1, u - r : u + r + 1] = np.median(pixels)
    before = pressed.perception.state
    touch = pressed.perception.perceive(Image(pixels, image.time), image.time)
    pressed.perception.state = before
    assert touch.status == "ok"
    assert len(touch.markers) == len(markers) - 1


def test_an_image_of_another_size_is_an_error(pressed):
    image = pressed.image()
    with pytest.raises(DeviceError, match="320"):
        pressed.perception.perceive(Image(image.pixels[::2, ::2], image.time), image.time)
