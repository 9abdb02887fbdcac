"""Tests of the package's splines against those of scipy, whose import takes 0.1 s."""

import numpy as np
import pytest
from scipy.interpolate import (
    BSpline,
    PchipInterpolator,
    RegularGridInterpolator,
    make_interp_spline,
)

from mjtactile.core import analytical_solutions
from mjtactile.core.bspline import Cubic, interpolating

RNG = np.random.default_rng(0)


@pytest.mark.parametrize("spans", [1, 2, 9])
def test_b_splines(spans):
    """Values, slopes and curvatures, at the ends and at knots, too; to rounding of the largest."""
    splines = Cubic(0.04, spans, 3)
    knots = np.r_[[-0.02] * 3, np.linspace(-0.02, 0.02, spans + 1), [0.02] * 3]
    reference = BSpline(knots, np.eye(spans + 3), 3)
    x = np.r_[RNG.uniform(-0.02, 0.02, 50), splines.breaks]
    for derivative in range(3):
        expected = reference(x, nu=derivative)[:, 1:-1]
        np.testing.assert_allclose(
            splines.at(x, derivative),
            expected,
            atol=1e-14 * np.abs(reference(x, nu=derivative)).max(),
        )


def test_interpolating():
    knots = np.linspace(0, 3, 11)
    at = np.r_[RNG.uniform(0, 3, 30), 0.0, 3.0]
    spline = make_interp_spline(knots, np.eye(11), k=3)
    values, slopes = interpolating(knots, at)
    np.testing.assert_allclose(values, spline(at), atol=1e-14)
    np.testing.assert_allclose(slopes, spline.derivative()(at), atol=1e-12)


def test_monotone_interpolation():
    for _ in range(100):  # rising, falling, level and turning
        x = np.cumsum(RNG.uniform(0.1, 1, 6))
        y = RNG.normal(size=6).round(int(RNG.integers(0, 3)))
        at = float(RNG.uniform(x[0], x[-1]))
        assert analytical_solutions._monotone_cubic(x, y, at) == pytest.approx(
            float(PchipInterpolator(x, y)(at)), abs=1e-13
        )


def test_coefficients_of_a_rectangle():
    for aspect in (*RNG.uniform(1, 4, 20), *analytical_solutions._ASPECT):
        for poisson in (*RNG.uniform(0.3, 0.5, 3), *analytical_solutions._POISSON):
            method = "pchip" if aspect not in analytical_solutions._ASPECT else "linear"
            c2 = RegularGridInterpolator(
                (analytical_solutions._ASPECT, analytical_solutions._POISSON),
                analytical_solutions._C2,
                method=method,
            )((aspect, poisson))
            c1 = PchipInterpolator(analytical_solutions._ASPECT, analytical_solutions._C1)(aspect)
            found = analytical_solutions.rectangle_coefficients(float(aspect), float(poisson))
            assert found == pytest.approx((float(c1), float(c2)), rel=1e-13)
