"""Tests of the surface information from a grip of two fingers, and of the grip controller."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from mjtactile.core.types import Command, GripperState, Observation, Touch
from mjtactile.explore.grip_scan import _FACING, HEIGHTS, GripController, GripCycle, grips_of
from mjtactile.explore.meshing import mesh_of
from mjtactile.explore.object_size import principal_sizes
from mjtactile.explore.simulated import TURNS, next_grip
from mjtactile.explore.surface_fusion import fuse
from mjtactile.explore.surface_patch import Patch, group_covariance

RADIUS = 0.012


def test_two_fingers_face_each_other():
    # right-handed frames, z towards the other finger, y up, and x of one is -x of the other
    for R in _FACING:
        assert np.linalg.det(R) == pytest.approx(1.0)
        assert R[1] == pytest.approx([0, 0, 1])
    assert _FACING[0][2] == pytest.approx(-_FACING[1][2]) and _FACING[0][2] @ [1, 0, 0] == 1
    assert _FACING[0][0] == pytest.approx(-_FACING[1][0])


def drive(squeeze, force_of, cycles=600, period=1 / 30):
    """Run a controller with fingers that measure `force_of(opening)`; return its commands."""
    command = Command(0.08, 1.0)
    sent = []
    for cycle in range(cycles):
        force = force_of(command.opening)
        touch = tuple(Touch(0.0, 0.0, item, 0.01, item > 0) for item in force)
        state = GripperState(command.opening, 0.0, 0.0, command.lift_height)
        command = squeeze.step(Observation(cycle * period, period, touch, state, (), command))
        sent.append((command, force))
        if command.phase == "done":
            break
    return sent


def test_the_squeeze_stops_at_its_force_and_releases():
    # 160 N/m per finger, as of two membranes, around an object of 30 mm
    heights = (0.012, 0.006)
    sent = drive(
        GripController(heights, 0.3), lambda opening: [max(0.0, 160 * (0.03 - opening))] * 2
    )
    assert sent[-1][0].phase == "done"
    maximum = max(force[0] for _, force in sent)
    # one cycle at 3 mm/s is 0.016 N
    assert 0.3 <= maximum < 0.32
    assert max(command.lift_height for command, _ in sent) == pytest.approx(0.012)
    assert sent[-1][0].lift_height == 0
    # each height is a separate grip; a gripper that moves up with the object ends one
    moments = [
        GripCycle(
            tuple(Touch(0.0, 0.0, item, 0.01, item > 0) for item in force), command.opening, at
        )
        for command, force in sent
        for at in [command.lift_height]
    ]
    assert [grip[0].height for grip in grips_of(moments)] == pytest.approx(heights)
    lifted = [replace(one, height=0.012 + 1e-4 * k) for k, one in enumerate(grips_of(moments)[0])]
    grip, *_ = grips_of([*moments[:3], *lifted])
    assert 5 < len(grip) <= 11 and grip[-1].height <= 0.013 + 1e-9


def test_contact_of_one_finger_is_not_loaded_further():
    sent = drive(
        GripController((0.0,), 0.3), lambda opening: [max(0.0, 160 * (0.03 - opening)), 0.0]
    )
    assert max(force[0] for _, force in sent) < 1.5 * 0.3 + 0.02


def test_an_unknown_force_stops_the_motion():
    sent = drive(GripController((0.0,), 0.3), lambda opening: [math.nan, 0.1], cycles=20)
    assert {command.opening for command, _ in sent} == {0.08}


def ball_patch(way, shift, group=0, loose=0.0):
    way = np.asarray(way, float) / np.linalg.norm(way)
    near = way + np.random.default_rng(7).uniform(-0.15, 0.15, (12, 3))
    points = RADIUS * near / np.linalg.norm(near, axis=1)[:, None] + shift
    free = np.zeros((0, 3))
    return Patch(points, free, way, "smooth", 0.3, group=group, loose=loose)


@pytest.mark.slow
def test_a_grip_that_moved_the_object_does_not_change_the_size(two_families):
    # four grips, three of them shifted by up to 1 mm; a grip's two patches have the shift in common
    rng = np.random.default_rng(4)
    shifts = [np.zeros(3), *rng.normal(0, 7e-4, (3, 3))]
    directions = ([1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0])
    grips = list(zip(directions, shifts, strict=True))

    def patches(loose):
        return [
            ball_patch(sign * np.array(direction), shift, number + 1, loose)
            for number, (direction, shift) in enumerate(grips)
            for sign in (1, -1)
        ]

    meshes = {loose: mesh_of(fuse(patches(loose))[0], 1.5e-3) for loose in (0.0, 1e-3)}
    sizes, _ = principal_sizes(meshes[1e-3])
    # each pair gives 24 mm exactly; two of the shifts are across their own grip, by 1 mm
    assert 1e3 * sizes == pytest.approx([24, 24, 24], abs=0.3)
    # with the shifts in the model the ball's position is uncertain; without them the patches are
    assert meshes[1e-3].error() > 1.2 * meshes[0.0].error()
    alike = patches(1e-3)
    assert group_covariance(alike[0], alike[1]) == pytest.approx(np.full((12, 12), -1e-6))
    assert not group_covariance(alike[0], alike[2]).any()


def test_the_next_grip_is_at_the_largest_uncertainty():
    # both ends of x are well known, those of y are unknown: rotated by 90 deg
    mesh = mesh_of(fuse([ball_patch([1, 0, 0], 0), ball_patch([-1, 0, 0], 0)])[0], 2e-3)
    angle, height = next_grip(mesh, [(TURNS[0], HEIGHTS[0])], has_contact=True)
    assert angle != TURNS[0] and height in HEIGHTS
    assert next_grip(mesh, [], has_contact=False) == (TURNS[0], HEIGHTS[0])
