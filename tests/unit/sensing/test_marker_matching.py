"""Marker identity under missing and spurious circles, a displaced camera, a pressed and sheared
membrane."""

import numpy as np
import pytest

from mjtactile.core import geometry, optics
from mjtactile.core.design import load_sensor
from mjtactile.core.optics import Camera
from mjtactile.core.types import CirclePoses
from mjtactile.sensing.pose import marker_matching

SENSORS = ["paper16", "dense"]


def seen(p_SM, rng, missing=0.0, spurious=0, noise=20e-6):
    """Return some of the markers in random order, with noise, and false circles; and the true ids
    (-1: false)."""
    ids = np.flatnonzero(rng.random(len(p_SM)) >= missing)
    low = p_SM.min(axis=0)
    high = p_SM.max(axis=0)
    false = rng.uniform(low, high, (8 * spurious + 1, 3))
    # not on top of a marker
    distance = np.linalg.norm(false[:, None, :2] - p_SM[:, :2], axis=2).min(axis=1) > 1.3e-3
    false = false[distance][:spurious]
    p = np.concatenate([p_SM[ids] + rng.normal(scale=noise, size=(len(ids), 3)), false])
    ids = np.append(ids, np.full(len(false), -1))
    order = rng.permutation(len(p))
    return p[order], ids[order]


def pressed(design, depth=4e-3, shear=1e-3):
    """Return markers of a membrane pressed off its center: bell-shaped heights, contracted toward
    the center, and sheared."""
    p = design.markers.p_SM.copy()
    d = p[:, :2] - [3e-3, -2e-3]
    bell = np.exp(-(d**2).sum(axis=1) / (2 * 5e-3**2))
    p[:, 2] = -depth * bell
    p[:, :2] += -0.12 * d * bell[:, None] + np.array([shear, 0.4 * shear]) * bell[:, None]
    slope = depth * bell[:, None] * d / 5e-3**2
    return p, geometry.normal_from_slope(slope[:, 0], slope[:, 1])


# of the pitch; beyond a half the next marker is closer
@pytest.mark.parametrize("fraction", [1 / 3, 0.45])
@pytest.mark.parametrize("sensor", SENSORS)
def test_flat_membrane_seen_by_a_displaced_camera(sensor, fraction):
    design = load_sensor(sensor)
    layout = design.markers.p_SM
    markers = design.markers
    for seed in range(20):
        rng = np.random.default_rng(seed)
        p, ids = seen(layout, rng)
        offset = rng.choice([-1, 1], 2) * fraction * np.array([markers.pitch_x, markers.pitch_y])
        rotation = geometry.rotation_from_vector([0, 0, np.deg2rad(rng.uniform(-1, 1))])
        np.testing.assert_array_equal(
            marker_matching.match(p @ rotation.T + [*offset, 0], layout, layout), ids
        )


