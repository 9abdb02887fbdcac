"""`oracle`: `adaptive` with the truth in place of what it learns. It knows what holding takes, now
and half a second ahead, and what happens next; its hands, its jaws and its cameras are the others'.

What it cannot hold no sensing could: the draw of the task is too hard, or the simulation at fault.
What it holds and `adaptive` does not is what sensing and learning still cost.
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

MARGIN = 1.25  # grip over what holding takes: what the jaws miss their target by
AHEAD = 0.5  # s: what the jaws need to follow
PULL_ESTIMATE = (
    0.5  # N, of who takes it: what is held with less is torn out before the pull is felt
)
_LOOKS = 26
_LEAST = 0.15  # N: less is not regulated
_MAX_LEVER = 3.0  # of a torque about the grip, in the need


def step(observation: Observation) -> Command:
    """What a controller's file has; this one needs a simulated world."""
    raise RuntimeError("the oracle runs in `mjtactile bench tasks` alone: it looks at the truth")


class Oracle(Observer):
    """A controller and, as an observer, the one who looks at the truth for it."""

    path = Path(__file__)
    sees = False

    def __init__(self, scenario: Scenario):
        own = load_controller("adaptive")
        self._adaptive = own
        # what it learns is what it is told here
        module: Any = sys.modules[own.function.__module__]
        module.grip_as_needed = lambda observation, command: command
        self._scenario = scenario
        self._judge: TaskScorer | None = None
        self._drawn: SampledTask | None = None
        self._up_since = math.nan
        self._lever = 1.0
        self.need = 0.0

    def begin(self, session: Any) -> None:
        """Take hold of the truth."""
        self._judge = TaskScorer.of(self._scenario, session.rig)
        fingers = len(session.rig.fingers)
        self._drawn = load_task(self._scenario.task).draw(self._scenario.seed, fingers)

    def on_images(self) -> None:
        """Look at the world while it stands."""
        judge = self._judge
        if judge is None:
            return
        if math.isnan(self._up_since) and judge.is_up():
            self._up_since = judge.world.time
        time = -1.0 if math.isnan(self._up_since) else judge.world.time - self._up_since
        now = judge.need()
        plain = self._plain(time, time)
        if judge.in_the_air() and plain > 0 and now > 0:
            self._lever = min(max(now / plain, 1.0), _MAX_LEVER)
        moments = np.linspace(time, time + AHEAD, _LOOKS)
        ahead = max(self._plain(moment, time) for moment in moments)
        self.need = max(now, ahead * self._lever)

    def step(self, observation: Observation) -> Command:
        """What `adaptive` does, with this grip."""
        command = observation.command
        target = max(_LEAST, MARGIN * self.need)
        command = replace(command, memory={**command.memory, "target": target})
        return self._adaptive.step(replace(observation, command=command))

    def _plain(self, time: float, now: float) -> float:
        """N on each finger, for a grip at the centre of mass, `time` s after the hand was up, seen
        `now` s after it."""
        judge = self._judge
        drawn = self._drawn
        if judge is None or drawn is None:
            return 0.0
        bodies = ground_truth.object_bodies(judge.world)
        mass = float(judge.world.model.body_mass[bodies].sum())
        pull = GRAVITY
        push = 0.0
        for event in drawn.events:
            done = (time - event.begin) / event.last
            if event.kind == "fill" and 0 < done < 1:
                since = max(now, event.begin)
                still = (time - since) / (event.begin + event.last - since)
                mass += (event.values["mass"] - mass) * still
            elif event.kind == "fill" and done >= 1:
                mass = event.values["mass"]
            elif event.kind == "shake" and 0 < done < 1:
                pull += event.values["acceleration"]
            elif event.kind == "push" and 0 < done < 1:
                push = max(push, event.values["impulse"] / event.last)
            elif event.kind == "pull" and done > 0:
                push = max(push, PULL_ESTIMATE)
        return (mass * pull + push) / judge.friction_sum()
