"""The compiled stages of a membrane's step against the same in numpy: a ball that falls onto a
sensor, bounces and rolls."""

import copy

import numpy as np
import pytest

from mjtactile.kernels import kernel
from mjtactile.sim.fast_step import advance
from mjtactile.sim.sensor.rubber_flex import stiffness_rows
from tests.numpy_pipeline import membrane
from tests.physics.test_step import scene

ROUNDING = 1e-9  # sums in another order, with cancellation of a few digits


@pytest.fixture(scope="module")
def rubber():
    """Provide a bulge with a strain everywhere, part of it compression."""
    model, _, sensor = scene()
    p_SV = sensor.mesh.p_SV.copy()
    p_SV[sensor.mesh.interior] += 1e-3 * np.random.default_rng(0).standard_normal(
        (len(sensor.mesh.interior), 3)
    )
    return model, sensor, p_SV


def test_volume_and_gradient(rubber):
    _, sensor, p_SV = rubber
    volume, gradient = sensor._geometry.volume_and_gradient(p_SV)
    expected, slope = membrane.volume_and_gradient(sensor.mesh, p_SV)
    assert volume == pytest.approx(sensor.design.chamber_volume_flat + expected, rel=1e-12)
    np.testing.assert_allclose(gradient, slope, rtol=ROUNDING, atol=1e-15)


def test_gas_load(rubber):
    """The kernel's gas load equals numpy's.

    The forces are p dV/dq. A spring acts along dV/dz, off its rest length by a fraction of the
    summed terms, and the force from this offset is compensated.
    """
    _, sensor, p_SV = rubber
    k = len(sensor.mesh.interior)
    gradient = sensor._geometry.volume_and_gradient(p_SV)[1]
    moved = (p_SV - sensor.mesh.p_SV)[sensor.mesh.interior]
    coefficients = np.empty(k)
    spring = np.empty(1)
    rest = np.empty(2)
    forces = np.empty((k, 3))
    kernel("apply_gas_load")(
        k, gradient, moved, 1e-3, 1e-12, 900.0, 2e9, coefficients, spring, rest, forces
    )
    terms = gradient[:, 2] * moved[:, 2]
    offset = 1e-3 * (np.abs(terms).sum() + 1e-12)
    expected = 900.0 * gradient
    expected[:, 2] += 2e9 * offset * gradient[:, 2]
    np.testing.assert_array_equal(coefficients, gradient[:, 2])
    np.testing.assert_allclose([*spring, *rest], [2e9, *[terms.sum() - offset] * 2], rtol=ROUNDING)
    np.testing.assert_allclose(forces, expected, rtol=ROUNDING)


def test_rubber(rubber):
    model, sensor, p_SV = rubber
    sensor._rubber.update(p_SV)
    expected = membrane.stiffness(model, sensor.flex_id, sensor.mesh, sensor.design.membrane, p_SV)
    np.testing.assert_allclose(
        stiffness_rows(model, sensor.flex_id),
        expected,
        rtol=ROUNDING,
        atol=1e-9 * np.abs(expected).max(),
    )


def test_unstrained_rubber_has_the_moduli_of_small_strain(rubber):
    model, sensor, _ = rubber
    free = sensor.mesh.p_SV / sensor.design.membrane.pre_stretch
    sensor._rubber.update(free)
    expected = membrane.stiffness(model, sensor.flex_id, sensor.mesh, sensor.design.membrane, free)
    np.testing.assert_allclose(stiffness_rows(model, sensor.flex_id), expected, rtol=1e-6)


def test_contact_memory_equals_numpy():
    """The kernel's contact memory equals numpy's, run in parallel on the same contacts with its own
    copy of the model."""
    model, data, sensor = scene()
    data.qvel[-6:-4] = 0.1, 0.05  # oblique velocity of the ball, m/s
    block = slice(int(sensor.vertex_geom_ids[0]), int(sensor.vertex_geom_ids[-1]) + 1)
    copied = copy.copy(model)
    beside = membrane.Stiction(copied, data, sensor.vertex_geom_ids, sensor.body_id)
    slid = stuck = 0
    for _ in range(150):
        sensor.update()
        beside.update(sensor._stand_off.margins)
        np.testing.assert_allclose(
            model.geom_margin[block], copied.geom_margin[block], rtol=ROUNDING, atol=1e-15
        )
        belt = copied.geom_surfacevel[block]
        np.testing.assert_allclose(
            model.geom_surfacevel[block],
            belt,
            rtol=ROUNDING,
            atol=1e-9 * max(np.abs(belt).max(), 1e-9),
        )
        slides = beside._states == membrane._SLIDES
        slid = slid + slides.sum()
        stuck = stuck + (beside._held.any(axis=0) & ~slides).sum()
        advance(model, data)
    assert slid >= 5 and stuck > 40
