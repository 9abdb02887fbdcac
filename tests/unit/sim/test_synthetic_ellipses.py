"""Tests of detections without an image: exact ellipses, errors as stated and as in the image
stages, and the report of this level."""

from dataclasses import replace

import numpy as np
import pytest

from mjtactile.core import geometry
from mjtactile.core.design import load_sensor
from mjtactile.core.scenario import Scenario
from mjtactile.core.types import Ellipses
from mjtactile.recording.reader import load_recording
from mjtactile.recording.writer import Recorder
from mjtactile.runtime.grasp import run_grasp
from mjtactile.sensing.image import markers
from mjtactile.sensing.image.ellipse import axes_from_shape
from mjtactile.sensing.pose.circles import estimate_poses
from mjtactile.sim.rendering.renderer import Renderer
from mjtactile.sim.rendering.synthetic_ellipses import EllipseSampler
from tests.emulated_host import controller_text

DESIGN = load_sensor("dense")
FLAT = DESIGN.markers.p_SM, np.tile([0.0, 0.0, 1.0], (DESIGN.markers.count, 1))


def bulged():
    """Return markers of a bulge 5 mm high, with the normals of its surface."""
    x, y, _ = DESIGN.markers.p_SM.T
    u = np.pi * x / 0.04
    v = np.pi * y / 0.03
    z = 5e-3 * np.cos(u) * np.cos(v)
    return np.column_stack([x, y, z]), geometry.normal_from_slope(
        -5e-3 * np.pi / 0.04 * np.sin(u) * np.cos(v), -5e-3 * np.pi / 0.03 * np.cos(u) * np.sin(v)
    )


def shape_of(ellipses):
    c = np.cos(ellipses.angle)
    s = np.sin(ellipses.angle)
    a, b = ellipses.semi_axes_px.T
    return np.column_stack(
        [ellipses.center_px, a * c * c + b * s * s, (a - b) * c * s, a * s * s + b * c * c]
    )


def test_a_circle_on_the_axis_is_a_circle_of_f_r_over_z():
    bare = replace(DESIGN.camera, distortion=(0.0,) * 5)
    design = replace(DESIGN, camera=bare, glass=replace(DESIGN.glass, refractive_index=1.0))
    midpoint = DESIGN.markers.count // 2
    center, shape = EllipseSampler(design)._true(*FLAT)
    np.testing.assert_allclose(center[midpoint], [319.5, 239.5], atol=1e-9)
    # px
    np.testing.assert_allclose(shape[midpoint], [600 * 1.0 / 45, 0.0, 600 * 1.0 / 45], atol=1e-9)


def test_exact_ellipses_lead_back_to_the_circles():
    """Exact ellipses through glass and lens give the circles back, by the sensing pipeline's closed
    form, which is independent code."""
    p_SM, n_S = bulged()
    sampler = EllipseSampler(DESIGN)
    center, shape = sampler._true(p_SM, n_S)
    axes, angle = axes_from_shape(shape)
    found = estimate_poses(
        Ellipses(center, axes, angle, np.tile(np.eye(5), (81, 1, 1)), np.full(81, "ok")),
        sampler.camera,
        DESIGN.markers.radius,
    )
    first = np.linalg.norm(found.p_CM + DESIGN.camera.p_SC - p_SM, axis=1)
    second = np.linalg.norm(found.p_CM_alt + DESIGN.camera.p_SC - p_SM, axis=1)
    # the closed form takes the distorted circle for an ellipse at its boundary, this its moments:
    # 0.001 px of size, 3 um of depth
    assert np.minimum(first, second).max() < 3e-6


def test_errors_are_as_large_as_stated():
    """Chi-square of five numbers, 81 markers, 40 sightings: 1 +- 0.011 (sd)."""
    sampler = EllipseSampler(DESIGN, seed=3)
    pose = bulged()
    true = np.concatenate(sampler._true(*pose), axis=1)
    spread = drawn_from(sampler, pose)
    chi = [
        np.einsum("ni,nij,nj->n", e, np.linalg.inv(spread), e).mean() / 5
        for e in (shape_of(sampler.sample(*pose).ellipses) - true for _ in range(40))
    ]
    assert np.mean(chi) == pytest.approx(1.0, abs=0.04)


def drawn_from(sampler, pose):
    """Return the covariance of the sampled errors, for the shapes without errors."""
    from mjtactile.sim.rendering import synthetic_ellipses

    _, shape = sampler._true(*pose)
    blur = sampler.design.camera.blur_px**2 / (shape[:, 0] * shape[:, 2])
    loss = synthetic_ellipses.LOSS + synthetic_ellipses.LOSS_BY_BLUR * blur[:, None]
    return loss[:, :, None] * loss[:, None] * sampler._bound(shape, pose[0])


@pytest.mark.parametrize("blur", [0.7, 2.0])
def test_errors_are_those_of_the_image_stages(blur):
    """Spread of centre and size over 16 images, median of 81 markers: sampling 3 %, the model's own
    10 %."""
    design = replace(DESIGN, camera=replace(DESIGN.camera, blur_px=blur))
    renderer = Renderer(design, seed=1)
    sampler = EllipseSampler(design, seed=1)
    pose = bulged()
    true = np.concatenate(sampler._true(*pose), axis=1)
    observed = []
    sampled = []
    for _ in range(16):
        fit, status = markers.search(renderer.render(*pose).pixels, min_radius_px=4)
        order = np.linalg.norm(fit.center[:, None] - true[:, :2], axis=2).argmin(axis=0)
        assert (status == "ok").all() and len(status) == 81
        observed.append(np.concatenate([fit.center, fit.shape], axis=1)[order] - true)
        sampled.append(shape_of(sampler.sample(*pose).ellipses) - true)
    ratio = np.median(np.std(sampled, axis=0), axis=0) / np.median(np.std(observed, axis=0), axis=0)
    np.testing.assert_allclose(ratio, 1.0, atol=0.2)


def test_markers_outside_the_image_or_missing_are_not_detected():
    radius = np.full(81, DESIGN.markers.radius)
    radius[7] = 0.0
    p_SM = FLAT[0].copy()
    p_SM[0, 0] -= 0.01
    ellipses = EllipseSampler(DESIGN, radius=radius).sample(p_SM, FLAT[1]).ellipses
    assert len(ellipses) == 79 and (ellipses.status == "ok").all()


@pytest.mark.slow(10)
def test_a_grasp_without_images_holds_the_egg_and_reports_it(tmp_path):
    (tmp_path / "quick.py").write_text(controller_text(hold=0.3))
    with Recorder(tmp_path / "run", {}) as recorder:
        scenario = Scenario(effects="-images", controller=str(tmp_path / "quick.py"))
        result = run_grasp(scenario, [recorder], workers=0)
        recorder.close(outcome=result.outcome)
    assert result.outcome == "held" and result.summary()["images"] is False
    assert result.hold_force_true == pytest.approx(0.6, abs=0.02)  # force in N, as with images
    recording = load_recording(tmp_path / "run")
    assert (
        recording.complete
        and not any(map(len, recording.columns["images"]))
        and not list((tmp_path / "run/frames").iterdir())
    )
