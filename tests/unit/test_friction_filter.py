"""Tests of the friction filter against simulated grips with a known friction coefficient mu(t)."""

import math
from dataclasses import asdict, replace

import numpy as np
import pytest

from mjtactile.core.types import Slip, Touch, Traction
from mjtactile.grasp_estimation import FrictionFilter
from mjtactile.grasp_estimation.friction_filter import GRID, _likelihood, _transition

PERIOD = 1 / 30
RISK = 0.01
NODES = np.zeros(1)


def touches(drag, press, state="sticking", distance=0.0):
    """Return two equal touches with this shear and normal force, N."""
    wrench = np.array([0.0, -drag, -press, 0.0, 0.0, 0.0])
    traction = Traction(NODES, NODES, np.zeros((1, 1, 3)), wrench, np.eye(6), 0.0, "simulated")
    slip = Slip(state, np.zeros(2), distance, 1.0)
    return [Touch(0.0, 0.0, press, 0.003, True, traction=traction, slip=slip)] * 2


def updated(friction, touch, count=1):
    """Return the filter after `count` equal images, stored as plain values in between."""
    for _ in range(count):
        friction = FrictionFilter(**asdict(friction)).after(touch, PERIOD)
    return friction


def grip_of(mu, load, seed, seconds, lag=0.12):
    """Simulate a grip of a `load`, N per finger, that follows the filter with a delay.

    Coulomb: the shear is the load, or `mu(t)` times the normal force. Fully sliding objects fall.
    A slip is reported in four of five images. Return filters, normal forces, N, and the
    distance, m.
    """
    rng = np.random.default_rng(seed)
    friction = FrictionFilter()
    press, speed, distance = load / 0.4, 0.0, 0.0
    found, forces = [], []
    for k in range(round(seconds / PERIOD)):
        limit = mu(k * PERIOD) * press
        slides = load > limit or speed > 0
        drag = min(load, limit) if not slides else limit
        speed = max(0.0, speed + 9.81 * (1 - limit / load) * PERIOD) if slides else 0.0
        distance += speed * PERIOD
        reported = slides and rng.random() < 0.8
        noise = 1 + 0.02 * rng.standard_normal(2)
        touch = touches(
            drag * noise[0], press * noise[1], "slipping" if reported else "sticking", distance
        )
        friction = updated(friction, touch)
        found.append(friction)
        forces.append(press)
        target = min(friction.grip(load, RISK), 2.2)
        press += PERIOD / lag * (target - press)
    return found, forces, distance


def test_a_posterior_is_a_distribution_and_a_smaller_risk_is_a_firmer_grip():
    friction = updated(FrictionFilter(), touches(0.2, 0.5), 10)
    assert sum(friction.weights) == pytest.approx(1.0) and min(friction.weights) >= 0
    grips = [friction.grip(0.2, risk) for risk in (0.5, 0.1, 0.01, 0.001)]
    assert grips == sorted(grips) and grips[0] < 0.5 * grips[-1]
    # proportional to the load
    assert friction.grip(0.4, RISK) == pytest.approx(2 * friction.grip(0.2, RISK))


def test_the_prediction_does_not_depend_on_the_rate_of_the_images():
    prior = np.zeros(2 * len(GRID))
    prior[20] = 1.0
    slow = _transition(0.2) @ prior
    fast = np.linalg.matrix_power(_transition(0.02), 10) @ prior
    both = np.tile(GRID, 2)
    for power in (1, 2):  # mean and spread
        assert both**power @ fast == pytest.approx(both**power @ slow, rel=0.01)
    assert fast[: len(GRID)].sum() == pytest.approx(slow[: len(GRID)].sum(), abs=1e-3)


def test_a_hold_bounds_friction_from_below():
    friction = updated(FrictionFilter(), touches(0.35, 0.5), 60)
    assert friction.quantile(0.01) > 0.6 and friction.quantile(0.5) > 0.7
    assert FrictionFilter().quantile(0.01) < 0.2


