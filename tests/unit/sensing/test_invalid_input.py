"""Tests of the pipeline with unusable input from callers: package errors of one line each, or a
status."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from mjtactile.core.design import load_sensor
from mjtactile.core.errors import DeviceError, InputError, MjtactileError
from mjtactile.core.optics import project
from mjtactile.core.types import Image, Markers
from mjtactile.sensing.image.markers import detect
from mjtactile.sensing.pipeline import SensingPipeline
from mjtactile.sensing.pose.circles import estimate_poses
from tests import membrane_images

DESIGN = load_sensor("paper16")
NO_MARKERS = Markers(np.zeros(0, int), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3)))


@pytest.fixture(scope="module")
def sensing_pipeline():
    return SensingPipeline(DESIGN)


@pytest.fixture(scope="module")
def flat(sensing_pipeline):
    return sensing_pipeline.measure_flat_reference(
        sensing_pipeline.initial_state(), membrane_images.sequence().flat
    )


def test_missing_images_give_no_reference(sensing_pipeline, flat):
    with pytest.raises(DeviceError, match="flat reference: 0 images"):
        sensing_pipeline.measure_flat_reference(sensing_pipeline.initial_state(), [])
    with pytest.raises(DeviceError, match="rest reference: no images"):
        sensing_pipeline.measure_rest_reference(flat, [], 1000.0)


@pytest.mark.parametrize("count", [0, 1, 16])
def test_missing_or_invalid_markers_give_no_reference(sensing_pipeline, flat, count):
    nowhere = Markers(
        np.arange(count),
        np.full((count, 3), np.nan),
        np.zeros((count, 3)),
        np.full((count, 3, 3), np.nan),
    )
    with pytest.raises(DeviceError, match="only 0 of 16 markers found"):
        sensing_pipeline.load_rest_reference(flat, nowhere, 1000.0)


@pytest.mark.parametrize("pressure", [None, np.nan, np.inf, "1000"])
def test_an_invalid_pressure_is_reported(sensing_pipeline, flat, pressure):
    with pytest.raises(InputError, match=r"gauge_pressure: .* is not a (number|pressure in Pa)"):
        sensing_pipeline.measure_rest_reference(flat, membrane_images.sequence().rest, pressure)


@pytest.mark.parametrize("pressure", [1e9, -1e9, 1e5])
def test_a_pressure_without_an_equilibrium_is_refused(sensing_pipeline, flat, pressure):
    with pytest.raises(MjtactileError, match="no equilibrium of the membrane was found"):
        sensing_pipeline.measure_rest_reference(flat, membrane_images.sequence().rest, pressure)


@pytest.mark.parametrize("young", [np.nan, np.inf])
def test_a_stiffness_that_is_not_finite_is_reported(flat, young):
    design = replace(DESIGN, membrane=replace(DESIGN.membrane, young=young))
    with pytest.raises(MjtactileError, match="stiffness is not finite"):
        SensingPipeline(design).measure_rest_reference(
            flat, membrane_images.sequence().rest, 1000.0
        )


def test_touch_without_markers_reports_it(sensing_pipeline, flat):
    rest = sensing_pipeline.measure_rest_reference(
        flat, membrane_images.sequence().rest, membrane_images.GAUGE
    )
    touch, _ = sensing_pipeline.estimate_touch(
        rest, NO_MARKERS, sensing_pipeline.fitter.fit(NO_MARKERS), 0.0
    )
    assert touch.status == "only 0 of 16 markers detected"
    assert np.isnan(touch.force_normal)


def test_a_radius_that_is_not_finite_is_reported():
    ellipses = detect(membrane_images.sequence().flat[0])
    for radius in ("x", None, [1e-3, "x"], object()):
        with pytest.raises(InputError, match="radius: "):
            estimate_poses(ellipses, DESIGN.camera, radius)


def enlarged(image, at, radius):
    """Draw a gray disc of this radius, px, over the marker at `at`, which then appears larger and
    closer."""
    cover = np.zeros(image.pixels.shape, np.uint8)
    center = [round(16 * x) for x in at]
    cv2.circle(cover, center, round(16 * radius), 255, -1, shift=4)
    fraction = cv2.GaussianBlur(cover, (0, 0), 0.8) / 255
    spotted = image.pixels * (1 - fraction) + 45 * fraction
    return Image(np.minimum(image.pixels, spotted).astype(np.uint8), image.time)


@pytest.mark.parametrize("sensor", ["dense", "paper16"])
@pytest.mark.parametrize("larger", [1.12, 1.5])
def test_a_speck_on_a_marker_loses_only_that_marker(sensor, larger):
    """A speck removes one marker: forces change by at most the effect of one marker of 16 and two
    sd, 25 mN."""
    design = load_sensor(sensor)
    images = membrane_images.sequence(sensor)
    sensing_pipeline = SensingPipeline(design)
    state = sensing_pipeline.measure_flat_reference(sensing_pipeline.initial_state(), images.flat)
    state = spotted = sensing_pipeline.measure_rest_reference(
        state, images.rest, membrane_images.GAUGE
    )
    markers, _ = sensing_pipeline.detect_markers(state, images.rest[0])
    observed = project(sensing_pipeline.camera, markers.p_SM - design.camera.p_SC)
    center = observed[len(observed) // 2]
    radius = larger * sensing_pipeline.camera.fx * design.markers.radius / design.camera.distance
    for image in images.pressed:
        clean, state = sensing_pipeline.step(state, image, image.time)
        touch, spotted = sensing_pipeline.step(spotted, enlarged(image, center, radius), image.time)
        assert touch.status == "ok"
        assert touch.markers is not None
        assert len(touch.markers) >= design.markers.count - 1
        assert touch.force_normal == pytest.approx(clean.force_normal, abs=0.025)
