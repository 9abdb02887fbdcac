"""Vectors against numpy's own functions."""

import numpy as np
import pytest

from mjtactile.core import geometry

RNG = np.random.default_rng(0)


@pytest.mark.parametrize(
    "a, b", [((3,), (3,)), ((5, 3), (5, 3)), ((5, 1, 3), (5, 2, 3)), ((0, 3), (0, 3))]
)
def test_cross_is_numpys_bit_for_bit(a, b):
    a = RNG.normal(size=a)
    b = RNG.normal(size=b)
    np.testing.assert_array_equal(geometry.cross(a, b), np.cross(a, b))


def test_cross_accepts_non_contiguous_arrays():
    a = RNG.normal(size=(4, 3, 2))
    np.testing.assert_array_equal(
        geometry.cross(a[:, :, 0], a[:, :, 1]), np.cross(a[:, :, 0], a[:, :, 1])
    )