@pytest.mark.parametrize("mu", [0.35, 0.5, 0.8])
def test_a_slip_is_the_coefficient(mu):
    """The object slides while the grip grows: mu is found within the error of one utilization."""
    friction = updated(FrictionFilter(), touches(0.8 * mu * 0.5, 0.5), 30)
    for k in range(6):
        friction = updated(friction, touches(mu * 0.5, 0.5, "slipping", 1e-3 * k))
    assert friction.quantile(0.5) == pytest.approx(mu, abs=0.08)


def test_a_confirmed_slip_counts_whatever_was_held_before():
    """Ten seconds at a utilization of 0.6 do not delay the answer to a slip at 0.5."""
    held = updated(FrictionFilter(), touches(0.3, 0.5), 300)
    before = held.grip(0.3, RISK)
    first = updated(held, touches(0.25, 0.5, "slipping", 0.0))
    second = updated(first, touches(0.25, 0.5, "slipping", 1e-3))
    third = updated(second, touches(0.25, 0.5, "slipping", 2e-3))
    assert third.grip(0.3, RISK) > 1.4 * before
    # the same report without a growing distance is weaker evidence
    weak = updated(updated(held, touches(0.25, 0.5, "slipping")), touches(0.25, 0.5, "slipping"))
    assert weak.grip(0.3, RISK) < second.grip(0.3, RISK)


def test_a_sliding_finger_measures_friction_whatever_the_other_one_does():
    """One finger slides at 0.4 of its own normal force; the other carries more and sticks."""
    held = updated(FrictionFilter(), touches(0.3, 0.5), 30)
    for k in range(4):
        slides = touches(0.2, 0.5, "slipping", 1e-3 * k)[:1]
        held = updated(held, slides + touches(0.19, 0.5)[:1])
    assert held.quantile(0.5) == pytest.approx(0.4, abs=0.04)


def steady_hold(drags, count=60):
    """Return the filter after a hold with these shears, N, at 0.5 N, and errors of 0.5 mN."""
    rng = np.random.default_rng(0)
    friction = FrictionFilter()
    for _ in range(count):
        errors = 5e-4 * rng.standard_normal(2)
        friction = friction.after(two_fingers(np.add(drags, errors)), PERIOD)
    return friction


def two_fingers(drags, presses=(0.5, 0.5), across=0.0):
    """Return touches that do not report slip, with these forces, N; `across` is the shear of the
    first one across the load."""
    pairs = zip(drags, presses, strict=True)
    first, second = (touches(drag, press)[0] for drag, press in pairs)
    assert first.traction is not None
    wrench = first.traction.wrench + np.array([across, 0.0, 0.0, 0.0, 0.0, 0.0])
    return [replace(first, traction=replace(first.traction, wrench=wrench)), second]


def test_shear_that_moves_to_the_other_finger_at_a_constant_grip_is_a_slip():
    """One finger slides while friction falls: it loses 5 mN, ten times the error of an image, and
    the other one takes over the load. No finger reports slip yet. The friction coefficient is the
    utilization of the finger that slides."""
    held = steady_hold((0.22, 0.19))
    assert not held.grows
    slides = held
    for lost in (0.005, 0.010, 0.016, 0.022):
        slides = slides.after(two_fingers((0.22 - lost, 0.19 + lost)), PERIOD)
        assert slides.grows
    assert slides.quantile(0.5) == pytest.approx(0.198 / 0.5, abs=0.06)
    # a table takes shear as well
    assert not held.after(two_fingers((0.215, 0.195)), PERIOD, is_hanging=False).grows
    first = held.after(two_fingers((0.215, 0.195)), PERIOD)
    assert first.grip(0.2, RISK) > 1.2 * held.grip(0.2, RISK)


@pytest.mark.parametrize(
    ("drags", "presses", "across"),
    [
        ((0.12, 0.19), (0.5, 0.5), 0.0),  # no contact loses half of its shear within one image
        ((0.28, 0.19), (0.5, 0.5), 0.0),  # an outlier of the other finger
        ((0.215, 0.19), (0.52, 0.5), 0.0),  # an outlier changes the normal force, too
        ((0.215, 0.19), (0.5, 0.5), 0.01),  # and the shear across the load
        ((0.21, 0.18), (0.5, 0.5), 0.0),  # the load has decreased
        ((0.215, 0.195), (0.6, 0.6), 0.0),  # a firmer grip turns the object
        ((0.2185, 0.1905), (0.5, 0.5), 0.0),  # noise
    ],
)
def test_other_changes_of_shear_are_no_slip(drags, presses, across):
    held = steady_hold((0.22, 0.19))
    assert held.after(two_fingers((0.215, 0.19)), PERIOD).grows  # each differs from a slip
    assert not held.after(two_fingers(drags, presses, across), PERIOD).grows