@pytest.mark.parametrize("sensor", SENSORS)
def test_sixty_percent_missing_and_others_spurious(sensor):
    design = load_sensor(sensor)
    layout = design.markers.p_SM
    right = wrong = total = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        p, ids = seen(layout, rng, missing=0.6, spurious=design.markers.count // 8)
        p += [design.markers.pitch_x / 4, -design.markers.pitch_y / 5, 0]
        found = marker_matching.match(p, layout, layout)
        right += np.sum((found == ids) & (ids >= 0))
        wrong += np.sum((found != ids) & (found >= 0) & (ids >= 0))
        total += np.sum(ids >= 0)
        assert len(np.unique(found[found >= 0])) == np.sum(found >= 0)
    # a wrong identity is a false displacement of a pitch; a missing one costs little
    assert wrong == 0
    # a spurious circle may be closer to the expected position than the marker itself
    assert right >= 0.97 * total


@pytest.mark.parametrize("sensor", SENSORS)
def test_identity_is_kept_through_a_press(sensor):
    design = load_sensor(sensor)
    layout = design.markers.p_SM
    last = design.markers.p_SM
    rng = np.random.default_rng(0)
    kept = total = 0
    for step in np.linspace(0, 1, 8)[1:]:  # 0.25 s at 30 fps
        truth, _ = pressed(design, depth=5e-3 * step, shear=1.5e-3 * step)
        p, ids = seen(truth, rng, missing=0.6, spurious=2)
        found = marker_matching.match(p, last, layout)
        assert not np.any((found != ids) & (found >= 0) & (ids >= 0))
        kept = kept + np.sum(found[ids >= 0] >= 0)
        total = total + np.sum(ids >= 0)
        last = last.copy()
        last[found[found >= 0]] = p[found >= 0]
    # 5 of 16 markers are visible, too few to determine a neighbourhood's motion every time
    assert kept >= 0.9 * total


def test_a_wrong_match_is_found_by_its_neighbours():
    design = load_sensor("dense")
    layout = design.markers.p_SM
    # marker 40 is hidden, and a speck lies half a pitch away from it, nearest to its place of all
    # circles
    p = np.delete(layout, 40, axis=0)
    p = np.concatenate([p, layout[40:41] + np.array([0.55 * design.markers.pitch_y, 0, 0])])
    found = marker_matching.match(p, layout, layout)
    assert found[-1] == -1
    np.testing.assert_array_equal(found[:-1], np.delete(np.arange(81), 40))


def test_unknown_expectations_come_from_the_neighbours():
    design = load_sensor("dense")
    layout = design.markers.p_SM
    moved = layout + np.array([1.4e-3, 0.5e-3, 0])
    expected = moved.copy()
    expected[::3] = np.nan
    np.testing.assert_array_equal(marker_matching.match(moved, expected, layout), np.arange(81))


def test_no_detected_markers_are_no_error():
    layout = load_sensor("dense").markers.p_SM
    assert len(marker_matching.match(np.zeros((0, 3)), layout, layout)) == 0
    np.testing.assert_array_equal(
        marker_matching.match(np.full((3, 3), np.nan), layout, layout), [-1, -1, -1]
    )
    np.testing.assert_array_equal(marker_matching.match(layout[5:6], layout, layout), [5])


def poses_of(design, p_SM, n_S, ids_bad=()):
    """Return circle poses as a detector gives them, in random order, so that the order has no
    information.

    The second normal is the first mirrored at the line of sight.
    """
    p = p_SM - design.camera.p_SC
    view = geometry.unit(p)
    mirrored = 2 * (n_S * view).sum(axis=1, keepdims=True) * view - n_S
    swap = np.random.default_rng(9).random((len(p), 1)) < 0.5
    status = np.full(len(p), "ok", dtype="<U16")
    status[list(ids_bad)] = "cut"
    camera = Camera.from_design(design.camera, design.glass)
    return CirclePoses(
        optics.project(camera, p),
        p,
        np.where(swap, mirrored, n_S),
        p,
        np.where(swap, n_S, mirrored),
        np.tile(1e-10 * np.eye(3), (len(p), 1, 1)),
        status,
    )


@pytest.mark.parametrize(("sensor", "fraction"), [("paper16", 0.9), ("dense", 1.0)])
def test_two_fold_ambiguity_is_resolved_by_the_surface(sensor, fraction):
    design = load_sensor(sensor)
    p, n = pressed(design)
    poses = poses_of(design, p, n)
    markers = marker_matching.identify(poses, design, p)
    distance = np.degrees(np.arccos(np.clip((poses.n_C * poses.n_C_alt).sum(axis=1), -1, 1)))
    # closer normals are interchangeable: face-on, a normal is only known to 2 degrees
    clear = distance > 4
    assert clear.sum() >= 8
    first_only = np.mean(np.linalg.norm(poses.n_C - n, axis=1)[clear] < 1e-9)
    # 16 markers see this bell with two or three points across: a slope's sign may be lost next to
    # its edge
    assert np.mean(np.linalg.norm(markers.n_S - n, axis=1)[clear] < 1e-9) >= fraction
    assert first_only < 0.8  # there was something to resolve


def test_identify_sorts_drops_and_scales():
    design = load_sensor("dense")
    p, n = pressed(design)
    rng = np.random.default_rng(1)
    order = rng.permutation(81)
    poses = poses_of(design, p[order], n[order], ids_bad=[4, 7])
    markers = marker_matching.identify(poses, design, p)
    expected = np.setdiff1d(np.arange(81), order[[4, 7]])
    np.testing.assert_array_equal(markers.ids, expected)
    np.testing.assert_allclose(markers.p_SM, p[expected], atol=1e-12)
    # a marker 1 % larger than assumed is 1 % farther from the origin of its rays: the camera less
    # the glass shift
    larger = marker_matching.identify(poses, design, p, np.full(81, 1.01))
    camera = Camera.from_design(design.camera, design.glass)
    shift = optics.glass_shift(
        camera, optics.unproject(camera, optics.project(camera, p - design.camera.p_SC))
    )
    apparent = p - design.camera.p_SC - shift[:, None] * [0, 0, 1]
    np.testing.assert_allclose(larger.p_SM, (p + 0.01 * apparent)[expected], atol=1e-12)
