"""Grips of an object by two fingers at several heights, and the surface patches from them."""

from __future__ import annotations

import itertools
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
"""Standard deviation of the object displacement by a grip, m; common to both of its patches."""
HEIGHTS = (0.0, 6e-3, 12e-3, 18e-3)
"""Heights above the start of the gripper, m. At lower heights the sensors' frames would touch the
table."""
_CONTACT_FORCE = 0.08  # N
_RISE_SPEED = 0.040  # lift speed, m/s
_CLOSE_SPEED = 0.015
_PRESS_SPEED = 0.003
_OPEN_SPEED = 0.030
_CLEAR = 0.012  # opening beyond that of the grip, m
_STILL_TIME = 0.3  # hold time before the last image, s
_MIN_OPENING = 1e-3
_LIFTED = 1e-3  # gripper rise after which the object no longer stands at its original position, m
_TOO_STRONG = 1.5  # maximum force on one finger alone, as a multiple of the requested force
# axes of S in the gripper frame, for the first and the second finger: x along the closing, z up
_FACING = (
    np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
    np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]]),
)


@dataclass(frozen=True, eq=False)
class GripCycle:
    """One cycle of a grip: each finger's touch, opening between the frames, m, gripper height,
    m."""

    touch: tuple[Touch, ...]
    opening: float
    height: float


@dataclass(frozen=True)
class GripController:
    """Controller of a grip scan. At each of the `heights`, m, it closes until each finger measures
    `force` N. It holds, opens, and then lowers the gripper. A single finger is loaded with at most
    1.5 times this force."""

    heights: tuple[float, ...]
    force: float
    path: Path = Path("explore")

    def step(self, observation: Observation) -> Command:
        """Return the command of one control cycle."""
        command = replace(observation.command, force_limit=2 * self.force + 0.5)
        forces = [touch.force_normal for touch in observation.touch]
        period = observation.period
        if not all(math.isfinite(force) for force in forces):
            return command
        done = int(command.memory.get("done", 0))
        if command.phase == "approach" and command.lift_height != self.heights[done]:
            step = _RISE_SPEED * period
            change = max(-step, min(step, self.heights[done] - command.lift_height))
            return replace(command, lift_height=command.lift_height + change)
        if command.phase == "approach":
            return self._close(command, forces, period)
        since = command.memory.get("since", 0.0) + period
        command = replace(command, memory={**command.memory, "since": since})
        if command.phase == "hold":
            return command if since < _STILL_TIME else replace(command, phase="release")
        opening = min(command.opening + _OPEN_SPEED * period, command.memory["opened"])
        if opening < command.memory["opened"] or max(forces) > _CONTACT_FORCE:
            return replace(command, opening=opening)
        if done + 1 < len(self.heights):
            return replace(command, phase="approach", memory={"done": done + 1.0})
        lower = max(command.lift_height - _RISE_SPEED * period, 0.0)
        is_down = lower == 0 and observation.gripper.lift_height < 5e-4
        return replace(command, lift_height=lower, phase="done" if is_down else "release")

    def _close(self, command: Command, forces: Sequence[float], period: float) -> Command:
        reached = min(forces) >= self.force or max(forces) >= _TOO_STRONG * self.force
        if reached or command.opening <= _MIN_OPENING:
            opened = {"opened": command.opening + _CLEAR, "since": 0.0}
            memory = {**command.memory, **opened}
            return replace(command, phase="hold", memory=memory)
        speed = _PRESS_SPEED if max(forces) > _CONTACT_FORCE else _CLOSE_SPEED
        return replace(command, opening=command.opening - speed * period)


class Log(Observer):
    """Observer that keeps the cycles of a grip."""

    def __init__(self) -> None:
        self.cycles: list[GripCycle] = []

    def add(self, cycle: Cycle, view: object = None, **truth: object) -> None:
        """Add a cycle."""
        gripper = cycle.gripper
        self.cycles.append(GripCycle(cycle.touch, gripper.opening, gripper.lift_height))


def require_two(fingers: int) -> None:
    """Raise InputError unless the gripper has two fingers."""
    if fingers != 2:
        raise InputError(
            f"{fingers} fingers: only two that face each other are supported",
            source="explore",
            field="--rig",
        )


def grips_of(cycles: Sequence[GripCycle]) -> list[list[GripCycle]]:
    """Split a run into its grips with contact on both fingers. A grip lasts from the first contact
    to the last, while the gripper stays at its contact height."""
    grips: list[list[GripCycle]] = []
    now: list[GripCycle] = []
    for cycle in cycles:
        forces = [touch.force_normal for touch in cycle.touch]
        if max(forces, default=0.0) > _CONTACT_FORCE:
            now.append(cycle)
        elif all(math.isfinite(force) for force in forces):  # blind cycles end no grip
            grips.append(now)
            now = []
    grips.append(now)
    return [grip for grip in map(_before_lift, grips) if _strongest(grip) is not None]


def _before_lift(grip: list[GripCycle]) -> list[GripCycle]:
    return list(itertools.takewhile(lambda c: abs(c.height - grip[0].height) <= _LIFTED, grip))


def patches_of_grip(
    cycles: Sequence[GripCycle],
    perceptions: Sequence[Perceiver],
    designs: Sequence[SensorDesign],
    *,
    yaw: float = 0.0,
    group: int = 1,
) -> list[Patch]:
    """Compute the surface patches of one grip.

    Args:
        cycles: Cycles of the grip.
        perceptions: Sensing pipelines that estimated the touches.
        designs: Sensors of two opposite fingers.
        yaw: Rotation of the object about z relative to its own frame, rad.
        group: Group number of the grip; its patches have a common displacement.

    Returns:
        A patch for each finger in contact, in the object's frame. Its origin is the point between
        the fingers at the start of the gripper motion.

    Raises:
        InputError: The gripper has another number of fingers.
    """
    require_two(len(designs))
    end = _strongest(cycles)
    if end is None:
        return []
    c, s = math.cos(yaw), math.sin(yaw)
    R_GH = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    patches = []
    for finger, (perception, design) in enumerate(zip(perceptions, designs, strict=True)):
        contact = [c for c in cycles[: end + 1] if c.touch[finger].force_normal > _CONTACT_FORCE]
        if not contact or not isinstance(perception, StatefulPipeline):
            continue
        contact = contact[:: -max(len(contact) // 6, 1)][::-1]
        R_SG = _FACING[finger]
        away = (-1.0, 1.0)[finger] * 0.5
        origins = [
            R_SG @ (np.array([0.0, 0.0, -c.height]) - (away * c.opening, 0.0, 0.0)) for c in contact
        ]
        touches = tuple(c.touch[finger] for c in contact)
        shape = perception.shape(touches)
        patch = patch_from_press(Pressed(touches, R_SG @ R_GH, np.array(origins), shape), design)
        if patch is not None:
            patches.append(replace(patch, group=group, loose=LOOSE))
    return patches


def _strongest(cycles: Sequence[GripCycle]) -> int | None:
    """Return the last cycle near the maximum grip force; None without contact on both fingers."""
    minimum = np.array([min((t.force_normal for t in c.touch), default=0.0) for c in cycles])
    minimum = np.where(np.isfinite(minimum), minimum, 0.0)
    if not len(minimum) or minimum.max() < _CONTACT_FORCE:
        return None
    return int(np.flatnonzero(minimum > 0.9 * minimum.max())[-1])
