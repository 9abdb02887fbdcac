"""Tests of the flat reference: a tilted camera and markers of another size are estimated."""

from dataclasses import replace

import numpy as np
import pytest

from mjtactile.core import geometry
from mjtactile.core.design import load_sensor
from mjtactile.core.errors import DeviceError
from mjtactile.core.optics import Camera, project
from mjtactile.core.types import Image
from mjtactile.sensing.pose.flat_reference import fit_camera_pose
from mjtactile.sensing.stateful_pipeline import StatefulPipeline
from mjtactile.sim.rendering.renderer import Renderer

DESIGN = load_sensor("dense")
OUTWARD = np.tile([0.0, 0.0, 1.0], (DESIGN.markers.count, 1))


def flat_images(count=10, **renderer):
    view = Renderer(DESIGN, **renderer)
    return [view.render(DESIGN.markers.p_SM, OUTWARD) for _ in range(count)]


def test_pose_fit_inverts_the_projection():
    camera = Camera.from_design(DESIGN.camera, DESIGN.glass)
    R = geometry.rotation_from_vector(np.array([0.02, -0.03, 0.01]))
    p = DESIGN.camera.p_SC + [3e-4, -2e-4, 5e-4]
    found_R, found_p, residual = fit_camera_pose(
        DESIGN, camera, DESIGN.markers.p_SM, project(camera, (DESIGN.markers.p_SM - p) @ R)
    )
    np.testing.assert_allclose(found_R, R, atol=1e-9)  # exact data: only rounding is left
    np.testing.assert_allclose(found_p, p, atol=1e-10)
    assert residual < 1e-8


def test_radius_of_each_marker_is_found():
    factor = 1 + 0.03 * np.random.default_rng(1).uniform(-1, 1, DESIGN.markers.count)
    perception = StatefulPipeline.of(DESIGN)
    flat = perception.measure_flat_reference(
        flat_images(radius=DESIGN.markers.radius * factor, seed=2)
    )
    # depth noise of 18 um in 45 mm over ten images is 1.3e-4; four sd
    np.testing.assert_allclose(flat.scale, factor, atol=6e-4)
    view = Renderer(DESIGN, radius=DESIGN.markers.radius * factor, seed=5)
    markers = perception.pipeline.detect_markers(
        perception.state, view.render(DESIGN.markers.p_SM, OUTWARD)
    )[0]
    # without the calibration 3 % of 45 mm is 1.35 mm
    assert np.abs(markers.p_SM[:, 2]).max() < 1.5e-4


def test_a_tilted_camera_is_estimated_and_corrected():
    """Tilt and shift the scene before the camera: the same images as from a camera that is mounted
    askew."""
    R_SC = geometry.rotation_from_vector(np.array([0.01, -0.015, 0.02]))
    p_SC = DESIGN.camera.p_SC + [4e-4, -3e-4, 6e-4]
    view = Renderer(DESIGN, seed=3)

    def image(p_SM: np.ndarray, n_S: np.ndarray) -> Image:
        return view.render((p_SM - p_SC) @ R_SC + DESIGN.camera.p_SC, n_S @ R_SC)

    perception = StatefulPipeline.of(DESIGN)
    flat = perception.measure_flat_reference(
        [image(DESIGN.markers.p_SM, OUTWARD) for _ in range(10)]
    )
    # 81 centres to 0.02 px over ten images: 0.7 um sideways, 2 um in depth, 1e-4 rad; four sd
    np.testing.assert_allclose(flat.p_SC, p_SC, atol=1e-5)
    np.testing.assert_allclose(flat.R_SC, R_SC, atol=4e-4)
    raised = DESIGN.markers.p_SM + [0.0, 0.0, 1e-3]
    markers = perception.pipeline.detect_markers(perception.state, image(raised, OUTWARD))[0]
    # 18 um / sqrt(81), four sd
    np.testing.assert_allclose(markers.p_SM.mean(axis=0), raised.mean(axis=0), atol=1e-5)


def test_a_reference_of_another_sensor_is_refused():
    with pytest.raises(DeviceError, match=r"radius_mm"):
        StatefulPipeline.of(DESIGN).measure_flat_reference(
            flat_images(2, radius=DESIGN.markers.radius * 1.15)
        )
    blank = Image(np.full((480, 640), 180, np.uint8))
    with pytest.raises(DeviceError, match="only 0 of 81 markers"):
        StatefulPipeline.of(DESIGN).measure_flat_reference([blank])
    stretched = replace(DESIGN, markers=replace(DESIGN.markers, pitch_x=3.9e-3))
    with pytest.raises(DeviceError, match=r"rms\) from the layout"):
        StatefulPipeline.of(stretched).measure_flat_reference(flat_images(2))


@pytest.mark.parametrize("stuck_inflated", [False, True])
def test_a_stuck_valve_is_detected_without_a_pressure_sensor(stuck_inflated):
    """A valve that does not move is detected by equal references.

    The membrane either stays flat, or was never flat.
    """
    x, y = (
        DESIGN.markers.p_SM[:, i] / size
        for i, size in ((0, DESIGN.frame.length), (1, DESIGN.frame.width))
    )
    bulge = 2e-3 * np.cos(np.pi * x) * np.cos(np.pi * y) * stuck_inflated
    view = Renderer(DESIGN, seed=4)
    images = [
        view.render(DESIGN.markers.p_SM + bulge[:, None] * [0, 0, 1], OUTWARD) for _ in range(5)
    ]
    perception = StatefulPipeline.of(DESIGN)
    perception.measure_flat_reference(images)
    with pytest.raises(DeviceError, match="check that the valve moves"):
        perception.measure_rest_reference(images, DESIGN.chamber.supply_gauge)
