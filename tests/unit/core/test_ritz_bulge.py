"""Tests of heights of inflated membranes by Ritz's method, against closed forms and against the
splines of sensing, which share only the rubber constants."""

from dataclasses import replace

import closed_forms
import numpy as np
import pytest

from mjtactile.core.design import load_sensor
from mjtactile.core.neo_hookean import Law
from mjtactile.core.ritz_bulge import inflated_height
from mjtactile.sensing.force.spline_fem import Gas, SplineMembrane

DENSE = load_sensor("dense")
ROUND = load_sensor("round30")
ELLIPSE = load_sensor("ellipse")
# of no symmetry
CORNERS = ((17e-3, -6e-3), (15e-3, 12e-3), (-4e-3, 14e-3), (-16e-3, -2e-3), (-5e-3, -13e-3))
POLYGON = replace(ROUND.frame, shape="polygon", corners=CORNERS, corner_radius=3e-3)
POLYGON = replace(
    POLYGON, length=2 * POLYGON.outline.half_sizes[0], width=2 * POLYGON.outline.half_sizes[1]
)
ROUNDED = replace(ROUND.frame, shape="rounded", width=20e-3, corner_radius=4e-3)


def by_splines(design, pressure, spans):
    rubber = SplineMembrane(design, spans)
    c = rubber.equilibrium(Gas(pressure))
    center = rubber.parametric(np.zeros((1, 2))) if design.frame.outline else np.zeros((1, 2))
    return float((rubber.basis(center) @ c[2])[0])


def test_a_flat_circle_is_henckys():
    membrane = replace(ROUND.membrane, law=Law.STVK, pre_stretch=1.0)
    pressure = 1e-3 * 300 / 15e-3  # p a / E h = 1e-3: the closed form is that of small slopes
    expected = closed_forms.hencky_height(15e-3, 300.0, membrane.poisson, pressure)
    found = inflated_height(replace(ROUND, membrane=membrane), pressure)
    assert found == pytest.approx(expected, rel=1e-3)


def test_a_taut_ellipse_sags_under_its_weight():
    """T lap z = rho g h / l^2: a paraboloid; the weight of 2.5 Pa alone, slopes of 0.001."""
    a, b = ELLIPSE.frame.length / 2, ELLIPSE.frame.width / 2
    membrane = ELLIPSE.membrane
    load = 9.81 * membrane.density * membrane.thickness / membrane.pre_stretch**2
    tension = membrane.pretension
    expected = -load / (2 * tension * (1 / a**2 + 1 / b**2))
    pressure = 1e-3  # pressure in Pa: negligible
    assert inflated_height(ELLIPSE, pressure, gravity=9.81) == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("design", [ROUND, ELLIPSE], ids=["round30", "ellipse"])
def test_ritz_bulge_converges_to_the_spline_membrane(design):
    heights = [inflated_height(design, 2000.0, degree=degree) for degree in (1, 2, 3, 5)]
    errors = np.abs(np.array(heights[:-1]) / heights[-1] - 1)
    assert (errors[1:] < 0.2 * errors[:-1]).all()
    assert heights[-1] == pytest.approx(by_splines(design, 2000.0, (14, 12)), rel=1e-4)


@pytest.mark.parametrize(
    ("frame", "tolerance"),
    # corners slow polynomials down: 0.02 and 0.01 % from degree 5 on; 0.06 % of the hexagon's
    # degree 3, and its own splines are not better than that on 16 x 16 intervals
    [(DENSE.frame, 5e-4), (ROUNDED, 5e-4), (POLYGON, 2e-3)],
    ids=["rectangle", "rounded", "polygon"],
)
def test_frames_with_corners(frame, tolerance):
    design = replace(ROUND, frame=frame)
    expected = by_splines(design, 1000.0, (16, 16))
    assert inflated_height(design, 1000.0) == pytest.approx(expected, rel=tolerance)


def test_a_pressure_beyond_the_rubbers_limit_has_no_height():
    assert np.isnan(inflated_height(ROUND, 2e4, degree=2))
    assert inflated_height(ROUND, -300.0) == pytest.approx(-inflated_height(ROUND, 300.0), rel=1e-9)
