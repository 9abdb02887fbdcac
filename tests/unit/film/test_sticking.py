"""What sticks: against an independent sheet's number, statics, and Coulomb's law."""

import numpy as np
import pytest

from mjtactile import Film, InputError
from mjtactile.film import Held, drag

FRAME = np.sqrt(0.04 * 0.03 / np.pi)  # m, radius of a circle of its area


@pytest.fixture(scope="module")
def fine():
    return Film("dense", grid=(41, 31), pressure_gauge=1000.0)


def pressed(film, radius, depth, place=(0, 0)):
    return film.solve(
        film.obstacle("sphere", (radius - 0.15e-3,), (*place, 2.8699e-3 - depth + radius))
    )


@pytest.mark.parametrize(
    ("radius", "depth"), [(4e-3, 1e-3), (8e-3, 1e-3), (8e-3, 2e-3), (16e-3, 2e-3), (30e-3, 2e-3)]
)
def test_a_sticking_patch_is_as_stiff_as_an_independent_sheet_holds_it(fine, radius, depth):
    state = pressed(fine, radius, depth)
    (patch,) = fine.patches(state)
    # c / ln(b/a) is within 8 % of that sheet; across it is stiffer than along, by 5 to 25 %
    expected = 1030 / np.log(FRAME / np.sqrt(state.area / np.pi))
    assert patch.stiffness[0, 0] == pytest.approx(expected, rel=0.08)
    assert 1.0 < patch.stiffness[1, 1] / patch.stiffness[0, 0] < 1.3
    np.testing.assert_allclose(patch.place, 0, atol=1e-6)  # by symmetry, and nothing couples
    scale = np.sqrt(patch.stiffness[0, 0] * patch.stiffness[2, 2])
    np.testing.assert_allclose(patch.stiffness[2, :2], 0, atol=1e-6 * scale)


def test_two_bodies_are_two_patches(fine):
    balls = [
        fine.obstacle("sphere", (4e-3,), (x, 0, z)) for x, z in ((-8e-3, 6e-3), (8e-3, 5.5e-3))
    ]
    patches = fine.patches(fine.solve(balls))
    assert [patch.place[0] > 0 for patch in patches] == [True, False]  # the deeper one first
    assert fine.patches(fine.rest) == []


def test_it_holds_remembers_and_slides(fine):
    (patch,) = fine.patches(pressed(fine, 8e-3, 2e-3))
    force, held = drag(patch, Held.none(), (1e-4, 0, 0), friction=0.5)
    assert force[0] == pytest.approx(-1e-4 * patch.stiffness[0, 0])
    force, held = drag(patch, held, (-1e-4, 0, 0), friction=0.5)
    np.testing.assert_allclose(force, 0, atol=1e-12)  # back where it was: nothing is left
    for _ in range(20):
        force, held = drag(patch, held, (1e-4, 5e-5, 1e-3), friction=0.5)
        carried = np.hypot(np.hypot(*force[:2]), force[2] / patch.radius)
        assert carried <= 0.5 * patch.force_normal * (1 + 1e-9)
    assert carried == pytest.approx(0.5 * patch.force_normal)  # it slides
    before = np.linalg.norm(force[:2])
    force, held = drag(patch, held, (0, 0, 0.5), friction=0.5)
    assert np.linalg.norm(force[:2]) < 0.2 * before  # what turns holds no drag
    force, _ = drag(patch, held, (1.0, 0, 0), friction=0.0)
    np.testing.assert_allclose(force, 0, atol=1e-12)
    with pytest.raises(InputError, match="friction"):
        drag(patch, held, (0, 0, 0), friction=-1)
