"""The compiled fits of surface and traction against the same in numpy, by dense matrices."""

import numpy as np
import pytest

from mjtactile.core.design import load_sensor
from mjtactile.sensing.shape import surface
from tests.numpy_chain import surface as numpy_surface


def dented(design, rng):
    """Markers (positions, covariances, normals) on a dent somewhere, some of them wrong or unknown."""
    p = design.markers.p_SM.copy()
    middle, deep = rng.uniform(-6e-3, 6e-3, 2), rng.uniform(-1e-3, 3e-3)
    dent = deep * np.exp(-((p[:, :2] - middle) ** 2).sum(axis=1) / 8e-3**2)
    slopes = 2 * dent[:, None] * (p[:, :2] - middle) / 8e-3**2
    p[:, 2] -= dent
    n = np.column_stack([slopes, -np.ones(len(p))]) + rng.normal(0, 0.01, p.shape)
    n, p = n / np.linalg.norm(n, axis=1)[:, None], p + rng.normal(0, 1e-5, p.shape)
    n[rng.random(len(p)) < 0.05] = np.nan
    p[rng.random(len(p)) < 0.03, 2] += 3e-3
    p[rng.random(len(p)) < 0.03, 1] = np.nan
    return p, np.eye(3) * 1e-10 * rng.uniform(0.5, 2, (len(p), 1, 1)), n


@pytest.mark.parametrize("sensor", ["dense", "paper16"])
def test_spline_through_markers(sensor):
    """Heights are of order 1e-3 m and the equations' condition 1e6; leverage and covariances are in single precision in numpy."""
    design, rng = load_sensor(sensor), np.random.default_rng(1)
    fitters = surface.SurfaceFitter(design), numpy_surface.SurfaceFitter(design)
    left_out = 0
    for tilts in [True] * 8 + [False] * 2:
        p, cov, n = dented(design, rng)
        ours, theirs = (fitter.fit_spline(p, cov, n if tilts else None) for fitter in fitters)
        left_out += np.isfinite(p).all(axis=1).sum() - theirs.markers
        np.testing.assert_allclose(ours.coefficients, theirs.coefficients, atol=1e-13)
        assert ours.misfit == pytest.approx(theirs.misfit, rel=1e-9)
        ours, theirs = ours.surface(), theirs.surface()
        np.testing.assert_allclose(ours.z, theirs.z, atol=1e-14)
        assert ours.area == pytest.approx(theirs.area, rel=1e-12) and ours.volume == pytest.approx(theirs.volume, abs=1e-17)
        assert ours.area_sd == pytest.approx(theirs.area_sd, rel=1e-5)
        assert ours.volume_sd == pytest.approx(theirs.volume_sd, rel=1e-5)
    assert left_out or sensor == "paper16"  # there, four markers a row leave none that all others predict
