"""Two fingers that squeeze an object, at one height after the other: what grips say of its
surface."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.types import Command, Observation, Touch
from mjtactile.explore.patch_from_touch import Pressed, patch_from_press
from mjtactile.explore.surface_patch import Patch
from mjtactile.recording.observer import Observer
from mjtactile.runtime.cycle import Cycle
from mjtactile.runtime.perception_threads import Perceiver
from mjtactile.sensing.stateful_pipeline import StatefulPipeline

LOOSE = 1e-3
"""m, sd: so far a grip may have pushed the object aside, both of its patches alike."""
HEIGHTS = (0.0, 6e-3, 12e-3, 18e-3)
"""m above where the hand begins: lower, the sensors' frames would meet the table."""
_SEEN = 0.08  # N
_RISE_SPEED = 0.040  # m/s
_CLOSE_SPEED = 0.015
_PRESS_SPEED = 0.003
_OPEN_SPEED = 0.030
_CLEAR = 0.012  # m to open beyond the grip
_STILL_TIME = 0.3  # s that the jaws stand before the last image
_MIN_OPENING = 1e-3  # m
_LIFTED = 1e-3  # m that a hand goes up with what it grips, which then is where it no longer stood
_TOO_STRONG = 1.5  # of the wanted force, on one finger alone
# of the first finger and of the second: axes of S in the hand's, x along the closing, z up
_FACING = (
    np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
    np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]]),
)


@dataclass(frozen=True, eq=False)
class GripCycle:
    """One cycle of a grip: each finger's touch, the opening m between the frames, the hand's
    height m."""

    touch: tuple[Touch, ...]
    opening: float
    height: float


@dataclass(frozen=True)
class GripController:
    """A controller: at each of the `heights` m, close until each finger feels `force` N, stand
    still, open; then down. One finger alone is pressed with half more at most."""

    heights: tuple[float, ...]
    force: float
    path: Path = Path("explore")

    def step(self, observation: Observation) -> Command:
        """One control cycle."""
        command = replace(observation.command, force_limit=2 * self.force + 0.5)
        felt = [touch.force_normal for touch in observation.touch]
        period = observation.period
        if not all(math.isfinite(one) for one in felt):
            return command
        done = int(command.memory.get("done", 0))
        if command.phase == "approach" and command.lift_height != self.heights[done]:
            height = _towards(command.lift_height, self.heights[done], _RISE_SPEED * period)
            return replace(command, lift_height=height)
        if command.phase == "approach":
            return self._close(command, felt, period)
        since = command.memory.get("since", 0.0) + period
        command = replace(command, memory={**command.memory, "since": since})
        if command.phase == "hold":
            return command if since < _STILL_TIME else replace(command, phase="release")
        opening = min(command.opening + _OPEN_SPEED * period, command.memory["opened"])
        if opening < command.memory["opened"] or max(felt) > _SEEN:
            return replace(command, opening=opening)
        if done + 1 < len(self.heights):
            return replace(command, phase="approach", memory={"done": done + 1.0})
        lower = max(command.lift_height - _RISE_SPEED * period, 0.0)
        is_down = lower == 0 and observation.gripper.lift_height < 5e-4
        return replace(command, lift_height=lower, phase="done" if is_down else "release")

    def _close(self, command: Command, felt: Sequence[float], period: float) -> Command:
        met = min(felt) >= self.force or max(felt) >= _TOO_STRONG * self.force
        if met or command.opening <= _MIN_OPENING:
            opened = {"opened": command.opening + _CLEAR, "since": 0.0}
            memory = {**command.memory, **opened}
            return replace(command, phase="hold", memory=memory)
        speed = _PRESS_SPEED if max(felt) > _SEEN else _CLOSE_SPEED
        return replace(command, opening=command.opening - speed * period)


def _towards(start: float, goal: float, most: float) -> float:
    return start + max(-most, min(most, goal - start))


