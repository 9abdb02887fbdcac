"""The compiled fits of surface and traction against the same in numpy, by dense matrices."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import cho_solve, solve_triangular
from scipy.special import lambertw

from mjtactile.core.design import load_sensor
from mjtactile.core.neo_hookean import Law
from mjtactile.core.types import Markers
from mjtactile.kernels import kernel
from mjtactile.sensing.constitutive_law import ConstitutiveLaw
from mjtactile.sensing.force import spline_fem
from mjtactile.sensing.force.inverse_fem import InverseMembrane
from mjtactile.sensing.force.spline_fem import Gas
from mjtactile.sensing.surface import surface
from tests.numpy_pipeline import spline_membrane as numpy_membrane
from tests.numpy_pipeline import surface as numpy_surface
from tests.numpy_pipeline.inverse import DenseInverse


def dented(design, rng):
    """Return markers (positions, covariances, normals) on a dent at a random position, some of them
    wrong or unknown."""
    p = design.markers.p_SM.copy()
    center = rng.uniform(-6e-3, 6e-3, 2)
    deep = rng.uniform(-1e-3, 3e-3)
    dent = deep * np.exp(-((p[:, :2] - center) ** 2).sum(axis=1) / 8e-3**2)
    slopes = 2 * dent[:, None] * (p[:, :2] - center) / 8e-3**2
    p[:, 2] -= dent
    n = np.column_stack([slopes, -np.ones(len(p))]) + rng.normal(0, 0.01, p.shape)
    n = n / np.linalg.norm(n, axis=1)[:, None]
    p = p + rng.normal(0, 1e-5, p.shape)
    n[rng.random(len(p)) < 0.05] = np.nan
    p[rng.random(len(p)) < 0.03, 2] += 3e-3
    p[rng.random(len(p)) < 0.03, 1] = np.nan
    return p, np.eye(3) * 1e-10 * rng.uniform(0.5, 2, (len(p), 1, 1)), n


@pytest.mark.parametrize("sensor", ["dense", "paper16"])
def test_spline_through_markers(sensor):
    """Heights are of order 1e-3 m and the equations' condition 1e6; leverage and covariances are in
    single precision in numpy."""
    design = load_sensor(sensor)
    rng = np.random.default_rng(1)
    fitters = surface.SurfaceFitter(design), numpy_surface.SurfaceFitter(design)
    left_out = 0
    for tilts in [True] * 8 + [False] * 2:
        p, cov, n = dented(design, rng)
        computed, reference = (
            fitter.fit_spline(p, cov, n if tilts else None) for fitter in fitters
        )
        left_out += np.isfinite(p).all(axis=1).sum() - reference.markers
        np.testing.assert_allclose(computed.coefficients, reference.coefficients, atol=1e-13)
        assert computed.misfit == pytest.approx(reference.misfit, rel=1e-9)
        computed = computed.surface()
        reference = reference.surface()
        np.testing.assert_allclose(computed.z, reference.z, atol=1e-14)
        assert computed.area == pytest.approx(
            reference.area, rel=1e-12
        ) and computed.volume == pytest.approx(reference.volume, abs=1e-17)
        assert computed.area_sd == pytest.approx(reference.area_sd, rel=1e-5)
        assert computed.volume_sd == pytest.approx(reference.volume_sd, rel=1e-5)
    # there, four markers a row leave none that all others predict
    assert left_out or sensor == "paper16"


def from_band(band, width):
    """Reorder the symmetric matrix (n, n) from spline-major to component-major order."""
    n = len(band)
    lower = sum(np.diag(band[: n - below, below], -below) for below in range(width + 1))
    order = np.arange(n).reshape(-1, 3).T.ravel()
    return (lower + np.tril(lower, -1).T)[np.ix_(order, order)]


@pytest.mark.parametrize("law", list(Law))
def test_membrane(law):
    """The kernel's membrane equals numpy's to rounding of sums of some hundred products."""
    design = load_sensor("dense")
    design = replace(design, membrane=replace(design.membrane, law=law))
    computed = spline_fem.SplineMembrane(design, (14, 10))
    theirs = numpy_membrane.SplineMembrane(design, (14, 10))
    rng = np.random.default_rng(4)
    n = computed.count
    c = computed.equilibrium(Gas(600.0)) + rng.normal(0, 3e-5, (3, n))
    state = computed.state(c, 1.2)
    reference = theirs.state(c, 1.2)
    assert state.volume == pytest.approx(reference.volume, rel=1e-12)
    np.testing.assert_allclose(
        state.gradient, theirs.volume_gradient(reference), atol=1e-13 * np.abs(state.gradient).max()
    )
    residual = theirs.residual(reference, 600.0)
    np.testing.assert_allclose(
        computed.residual(state, 600.0), residual, atol=1e-12 * np.abs(state.elastic).max()
    )
    lower = theirs.tangent(reference, 600.0)
    tangent = np.where(np.kron(np.tri(3), np.ones((n, n))), lower, 0)
    tangent += np.where(np.kron(1 - np.tri(3), np.ones((n, n))), lower.T, 0)
    np.testing.assert_allclose(
        from_band(computed.tangent(state, 600.0), computed.width),
        tangent,
        atol=1e-12 * np.abs(tangent).max(),
    )
    gas = computed.seal(state, 600.0)
    (_, stiffness), (_, factor) = computed.linearise(state, gas), theirs.linearise(reference, gas)
    forces = rng.standard_normal((3, n))
    expected = cho_solve(factor, forces.ravel()).reshape(3, -1)
    # condition 1e3
    np.testing.assert_allclose(
        stiffness.solve(forces), expected, atol=1e-11 * np.abs(expected).max()
    )


def test_an_indefinite_stiffness_is_regularized():
    """A membrane with random displacements of millimeters has an indefinite tangent; Newton's step
    is finite and a descent direction."""
    computed = spline_fem.SplineMembrane(load_sensor("dense"), (14, 10))
    state = computed.state(np.random.default_rng(0).normal(0, 2e-3, (3, computed.count)))
    assert np.linalg.eigvalsh(from_band(computed.tangent(state, 0.0), computed.width))[0] < 0
    residual, stiffness = computed.linearise(state, Gas(0.0))
    assert (residual * stiffness.solve(residual)).sum() > 0


@pytest.mark.parametrize("sensor", ["dense", "paper16"])
def test_tractions_from_markers(sensor):
    """The kernel's tractions equal numpy's, up to rounding times the condition of stiffness and
    innovation, 1e3 each."""
    design = load_sensor(sensor)
    rng = np.random.default_rng(2)
    computed = InverseMembrane(design)
    expected = DenseInverse(design)
    p = design.markers.p_SM
    n = design.markers.count
    bulge = (
        2e-3
        * np.cos(np.pi * p[:, 0] / design.frame.length)
        * np.cos(np.pi * p[:, 1] / design.frame.width)
    )
    cov = np.tile(np.diag([1e-12, 1e-12, 3e-11]), (n, 1, 1))
    outward = np.tile([0.0, 0.0, -1.0], (n, 1))
    rest = computed.rest_state(
        Markers(np.arange(n), p + np.outer(bulge, [0, 0, 1]), outward, cov), 1000.0
    )
    rest = replace(rest, young=rest.stiffness_scale, stretch=1.0)  # the reference has no stretch
    shape = reference = None
    for depth in (0.0, 0.3e-3, 0.32e-3, 1.5e-3):
        q = computed.positions(rest.c) + rest.offset
        dent = depth * np.exp(-((p[:, :2] - [2e-3, 1e-3]) ** 2).sum(axis=1) / 6e-3**2)
        q[:, 2] -= dent
        tilts = 2 * dent[:, None] * (p[:, :2] - [2e-3, 1e-3]) / 6e-3**2
        normals = np.column_stack([tilts, -np.ones(n)])
        ids = np.sort(rng.choice(n, n - (depth > 1e-3), replace=False))
        markers = Markers(ids, (q + rng.normal(0, 5e-6, q.shape))[ids], normals[ids], cov[ids])
        shape = computed.estimate(markers, rest, shape)
        reference = expected.estimate(markers, rest, reference)
        assert shape.steps == reference.steps
        np.testing.assert_allclose(shape.c, reference.c, atol=1e-12)
        one = computed.traction(shape)
        other = expected.traction(reference)
        np.testing.assert_allclose(one.wrench, other.wrench, atol=1e-9)
        np.testing.assert_allclose(one.force, other.force, atol=1e-9)
        np.testing.assert_allclose(shape.excess, reference.excess, rtol=1e-6, atol=1e-6)
        assert (shape.misfit, shape.drift) == pytest.approx(
            (reference.misfit, reference.drift), rel=1e-6
        )
        np.testing.assert_allclose(
            shape.gain.half, reference.gain.half, atol=1e-9 * np.abs(reference.gain.half).max()
        )
        np.testing.assert_allclose(
            one.wrench_cov, other.wrench_cov, rtol=1e-5, atol=1e-9 * one.wrench_cov[0, 0]
        )


def test_lower_factor():
    """The kernel solves a well-conditioned factor to rounding, and ignores values above its
    diagonal."""
    rng = np.random.default_rng(2)
    factor = rng.normal(size=(40, 40)) + 20 * np.eye(40)
    right = rng.normal(size=(40, 3))
    found = right.copy()
    kernel("solve_lower")(*found.shape, factor, found)
    np.testing.assert_allclose(found, solve_triangular(factor, right, lower=True), atol=1e-14)


@pytest.mark.parametrize("poisson", [0.01, 0.1, 0.3, 0.45, 0.49, 0.4999])
def test_thickness_is_lamberts_function(poisson):
    """To rounding, where Lambert's argument is a finite number; a stretch of 1 leaves 1."""
    membrane = replace(load_sensor("dense").membrane, poisson=poisson)
    half = poisson / (1 - 2 * poisson)
    log_det = np.linspace(-1.0, 2.0, 301)
    lambert = half * lambertw(np.exp(1 / half - log_det) / half).real
    places = np.linspace(-3.0, 4.0, 7001)
    q, _ = ConstitutiveLaw(membrane).table
    np.testing.assert_allclose(np.interp(log_det, places, q) * np.exp(log_det), lambert, rtol=1e-9)
