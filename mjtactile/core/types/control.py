"""What a controller sees, and what it asks for."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from numbers import Real
from types import MappingProxyType
from typing import Any, Literal, get_args

from mjtactile.core.errors import InputError
from mjtactile.core.types.devices import GripperState, ValveState
from mjtactile.core.types.touch import Touch

Phase = Literal[
    "approach", "close", "regulate", "lift", "hold", "lower", "release", "done", "abort"
]
PHASES: tuple[str, ...] = get_args(Phase)
MEMORY_MAX = 100_000
"""Entries of a controller's notebook, which is copied in every cycle."""


def _finite(value: Any, name: str) -> float:
    """A number of a Command. Raises InputError."""
    with contextlib.suppress(ArithmeticError, TypeError, ValueError):
        if isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value):
            return float(value)
    raise InputError(f"{value!r} is not a finite number", source="Command", field=name)


@dataclass(frozen=True)
class Command:
    """What a controller asks for. The rig limits it and returns what was really sent.

    This is the contract of every gripper: simulated, emulated, real, replayed, or a test's
    (`tests/contract/test_command.py`). No number stands for anything but itself; "unchanged" is
    None. `Command` refuses what is not finite. `CommandLimits` of the rig then cut each goal to its
    range and to the rig's speed, starting from the command before, and the gripper cuts it once
    more to what its own devices can do.

    Attributes:
        opening: m, the gripper's goal; cut to `CommandLimits.opening` and `CommandLimits.speed`. 0:
            closed.
        force_limit: N, the most that the servo may push each finger with, opening or closing; cut
            to 0 and `CommandLimits.force`. 0: it pushes with nothing at all, and so moves nothing.
            None: the limit that is in force stays. What a gripper returns has the limit in force,
            never None; only a replay of a recording that does not say it returns None.
        lift_height: m of the hand above where it started, its goal; cut to `CommandLimits.lift` and
            `CommandLimits.lift_speed`. 0: where it started.
        phase: One of PHASES; "done" and "abort" end the run.
        memory: The controller's own notebook: the loop hands it back in the next
            `Observation.command`, so that `step` can be a pure function.
        reason: Why the controller gives up, or sets down early; for the result and the log. Empty:
            it does neither.
        gauge_pressure: Pa above ambient in each finger's chamber, in their order, which the valves
            then keep; cut to `CommandLimits.pressure` and `CommandLimits.pressure_rate`. 0: the
            ambient air's.
            None: leave the air alone, sealed in.
    """

    opening: float
    force_limit: float | None
    lift_height: float = 0.0
    phase: str = "approach"
    memory: Mapping[str, float] = field(default_factory=dict)
    reason: str = ""
    gauge_pressure: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        for name in ("opening", "force_limit", "lift_height"):
            value = getattr(self, name)
            if value is None and name == "force_limit":
                continue
            if type(value) is not float or not math.isfinite(value):
                object.__setattr__(self, name, _finite(value, name))
        if not isinstance(self.phase, str) or self.phase not in PHASES:
            raise InputError(
                f"{self.phase!r} is not a phase", source="Command", field="phase", choices=PHASES
            )
        if not isinstance(self.reason, str):
            raise InputError(f"{self.reason!r} is no text", source="Command", field="reason")
        if self.gauge_pressure is not None:
            pressures = tuple(_finite(one, "gauge_pressure") for one in self.gauge_pressure)
            object.__setattr__(self, "gauge_pressure", pressures)
        if len(self.memory) > MEMORY_MAX:
            raise InputError(
                f"has {len(self.memory)} entries, and {MEMORY_MAX} at most",
                source="Command",
                field="memory",
            )
        object.__setattr__(self, "memory", MappingProxyType(dict(self.memory)))

    def checked(self) -> Command:
        """Check every value again, also of a subclass, or what was changed past the checks.

        Returns:
            A plain Command of the same values.

        Raises:
            InputError: A value is not what it must be.
        """
        return Command(
            self.opening,
            self.force_limit,
            self.lift_height,
            self.phase,
            self.memory,
            self.reason,
            self.gauge_pressure,
        )

    def __reduce__(self):  # a mappingproxy does not pickle
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        return Command, tuple((values | {"memory": dict(self.memory)}).values())


@dataclass(frozen=True)
class TaskGoal:
    """What a task asks of the robot.

    Attributes:
        lift_height: m, how high it shall lift.
        hold_time: s, how long it shall hold there.
        place_height: m of the hand over where it gripped, where the thing shall be set down; the
            place may be higher or lower than that.
        handover: Whether somebody will take the thing out of the hand.
        push: N, as hard as somebody may push it, from any side.
    """

    lift_height: float = 0.040
    hold_time: float = 2.0
    place_height: float = 0.0
    handover: bool = False
    push: float = 0.0


DEFAULT_GOAL = TaskGoal()


@dataclass(frozen=True, eq=False)
class Observation:
    """What a controller sees once a control cycle: only what the sensors say.

    Attributes:
        time: s on the rig's clock.
        period: s from one cycle to the next.
        touch: One value a finger, in the order of the rig (left, right).
        gripper: The gripper's newest state.
        valves: The valves' states, in the order of the fingers that have one.
        command: The last command really sent, with the `phase` and `memory` that the controller put
            into it.
        told: What the task asks for.
    """

    time: float
    period: float
    touch: tuple[Touch, ...]
    gripper: GripperState
    valves: tuple[ValveState, ...]
    command: Command
    told: TaskGoal = DEFAULT_GOAL