@pytest.mark.parametrize(("drags", "is_slip"), [((0.15, 0.25), False), ((0.22, 0.25), True)])
def test_a_finger_that_moves_where_another_one_uses_more_friction_does_not_slide(drags, is_slip):
    """Both have the same friction: an object that turns or rolls moves over one finger. Utilizations
    that differ by 12 % are equal within the errors of the forces."""
    held = steady_hold(drags)
    moving = touches(drags[0], 0.5, "slipping", 7e-5)[:1] + touches(drags[1], 0.5)[:1]
    assert held.after(moving, PERIOD).grows == is_slip


def test_the_hold_itself_sets_the_noise_of_a_moving_shear():
    """A shaken object moves its shear between the fingers by 10 mN all the time."""
    friction = steady_hold((0.22, 0.19))
    signs = []
    for k in range(60):
        moved = 0.01 * math.sin(2 * math.pi * 4.0 * k * PERIOD)
        friction = friction.after(two_fingers((0.22 + moved, 0.19 - moved)), PERIOD)
        signs.append(friction.grows)
    assert not any(signs[15:])


def test_a_slip_at_a_utilization_that_was_held_is_a_fall():
    """Friction of a steady contact is the utilization at which it slips first; slip where it held
    means that friction has changed, and the fall may continue."""
    grips = []
    for before in (0.12, 0.2):  # shear, N: the load grows until slip, or it was there before
        friction = updated(FrictionFilter(), touches(before, 0.4), 60)
        friction = updated(friction, touches(0.2, 0.4, "slipping", 0.0))
        friction = updated(friction, touches(0.2, 0.4, "slipping", 2e-4))
        grips.append(friction.grip(0.2, RISK))
    assert grips[1] > 1.15 * grips[0]


def test_a_report_that_outlasts_its_slip_measures_nothing_more():
    """The grip has become firmer, and the object stands still; the report lasts for some images."""
    friction = updated(FrictionFilter(), touches(0.2, 0.4), 30)
    for k in range(3):
        friction = updated(friction, touches(0.2, 0.5, "slipping", 1e-3 * k))
    after = updated(friction, touches(0.2, 0.9, "slipping", 2e-3), 3)
    assert after.quantile(0.5) > 0.3  # the utilization is 0.22
    assert after.utilization(RISK) < 1.15 * friction.utilization(RISK)


def test_a_fall_has_an_end():
    """After a slip the grip allows for a fall that continues; without another slip it does not grow
    for ever: less than twice the load over the measured coefficient."""
    friction = updated(FrictionFilter(), touches(0.2, 0.4), 60)
    for k in range(3):
        friction = updated(friction, touches(0.2, 0.5, "slipping", 1e-3 * k))
    grips = []
    for _ in range(120):
        grips.append(friction.grip(0.2, RISK))
        friction = updated(friction, touches(0.2, grips[-1]))
    assert grips[0] > 1.15 * 0.5 and max(grips) < 2 * 0.5


def test_the_force_that_stops_an_object_grows_with_its_speed():
    """v^2 / (2 g s): slow creep needs none; the predicted speed includes the acceleration."""
    creeps, slides = (updated(FrictionFilter(), touches(0.2, 0.5), 5) for _ in range(2))
    for k in range(1, 4):
        creeps = updated(creeps, touches(0.2, 0.5, "slipping", 1e-4 * k))
        slides = updated(slides, touches(0.2, 0.5, "slipping", 1e-3 * k))
    assert creeps.inertia < 0.01
    assert slides.speed == pytest.approx(0.03) and slides.acceleration == pytest.approx(0.0)
    assert slides.inertia == pytest.approx(0.03**2 / (2 * 9.81 * 1e-3))
    faster = updated(slides, touches(0.2, 0.5, "slipping", 5e-3))
    assert faster.acceleration == pytest.approx(0.03 / PERIOD) and faster.inertia > 1.0


