"""Tests of the ground truth next to an estimated shape: sections of the scene's triangles, and the
plot of both, against a ball with circular sections."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from mjtactile.core.types import ContactShape
from mjtactile.report.shape_cross_section import plot_section
from mjtactile.report.shape_wireframe import lines_of, true_lines

RADIUS = 0.008
PLACE = np.array([2e-3, -1e-3, 4e-3])
R_WS = Rotation.from_euler("xyz", [0.4, 1.1, -0.7]).as_matrix()
P_WS = np.array([0.3, -0.2, 0.5])


@dataclass
class Scene:
    """Scene of a ball with the lowest point `place` in S, and a table far above it, in W."""

    place: np.ndarray
    p_WS: np.ndarray
    R_WS: np.ndarray

    def triangles(self):
        raise AssertionError("the membrane is no body")

    def object_triangles(self):
        number = np.arange(4000)
        z = 1 - (2 * number + 1) / 4000  # a spiral, uniformly distributed
        angle = number * np.pi * (3 - np.sqrt(5))
        wide = np.sqrt(1 - z**2)
        points = np.column_stack([wide * np.cos(angle), wide * np.sin(angle), z])
        faces = ConvexHull(points).simplices
        ball = RADIUS * points + self.place + [0, 0, RADIUS]
        table = np.array([[[-1.0, -1, 0.05], [1, -1, 0.05], [0, 1, 0.05]]])
        return np.concatenate([ball[faces], table]) @ self.R_WS[0].T + self.p_WS[0]


def ball(radius=RADIUS, place=PLACE, direction=0.5):
    kinds = {"smooth": 1.0}
    curvatures = np.full(2, 1 / radius)
    return ContactShape(
        "smooth", kinds, curvatures=curvatures, direction=direction, radius=radius, p_SO=place,
        family="ball",
    )  # fmt: skip


def scene(place=PLACE):
    return Scene(place, P_WS[None], R_WS[None])


def test_lines_of_an_accurate_estimate_lie_on_the_true_ball():
    shape = ball()
    pieces = true_lines(shape, scene(), 0)
    off = np.linalg.norm(pieces - PLACE - [0, 0, RADIUS], axis=2)
    # triangles of 4000 points have edges of about 0.5 mm: their middles sag by 0.3^2 / 2 / 8 mm
    assert off.max() < RADIUS + 1e-9 and off.min() > RADIUS - 1e-5
    assert len(pieces) > 100  # and the table is left out
    # each piece is in one of the two planes of the estimated arcs
    for angle in (0.5, 0.5 + np.pi / 2):
        across = np.array([-np.sin(angle), np.cos(angle)])
        in_plane = (np.abs((pieces - PLACE)[:, :, :2] @ across) < 1e-9).all(axis=1)
        assert in_plane.sum() > 50
    assert not len(true_lines(ContactShape("unknown", {}), scene(), 0))


def dark(image):
    return np.argwhere((image[24:, :240] < 110).all(axis=2))


def orange(image):
    b, g, r = np.moveaxis(image[24:, :240].astype(int), 2, 0)
    return np.argwhere((r > 180) & (g < 180) & (b < 90))


def test_a_section_shows_the_error_of_the_estimated_shape():
    size = (150, 480)
    right = plot_section(ball(), true_lines(ball(), scene(), 0), size)
    deep = ball(place=PLACE + [0, 0, 1e-3])
    off = plot_section(deep, true_lines(deep, scene(), 0), size)
    lowest = {name: dark(image)[:, 0].max() for name, image in (("right", right), ("off", off))}
    true = {"right": orange(right)[:, 0].max(), "off": orange(off)[:, 0].max()}
    # estimated shapes are plotted from their own lowest point: the true one is 1 mm lower
    assert lowest["right"] == pytest.approx(lowest["off"], abs=1)
    assert true["off"] - true["right"] == pytest.approx(240 / 18, abs=2)  # px in a mm
    empty = plot_section(None, np.zeros((0, 2, 3)), size)
    assert not len(dark(empty))
    assert len(lines_of(ball())) == 2