class Log(Observer):
    """Keeps the moments of a grip."""

    def __init__(self) -> None:
        self.moments: list[GripCycle] = []

    def add(self, cycle: Cycle, view: object = None, **truth: object) -> None:
        """Take in a cycle."""
        gripper = cycle.gripper
        self.moments.append(GripCycle(cycle.touch, gripper.opening, gripper.lift_height))


def require_two(fingers: int) -> None:
    """Raise InputError for hands of another number of fingers."""
    if fingers != 2:
        raise InputError(
            f"{fingers} fingers: only two that face each other are understood",
            source="explore",
            field="--rig",
        )


def grips_of(moments: Sequence[GripCycle]) -> list[list[GripCycle]]:
    """Each grip of a run by itself: from the first finger that feels something to the last, as far
    as the hand stays where it met the object.

    Args:
        moments: The run's cycles.

    Returns:
        The cycles of each grip in which both fingers felt something.
    """
    grips: list[list[GripCycle]] = []
    now: list[GripCycle] = []
    for moment in moments:
        forces = [touch.force_normal for touch in moment.touch]
        if max(forces, default=0.0) > _SEEN:
            now.append(moment)
        elif all(math.isfinite(force) for force in forces):  # blind cycles end no grip
            grips.append(now)
            now = []
    grips.append(now)
    stood = [_before_it_was_lifted(grip) for grip in grips]
    return [grip for grip in stood if _strongest(grip) is not None]


def _before_it_was_lifted(grip: list[GripCycle]) -> list[GripCycle]:
    for number, moment in enumerate(grip):
        if abs(moment.height - grip[0].height) > _LIFTED:
            return grip[:number]
    return grip


def patches_of_grip(
    moments: Sequence[GripCycle],
    perceptions: Sequence[Perceiver],
    designs: Sequence[SensorDesign],
    *,
    yaw: float = 0.0,
    group: int = 1,
) -> list[Patch]:
    """What one grip says of the surface.

    Args:
        moments: Its cycles.
        perceptions: The chains that felt it.
        designs: The fingers' sensors: two that face each other.
        yaw: rad by which the object was turned about z against its own frame.
        group: Of the grip: what both patches have in common is known to be so.

    Returns:
        A patch for each finger that felt something, in the object's frame: its origin is the place
        between the fingers, where the hand began.

    Raises:
        InputError: For hands of another number of fingers.
    """
    require_two(len(designs))
    end = _strongest(moments)
    if end is None:
        return []
    c, s = math.cos(yaw), math.sin(yaw)
    R_GH = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    patches = []
    for finger, (perception, design) in enumerate(zip(perceptions, designs, strict=True)):
        felt = [
            moment
            for moment in moments[: end + 1]
            if (force := moment.touch[finger].force_normal) == force and force > _SEEN
        ]
        if not felt or not isinstance(perception, StatefulPipeline):
            continue
        felt = felt[-1 : -1 - len(felt) : -max(len(felt) // 6, 1)][::-1]
        R_SG = _FACING[finger]
        away = (-1.0, 1.0)[finger] * 0.5
        places = [
            R_SG @ (np.array([0.0, 0.0, -one.height]) - (away * one.opening, 0.0, 0.0))
            for one in felt
        ]
        touches = tuple(one.touch[finger] for one in felt)
        shape = perception.shape(touches)
        patch = patch_from_press(Pressed(touches, R_SG @ R_GH, np.array(places), shape), design)
        if patch is not None:
            patches.append(replace(patch, group=group, loose=LOOSE))
    return patches


def _strongest(moments: Sequence[GripCycle]) -> int | None:
    """The last moment of the firmest part of a grip; None where not both fingers felt something."""
    least = np.array([min((t.force_normal for t in m.touch), default=0.0) for m in moments])
    least = np.where(np.isfinite(least), least, 0.0)
    if not len(least) or least.max() < _SEEN:
        return None
    return int(np.flatnonzero(least > 0.9 * least.max())[-1])
