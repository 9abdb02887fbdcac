"""Shadows against similar triangles, vector algebra, symmetry and a brute-force march along every
ray."""

from dataclasses import replace

import numpy as np
import pytest

from mjtactile.core import optics
from mjtactile.core.design import load_sensor
from mjtactile.core.errors import InputError
from mjtactile.sim.rendering import shadows
from mjtactile.sim.rendering.led_illumination import Light
from mjtactile.sim.rendering.renderer import Renderer
from mjtactile.sim.rendering.shadows import (
    ShadowedLight,
    SmoothMembrane,
    bilinear,
    clearance,
    irradiance,
    may_block,
    visible,
    wall_clearance,
)

DENSE = load_sensor("dense")
OUTWARD = np.tile([0.0, 0.0, 1.0], (81, 1))
DOWN = 45e-3  # distance from the flat membrane to the LEDs, m
RING = np.array(
    [
        [8.5e-3, 8.5e-3, -DOWN],
        [-8.5e-3, 8.5e-3, -DOWN],
        [-8.5e-3, -8.5e-3, -DOWN],
        [8.5e-3, -8.5e-3, -DOWN],
    ]
)


def grid(node, half_x=20e-3, half_y=15e-3):
    x, y = (np.linspace(-half, half, round(2 * half / node) + 1) for half in (half_x, half_y))
    return np.stack(np.meshgrid(x, y), axis=-1)


def crossing(x, clear, level):
    """Return the position of the last rise of `clear` through `level` along `x`."""
    last = np.flatnonzero((clear[:-1] < level) & (clear[1:] >= level))[-1]
    return np.interp(level, clear[last : last + 2], x[last : last + 2])


def scene(p_SM, **leds):
    """Light the dense sensor without glass and lens errors, so that unshadowed and shadowed light
    have the same positions."""
    camera = replace(DENSE.camera, distortion=(0.0,) * 5)
    glass = replace(DENSE.glass, refractive_index=1.0)
    design = replace(DENSE, camera=camera, glass=glass, leds=replace(DENSE.leds, **leds))
    lens = optics.Camera.from_design(camera, glass)
    return Light(design, lens).field(p_SM), ShadowedLight(design, lens).field(p_SM), lens


def dented(depth, at=(0.0, 0.0), width=3e-3, design=DENSE):
    p = design.markers.p_SM.copy()
    p[:, 2] = -depth * np.exp(-((p[:, :2] - at) ** 2).sum(axis=1) / (2 * width**2))
    return p


@pytest.mark.parametrize("node", [1e-3, 0.25e-3])
@pytest.mark.parametrize("level", [0.0, -1.0, 1.0])
def test_shadow_of_a_ridge_follows_from_similar_triangles(node, level):
    """The shadow of a ridge follows similar triangles.

    A ridge along y that ends at x0, h below the membrane, hides an LED at xl up to x0 + (x0 - xl) h
    / (D - h). The LED's far edge, xl - radius, appears first (level -1: none is visible before),
    its near edge last.
    """
    xy = grid(node)
    height = 6e-3
    ridge = 5e-3
    led = -30e-3
    radius = 1.5e-3
    z = -height * np.interp(xy[..., 0], ridge + np.array([-4e-3, -2e-3, 0.0, 2e-3]), [0, 1, 1, 0])
    clear = clearance(xy, z, np.array([[led, 0.0, -DOWN]]), radius)[0]
    end = ridge + (ridge - (led - level * radius)) * height / (DOWN - height)
    row = len(xy) // 2  # y = 0: a ray there runs along x
    # samples along a ray are half a node apart: the ridge's end is missed by that much, its
    # shadow's by (1 + h / (D - h))
    assert crossing(xy[row, :, 0], clear[row], level) == pytest.approx(end, abs=0.6 * node)


def test_penumbra_of_a_straight_edge():
    assert visible(np.array([-3.0, -1.0, 0.0, 0.5, 1.0, 9.0])) == pytest.approx(
        [0, 0, 0.5, 0.75, 1, 1]
    )


def dents(x, y):
    """Return a bulge with three dents, m; curvature up to 1.4 / mm at their bottoms."""
    bulge = 2e-3 * np.cos(np.pi * x / 40e-3) * np.cos(np.pi * y / 30e-3)
    return bulge - sum(
        depth * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * width**2))
        for depth, width, u, v in (
            (13e-3, 3e-3, 12e-3, 0.0),
            (9e-3, 2.5e-3, -9e-3, 8e-3),
            (5e-3, 2e-3, -3e-3, -6e-3),
        )
    )


