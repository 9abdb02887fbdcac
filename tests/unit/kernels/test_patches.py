"""Compiled contact patches compared with numpy: one to three loads at random positions, with
shear."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mjtactile.core.design import load_sensor
from mjtactile.sensing.force.inverse_fem import InverseMembrane
from mjtactile.sensing.force.linearization import Shape
from mjtactile.sensing.touch.patches import find_patches
from tests.numpy_pipeline import patches as numpy_patches

NO_PLANE: Any = SimpleNamespace(mean=None)  # the part of a linearization that patches read


def pressed(estimator, rest, rng, count):
    """Create a shape under `count` loads, some at the frame or as small as a node spacing."""
    traction = rng.normal(0, 30.0, (3, len(estimator.nodes)))
    for center in rng.uniform(-0.5, 0.5, (count, 2)) * [
        estimator.design.frame.length,
        estimator.design.frame.width,
    ]:
        off = np.linalg.norm(estimator.nodes - center, axis=1)
        press = rng.uniform(1e3, 8e3) * np.exp(-((off / rng.uniform(1e-3, 4e-3)) ** 2))
        traction += np.outer([*rng.uniform(-0.3, 0.3, 2), -1.0], press)
    c = rest + rng.normal(0, 5e-5, rest.shape)
    return Shape(
        c,
        traction,
        rng.uniform(-100.0, 900.0),
        1.0,
        NO_PLANE,
        1,
        np.zeros((2, estimator.design.markers.count)),
        0.0,
        np.zeros(0),
    )


@pytest.mark.parametrize("sensor", ["dense", "paper16"])
def test_patches(sensor):
    """Results agree to rounding; the angle of an axis has a period of pi."""
    design = load_sensor(sensor)
    rng = np.random.default_rng(7)
    estimator = InverseMembrane(design)

    class rest:
        c = estimator.membrane.equilibrium(
            estimator.membrane.seal(
                estimator.membrane.state(np.zeros((3, estimator.membrane.count))), 600.0
            )
        )

    several = 0
    for count in [1, 2, 3] * 12:
        shape = pressed(estimator, rest.c, rng, count)
        compiled, reference = (
            module(estimator, shape, rest) for module in (find_patches, numpy_patches.find_patches)
        )
        assert len(compiled) == len(reference)
        several += len(compiled) > 1
        for patch, expected in zip(compiled, reference, strict=True):
            np.testing.assert_array_equal(patch.mask, expected.mask)
            np.testing.assert_allclose(patch.outline, expected.outline, atol=1e-15)
            np.testing.assert_allclose(patch.force, expected.force, rtol=1e-10, atol=1e-12)
            np.testing.assert_allclose(patch.centroid, expected.centroid, atol=1e-13)
            np.testing.assert_allclose(patch.semi_axes, expected.semi_axes, atol=1e-10)
            assert patch.area == pytest.approx(expected.area, rel=1e-11)
            assert patch.depth == pytest.approx(expected.depth, abs=1e-15)
            if np.diff(patch.semi_axes)[0] < -1e-4:
                assert math.sin(patch.angle - expected.angle) == pytest.approx(0, abs=1e-6)
    assert several > 5


def test_a_pulled_membrane_has_no_patches():
    estimator = InverseMembrane(load_sensor("dense"))
    c = np.zeros((3, estimator.membrane.count))
    pull = np.full((3, len(estimator.nodes)), 10.0)

    class rest:
        pass

    rest.c = c
    shape = Shape(c, pull, 600.0, 1.0, NO_PLANE, 1, np.zeros((2, 81)), 0.0, np.zeros(0))
    assert find_patches(estimator, shape, rest) == ()
