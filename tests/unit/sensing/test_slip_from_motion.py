"""Tests of slip from a known shape's motion: closed cases of rates, shear and the rubber's own
motion."""

from __future__ import annotations

import numpy as np
import pytest

from mjtactile.core.types import RelativeMotion, Slip
from mjtactile.sensing.settings import DEFAULTS
from mjtactile.sensing.touch.slip import SlipHistory, SlipSample
from mjtactile.sensing.touch.slip_from_motion import slides, spins, with_motion

S = DEFAULTS.slip
STICKS = Slip("sticking", np.zeros(2), 0.0, 0.5)


def motion(velocity=(0.0, 0.0), sd=1e-3, spinning=0.0, spinning_sd=0.05):
    """Return the motion of a shape with unknown rolling."""
    empty = np.full((2, 2), np.nan)
    return RelativeMotion(
        np.array(velocity),
        sd**2 * np.eye(2),
        np.full(2, np.nan),
        empty,
        np.zeros(2),
        spinning,
        spinning_sd,
    )


def history(ratio=(0.5, 0.0, 0.0), dragged=0.0):
    """Return two images 0.1 s apart, with the rubber dragged by a distance, m, along x between
    them."""
    samples = tuple(
        SlipSample(0.1 * k, np.zeros(2), np.array([k * dragged, 0.0, 0.0]), np.array(ratio))
        for k in range(2)
    )
    return SlipHistory(samples, np.ones(1), np.zeros((1, 3)), 0.0, 0.9)


def test_a_body_that_slides_along_the_shear_slips():
    # 10 mm/s, ten sd of 1 mm/s: above the least speed and surely so
    assert slides(motion((10e-3, 0.0)), history())
    moved, after = with_motion(STICKS, history(), motion((10e-3, 0.0)))
    assert moved.state == "slipping" and moved.stick_ratio == 0
    assert moved.velocity == pytest.approx([10e-3, 0.0])
    # one more image, 0.1 s of 10 mm/s
    assert moved.distance == after.distance == pytest.approx(1e-3)


@pytest.mark.parametrize(
    "still",
    [
        (motion((-10e-3, 0.0)), history()),  # against the shear: it is carried along
        (motion((0.0, 10e-3)), history()),  # across it
        (motion((10e-3, 0.0), sd=3e-3), history()),  # within its uncertainty
        (motion((0.9 * S.shape_speed, 0.0), sd=1e-5), history()),  # creeping
        (motion((10e-3, 0.0)), history((0.5 * S.min_load, 0.0, 0.0))),  # no shear: it rolls
        # partial slip: a shape moves by the fraction `follows` of its drag on the rubber
        (motion((10e-3, 0.0)), history(dragged=0.1 * 8e-3 / S.follows)),
    ],
)
def test_a_sticking_contact_does_not_slip(still):
    body, before = still
    assert not slides(body, before)
    moved, after = with_motion(STICKS, before, body)
    assert moved.state == "sticking" and after is before
    assert moved.velocity == pytest.approx(body.velocity)


def test_a_body_that_turns_on_the_spot_slips():
    """Its centre of pressure stays where it is."""
    assert spins(motion(spinning=1.0))
    assert with_motion(STICKS, history(), motion(spinning=-1.0))[0].state == "slipping"
    assert not spins(motion(spinning=0.9 * S.shape_spin))
    assert not spins(motion(spinning=1.0, spinning_sd=0.5))
    # round: rotation is not observable
    assert not spins(motion(spinning=np.nan, spinning_sd=np.nan))


def test_unknown_motion_has_no_effect():
    unknown = Slip("unknown", np.full(2, np.nan), np.nan, np.nan)
    fast = motion((1.0, 0.0))
    assert with_motion(unknown, history(), fast)[0] is unknown
    assert with_motion(STICKS, history(), None)[0] is STICKS
    assert with_motion(STICKS, None, fast)[0] is STICKS