@pytest.mark.parametrize(
    ("node", "wrong", "lit_and_wrong"),
    [(1e-3, 0.2, 0.05), pytest.param(0.4e-3, 0.07, 0.018, marks=pytest.mark.slow)],
)
def test_ray_intersections_agree_with_a_fine_march(node, wrong, lit_and_wrong):
    """Rays are blocked as in a march of 1000 steps over the membrane's own formula, for every node
    and LED of a wide ring.

    Wrong nodes lie along the borders of the shadows. Their fraction of the hidden ones falls with
    the node spacing (patches of 5 mm have a fifth of their area within half a node of 1 mm). Most
    of them are on the flanks, where the membrane turns away and is dark anyway. Few would have more
    than a twentieth of the maximum light.
    """
    xy = grid(node)
    leds = RING * [2.0, 2.0, 1.0]
    z = dents(xy[..., 0], xy[..., 1])
    found = clearance(xy, z, leds) < 0
    light = irradiance(xy, z, leds)
    hidden = np.zeros(found.shape, bool)
    for part in np.linspace(0, 0.5, 1001)[1:]:
        x, y, along = (
            (1 - part) * start + part * leds[:, i, None, None]
            for i, start in enumerate((xy[..., 0], xy[..., 1], z))
        )
        hidden |= dents(x, y) < along - 1e-9
    assert hidden.mean() > 0.04
    assert (found != hidden).sum() < wrong * hidden.sum()
    assert ((found != hidden) & (light > 0.05 * light.max())).sum() < lit_and_wrong * hidden.sum()


@pytest.mark.parametrize("steepness", [3e-3, 12e-3])
def test_no_shadow_in_a_convex_bulge(steepness):
    """The air behind a bulge is convex, so that a straight ray from an LED inside of it stays
    inside of it."""
    xy = grid(1e-3)
    z = steepness * np.sqrt(
        np.maximum(1 - (xy[..., 0] / 20.1e-3) ** 2 - (xy[..., 1] / 20.1e-3) ** 2, 0)
    )
    clear = clearance(xy, z, RING)
    round_part = z > 0  # beyond it the membrane is flat, and the bulge's edge no longer convex
    assert clear[:, round_part].min() >= 1
    dent = clearance(xy, -6 * z, RING)
    assert dent.min() < -1  # the inverted bulge shadows itself


@pytest.mark.parametrize(("slope", "found"), [(0.85, False), (0.95, True)])
def test_the_search_starts_where_a_slope_is_as_steep_as_a_ray(slope, found):
    """A light 10 m away, 0.9 down per length: all rays are as steep to 0.4 %."""
    xy = grid(1e-3)
    z = -slope * np.clip(xy[..., 0], 0, 4e-3)
    assert may_block(xy, z, np.array([[-10.0, 0.0, -9.0]])) == found


def test_irradiance_is_inverse_square_with_both_cosines():
    """On a tilted plane, against vectors: cos at the LED x cos at the membrane / distance^2."""
    xy = grid(1e-3)
    z = 0.3 * xy[..., 0] - 0.2 * xy[..., 1]
    got = irradiance(xy, z, RING)
    normal = np.array([0.3, -0.2, -1.0]) / np.linalg.norm([0.3, -0.2, -1.0])  # of the inside
    for led, light in zip(RING, got, strict=True):
        away = led - np.dstack([xy, z])
        distance = np.linalg.norm(away, axis=-1)
        expected = (away @ normal / distance) * (-away[..., 2] / distance) / distance**2
        np.testing.assert_allclose(light, expected, rtol=1e-9)  # the slope of a plane is exact


def test_unblocked_flat_membrane_is_lit_as_without_shadows():
    even, shaded, _ = scene(DENSE.markers.p_SM.copy())
    # light without shadows is the same formula at the pixels' own positions. The remaining error is
    # the interpolation between nodes, (1 mm)^2 / 8 of a curvature of 1 / (30 mm)^2
    inside = slice(60, -60), slice(70, -70)
    np.testing.assert_allclose(shaded[inside], even[inside], atol=3e-4)
    # next to the frame a block of 16 px = 1.2 mm is half beyond the rim and takes the rim's light:
    # 1 / (100 mm) of slope
    np.testing.assert_allclose(shaded, even, atol=6e-3)


def test_a_bulge_without_shadow_keeps_all_its_light():
    p = DENSE.markers.p_SM.copy()
    p[:, 2] = 3e-3 * np.cos(np.pi * p[:, 0] / 40e-3) * np.cos(np.pi * p[:, 1] / 30e-3)
    light = ShadowedLight(DENSE, optics.Camera.from_design(DENSE.camera, DENSE.glass))
    z = light._membrane.heights(p)
    assert not may_block(light._membrane.xy, z, light._p_SL)
    parts = irradiance(light._membrane.xy, z, light._p_SL)
    assert light._blocked(z, parts / parts.sum(axis=0)) is None


def test_symmetric_scene_gives_a_symmetric_image():
    p = DENSE.markers.p_SM.copy()
    p[:, 2] = dented(11e-3, at=(14e-3, 0.0))[:, 2] + dented(11e-3, at=(-14e-3, 0.0))[:, 2]
    even, shaded, _ = scene(p)
    assert (shaded / even).min() < 0.7  # deep enough to cast shadows
    # mirrored nodes and pixels agree up to rounding and the table of cv2.remap: 1/32 of a node or
    # block, with light that falls from 1 to 0.5 over a node at worst
    np.testing.assert_allclose(shaded, shaded[:, ::-1], atol=0.016)
    np.testing.assert_allclose(shaded, shaded[::-1], atol=0.016)