def test_a_shear_that_falls_with_the_grip_is_a_slip():
    """The grip is loosened by a third. A shear that follows it is friction; one that stays is a
    load, which shows a larger coefficient."""
    held = updated(FrictionFilter(), touches(0.3, 0.6), 30)
    loads, slides = held, held
    for press in (0.55, 0.5, 0.45, 0.4, 0.4):
        loads = updated(loads, touches(0.3, press))
        slides = updated(slides, touches(0.5 * press, press))
    assert slides.quantile(0.5) < loads.quantile(0.5) - 0.1
    assert loads.quantile(0.01) > 0.55


@pytest.mark.parametrize(("seconds", "slid"), [(1.0, 10e-3), (3.0, 2e-3)])
@pytest.mark.parametrize("seed", range(4))
def test_a_grip_survives_a_surface_that_gets_wet(seconds, slid, seed):
    """mu falls from 0.8 to 0.35: the grip follows before the object has slid far, and the posterior
    covers the new value."""
    start = 4.0
    ramp = lambda t: 0.8 - 0.45 * min(max((t - start) / seconds, 0.0), 1.0)  # noqa: E731
    found, forces, distance = grip_of(ramp, 0.2, seed, start + seconds + 4.0)
    assert forces[-1] * 0.35 > 0.2 and distance < slid
    assert found[-1].quantile(0.01) < 0.36 < found[-1].quantile(0.99)
    assert max(forces) < 1.2


def test_a_constant_friction_keeps_a_light_grip():
    """Without a slip the grip does not grow in ten seconds by more than a fifth."""
    _, forces, distance = grip_of(lambda _: 0.8, 0.2, 1, 14.0)
    assert distance == 0.0
    assert forces[-1] < 1.2 * forces[120] and forces[-1] < 2.5 * 0.2 / 0.8


def test_an_image_without_force_is_only_a_prediction():
    friction = updated(FrictionFilter(), touches(0.3, 0.5), 30)
    unknown = updated(friction, touches(math.nan, math.nan))
    np.testing.assert_allclose(unknown.weights, _transition(PERIOD) @ np.array(friction.weights))
    assert unknown.recent == friction.recent


def test_signs_are_likelier_at_a_higher_utilization():
    """Every sign of slip favors small coefficients, and more fingers do so more strongly."""
    held = updated(FrictionFilter(), touches(0.3, 0.5), 30)
    ratios = []
    for state, distance in (("sticking", 0.0), ("slipping", 0.0), ("slipping", 1e-3)):
        signs = held.signs(touches(0.3, 0.5, state, distance), PERIOD)
        likelihood = _likelihood(signs)
        ratios.append(likelihood[np.searchsorted(GRID, 0.62)] / likelihood[-1])
    assert ratios == sorted(ratios) and ratios[0] < 1.0 < ratios[1]


@pytest.mark.parametrize(("growth", "is_slip"), [(1e-4, False), (6e-4, True)])
def test_a_surface_that_closing_jaws_drag_along_is_no_slip(growth, is_slip):
    """A grip firmer by 30 % drags the surface by up to 0.35 mm."""
    steady = updated(FrictionFilter(), touches(0.2, 0.5, "slipping"), 8)
    firmer = updated(steady, touches(0.2, 0.65, "slipping", growth))
    assert firmer.grows == is_slip
    assert updated(steady, touches(0.2, 0.5, "slipping", growth)).grows


def test_an_image_without_a_speed_is_no_stop_of_a_slip():
    """The slip goes on at a constant speed; only its start is an acceleration."""
    friction = updated(FrictionFilter(), touches(0.2, 0.5), 30)
    distances = (1e-3, 2e-3, 3e-3, 3e-3, 4e-3)
    accelerations = []
    for distance in distances:
        friction = updated(friction, touches(0.2, 0.5, "slipping", distance))
        accelerations.append(friction.acceleration)
    assert accelerations[0] > 0
    assert max(accelerations[1:]) == pytest.approx(0.0, abs=1e-9)
