"""Tests of camera faults: each changes an image as its name states, and none acts without
request."""

import re
import tomllib
from dataclasses import fields, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from mjtactile.core import resources
from mjtactile.core.config_fields import default_of, entries, from_table
from mjtactile.core.design import load_sensor
from mjtactile.core.effect_names import Effect
from mjtactile.core.errors import InputError
from mjtactile.core.types import Image
from mjtactile.rig.as_built_sensor import AsBuiltSensor
from mjtactile.rig.camera_faults import NO_CAMERA_FAULTS, CameraFaults
from mjtactile.rig.domain_randomization import CAMERA, load_variation
from mjtactile.rig.file import load_rig_file, rig_from_table
from mjtactile.sensing.image.markers import detect
from mjtactile.sim.camera import SimCamera
from mjtactile.sim.rendering.image_faults import STEPS, FaultyImage
from mjtactile.sim.rendering.renderer import Renderer
from mjtactile.sim.sensor.effect_switches import CAMERA as SAMPLED

DESIGN = load_sensor("dense")
UP = np.tile([0.0, 0.0, 1.0], (DESIGN.markers.count, 1))
PAGE = Path(__file__).resolve().parents[3] / "docs/how-to/camera_faults.md"
FIELDS = entries(CameraFaults)
PARAMETERS = {"start", "dust_radius", "dust_darkness", "flicker_rate"}
"""Fields that set details and do not enable a fault."""
STRONG = {
    "scale_percent": 1,
    "image_shift_px": [3, 2],
    "rotation_deg": 1,
    "defocus_px": 1.5,
    "fog_percent": 50,
    "dust_count": 8,
    "scratch_count": 5,
    "fingerprint_percent": 100,
    "gradient_percent": 50,
    "flicker_percent": 20,
    "exposure_percent": 60,
    "auto_exposure_DN": 100,
    "rolling_shutter_ms": 20,
    "smear_DN": 80,
    "hot_pixel_count": 100,
    "dead_row_count": 5,
    "bayer_percent": 40,
    "noise_reduction_percent": 50,
    "sharpening_percent": 100,
    "gamma": 1.5,
    "black_DN": 60,
    "white_DN": 150,
    "bits": 4,
    "yuyv": 1,
    "jpeg_quality": 50,
    "damaged_percent": 100,
    "torn_percent": 100,
    "lost_lines_percent": 100,
}


@pytest.fixture(scope="module")
def images():
    """Provide images of the flat membrane, and one period later 2 mm higher."""
    renderer = Renderer(DESIGN, seed=1)
    low = DESIGN.markers.p_SM
    return [renderer.render(low, UP, 0.0), renderer.render(low + [0, 0, 2e-3], UP, 1 / 30)]


def faults(**table):
    return from_table(CameraFaults, table, "my.toml")


def shown(images, seed=0, **table):
    """Return the second image as received after the first."""
    camera = FaultyImage(faults(**table), seed)
    return [camera(view) for view in images][-1].pixels.astype(float)


def test_every_fault_belongs_to_a_step_and_is_off_by_default(images):
    switches = [name for step in STEPS for name in step.switches]
    assert sorted([*switches, *PARAMETERS]) == sorted(field.name for field in fields(CameraFaults))
    assert {FIELDS[name].key for name in switches} == set(STRONG)
    assert FaultyImage(NO_CAMERA_FAULTS)(images[0]) is images[0]
    assert not FaultyImage(faults(dust_px=9, flicker_Hz=50)).has_faults


@pytest.mark.parametrize("key", STRONG)
def test_each_fault_changes_the_image_reproducibly(images, key):
    before = images[1].pixels
    one = shown(images, **{key: STRONG[key]})
    assert one.shape == before.shape and not np.array_equal(one, before)
    assert np.array_equal(one, shown(images, **{key: STRONG[key]}))


def test_a_fault_starts_at_its_time(images):
    camera = FaultyImage(faults(gamma=2, from_s=0.02))
    first, second = [camera(view) for view in images]
    assert first is images[0] and not np.array_equal(second.pixels, images[1].pixels)


def test_a_zoom_and_a_shift_move_the_circles_by_the_stated_amounts(images):
    """A zoom about the image center and a shift move the circles by the stated amounts.

    Circles are located to 0.02 px; the resampling adds as much.
    """
    center = np.array([319.5, 239.5])
    before = detect(images[1]).center_px
    camera = FaultyImage(faults(scale_percent=1, image_shift_px=[3, 2]))
    after = detect(camera(images[1])).center_px
    requested = center + 1.01 * (before - center) + [3, 2]
    nearest = np.linalg.norm(after[:, None] - requested, axis=2).min(axis=0)
    assert len(after) == len(before) and nearest.max() < 0.1


