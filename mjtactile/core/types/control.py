"""Input and output of a controller."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from numbers import Real
from types import MappingProxyType
from typing import Any, Literal, get_args

from mjtactile.core.errors import InputError
from mjtactile.core.signature_checks import validated
from mjtactile.core.types.devices import GripperState, ValveState
from mjtactile.core.types.touch import Touch

Phase = Literal[
    "approach", "close", "regulate", "lift", "hold", "lower", "release", "done", "abort"
]
PHASES: tuple[str, ...] = get_args(Phase)
MEMORY_MAX = 100_000
"""Entries of a controller's notebook, which is copied in every cycle."""


def _finite(value: Any, name: str) -> float:
    """Return a finite number of a Command. Raises InputError for any other."""
    with contextlib.suppress(ArithmeticError, TypeError, ValueError):
        if isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value):
            return float(value)
    raise InputError(f"{value!r} is not a finite number", source="Command", field=name)


@dataclass(frozen=True)
class Command:
    """Command of a controller. The rig limits it and returns the command that was sent.

    This is the contract of every gripper: simulated, emulated, real, replayed, or a test's
    (`tests/contract/test_command.py`). No number has a special meaning; "unchanged" is None.
    `Command` rejects non-finite values. `CommandLimits` of the rig then limit each goal to its
    range. They also limit its speed, starting from the previous command. The gripper further limits
    it to the range of its own devices.

    Attributes:
        opening: Goal of the gripper's opening, m; limited to `CommandLimits.opening` and
            `CommandLimits.speed`. 0: closed.
        force_limit: Maximum force of the servo on each finger, N, opening or closing. Limited to 0
            and `CommandLimits.force`. 0: no force, so that the gripper does not move. None: the
            current limit is kept. A gripper returns the limit in force, never None. Only a replay
            of a recording without it returns None.
        lift_height: Goal of the gripper's height above its start, m; limited to
            `CommandLimits.lift` and `CommandLimits.lift_speed`. 0: the start.
        phase: One of PHASES; "done" and "abort" end the run.
        memory: The controller's own state. The loop returns it in the next `Observation.command`.
            `step` can therefore be a pure function.
        reason: Reason for an abort or an early set-down, for the result and the log. Empty: none.
        gauge_pressure: Gauge pressure, Pa, in each finger's chamber, in their order. The valves
            then maintain it. Limited to `CommandLimits.pressure` and `CommandLimits.pressure_rate`.
            0: the pressure of the ambient air. None: the chambers stay sealed.
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
            raise InputError(f"{self.reason!r} is not text", source="Command", field="reason")
        if self.gauge_pressure is not None:
            given = self.gauge_pressure
            if not isinstance(given, Iterable) or isinstance(given, (str, bytes, Mapping)):
                text = f"{given!r} is not a pressure for each finger, Pa"
                raise InputError(text, source="Command", field="gauge_pressure")
            pressures = tuple(_finite(one, "gauge_pressure") for one in given)
            object.__setattr__(self, "gauge_pressure", pressures)
        if not isinstance(self.memory, Mapping):
            raise InputError(f"{self.memory!r} is not a mapping", source="Command", field="memory")
        if len(self.memory) > MEMORY_MAX:
            message = f"has {len(self.memory)} entries; at most {MEMORY_MAX} are allowed"
            raise InputError(message, source="Command", field="memory")
        object.__setattr__(self, "memory", MappingProxyType(dict(self.memory)))

    def checked(self) -> Command:
        """Check every value again, also for a subclass, or for values changed without the checks.

        Returns:
            A plain Command of the same values.

        Raises:
            InputError: A value is invalid.
        """
        return Command(*(getattr(self, field.name) for field in fields(Command)))

    def __reduce__(self):  # a mappingproxy does not pickle
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        return Command, tuple((values | {"memory": dict(self.memory)}).values())


@dataclass(frozen=True)
class TaskGoal:
    """Goal of a task for the robot.

    Attributes:
        lift_height: Lift height, m.
        hold_time: Hold time at that height, s.
        place_height: Height of the gripper above the grip height at which the object shall be set
            down, m; it may be negative.
        handover: True if a person will take the object out of the gripper.
        push: Maximum force of pushes by a person, from any side, N.
    """

    lift_height: float = 0.040
    hold_time: float = 2.0
    place_height: float = 0.0
    handover: bool = False
    push: float = 0.0


DEFAULT_GOAL = TaskGoal()


@validated()
@dataclass(frozen=True, eq=False)
class Observation:
    """Observation of a controller in one control cycle: only sensor data.

    Attributes:
        time: Time on the rig's clock, s.
        period: Time from one cycle to the next, s.
        touch: One value per finger, in the order of the rig (left, right).
        gripper: The gripper's newest state.
        valves: The valves' states, in the order of the fingers that have one.
        command: The last command that was sent, with the controller's `phase` and `memory`.
        goal: Goal of the task.
    """

    time: float
    period: float
    touch: tuple[Touch, ...]
    gripper: GripperState
    valves: tuple[ValveState, ...]
    command: Command
    goal: TaskGoal = DEFAULT_GOAL
