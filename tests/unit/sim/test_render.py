"""Tests of the renderer against brute-force ray casting of the same scene: 16 x 16 rays per pixel,
each traced face by face.

Each ray is at a random position in its cell of 1/16 px. On a regular grid an edge along a pixel row
would be off by up to 1/32 px, 2 DN. The reference shares no code with the renderer or with
`optics`: OpenCV inverts the lens, and Snell's law is in vector form. A ray is black if it meets the
marker's plane within its radius.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from mjtactile.core import geometry
from mjtactile.core.design import load_sensor
from mjtactile.core.sensor_parts import Leds
from mjtactile.sim.rendering.renderer import Effects, Renderer

RAYS = 16
NO_LEDS = Leds(count=0, membrane_dn=185.0, marker_dn=40.0)  # even light: shapes only


def bent_lens(name="paper16"):
    design = load_sensor(name)
    return replace(
        design,
        leds=NO_LEDS,
        camera=replace(design.camera, distortion=(-0.2, 0.06, 0.002, -0.001, 0.01)),
    )


def tilted_scene(design, seed=3):
    """Return markers moved by up to 1 mm along and -6..+2 mm across the membrane, tilted by up to
    45 degrees."""
    rng = np.random.default_rng(seed)
    p = design.markers.p_SM
    p = p + rng.uniform([-1e-3, -1e-3, -6e-3], [1e-3, 1e-3, 2e-3], p.shape)
    tilt = np.deg2rad(rng.uniform(0, 45, len(p)))
    angle = rng.uniform(0, 2 * np.pi, len(p))
    return p, np.column_stack(
        [np.sin(tilt) * np.cos(angle), np.sin(tilt) * np.sin(angle), -np.cos(tilt)]
    )


def refracted(d, ratio):
    cos_in = d[:, 2:]
    normal = np.array([0.0, 0.0, 1.0])
    return ratio * d + (np.sqrt(1 - ratio**2 * (1 - cos_in**2)) - ratio * cos_in) * normal


def cast(design, p_SM, n_S, corner, size, blur):
    """Return grey levels of the `size` (w, h) pixels from `corner` (u, v), by brute force."""
    margin = int(np.ceil(5 * blur)) + 1
    u = corner[0] - margin - 0.5 + (np.arange((size[0] + 2 * margin) * RAYS) + 0.5) / RAYS
    v = corner[1] - margin - 0.5 + (np.arange((size[1] + 2 * margin) * RAYS) + 0.5) / RAYS
    uv = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 1, 2)
    uv += np.random.default_rng(0).uniform(-0.5 / RAYS, 0.5 / RAYS, uv.shape)
    camera = design.camera
    glass = design.glass
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-13)
    xy = cv2.undistortPoints(uv, camera.K, np.array(camera.distortion), None, None, None, stop)[
        :, 0
    ]
    air = geometry.unit(np.column_stack([xy, np.ones(len(xy))]))
    inside = refracted(air, 1 / glass.refractive_index)
    p = (
        air * (glass.distance / air[:, 2:])
        + inside * (glass.thickness / inside[:, 2:])
        + camera.p_SC
    )
    d = refracted(inside, glass.refractive_index)
    flat = p + d * (-p[:, 2:] / d[:, 2:])
    inner = (np.abs(flat[:, 0]) < design.frame.length / 2) & (
        np.abs(flat[:, 1]) < design.frame.width / 2
    )
    gray = np.where(inner, design.leds.membrane_dn, 0.45 * design.leds.membrane_dn)
    # a marker 6 mm above the plane appears less than 8 mm aside
    near = np.linalg.norm(p_SM[:, :2] - flat[:, :2].mean(axis=0), axis=1) < 12e-3
    for center, n in zip(p_SM[near], n_S[near], strict=True):
        hit = p + d * (((center - p) @ n) / (d @ n))[:, None]
        gray[((hit - center) ** 2).sum(axis=1) < design.markers.radius**2] = design.leds.marker_dn
    gray = gray.reshape(len(v), len(u))
    if blur:
        gray = gaussian_filter(gray, blur * RAYS, truncate=6)
    gray = gray.reshape(len(v) // RAYS, RAYS, len(u) // RAYS, RAYS).mean(axis=(1, 3))
    return gray[margin:-margin, margin:-margin]


def around(design, p_SM, half=26):
    camera = design.camera
    u, v = (camera.K @ (p_SM - camera.p_SC) / (p_SM[2] + camera.distance))[:2].astype(int)
    return (max(u - half, 0), max(v - half, 0)), (2 * half, 2 * half)


@pytest.mark.parametrize(
    ("blur", "worst", "rms", "which"),
    [
        pytest.param(0.35, 2.5, 0.2, (15,), marks=pytest.mark.slow),
        (0.7, 1.2, 0.1, (5,)),
        pytest.param(1.3, 0.6, 0.07, (5,), marks=pytest.mark.slow),
    ],
)
def test_markers_agree_with_traced_rays(blur, worst, rms, which):
    design = bent_lens()
    p, n = tilted_scene(design)
    image = Renderer(design).irradiance_image(p, n, effects=Effects(blur_px=blur))
    for i in which:
        (u, v), (w, h) = around(design, p[i])
        error = image[v : v + h, u : u + w] - cast(design, p, n, (u, v), (w, h), blur)
        # The remaining error is the reference's: contrast 145 x 0.4 / 256 per edge cell, averaged
        # over the cells that the blur spans. With 48 x 48 rays the rms at 0.7 px falls to 0.03 DN.
        # The camera's noise is 2 DN.
        assert np.abs(error).max() < worst
        assert np.sqrt(np.mean(error**2)) < rms


def test_center_of_darkness_has_no_bias():
    design = bent_lens()
    p, n = tilted_scene(design, seed=5)
    renderer = Renderer(design)
    image = renderer.irradiance_image(p, n)
    for i in (0, 9):
        (u, v), (w, h) = around(design, p[i], half=23)
        lit = image[v, u] - cast(design, p[i : i + 1], n[i : i + 1], (u, v), (w, h), 0.7)
        dark = image[v, u] - image[v : v + h, u : u + w].astype(float)
        grid = np.mgrid[:h, :w]
        center = (grid * dark).sum(axis=(1, 2)) / dark.sum()
        reference = (grid * lit).sum(axis=(1, 2)) / lit.sum()
        # the requirement; a detector's noise is 0.02 px
        np.testing.assert_allclose(center, reference, atol=0.005)
        # area: 1e-3 of r = 20 px is 0.01 px of radius
        assert dark.sum() == pytest.approx(lit.sum(), rel=1e-3)


def test_the_frame_border_agrees_with_traced_rays():
    design = bent_lens()
    none = np.zeros((0, 3))
    image = Renderer(design).irradiance_image(none, none)
    reference = cast(design, none, none, (30, 20), (50, 50), 0.7)
    # the reference's own sampling, as above
    np.testing.assert_allclose(image[20:70, 30:80], reference, atol=1.2)
    assert reference.min() < 90 and reference.max() > 180  # the corner is in the patch


def test_markers_cut_by_the_image_border_and_out_of_sight():
    design = bent_lens()
    design = replace(design, camera=replace(design.camera, distortion=(0.0,) * 5))
    p = np.array([[24e-3, 0, 0], [0, -18.2e-3, 0], [0.2, 0, 0], [0, 0, -0.06], [np.nan, 0, 0]])
    n = np.tile([0.0, 0.0, -1.0], (5, 1))
    image = Renderer(design).irradiance_image(p, n)
    assert image.shape == (480, 640)
    reference = cast(design, p[:2], n[:2], (590, 200), (50, 80), 0.7)
    np.testing.assert_allclose(image[200:280, 590:], reference, atol=1.2)  # as above
    assert np.isfinite(image).all()
    assert image[0, 319] == pytest.approx(40.0, abs=1.0)


def test_noise_has_the_design_s_sd_no_bias_and_is_seeded():
    design = load_sensor("dense")
    p = design.markers.p_SM
    n = np.tile([0.0, 0.0, -1.0], (81, 1))
    renderer = Renderer(design, seed=4)
    clean = renderer.irradiance_image(p, n)
    first, second = (renderer.render(p, n).pixels.astype(float) for _ in range(2))
    error = first - clean
    # 307 200 pixels: the mean of noise 2 DN is known to 0.004 DN; rounding adds 1/12 DN^2 of
    # variance
    assert abs(error.mean()) < 0.015
    assert error.std() == pytest.approx(np.hypot(2.0, 12**-0.5), rel=0.01)
    assert abs(np.corrcoef(error.ravel(), (second - clean).ravel())[0, 1]) < 0.01
    again = Renderer(design, seed=4).render(p, n)
    np.testing.assert_array_equal(again.pixels, first)
    quiet = renderer.render(p, n, 1.5, effects=Effects(noise_dn=0.0))
    assert quiet.time == 1.5
    assert np.abs(quiet.pixels - clean).max() <= 0.5001  # rounded to nearest, not cut


def test_light_falls_off_as_designed_and_follows_the_membrane():
    design = load_sensor("dense")
    none = np.zeros((0, 3))
    image = Renderer(design).irradiance_image(none, none)
    # interpolation of the light in 16 px blocks
    assert image[240, 320] == pytest.approx(185, abs=0.2)
    corner = design.camera.K @ (np.array([-19.5e-3, -14.5e-3, 0.0]) - design.camera.p_SC) / 44.3e-3
    u, v = corner[:2].astype(int)
    # 0.5 mm from the corner itself, lens neglected
    assert image[v, u] == pytest.approx(0.75 * 185, rel=0.03)
    p = design.markers.p_SM.copy()
    n = np.tile([0.0, 0.0, -1.0], (81, 1))
    flat = Renderer(design).irradiance_image(p, n)
    bubble = np.cos(np.pi * p[:, 0] / design.frame.length) * np.cos(
        np.pi * p[:, 1] / design.frame.width
    )
    p[:, 2] = -3e-3 * bubble
    near = Renderer(design).irradiance_image(p, n)
    between = (slice(255, 262), slice(290, 297))  # no marker there in either image
    assert 1.01 < near[between].mean() / flat[between].mean() < 1.2  # closer: (45/42)^2
