"""Uncertainty of contact areas and of shapes without a model."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mjtactile import QuasistaticMembrane, load_sensor
from mjtactile.core.types import SHAPES, ContactShape
from mjtactile.sensing.contact_shape.contact_area import interval, rim_areas
from mjtactile.sensing.contact_shape.fit_state import _whitening
from mjtactile.sensing.contact_shape.initial_search import Suggestions
from mjtactile.sensing.contact_shape.random_presses import GROUPS
from mjtactile.sensing.contact_shape.shape_models import FAMILIES, SHARP
from mjtactile.sensing.contact_shape.shape_result import (
    _with_unequal,
    with_curvature_spread,
    with_position_spread,
    with_tip,
)
from mjtactile.sensing.touch.patches import _area_interval


@pytest.mark.parametrize("common_sd", [0.0, 2.0])
def test_whitened_markers_are_independent(common_sd):
    rng = np.random.default_rng(0)
    sd = rng.uniform(1.0, 3.0, 9)
    common = common_sd * rng.standard_normal((9, 2))
    root = _whitening(sd, common)
    np.testing.assert_allclose(
        root @ (np.diag(sd**2) + common @ common.T) @ root.T, np.eye(9), atol=1e-12
    )


def test_the_area_of_a_light_contact_is_less_certain():
    light, firm = (_area_interval(20e-6, force, 1000.0) for force in (0.05, 1.0))
    for low, high in (light, firm):
        assert low < 20e-6 < high
    assert light[0] < 0.5 * firm[0]
    # far beyond the range of the presses, the area is not below the lower end
    assert _area_interval(20e-6, 1e3, 1000.0)[0] == pytest.approx(20e-6)


def round_shape(**values):
    probabilities = dict.fromkeys(SHAPES, 0.0) | {"smooth": 1.0}
    known = {
        "family": "ball",
        "area": np.pi * 4e-6,
        "curvatures": (100.0, 100.0),
        "curvatures_sd": (3.0, 3.0),
        "radius": 0.01,
        "radius_sd": 3e-4,
        "pose_cov": np.zeros((6, 6)),
    }
    return ContactShape("smooth", probabilities, **(known | values))


def fit(name, theta):
    guess = SimpleNamespace(position=np.zeros(2), height=0.0)
    return SimpleNamespace(family=FAMILIES[name], theta=np.array(theta, float), hint=guess)


def test_another_round_model_widens_the_curvatures():
    """A mixture of 100 and (140, 90) at equal weights: half of the squared differences."""
    fits = [
        (0.4, fit("ball", [0, 0, 0, 100])),
        (0.4, fit("smooth", [0, 0, 0, 140, 0, 90])),
        (0.2, fit("disc", [0, 0, 0, 0, 0, 4])),
    ]
    shape = with_curvature_spread(round_shape(), fits)
    expected = np.sqrt(9 + 0.5 * np.array([40.0, 10.0]) ** 2)
    assert shape.curvatures_sd == pytest.approx(expected)
    grown = np.linalg.norm(expected) / np.linalg.norm([3, 3])
    assert shape.radius_sd == pytest.approx(3e-4 * grown)
    flat = replace(round_shape(), family="disc")
    assert with_curvature_spread(flat, fits) is flat


def test_unequal_curvatures_have_their_direction():
    """The larger curvature is along the diagonal, the smaller one across."""
    other = SimpleNamespace(unequal=np.array([0.0, 20.0]), unequal_sd=4.0)
    shape = _with_unequal(round_shape(R_SO=np.eye(3)), other)
    assert shape.curvatures == pytest.approx((120.0, 80.0))
    assert shape.curvatures_sd == pytest.approx((5.0, 5.0))
    assert shape.direction == pytest.approx(0.75 * np.pi)
    assert shape.direction_sd == pytest.approx(0.1)
    assert shape.R_SO[:, 0] == pytest.approx([-np.sqrt(0.5), np.sqrt(0.5), 0.0])


def test_a_probably_sharp_contact_has_no_certain_curvature():
    fits = [(1.0, fit("ball", [0, 0, 0, 100]))]
    shape = with_curvature_spread(round_shape(), fits, sharp=0.25)
    # half of the limit of sharp contacts, for the larger curvature
    assert shape.curvatures_sd == pytest.approx([np.hypot(3.0, 0.5 * SHARP), 3.0])


def test_another_model_widens_the_position():
    """A mixture: 0.25 of a square of 2 mm in x, and 0.04 of one of 1 mm in y."""
    others = [(0.25, fit("disc", [2, 0, 0, 0, 0, 4])), (0.04, fit("smooth", [0, 1, 0, 90, 0, 90]))]
    shape = with_position_spread(round_shape(p_SO=np.zeros(3)), others)
    assert np.sqrt(np.diag(shape.pose_cov)[:3]) == pytest.approx([1e-3, 2e-4, 0.0])
    assert not with_position_spread(round_shape(p_SO=np.zeros(3)), []).pose_cov.any()


def test_a_likely_tip_widens_the_position():
    shape = with_tip(round_shape(), 0.25)
    # half of 0.4 and of 0.2 times the contact radius of 2 mm
    assert np.sqrt(np.diag(shape.pose_cov))[:3] == pytest.approx([2e-4, 2e-4, 4e-4])
    assert not with_tip(round_shape(), 0.0).pose_cov.any()


def disc(area, radius=4.0):
    fitted = fit("disc", [0, 0, 0, 0, 0, radius])
    fitted.state = SimpleNamespace(area=area)
    return fitted


def test_a_face_that_grows_with_depth_has_a_round_rim():
    """The densities of a growth of 0.09 differ by exp(0.15^2 / (2 (0.05^2 + v)))."""
    face, spread = np.pi * 16e-6, 70e-6
    (p, area, _), (other, sharp, sd) = rim_areas(disc(spread), (0.09, 0.0), 0.8, face, 2e-6)
    assert (area, sharp, sd) == (spread, face, 2e-6)
    assert p + other == pytest.approx(0.8)
    assert np.log(p / other) == pytest.approx(0.15**2 / (2 * 0.05**2) - 1.7)
    (_, area, _), _ = rim_areas(disc(spread), (0.09, 0.1**2), 0.8, face, 2e-6)
    assert area == face  # uncertain growth
    (_, area, _), _ = rim_areas(disc(spread), (-0.06, 0.0), 0.8, face, 2e-6)
    assert area == face


def test_a_face_without_history_or_in_part_has_a_sharp_rim():
    face = np.pi * 16e-6
    assert rim_areas(disc(70e-6), (0.0, np.inf), 0.8, face, 2e-6) == [(0.8, face, 2e-6)]
    part = 0.8 * face
    assert rim_areas(disc(70e-6), (0.09, 0.0), 0.8, part, 2e-6) == [(0.8, part, 2e-6)]


def test_models_that_image_and_history_exclude_are_not_fitted():
    probabilities = np.full(len(GROUPS), 1e-6)
    for name, value in (("ball", 0.92), ("smooth", 0.07), ("disc", 0.01)):
        probabilities[GROUPS.index(name)] = value
    suggestions = Suggestions(SimpleNamespace(probabilities=probabilities), None)
    assert suggestions.names(2) == ["ball"]
    alone = suggestions.likely(dict.fromkeys(FAMILIES, 0.0))
    assert set(alone) == set(FAMILIES)  # one image alone excludes none
    # evidence of earlier images outweighs the image
    assert set(suggestions.likely({"ball": -14.0, "disc": 0.0})) == {"disc"}


def test_a_resumed_solution_is_the_solution():
    membrane = QuasistaticMembrane(load_sensor("dense"), (21, 16))
    balls = [membrane.obstacle("sphere", (8e-3,), (0, 0, z + 8e-3)) for z in (2e-3, 1.5e-3)]
    first = membrane.solve(balls[0])
    resumed = membrane.resume(balls[1].parameters[None], None, first)
    whole = membrane.solve(balls[1])
    assert resumed.converged and first.converged
    np.testing.assert_allclose(resumed.x, whole.x, atol=2e-6)
    assert resumed.force_normal == pytest.approx(whole.force_normal, rel=1e-3)


@pytest.mark.parametrize("sd", [2e-6, 30e-6])
def test_an_area_interval_is_the_same_for_one_model_and_for_two_equal_ones(sd):
    """Quantiles of a normal distribution, at least zero; the grid of mixtures has 127 steps of
    eight standard deviations: 1e-4 of one, interpolated."""
    area = 20e-6
    one = interval([(1.0, area, sd)])
    assert one == pytest.approx([max(area - 0.99446 * sd, 0), area + 0.99446 * sd], rel=1e-4)
    two = interval([(0.5, area, sd), (0.5, area, sd)])
    assert two == pytest.approx(one, abs=2e-3 * sd)
