"""Tests of an estimated shape as lines: arcs lie on the given shape, the border is closed, and an
unknown shape has none."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mjtactile.core.types import ContactShape
from mjtactile.report.shape_wireframe import describe_shape, lines_of

BORDER = 3e-3 * np.column_stack([np.cos(np.arange(12) / 2), np.sin(np.arange(12) / 2)])


def shape(**values):
    reported = {"p_SO": np.array([1e-3, -2e-3, 1.5e-3]), "outline": BORDER, "direction": 0.4}
    return ContactShape("smooth", {"smooth": 1.0}, **reported | values)


def test_the_arcs_of_a_ball_lie_on_it():
    ball = shape(curvatures=(125.0, 125.0), radius=8e-3, family="ball")
    border, *arcs = lines_of(ball)
    assert border[0] == pytest.approx(border[-1])
    center = ball.p_SO + (0, 0, 8e-3)
    for arc in arcs:
        assert np.linalg.norm(arc - center, axis=1) == pytest.approx(np.full(len(arc), 8e-3))
    assert describe_shape(ball) == "ball, radius 8.0 mm"


def test_a_lying_cylinder_is_straight_along_itself():
    lying = shape(curvatures=(100.0, 0.0), family="cylinder", radius=1e-2)
    _, along, across = lines_of(lying)
    ray = np.array([math.cos(0.4), math.sin(0.4), 0.0])
    off = along - lying.p_SO
    assert np.linalg.norm(np.cross(off, ray), axis=1) == pytest.approx(0, abs=1e-12)
    axis = lying.p_SO + (0, 0, 1e-2)
    assert np.linalg.norm(np.cross(across - axis, ray), axis=1) == pytest.approx(1e-2)


def test_an_unknown_shape_has_no_lines():
    unknown = ContactShape("unknown", {}, status="no body explains the markers")
    assert lines_of(unknown) == []
    assert describe_shape(unknown) == "shape unknown: no body explains the markers"
