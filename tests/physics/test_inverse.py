"""Inverse finite elements against an independent membrane (tests/reference_membrane.py), symmetry
and its own statistics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reference_membrane import ReferenceMembrane
from scipy.interpolate import RectBivariateSpline

from mjtactile.core.design import load_sensor
from mjtactile.core.types import Markers
from mjtactile.sensing.force.inverse_fem import InverseMembrane
from mjtactile.sensing.force.spline_fem import Gas, SplineMembrane
from mjtactile.sensing.touch.patches import find_patches, together
from tests.numpy_pipeline.inverse import half_of, moments

SUPPLY = 1000.0  # gauge pressure, Pa
OBLIQUE = np.array([0.15, -0.05, -0.6])
PLACE = (0.004, -0.002)
RIM = 0.0065  # radius of a flat face that presses at its rim, m
PAIR = ((-0.009, 0.002), (0.009, -0.002))


class GroundTruth:
    """Ground truth of the paper's membrane as triangles: at rest, under one oblique patch, and
    under two patches."""

    def __init__(self):
        d = load_sensor("dense")
        m = d.membrane
        self.fem = ReferenceMembrane(
            d.frame.length,
            d.frame.width,
            m.thickness,
            m.young,
            m.poisson,
            m.pre_stretch,
            d.chamber_volume_flat,
            d.chamber.ambient,
            n=33,
        )
        self.rest, _ = self.fem.solve(np.zeros((len(self.fem.X), 3)), gauge=SUPPLY)
        self.volume = self.fem._volume(self.rest)[0]
        self.sealed = (d.chamber.ambient + SUPPLY) * (d.chamber_volume_flat + self.volume)
        self.load = self.patch(PLACE, OBLIQUE, 0.006)
        self.pressed, self.gauge = self.fem.solve(self.load, sealed=self.sealed, x=self.rest)
        two = sum(
            self.patch(place, np.array([0, 0, -force]), 0.005)
            for place, force in zip(PAIR, (0.3, 0.5), strict=True)
        )
        self.twice, _ = self.fem.solve(two, sealed=self.sealed, x=self.rest)

    def patch(self, center, force, radius):
        weight = (
            np.clip(1 - np.sum((self.fem.X - center) ** 2, axis=1) / radius**2, 0, None)
            * self.fem.node_area
        )
        return np.outer(weight / weight.sum(), force)

    def markers(self, design, x, noise=6e-6):
        q = design.markers.p_SM
        grid = x.reshape(*self.fem.shape, 3)
        splines = [RectBivariateSpline(*self.fem.grid, grid[..., k]) for k in range(3)]
        p, g1, g2 = (
            np.column_stack([s(q[:, 0], q[:, 1], grid=False, **slope) for s in splines])
            for slope in ({}, {"dx": 1}, {"dy": 1})
        )
        return make_markers(p, noise, n=-np.cross(g1, g2))


def make_markers(p, noise=6e-6, n=None):
    # NaN: unknown
    n = np.full(p.shape, np.nan) if n is None else n / np.linalg.norm(n, axis=1)[:, None]
    return Markers(np.arange(len(p)), p, n, np.tile(np.eye(3) * noise**2, (len(p), 1, 1)))


@pytest.fixture(scope="module")
def truth():
    return GroundTruth()


@pytest.fixture(scope="module", params=["dense", "paper16"])
def sensor(request, truth):
    estimator = InverseMembrane(load_sensor(request.param))
    return estimator, estimator.rest_state(truth.markers(estimator.design, truth.rest), SUPPLY)


def test_forward_solution_matches_the_independent_membrane(truth):
    rubber = SplineMembrane(load_sensor("dense"), (14, 10))
    c = rubber.equilibrium(Gas(SUPPLY))
    height = (rubber.basis(np.zeros((1, 2))) @ c[2])[0]
    # linear triangles of 1.25 mm are too stiff by O(h^2): 0.4 % of a 40 x 30 mm bulge
    assert height == pytest.approx(truth.rest[:, 2].max(), rel=0.006)
    assert rubber.state(c).volume == pytest.approx(truth.volume, rel=0.01)


def test_tangent_is_the_derivative_of_the_residual():
    rubber = SplineMembrane(load_sensor("dense"), (14, 10))
    c = rubber.equilibrium(Gas(SUPPLY))
    v = 1e-6 * np.random.default_rng(0).standard_normal(c.shape)
    band = rubber.tangent(rubber.state(c), SUPPLY)
    lower = sum(
        np.diag(band[: len(band) - below, below], -below) for below in range(rubber.width + 1)
    )
    K = lower + np.tril(lower, -1).T  # the three components of a spline together
    change = (
        rubber.residual(rubber.state(c + v), SUPPLY) - rubber.residual(rubber.state(c - v), SUPPLY)
    ) / 2
    # 2-point Gauss quadrature makes the follower pressure's matrix asymmetric by 5e-4; half is
    # used
    assert np.linalg.norm(K @ v.T.ravel() - change.T.ravel()) < 2e-3 * np.linalg.norm(change)


def test_force_torque_and_pressure_of_an_oblique_patch(sensor, truth):
    estimator, rest = sensor
    shape = estimator.estimate(truth.markers(estimator.design, truth.pressed), rest)
    traction = estimator.traction(shape)
    # required: 0.02 N (dense), 0.04 N (paper16); triangles are up to 3 % stiffer under a patch of 6
    # mm
    assert traction.wrench[2] == pytest.approx(OBLIQUE[2], abs=0.03)
    np.testing.assert_allclose(traction.wrench[:2], OBLIQUE[:2], atol=0.015)
    torque = np.cross(truth.pressed, truth.load).sum(axis=0)
    np.testing.assert_allclose(traction.wrench[3:], torque, atol=0.6 * 4e-4)  # 0.6 N at 0.4 mm
    # and to rounding it is the moment of the nodal forces
    nodal = (shape.traction * estimator.node_area).T
    np.testing.assert_allclose(
        traction.wrench[3:],
        np.cross(estimator.node_positions(shape.c), nodal).sum(axis=0),
        atol=1e-12,
    )
    assert traction.gauge_pressure == pytest.approx(truth.gauge, rel=0.02)
    assert traction.force[..., :].sum(axis=(0, 1)) == pytest.approx(traction.wrench[:3])


def test_patch_lies_where_the_load_is(sensor, truth):
    estimator, rest = sensor
    shape = estimator.estimate(truth.markers(estimator.design, truth.pressed), rest)
    patches = find_patches(estimator, shape, rest)
    assert len(patches) == 1
    where = np.abs(truth.load[:, 2]) @ truth.pressed[:, :2] / np.abs(truth.load[:, 2]).sum()
    # twice the mean required by bench touch
    np.testing.assert_allclose(patches[0].centroid, where, atol=6e-4)
    assert 0.5e-3 < patches[0].depth < 4e-3
    # a parabola of radius 6 mm has most of its force within 4 mm (50 mm^2) and none beyond 6 mm
    # (113 mm^2)
    assert 40e-6 < patches[0].area < 120e-6
    inside = patches[0].outline
    assert np.linalg.norm(inside - patches[0].centroid, axis=1).max() < 8e-3


def test_two_patches_are_distinguished(truth):
    estimator = InverseMembrane(load_sensor("dense"))
    rest = estimator.rest_state(truth.markers(estimator.design, truth.rest), SUPPLY)
    patches = find_patches(
        estimator, estimator.estimate(truth.markers(estimator.design, truth.twice), rest), rest
    )
    assert len(patches) == 2
    strong, weak = patches
    assert strong.centroid[0] == pytest.approx(PAIR[1][0], abs=1e-3) and weak.centroid[
        0
    ] == pytest.approx(PAIR[0][0], abs=1e-3)
    assert -strong.force[2] == pytest.approx(0.5, abs=0.06) and -weak.force[2] == pytest.approx(
        0.3, abs=0.06
    )
    both = together(patches, (3, 4))
    assert both.area == pytest.approx(strong.area + weak.area) and both.force[2] == pytest.approx(
        -0.8, abs=0.04
    )


def test_mirror_image_gives_the_mirrored_wrench(sensor, truth):
    estimator, rest = sensor
    design = estimator.design
    grid = (design.markers.rows, design.markers.columns, 3)

    def mirrored(m):
        p, n = (v.reshape(grid)[:, ::-1].reshape(-1, 3) * [-1, 1, 1] for v in (m.p_SM, m.n_S))
        return make_markers(p, n=n)

    pressed = truth.markers(design, truth.pressed)
    mirrored_rest = estimator.rest_state(mirrored(truth.markers(design, truth.rest)), SUPPLY)
    one = estimator.traction(estimator.estimate(pressed, rest)).wrench
    other = estimator.traction(estimator.estimate(mirrored(pressed), mirrored_rest)).wrench
    # the same operations in another order: only where an iteration stops (30 um of shape) can
    # differ
    np.testing.assert_allclose(other * [-1, 1, 1, 1, -1, -1], one, atol=1e-4)


def test_covariance_is_that_of_errors_sampled_from_prior_and_noise(sensor, truth):
    """Tractions are sampled from the prior and noise from the markers; errors of the linear
    estimate have the predicted covariance."""
    estimator, rest = sensor
    shape = estimator.estimate(truth.markers(estimator.design, truth.pressed), rest)
    gain = shape.gain
    moment = moments(estimator, shape.c)
    rng = np.random.default_rng(1)
    # of the prior's covariance
    root = half_of(estimator.prior, np.eye(len(gain.prior)), gain.prior)
    sampled = rng.standard_normal((len(root), 400))
    seen = gain.half
    t = root @ sampled
    y = (
        seen @ sampled
        + gain.drift @ rng.standard_normal((gain.drift.shape[1], 400))
        + rng.standard_normal((len(seen), 400))
    )
    S = seen @ seen.T + gain.drift @ gain.drift.T + np.eye(len(seen))
    error = moment @ (root @ (seen.T @ np.linalg.solve(S, y)) - t)
    predicted = np.sqrt(np.diag(estimator._posterior(shape, estimator.node_positions(shape.c))))
    fraction = np.sqrt(estimator.posterior_fraction(shape))
    # 400 samples: 3.5 %, six of them
    np.testing.assert_allclose(error.std(axis=1) * fraction, predicted, rtol=0.12)


@pytest.mark.parametrize(("young", "tauter"), [(1.0, 0.01), (1.0, -0.01), (1.06, 0.005)])
def test_a_membrane_with_another_mounting_estimates_shear(young, tauter):
    """The pre-stretch is off by two sd, or both parameters by one sd. With the bulge height
    attributed to the rubber alone, shear errors were 14, 13 and 7 %. The normal force depends only
    on the pressure."""
    nominal = load_sensor("dense")
    estimator = InverseMembrane(nominal)
    rubber = nominal.membrane
    other = replace(rubber, young=young * rubber.young, pre_stretch=rubber.pre_stretch + tauter)
    true = InverseMembrane(replace(nominal, membrane=other))
    c = true.membrane.equilibrium(Gas(SUPPLY))
    gas = true.membrane.seal(true.membrane.state(c), SUPPLY)
    inside = np.maximum(1 - (true.nodes**2).sum(axis=1) / 5e-3**2, 0.0)
    traction = np.outer([0.1, 0.0, -0.4], inside / (inside @ true.node_area))
    load = traction @ np.kron(*true._grid[2:4]).T
    pressed = true.membrane.equilibrium(gas, load=load, start=c)

    def seen(coefficients):
        p = true.positions(coefficients)
        cov = np.tile(np.diag([4e-12, 4e-12, 36e-12]), (len(p), 1, 1))
        return Markers(np.arange(len(p)), p, np.full(p.shape, np.nan), cov)

    rest = estimator.rest_state(seen(c), SUPPLY)
    shape = None
    for _ in range(4):
        shape = estimator.estimate(seen(pressed), rest, shape)
    assert shape is not None
    force = estimator.force(shape)
    assert force[0] == pytest.approx(0.1, rel=0.065)
    assert force[2] == pytest.approx(-0.4, rel=0.01)


def test_softer_rubber_is_absorbed_by_the_rest_state(truth):
    """With a modulus 10 % too high in the file, the estimator infers it from the bulge, and the
    force is still accurate."""
    nominal = load_sensor("dense")
    wrong = replace(nominal, membrane=replace(nominal.membrane, young=1.1 * nominal.membrane.young))
    estimator = InverseMembrane(wrong)
    rest = estimator.rest_state(truth.markers(nominal, truth.rest), SUPPLY)
    # a part is attributed to the pre-stretch, which changes the bulge differently
    assert rest.stiffness_scale == pytest.approx(1 / 1.1, abs=0.03)
    wrench = estimator.traction(
        estimator.estimate(truth.markers(nominal, truth.pressed), rest)
    ).wrench
    assert wrench[2] == pytest.approx(OBLIQUE[2], abs=0.03)


def test_starting_from_the_last_frame_gives_the_same_force(sensor, truth):
    estimator, rest = sensor
    markers = truth.markers(estimator.design, truth.pressed)
    cold = estimator.estimate(markers, rest)
    warm = estimator.estimate(markers, rest, cold)
    assert warm.steps <= cold.steps
    difference = estimator.traction(warm).wrench[:3] - estimator.traction(cold).wrench[:3]
    assert np.abs(difference).max() < 0.01  # reweighting continues, within the standard deviation


# -- slopes of the markers
# --------------------------------------------------------------------------------


def test_rows_of_slopes_are_their_derivative(truth):
    estimator = InverseMembrane(load_sensor("paper16"))
    slopes = estimator._slopes
    markers = truth.markers(estimator.design, truth.pressed)
    assert slopes is not None
    c = estimator.estimate(
        markers, estimator.rest_state(truth.markers(estimator.design, truth.rest), SUPPLY)
    ).c
    v = 1e-7 * np.random.default_rng(3).standard_normal(c.shape)
    change = (slopes.off(markers, c - v) - slopes.off(markers, c + v)) / 2
    # central differences have an error of third order: (1e-4)^2 of slopes that change by 1e-4.
    # `moved` are the tangents, (2, 16, 3)
    moved = np.stack([along @ v.T for along in (slopes._along_x, slopes._along_y)])
    predicted = np.einsum("tmki,tmi->mk", slopes.rows(c, markers.ids), moved[:, markers.ids])
    np.testing.assert_allclose(predicted, change, rtol=1e-5, atol=1e-11)


def test_slopes_reduce_the_error_of_sparse_markers(truth):
    """Marker slopes reduce the force error of a flat face on sparse markers.

    The face covers the four central markers. Their slopes show that it is flat; heights alone allow
    a deeper dent.
    """
    estimator = InverseMembrane(load_sensor("paper16"))
    rest = estimator.rest_state(truth.markers(estimator.design, truth.rest), SUPPLY)
    rim = np.exp(-(((np.linalg.norm(truth.fem.X, axis=1) - RIM) / 8e-4) ** 2)) * truth.fem.node_area
    load = np.outer(rim / rim.sum(), [0.0, 0.0, -0.85])
    pressed, _ = truth.fem.solve(load, sealed=truth.sealed, x=truth.rest)
    markers = truth.markers(estimator.design, pressed)
    blind = make_markers(markers.p_SM)
    seeing, blind = (
        abs(estimator.traction(estimator.estimate(m, rest)).wrench[2] + 0.85)
        for m in (markers, blind)
    )
    # 0.01 N and 0.028 N; triangles of 1.25 mm are stiffer than the membrane by up to 3 % under a
    # patch, 0.5 % under this one
    assert seeing < 0.015 < 0.02 < blind


def test_a_wrong_slope_is_excluded(truth):
    """The other of an ellipse's two normals, or none: neither moves the force."""
    estimator = InverseMembrane(load_sensor("paper16"))
    rest = estimator.rest_state(truth.markers(estimator.design, truth.rest), SUPPLY)
    markers = truth.markers(estimator.design, truth.pressed)
    n = markers.n_S.copy()
    n[5, :2] *= -4.0
    n[9] = np.nan
    right, wrong = (
        estimator.traction(estimator.estimate(m, rest)).wrench[2]
        for m in (markers, replace(markers, n_S=n))
    )
    assert wrong == pytest.approx(right, abs=0.01)  # 14 of 16 slopes; required: 0.04 N
