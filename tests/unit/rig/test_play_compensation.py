"""Tests of `PlayCompensation` on jaws that lag their motors by half of the play."""

import numpy as np
import pytest

from mjtactile.rig.play_compensation import PlayCompensation

PLAY = 4e-4


class Jaws:
    """Play operator: the motors move the jaws once the play is used up."""

    def __init__(self, opening):
        self.opening = opening

    def follow(self, motors):
        self.opening = min(max(self.opening, motors - PLAY / 2), motors + PLAY / 2)
        return self.opening


@pytest.mark.parametrize(("known", "error"), [(PLAY, 1e-9), (0.0, PLAY / 2)])
def test_jaws_reach_the_requested_opening_in_both_directions(known, error):
    """Without compensation they lag by half of the play."""
    jaws = Jaws(0.05)
    play = PlayCompensation(known)
    goals = np.concatenate([np.linspace(0.05, 0.04, 20), np.linspace(0.039, 0.045, 20)])
    reached = [jaws.follow(play.motor_goal(goal)) for goal in goals]
    lag = np.abs(np.array(reached) - goals)[1:]
    assert lag.max() == pytest.approx(error, abs=1e-8)


def test_the_reported_opening_is_that_of_the_jaws():
    jaws = Jaws(0.05)
    play = PlayCompensation(PLAY)
    for goal in (0.05, 0.048, 0.049, 0.047):
        motors = play.motor_goal(goal)
        assert play.opening(motors) == pytest.approx(jaws.follow(motors), abs=1e-9)


def test_noise_below_a_quarter_of_the_play_does_not_move_the_motors_back():
    play = PlayCompensation(PLAY)
    play.motor_goal(0.05)
    first = play.motor_goal(0.048)
    assert play.motor_goal(0.048 + 0.2 * PLAY) == first
    assert play.motor_goal(0.048 - 0.2 * PLAY) < first  # motion continues in the same direction


def test_without_play_commands_are_unchanged():
    play = PlayCompensation(0.0)
    for goal in (0.05, 0.0481, 0.0493):
        assert play.motor_goal(goal) == goal and play.opening(goal) == goal
