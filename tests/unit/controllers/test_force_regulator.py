"""Force of the adaptive controller's jaws after a step of the load, on a plant in closed form."""

import math
import runpy
from collections import deque

import numpy as np
import pytest

from mjtactile.core import resources
from mjtactile.core.types import Command, GripperState, Observation, TaskGoal, Touch, Traction
from mjtactile.grasp_estimation import phases

PERIOD, SUBSTEPS = 1 / 30, 20
GRID = np.linspace(-0.01, 0.01, 3)
SOFT, STIFFENING = 110.0, 260.0  # of a ball between two membranes, N/m and 1/m
SPEED = 0.05  # maximum speed of the jaws, m/s
adaptive = runpy.run_path(str(resources.find("adaptive", "controllers", ".py")))
regulated, START = adaptive["_regulated"], adaptive["START"]


class Plant:
    """Jaws around a spring. They follow a command `delay` s after the next image, with a time
    constant `lag` s.

    The spring is a ball between two membranes, or `hardness` times as hard.
    """

    def __init__(self, hardness, lag, delay):
        self.hardness, self.lag = hardness, lag
        self.contact = 0.04
        self.jaws = self.contact - 5e-4 / hardness  # at rest, in light contact
        self.pipe = deque([self.jaws] * round((PERIOD + delay) / PERIOD * SUBSTEPS))

    def move(self, command):
        """Move for one period, and return the force on each finger, N."""
        for _ in range(SUBSTEPS):
            self.pipe.append(command)
            way = (self.pipe.popleft() - self.jaws) / self.lag
            self.jaws += max(-SPEED, min(SPEED, way)) * PERIOD / SUBSTEPS
        compression = max(self.contact - self.jaws, 0.0)
        return SOFT / STIFFENING * math.expm1(STIFFENING * self.hardness * compression)


def finger(normal):
    wrench = np.array([0.0, 0.0, -normal, 0.0, 0.0, 0.0])
    traction = Traction(GRID, GRID, np.zeros((3, 3, 3)), wrench, np.eye(6) * 9e-6, 1e3, "made up")
    return Touch(0.0, 0.01, normal, 0.003, normal > 0.05, traction=traction)


def forces(plant, targets):
    """Return the force on each finger (n,), N, while the controller's target is `targets` (n,)."""
    command = Command(plant.jaws, 5.0, 0.0, "hold", memory=START)
    found = []
    for target in targets:
        normal = plant.move(command.opening)
        state = GripperState(plant.jaws, 0.0, normal, 0.0)
        observed = Observation(0.0, PERIOD, (finger(normal),) * 2, state, (), command, TaskGoal())
        command = phases.remember(command, target=target)
        command = regulated(observed, command, [normal, normal])
        found.append(normal)
    return np.array(found)


PLANTS = pytest.mark.parametrize(
    ("hardness", "lag", "delay"),
    [
        (hardness, lag, delay)
        for hardness in (1.0, 1.5, 3.0)  # ball, start value, flat face
        for lag in (0.015, 0.02)  # kv / kp of the grippers in models/
        for delay in (0.0, 0.025)  # of models/randomization/default.toml
    ],
)


@PLANTS
def test_a_larger_target_is_reached_within_a_few_images_and_without_overshoot(hardness, lag, delay):
    """Asked: 90 % of a step from 0.3 to 0.6 N within 0.15 s, less than 10 % above it."""
    targets = np.repeat([0.18, 0.3, 0.6], [75, 75, 60])
    found = forces(Plant(hardness, lag, delay), targets)[150:]
    assert found[0] == pytest.approx(0.3, abs=0.01)
    assert np.argmax(found > 0.57) * PERIOD <= 0.15
    assert found.max() < 0.63


@PLANTS
def test_a_target_that_rises_and_falls_does_not_accumulate(hardness, lag, delay):
    """Corrections that are no longer needed are removed: after ten rises by 0.2 N the force is
    below the largest target plus 10 % of a step."""
    targets = np.concatenate([np.repeat([0.18, 0.3], 75), np.tile([0.5, 0.3], 10)])
    found = forces(Plant(hardness, lag, delay), targets)[150:]
    assert found.max() < 0.52