def test_the_wall_of_the_frame_casts_its_shadow_onto_the_membrane():
    """The shadow border of the frame's wall is that of its glass-side edge.

    One LED at (xl, 0) is beyond the opening. The edge of the wall at L / 2, depth t below the flat
    membrane, hides it for x > xl - (xl - L/2) D / (D - t).
    """
    led = 26e-3
    design = replace(DENSE, leds=replace(DENSE.leds, count=1, ring_radius=led))
    lens = optics.Camera.from_design(design.camera, design.glass)
    light = ShadowedLight(design, lens)
    light._p_SL = np.array([[led, 0.0, -DOWN]])  # a ring of one LED is at 180 degrees
    field = light.field(design.markers.p_SM)
    border = led - (led - 20e-3) * DOWN / (DOWN - 20e-3)
    clear = wall_clearance(design.frame, 20e-3, grid(1e-3), np.zeros((31, 41)), light._p_SL)[0]
    # linear there
    assert crossing(-grid(1e-3)[15, ::-1, 0], clear[15, ::-1], 0.0) == pytest.approx(
        -border, abs=1e-6
    )
    # in the image: half of the step between both sides of the penumbra, which is 2 x 1.5 mm x t /
    # (D - t) wide
    pixels = np.arange(330.0, 600.0)
    p_CP = np.column_stack([np.linspace(0, 19.5e-3, 400), np.zeros(400), np.full(400, DOWN)])
    x = np.interp(pixels, optics.project(lens, p_CP)[:, 0], p_CP[:, 0])
    row = field[239:241, 330:600].mean(axis=0)
    lit = np.interp(border - 1.5e-3, x, row)
    dark = np.interp(border + 1.5e-3, x, row)
    center = np.interp(-(lit + dark) / 2, -row, x)
    assert lit - dark > 0.2
    # in full shadow only light scattered by the walls remains: the part without falloff
    assert row[x > border + 2.5e-3][0] == pytest.approx(
        1 - design.leds.vignetting / light._loss, abs=1e-3
    )
    # 2 px; the decrease of the light over the penumbra shifts its center
    assert center == pytest.approx(border, abs=0.15e-3)


def test_camera_rays_end_on_the_membrane():
    """Nodes of a dented membrane, projected through glass and lens, are the positions assigned to
    the pixels there."""
    lens = optics.Camera.from_design(DENSE.camera, DENSE.glass)
    light = ShadowedLight(DENSE, lens)
    membrane = light._membrane
    z = membrane.heights(dented(6e-3, width=5e-3))
    places = light._pixel_coordinates(z, 4)
    uv = optics.project(lens, np.dstack([membrane.xy, z + DOWN]))[4:-4, 4:-4]
    found = bilinear(places, (uv - 1.5) / 4)  # the center of the first block of 4 px is at 1.5
    expected = np.stack(np.meshgrid(np.arange(41), np.arange(31)), axis=-1)[4:-4, 4:-4]
    # in nodes of 1 mm: bilinear between blocks; without the membrane's height the places were 3
    # nodes off
    np.testing.assert_allclose(found, expected, atol=0.05)


@pytest.mark.parametrize(("node", "worst"), [(1e-3, 8e-5), (0.25e-3, 2e-5)])
def test_membrane_goes_through_the_markers_and_ends_at_the_frame(node, worst, monkeypatch):
    monkeypatch.setattr(shadows, "_NODE", node)
    p = dented(4e-3, at=(5e-3, -3e-3), width=6e-3)
    p[:, :2] += 5e-4 * np.sin(200 * p[:, 1::-1])  # along the membrane, too
    membrane = SmoothMembrane(DENSE)
    z = membrane.heights(p)
    # bilinear between nodes: 1/8 node^2 x curvature, 2 x 4 mm / (6 mm)^2 = 3e-5 at 1 mm. It is
    # somewhat more since a thin-plate spline's curvature peaks at its points; the peak's part falls
    # with the node spacing, not with its square
    np.testing.assert_allclose(bilinear(z, membrane.columns_rows(p[:, :2])), p[:, 2], atol=worst)
    rim = np.concatenate([z[0], z[-1], z[:, 0], z[:, -1]])
    assert np.abs(rim).max() < 2e-5  # between the points by which it is held, 2.5 mm apart


def test_a_circular_frame_holds_the_membrane_too():
    design = replace(DENSE, frame=replace(DENSE.frame, length=40e-3, width=40e-3, shape="circle"))
    membrane = SmoothMembrane(design)
    z = membrane.heights(dented(4e-3, design=design))
    outside = np.hypot(membrane.xy[..., 0], membrane.xy[..., 1]) >= 20e-3
    assert outside.any() and z.min() < -3.9e-3
    assert np.abs(z[outside]).max() < 2e-5  # as above


def test_shadows_need_all_markers():
    renderer = Renderer(DENSE, shadows=True)
    with pytest.raises(InputError, match="all 81 markers"):
        renderer.render(DENSE.markers.p_SM[:80], OUTWARD[:80])


def test_without_shadows_no_state_is_left():
    assert type(Renderer(DENSE)._light) is Light
    assert type(Renderer(DENSE, shadows=True)._light) is ShadowedLight
