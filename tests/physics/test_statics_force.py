"""Net contact force from marker positions against an independent finite-element membrane
(tests/reference_membrane.py)."""

from __future__ import annotations

import numpy as np
import pytest
from reference_membrane import ReferenceMembrane
from scipy.interpolate import RectBivariateSpline

from benchmarks.paper.deformation import MembraneModel
from benchmarks.paper.force_methods import MembraneForce, spring_grid_force
from mjtactile.core.design import load_sensor
from mjtactile.core.types import Markers, Surface

SUPPLY = 1000.0  # gauge pressure, Pa


class Bench:
    """Sensor on the reference membrane, inflated and sealed."""

    def __init__(self, name: str, young_factor: float = 1.0):
        self.design = d = load_sensor(name)
        m = d.membrane
        self.fem = ReferenceMembrane(
            d.frame.length,
            d.frame.width,
            m.thickness,
            m.young * young_factor,
            m.poisson,
            m.pre_stretch,
            d.chamber_volume_flat,
            d.chamber.ambient,
            n=33,
        )
        self.x0, _ = self.fem.solve(np.zeros((len(self.fem.X), 3)), gauge=SUPPLY)
        volume = d.chamber_volume_flat + self.fem._volume(self.x0)[0]
        self.sealed = (d.chamber.ambient + SUPPLY) * volume
        self.model = MembraneModel(d)
        self.estimator = MembraneForce(self.model)
        self.rest = self.estimator.rest_state(self.markers(self.x0), SUPPLY)

    def markers(self, x, noise=0.0, seed=0):
        q = self.design.markers.p_SM
        grid = x.reshape(*self.fem.shape, 3)
        p = np.column_stack(
            [
                RectBivariateSpline(*self.fem.grid, grid[..., k])(q[:, 0], q[:, 1], grid=False)
                for k in range(3)
            ]
        )
        p += noise * np.random.default_rng(seed).standard_normal(p.shape)
        n = np.tile([0.0, 0.0, -1.0], (len(p), 1))
        return Markers(np.arange(len(p)), p, n, np.tile(np.eye(3) * noise**2, (len(p), 1, 1)))

    def press(self, force, center=(0.0, 0.0), radius=0.006):
        """Return equilibrium under a parabolic pressure patch with the given resultant (3,) N."""
        r2 = np.sum((self.fem.X - center) ** 2, axis=1) / radius**2
        weight = np.clip(1 - r2, 0, None) * self.fem.node_area
        return self.fem.solve(np.outer(weight / weight.sum(), force), sealed=self.sealed, x=self.x0)

    def estimate(self, x, **noise):
        markers = self.markers(x, **noise)
        wrench, gauge = self.estimator.wrench(markers.ids, markers.p_SM, self.rest)
        return wrench[:3], gauge


@pytest.fixture(scope="module")
def dense() -> Bench:
    return Bench("dense")


@pytest.mark.parametrize(
    ("force", "center", "radius"),
    [
        ((0, 0, -0.6), (0, 0), 0.006),
        ((0, 0, -1.2), (0, 0), 0.008),
        ((0.2, 0, -0.6), (0, 0), 0.006),
        ((0, -0.15, -0.5), (0.004, 0.003), 0.006),
    ],
)
def test_net_force_and_pressure(dense, force, center, radius):
    x, gauge = dense.press(np.array(force, float), center, radius)
    estimated, gauge_estimated = dense.estimate(x)
    # 2 % of the force: 9 x 9 markers sample a patch of 6 mm radius at 4 mm pitch; 5 mN floor of the
    # spline near the rim
    np.testing.assert_allclose(estimated, force, atol=0.005 + 0.02 * np.linalg.norm(force))
    # volume of the spline against that of the FEM
    assert gauge_estimated == pytest.approx(gauge, abs=0.02 * gauge)


def test_torque_is_the_moment_of_the_patch(dense):
    """For a patch off the center, M = sum of x cross f over the loaded nodes of the independent
    membrane."""
    force = np.array([0.1, 0.0, -0.6])
    r2 = np.sum((dense.fem.X - (0.005, 0.003)) ** 2, axis=1) / 0.006**2
    weight = np.clip(1 - r2, 0, None) * dense.fem.node_area
    load = np.outer(weight / weight.sum(), force)
    x, _ = dense.fem.solve(load, sealed=dense.sealed, x=dense.x0)
    markers = dense.markers(x)
    torque = dense.estimator.wrench(markers.ids, markers.p_SM, dense.rest)[0][3:]
    # 0.6 N at 0.3 mm, the required accuracy of a contact position
    np.testing.assert_allclose(torque, np.cross(x, load).sum(0), atol=0.6 * 3e-4)


def test_force_error_follows_the_predicted_noise(dense):
    x, _ = dense.press(np.array([0, 0, -0.6]))
    exact = dense.estimate(x)[0]
    noise = 1e-5
    errors = np.array([dense.estimate(x, noise=noise, seed=s)[0] - exact for s in range(200)])
    cov = dense.estimator.wrench_cov(dense.markers(x, noise=noise), dense.rest)
    # sd of 200 samples is known to 5 %; the rest is that the sensitivities are taken at rest, not
    # under load
    np.testing.assert_allclose(errors.std(0), np.sqrt(np.diag(cov))[:3], rtol=0.25)


def test_wrong_young_modulus_is_absorbed_by_the_rest_state():
    bench = Bench("dense", young_factor=1.10)
    x, _ = bench.press(np.array([0, 0, -0.6]))
    # 1 % spline error plus the factor itself
    assert bench.rest.stiffness_scale == pytest.approx(1.10, abs=0.03)
    assert bench.estimate(x)[0][2] == pytest.approx(-0.6, abs=0.02)


def test_flat_membrane_estimates_zero_and_its_springs_cancel():
    design = load_sensor("dense")
    estimator = MembraneForce(MembraneModel(design))
    flat = design.markers.p_SM
    n = np.tile([0.0, 0.0, -1.0], (len(flat), 1))
    markers = Markers(np.arange(len(flat)), flat, n, np.zeros((len(flat), 3, 3)))
    rest = estimator.rest_state(markers, 0.0)
    wrench, gauge = estimator.wrench(markers.ids, flat, rest)
    np.testing.assert_allclose(wrench, 0, atol=1e-9)
    assert gauge == pytest.approx(0.0, abs=1e-6)
    x = np.linspace(-0.02, 0.02, 9)
    y = np.linspace(-0.015, 0.015, 7)
    surface = Surface(x, y, np.zeros((7, 9)), 1.2e-3, 0.0, 0.0, 0.0)
    np.testing.assert_allclose(spring_grid_force(surface, surface, 28.0), 0, atol=1e-12)


def test_spring_grid_matches_tension_times_curvature():
    """For a shallow paraboloid the exact answer is known: force per node = -T lap(w) dA,
    uniform."""
    x = np.linspace(-0.02, 0.02, 41)
    y = np.linspace(-0.015, 0.015, 31)
    bowl = -0.5 * 2.0 * (x[None, :] ** 2 + y[:, None] ** 2)  # curvature -2 1/m along both axes
    flat = Surface(x, y, np.zeros((31, 41)), 1.2e-3, 0.0, 0.0, 0.0)
    force = spring_grid_force(Surface(x, y, bowl, 1.2e-3, 0.0, 0.0, 0.0), flat, tension=28.0)
    expected = 28.0 * 4.0 * (x[1] - x[0]) * (y[1] - y[0])
    # slopes reach 0.05: cos differs by 0.1 %
    np.testing.assert_allclose(force[1:-1, 1:-1, 2], expected, rtol=0.01)
