"""`oracle`: the controller `adaptive` with ground truth in place of its estimates.

It receives the required grip force, now and half a second ahead, and all coming events. Gripper,
jaws and cameras are those of the other controllers.

If it cannot hold an object, no sensing could. The sampled task is then too hard, or the simulation
is at fault. Objects that it holds and `adaptive` does not show the remaining cost of sensing and
estimation.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core.scenario import Scenario
from mjtactile.core.task import GRAVITY, SampledTask, load_task
from mjtactile.core.types import Command, Observation
from mjtactile.recording.observer import Observer
from mjtactile.runtime.controller import load_controller
from mjtactile.runtime.task_scoring import TaskScorer
from mjtactile.sim import ground_truth

MARGIN = 1.25  # ratio of grip to required force: covers the control error of the jaws
AHEAD = 0.5  # prediction time, s: reaction time of the jaws
PULL_ESTIMATE = (
    # pull of a person in a handover, N: a weaker grip loses the object before the pull is detected
    0.5
)
_MOMENTS = 26
_FORCE_MIN = 0.15  # minimum grip force that can be regulated, N
_MAX_LEVER = 3.0  # maximum factor of a torque about the grip on the required force


def step(observation: Observation) -> Command:
    """Raise an error: a controller file needs `step`, but this one needs a simulated world."""
    raise RuntimeError("the oracle runs in `mjtactile bench tasks` alone: it reads ground truth")


class Oracle(Observer):
    """A controller that, as an observer, also reads the ground truth."""

    path = Path(__file__)
    sees = False

    def __init__(self, scenario: Scenario):
        own = load_controller("adaptive")
        self._adaptive = own
        # the oracle's values replace its estimates
        module: Any = sys.modules[own.function.__module__]
        module.grip_as_needed = lambda observation, command, forces: command
        self._scenario = scenario
        self._scorer: TaskScorer | None = None
        self._sampled: SampledTask | None = None
        self._up_since = math.nan
        self._lever = 1.0
        self.need = 0.0

    def start(self, session: Any) -> None:
        """Store the simulated world of the session."""
        self._scorer = TaskScorer.of(self._scenario, session.rig)
        fingers = len(session.rig.fingers)
        self._sampled = load_task(self._scenario.task).sample(self._scenario.seed, fingers)

    def on_images(self) -> None:
        """Read the ground truth while the simulation waits."""
        scorer = self._scorer
        if scorer is None:
            return
        if math.isnan(self._up_since) and scorer.is_up():
            self._up_since = scorer.world.time
        time = -1.0 if math.isnan(self._up_since) else scorer.world.time - self._up_since
        now = scorer.need()
        plain = self._plain(time, time)
        if scorer.in_the_air() and plain > 0 and now > 0:
            self._lever = min(max(now / plain, 1.0), _MAX_LEVER)
        moments = np.linspace(time, time + AHEAD, _MOMENTS)
        ahead = max(self._plain(moment, time) for moment in moments)
        self.need = max(now, ahead * self._lever)

    def step(self, observation: Observation) -> Command:
        """Return the command of `adaptive` with the oracle's grip force."""
        command = observation.command
        target = max(_FORCE_MIN, MARGIN * self.need)
        command = replace(command, memory={**command.memory, "target": target})
        return self._adaptive.step(replace(observation, command=command))

    def _plain(self, time: float, now: float) -> float:
        """Return the required force on each finger, N, for a grip at the center of mass.

        It holds at `time`, s after the lift, as predicted at `now`, s.
        """
        scorer = self._scorer
        sampled = self._sampled
        if scorer is None or sampled is None:
            return 0.0
        bodies = ground_truth.object_bodies(scorer.world)
        mass = float(scorer.world.model.body_mass[bodies].sum())
        pull = _pull_on(sampled, time)
        push = 0.0
        for event in sampled.events:
            done = (time - event.start) / event.duration
            if event.kind == "fill" and 0 < done < 1:
                since = max(now, event.start)
                still = (time - since) / (event.start + event.duration - since)
                mass += (event.values["mass"] - mass) * still
            elif event.kind == "fill" and done >= 1:
                mass = event.values["mass"]
            elif event.kind == "stack":
                mass += event.values["added_mass"] * min(max(done, 0.0), 1.0)
            elif event.kind == "shake" and 0 < done < 1:
                pull += event.values["acceleration"]
            elif event.kind == "push" and 0 < done < 1:
                push = max(push, event.values["impulse"] / event.duration)
            elif event.kind == "pull" and done > 0:
                push = max(push, PULL_ESTIMATE)
        return (mass * pull + push) / self._friction_ahead(scorer, sampled, time, now)

    def _friction_ahead(
        self, scorer: TaskScorer, sampled: SampledTask, time: float, now: float
    ) -> float:
        """Return the sum of the fingers' friction coefficients at `time`, as predicted at `now`."""
        friction = scorer.friction_sum()
        for event in sampled.events:
            if event.kind != "friction" or event.finger is not None:
                continue
            final = event.values["friction"] * len(scorer.world.sensors)
            passed, done = (
                min(max((moment - event.start) / event.duration, 0.0), 1.0)
                for moment in (now, time)
            )
            friction += (final - friction) * (done - passed) / max(1.0 - passed, 1e-9)
        return friction


def _pull_on(sampled: SampledTask, time: float) -> float:
    """Return weight and inertia on the path over the mass, m/s^2."""
    if sampled.path is None or time <= 0:
        return GRAVITY
    x, y, z = sampled.path.acceleration(time)
    return math.hypot(x, y, GRAVITY + z)