def test_gray_levels_follow_their_curves():
    """A wedge of all 256 levels, by the curves' own formulas."""
    level = np.tile(np.arange(256.0), (4, 1))
    wedge = Image(level.astype(np.uint8), 0.0)

    def curve(**table):
        return FaultyImage(faults(**table))(wedge).pixels

    assert np.array_equal(curve(gamma=1.3), np.rint(255 * (level / 255) ** (1 / 1.3)))
    assert np.array_equal(curve(black_DN=50, white_DN=200), np.clip(level, 50, 200))
    assert np.array_equal(curve(exposure_percent=60), np.rint(np.minimum(1.6 * level, 255)))
    assert len(np.unique(curve(bits=4))) == 16
    assert len(np.unique(curve(yuyv=1))) == 220


def test_noise_reduction_and_rolling_shutter_mix_the_last_two_images(images):
    first, second = [view.pixels.astype(float) for view in images]
    half = shown(images, noise_reduction_percent=50)
    assert np.abs(half - (first + second) / 2).max() <= 0.5
    rolled = shown(images, rolling_shutter_ms=1e3 / 30)  # the first row is one image old
    assert np.abs(rolled[0] - first[0]).max() <= 0.5
    center = len(rolled) // 2
    assert np.abs(rolled[center] - (first + second)[center] / 2).max() <= 0.5
    ends = shown(images, torn_percent=100)
    assert np.array_equal(ends[0], second[0]) and np.array_equal(ends[-1], first[-1])


def test_jpeg_is_that_of_the_codec(images):
    data = cv2.imencode(".jpg", images[1].pixels, [cv2.IMWRITE_JPEG_QUALITY, 80])[1]
    expected = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
    assert np.array_equal(shown(images, jpeg_quality=80), expected)


def test_faults_are_read_from_rig_and_variation_files():
    table = {
        **_table("emulated"),
        "emulator": {"as_built": {"left": {"camera": {"gamma": 1.3, "scale_percent": 0.3}}}},
    }
    emulator = rig_from_table(table, Path("my.toml")).emulator
    assert emulator.as_built_sensor("left").camera == CameraFaults(gamma=1.3, zoom=0.003)
    assert emulator.as_built_sensor("right").camera == NO_CAMERA_FAULTS
    assert (
        load_rig_file("emulated_as_built").emulator.as_built_sensor("left").camera
        == NO_CAMERA_FAULTS
    )
    table["emulator"]["as_built"]["left"]["camera"] = {"gama": 1.3}
    with pytest.raises(InputError, match=r"camera.gama: unknown field, did you mean 'gamma'"):
        rig_from_table(table, Path("my.toml"))


def test_faults_are_sampled_for_each_finger_by_seed():
    variation = load_variation("camera")
    assert set(variation.spreads) == {f"{CAMERA}.{entry.key}" for entry in FIELDS.values()}
    sampled = variation.sample(3, fingers=("left", "right"), markers=81)
    left, right = (sampled.as_built_sensor(finger).camera for finger in ("left", "right"))
    assert left != right and left.gamma == sampled.values["left.camera.gamma"]
    assert replace(sampled.as_built_sensor("left"), camera=NO_CAMERA_FAULTS) == AsBuiltSensor(
        "left"
    )


def test_faults_without_images_are_refused():
    own = AsBuiltSensor("left", camera=CameraFaults(gamma=1.3))
    with pytest.raises(InputError, match="need images"):
        SimCamera(None, 0, SAMPLED - {Effect.IMAGES}, own)  # refused before any file is read


def test_the_page_has_every_field_with_its_range():
    rows = re.findall(r"^\| `(\w+)` \| (.*?) \| (.*?) \| (.*?) \|$", PAGE.read_text(), re.MULTILINE)
    assert [row[0] for row in rows] == [entry.key for entry in FIELDS.values()]
    for (_, allowed, off, about), (name, entry) in zip(rows, FIELDS.items(), strict=True):
        assert allowed == f"{entry.low:g} to {entry.high:g}", name
        default = default_of(CameraFaults, name)
        plain = default[0] if isinstance(default, tuple) else default
        assert off == f"{plain / entry.unit:g}" and about == entry.about, name


def _table(name):
    return tomllib.loads(resources.find(name, "models/rigs", ".toml").read_text())
