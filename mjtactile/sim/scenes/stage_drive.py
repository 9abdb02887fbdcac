"""`StageDrive`: the indenter of a `PressWorld` on a stage that follows a protocol's moves."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mjtactile.core.errors import InputError
from mjtactile.recording.stage_protocol import Move
from mjtactile.sim.scenes.indentation import PressWorld

LIFTED = -2e-3  # depth relative to first touch, m: no contact


def current(moves: Sequence[Move], time: float) -> int | None:
    """Return the index of the newest move that is due; None before the first."""
    return max((i for i, move in enumerate(moves) if move.time <= time + 1e-9), default=None)


class StageDrive:
    """Stage that executes moves on an inflated `world`, with `offset` m added to depths.

    Raises InputError for a move whose depth is defined by a force.
    """

    def __init__(self, world: PressWorld, moves: Sequence[Move], offset: float = 0.0):
        if any(move.is_weight for move in moves):
            raise InputError(
                "the simulated stage moves to depths; weights are for a real stage",
                field="depth_mm",
            )
        self._world = world
        self._moves = moves
        self._offset = offset
        self._depth = LIFTED
        self._shear = 0.0
        self._first = world.step_count
        self._now = 0.0

    def advance_to(self, time: float) -> None:
        """Step the world to `time` s after the start, towards the newest move's target."""
        end = self._first + round(time / self._world.timestep)
        number = current(self._moves, self._now)
        if number is not None:
            self._follow(self._moves[number], (end - self._world.step_count) * self._world.timestep)
        if self._world.step_count < end:
            self._world.step(end - self._world.step_count)
        self._now = time

    def _follow(self, move: Move, seconds: float) -> None:
        depth = LIFTED if math.isnan(move.depth) else move.depth + self._offset
        way = np.array([depth - self._depth, move.shear - self._shear])
        longest = float(np.abs(way).max())
        if longest > 0 and seconds > 0:
            part = min(1.0, move.speed * seconds / longest)
            self._depth = self._depth + part * way[0]
            self._shear = self._shear + part * way[1]
            self._world.drive(self._depth, self._shear, move.speed)
