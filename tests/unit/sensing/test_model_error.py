"""Tests of the additions to the posterior variance: each part alone, on loads with a known
value."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mjtactile.core.design import load_sensor
from mjtactile.sensing.force.model_error import FitDiagnostics, ModelErrorVariance
from mjtactile.sensing.settings import DEFAULTS

DENSE = load_sensor("dense")
NODES = np.array([[0.0, 0.0], [18e-3, 0.0]])  # the second is beyond the outermost markers, at 16 mm
NOTHING = DEFAULTS.override(
    {
        f"model_error.{name}": (0.0,) * 4
        for name in ("sparse", "lateral", "sharp", "caught", "outside", "change", "burst")
    }
    | {"model_error.drag": 0.0}
).model_error
AT_REST = FitDiagnostics(np.zeros((3, 2)), np.zeros(6), np.zeros(3), 0.0)


def sd(estimated, design=DENSE, nodes=NODES, **shares):
    return np.sqrt(
        ModelErrorVariance(design, nodes, replace(NOTHING, **shares)).variance(estimated)
    )


def loaded(*forces, **more):
    return replace(AT_REST, force=np.array(forces, dtype=float).T, **more)


def test_fractions_are_of_the_force_and_torques_have_a_lever():
    estimated = loaded([0.0, 0.0, -2.0], [0.0, 0.0, 0.0])
    assert sd(estimated, sparse=(0.1, 0.2, 0.3, 0.4)) == pytest.approx(
        [0.2, 0.2, 0.4, 0.6 * 3e-3, 0.6 * 3e-3, 0.8 * 3e-3]
    )
    sparse = replace(DENSE, markers=replace(DENSE.markers, pitch_x=2 * DENSE.markers.pitch_x))
    assert sd(estimated, sparse, sparse=(0.0, 0.2, 0.0, 0.0))[2] == pytest.approx(0.8)


def test_canceling_shear_is_uncertain_too():
    estimated = loaded([0.5, 0.0, 0.0], [-0.5, 0.0, 0.0])
    assert sd(estimated, lateral=(0.1, 0.0, 0.0, 0.0))[:2] == pytest.approx([0.1, 0.1])


@pytest.mark.parametrize(("excess", "factor"), [(0.6, 0.0), (1.0, 0.0), (5.0, 2.0), (1e3, 19**0.5)])
def test_shear_of_edges_that_catch_the_membrane_is_uncertain_and_that_of_smooth_bodies_is_not(
    excess, factor
):
    """Shear of edges that catch the membrane adds uncertainty, shear of smooth shapes does not.

    It grows with the root of the markers' excess noise beyond one, limited to 20.
    """
    estimated = loaded([0.3, 0.0, -1.0], [-0.1, 0.0, 0.0], excess=excess)
    found = sd(estimated, caught=(0.1, 0.0, 0.2, 0.0))
    assert found == pytest.approx(
        np.array([0.04, 0.04, 0.0, 0.08 * 3e-3, 0.08 * 3e-3, 0.0]) * factor
    )


def test_only_positions_beyond_the_markers_are_outside():
    shares = {"outside": (0.0, 0.5, 0.0, 0.0)}
    assert sd(loaded([0.0, 0.0, -1.0], [0.0, 0.0, 0.0]), **shares)[2] == 0.0
    assert sd(loaded([0.0, 0.0, 0.0], [0.0, 0.0, -1.0]), **shares)[2] == pytest.approx(0.5)


def test_near_the_outermost_markers_a_fraction_of_the_load_is_uncertain():
    """Those of `dense` are at 16 mm, 4 mm apart."""
    pressed = loaded([0.0, 0.0, -1.0])
    found = [
        sd(pressed, nodes=np.array([[x, 0.0]]), outside=(0.0, 0.5, 0.0, 0.0))[2]
        for x in (0.0, 14e-3, 15e-3, -16e-3, 18e-3, 19.9e-3)
    ]
    assert found == pytest.approx([0.0, 0.0, 0.5 / 16, 0.5 / 4, 0.5, 0.5])


def test_a_force_that_comes_at_once_may_press_anywhere():
    """All of 0.4 N is new; of 0.4 N, 0.3 are; 0.2 are: half, and no burst."""
    shares = {"burst": (0.0, 0.5, 1.0, 0.0)}
    first, mostly, half = (
        sd(
            loaded([0.0, 0.0, -0.4], [0.0, 0.0, 0.0], change=np.array([0, 0, -new, 0, 0, 0])),
            **shares,
        )
        for new in (0.4, 0.3, 0.2)
    )
    assert first == pytest.approx([0, 0, 0.2, 1.2e-3, 1.2e-3, 0])
    assert mostly[2] == pytest.approx(0.5 * 0.3 * 0.5)
    assert half[2] == 0.0


def test_the_sharpness_term_has_a_limit():
    estimated = [
        sd(loaded([0.0, 0.0, -1.0], [0.0, 0.0, 0.0], excess=mean), sharp=(0.0, 0.01, 0.0, 0.0))[2]
        for mean in (5, 20, 70)
    ]
    assert estimated == pytest.approx([0.05, 0.2, 0.2])


def test_a_body_explains_sharpness_and_drag_from_all_sides():
    """A shape explains the parts `sharp` and `caught`, and `lateral` for shear and spin; the rest
    of the variance remains."""
    estimated = loaded([0.2, 0.0, -2.0], [-0.1, 0.3, 0.0], excess=5.0)
    shares = {
        name: getattr(DEFAULTS.model_error, name) for name in ("sparse", "lateral", "outside")
    }
    sharp = {"sharp": (0.1, 0.2, 0.3, 0.4), "caught": (0.4, 0.3, 0.2, 0.1)}
    error_model = ModelErrorVariance(DENSE, NODES, replace(NOTHING, **shares, **sharp))
    left = error_model.variance(estimated) - error_model.of_sharpness(
        estimated.force, estimated.excess
    )
    tilts = [2, 3, 4]  # and the normal force, which has no `lateral` part
    assert left[tilts] == pytest.approx(sd(estimated, **shares)[tilts] ** 2)
    alone = {name: value for name, value in shares.items() if name != "lateral"}
    others = [0, 1, 5]
    assert left[others] == pytest.approx(sd(estimated, **alone)[others] ** 2)


def test_a_membrane_that_moves_sideways_drags():
    """The drag of the simulated membrane relative to the frame is a damping of 81 s/m^2 times its
    stiffness per m^2."""
    estimated = replace(AT_REST, velocity=np.array([0.01, 0.0, 0.02]))
    area = DENSE.frame.length * DENSE.frame.width
    stiffness = DENSE.membrane.young * DENSE.membrane.thickness
    assert sd(estimated, drag=81.0) == pytest.approx(
        [81.0 * stiffness * area * 0.01, 0, 0, 0, 0, 0]
    )


def test_a_changing_wrench_is_less_certain():
    estimated = replace(AT_REST, change=np.array([0.1, 0.0, 0.4, 0.0, 1e-3, 2e-3]))
    assert sd(estimated, change=(0.1, 0.5, 0.2, 0.3)) == pytest.approx(
        [0.01, 0, 0.2, 0, 2e-4, 6e-4]
    )


def test_no_contact_is_not_uncertain():
    assert np.all(ModelErrorVariance(DENSE, NODES).variance(AT_REST) == 0.0)
