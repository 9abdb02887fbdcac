"""Tests of sticking contact: against an independent membrane's number, statics, and Coulomb's
law."""

import numpy as np
import pytest
from scipy.linalg import cho_solve_banded

from mjtactile import QuasistaticMembrane
from mjtactile.quasistatic.incremental import Sticking
from mjtactile.quasistatic.stick_contact import compliance_of


@pytest.fixture(scope="module")
def fine():
    return QuasistaticMembrane("dense", grid=(41, 31), gauge_pressure=1000.0)


def pressed(membrane, radius, depth, place=(0, 0)):
    return membrane.solve(
        membrane.obstacle("sphere", (radius - 0.15e-3,), (*place, 2.8699e-3 - depth + radius))
    )


# Radius and depth, m, and stiffness along x and y, N/m: the tangent of an independent membrane of
# 81 x 61 nodes. Its touching nodes are dragged as one rigid body while the others reach
# equilibrium.
DRAGGED = [
    (4e-3, 1e-3, 333.5, 345.1),
    (8e-3, 1e-3, 411.6, 443.4),
    (8e-3, 2e-3, 489.7, 532.5),
    (16e-3, 1e-3, 513.0, 559.7),
    (16e-3, 2e-3, 655.5, 744.1),
    (30e-3, 2e-3, 899.3, 1071.4),
]


@pytest.mark.parametrize(("radius", "depth", "along", "across"), DRAGGED)
def test_a_sticking_patch_is_as_stiff_as_an_independent_membrane_holds_it(
    fine, radius, depth, along, across
):
    (patch,) = fine.patches(pressed(fine, radius, depth))
    # a patch is whole nodes, 1 mm apart: of nine (4 mm) it is a tenth too wide
    rel = 0.12 if radius < 10e-3 else 0.04
    assert patch.stiffness[0, 0] == pytest.approx(along, rel)
    assert patch.stiffness[1, 1] == pytest.approx(across, rel)
    np.testing.assert_allclose(patch.center, 0, atol=1e-6)  # by symmetry, without coupling
    scale = np.sqrt(patch.stiffness[0, 0] * patch.stiffness[2, 2])
    np.testing.assert_allclose(patch.stiffness[2, :2], 0, atol=1e-5 * scale)


def test_a_membrane_that_moves_holds_a_patch_nearly_as_stiffly():
    """All contacts use the stiffness of the membrane at rest."""
    coarse = QuasistaticMembrane("dense", gauge_pressure=1000.0)
    sticking = Sticking(coarse)
    for radius, depth, along, _ in DRAGGED:
        state = pressed(coarse, radius, depth)
        grip = sticking.grip(state.x, state.force)
        assert grip.stiffness[0, 0] == pytest.approx(along, rel=0.1)  # nodes 2 mm apart


def test_the_compliance_is_the_inverse_of_the_stiffness():
    """The compliance is SciPy's inverse of the stiffness, even if the node count is not a multiple
    of the block size."""
    membrane = QuasistaticMembrane("dense", grid=(10, 8), gauge_pressure=1000.0)
    factor = membrane.stiffness_factor(membrane.rest)
    in_plane = np.arange(factor.shape[1]) % 3 < 2
    inverse = cho_solve_banded((factor, True), np.eye(factor.shape[1]))
    computed = compliance_of(membrane, membrane.rest)
    # the same sums in another order
    np.testing.assert_allclose(
        computed, inverse[in_plane][:, in_plane], atol=1e-12 * computed.max()
    )


def test_two_bodies_are_two_patches(fine):
    balls = [
        fine.obstacle("sphere", (4e-3,), (x, 0, z)) for x, z in ((-8e-3, 6e-3), (8e-3, 5.5e-3))
    ]
    patches = fine.patches(fine.solve(balls))
    assert [patch.center[0] > 0 for patch in patches] == [True, False]  # the deeper one first
    assert fine.patches(fine.rest) == []
