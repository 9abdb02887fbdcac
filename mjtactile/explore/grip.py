"""Two fingers that squeeze an object: what a grip says of its surface, live or from a recording."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mjtactile.core.calibration import pressure_reading
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.scenario import Scenario
from mjtactile.core.types import Command, Observation, Touch
from mjtactile.explore.felt import Pressed, patch_of
from mjtactile.explore.patch import Patch
from mjtactile.recording.observer import Observer
from mjtactile.recording.reader import Recording
from mjtactile.rig.registry import build_rig
from mjtactile.run.cycle import Cycle
from mjtactile.run.perceive import Perceiver
from mjtactile.run.session import Session
from mjtactile.sensing.perception import Perception

LOOSE = 1e-3
"""m, sd: so far a grip may have pushed the object aside, both of its patches alike."""
_SEEN = 0.08  # N
_RISE_SPEED = 0.040  # m/s
_CLOSE_SPEED = 0.015
_PRESS_SPEED = 0.003
_OPEN_SPEED = 0.030
_CLEAR = 0.012  # m to open beyond the grip
_STILL_TIME = 0.3  # s that the jaws stand before the last image
_LEAST_OPENING = 1e-3  # m
_TOO_STRONG = 1.5  # of the wanted force, on one finger alone
# of the first finger and of the second: axes of S in the hand's, x along the closing, z up
_FACING = (
    np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
    np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]]),
)


@dataclass(frozen=True, eq=False)
class Moment:
    """One cycle of a grip: each finger's touch, the opening m between the frames, the hand's
    height m."""

    touch: tuple[Touch, ...]
    opening: float
    height: float


@dataclass(frozen=True)
class Squeeze:
    """A controller: up to `height` m, close until each finger feels `force` N, stand still, open,
    down. One finger alone is pressed with half more at most."""

    height: float
    force: float
    path: Path = Path("explore")

    def step(self, observation: Observation) -> Command:
        """One control cycle."""
        command = replace(observation.command, force_limit=2 * self.force + 0.5)
        felt = [touch.force_normal for touch in observation.touch]
        period = observation.period
        if not all(math.isfinite(one) for one in felt):
            return command
        if command.phase == "approach" and command.lift_height < self.height:
            higher = min(command.lift_height + _RISE_SPEED * period, self.height)
            return replace(command, lift_height=higher)
        if command.phase == "approach":
            return self._close(command, felt, period)
        since = command.memory.get("since", 0.0) + period
        command = replace(command, memory={**command.memory, "since": since})
        if command.phase == "hold":
            return command if since < _STILL_TIME else replace(command, phase="release")
        opening = min(command.opening + _OPEN_SPEED * period, command.memory["opened"])
        if opening < command.memory["opened"] or max(felt) > _SEEN:
            return replace(command, opening=opening)
        lower = max(command.lift_height - _RISE_SPEED * period, 0.0)
        is_down = lower == 0 and observation.gripper.lift_height < 5e-4
        return replace(command, lift_height=lower, phase="done" if is_down else "release")

    def _close(self, command: Command, felt: Sequence[float], period: float) -> Command:
        met = min(felt) >= self.force or max(felt) >= _TOO_STRONG * self.force
        if met or command.opening <= _LEAST_OPENING:
            memory = {"opened": command.opening + _CLEAR, "since": 0.0}
            return replace(command, phase="hold", memory=memory)
        speed = _PRESS_SPEED if max(felt) > _SEEN else _CLOSE_SPEED
        return replace(command, opening=command.opening - speed * period)


class Log(Observer):
    """Keeps the moments of a grip."""

    def __init__(self) -> None:
        self.moments: list[Moment] = []

    def add(self, cycle: Cycle, view: object = None, **truth: object) -> None:
        """Take in a cycle."""
        gripper = cycle.gripper
        self.moments.append(Moment(cycle.touch, gripper.opening, gripper.lift_height))


def patches_of_grip(
    moments: Sequence[Moment],
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
    if len(designs) != 2:
        raise InputError(
            f"{len(designs)} fingers: only two that face each other are understood",
            source="explore",
            field="rig",
        )
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
        if not felt or not isinstance(perception, Perception):
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
        patch = patch_of(Pressed(touches, R_SG @ R_GH, np.array(places), shape), design)
        if patch is not None:
            patches.append(replace(patch, group=group, loose=LOOSE))
    return patches


def _strongest(moments: Sequence[Moment]) -> int | None:
    """The last moment of the firmest part of a grip; None where not both fingers felt something."""
    least = np.array([min((t.force_normal for t in m.touch), default=0.0) for m in moments])
    least = np.where(np.isfinite(least), least, 0.0)
    if not len(least) or least.max() < _SEEN:
        return None
    return int(np.flatnonzero(least > 0.9 * least.max())[-1])


def patches_of_recording(recording: Recording, group: int, yaw: float = 0.0) -> list[Patch]:
    """What a recorded grip (`mjtactile probe` or `grasp --out`, a rig that was recorded) says of
    the surface.

    Args:
        recording: With its images and its references.
        group: A number that no other grip has.
        yaw: rad by which the object was turned against the first one.

    Returns:
        A patch for each finger.

    Raises:
        InputError: Where images or references are missing, or it is no grip.
    """
    recording.require_images()
    stages = {reference.stage for reference in recording.references}
    if not {"flat", "rest"} <= stages or "opening" not in recording.columns:
        raise InputError(
            "is no grip with reference images (flat and rest)", source=recording.folder
        )
    rig = build_rig(
        Scenario(
            rig=f"replay:{recording.folder}", sensor=str(recording.header.get("sensor", "dense"))
        )
    )
    session = Session(rig)
    session.take_references()
    moments = []
    for cycle, images in enumerate(recording.images()):
        now = float(recording.column("time")[cycle, 0])
        readings = [pressure_reading(valve) for valve in recording.valves(cycle)]
        readings += [None] * (len(images) - len(readings))
        touch = tuple(
            chain.perceive(image, now, reading)
            for chain, image, reading in zip(session.perceptions, images, readings, strict=True)
        )
        opening, height = (
            float(recording.column(name)[cycle, 0]) for name in ("opening", "lift_height")
        )
        moments.append(Moment(touch, opening, height))
    designs = [finger.design for finger in rig.fingers]
    return patches_of_grip(moments, session.perceptions, designs, yaw=yaw, group=group)
