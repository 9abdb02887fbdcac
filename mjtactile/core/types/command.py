"""`Command`, and the contract of each of its fields.

The metadata of a field has its unit, meaning, column in recordings, and the names of its limits.
`COMMAND_FIELDS` collects them. Columns of the log and their validation, reading of recordings,
limits, messages for ROS and the table on the page of controllers are generated from it.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from numbers import Real
from types import MappingProxyType
from typing import Any, Literal, get_args

from mjtactile.core.errors import InputError

Phase = Literal[
    "approach", "close", "regulate", "lift", "hold", "lower", "release", "done", "abort"
]
PHASES: tuple[str, ...] = get_args(Phase)
MEMORY_MAX = 100_000
"""Entries of a controller's memory, which is copied in every cycle."""
# Maximum pressure change between two images, Pa (the sensing pipeline treats 60 as a valve jump)
PRESSURE_STEP = 45.0
UNCHANGED = "unchanged"
Kind = Literal["number", "numbers", "text", "phase", "table"]
_CONTRACT = "contract"


def _number(value: Any, name: str) -> float:
    """Return a finite number of a Command. Raises InputError for any other."""
    if type(value) is float and math.isfinite(value):
        return value
    with contextlib.suppress(ArithmeticError, TypeError, ValueError):
        if isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value):
            return float(value)
    raise InputError(f"{value!r} is not a finite number", source="Command", field=name)


def _numbers(value: Any, name: str) -> tuple[float, ...]:
    if not isinstance(value, Iterable) or isinstance(value, (str, bytes, Mapping)):
        raise InputError(
            f"{value!r} is not a pressure for each finger, Pa", source="Command", field=name
        )
    return tuple(_number(item, name) for item in value)


def _text(value: Any, name: str) -> str:
    if isinstance(value, str):
        return value
    raise InputError(f"{value!r} is not text", source="Command", field=name)


def _phase(value: Any, name: str) -> str:
    if isinstance(value, str) and value in PHASES:
        return value
    raise InputError(f"{value!r} is not a phase", source="Command", field=name, choices=PHASES)


def _table(value: Any, name: str) -> Mapping[str, float]:
    if not isinstance(value, Mapping):
        raise InputError(f"{value!r} is not a mapping", source="Command", field=name)
    if len(value) > MEMORY_MAX:
        message = f"has {len(value)} entries; at most {MEMORY_MAX} are allowed"
        raise InputError(message, source="Command", field=name)
    return MappingProxyType(dict(value))


_CHECKS: Mapping[Kind, Callable[[Any, str], Any]] = {
    "number": _number,
    "numbers": _numbers,
    "text": _text,
    "phase": _phase,
    "table": _table,
}
"""Functions that return the checked value of a field, or raise InputError."""


@dataclass(frozen=True, kw_only=True)
class CommandField:
    """Contract of one field of `Command`.

    Attributes:
        column: Column of recordings.
        about: Meaning, for the pages.
        unit: SI unit; empty for text and tables.
        kind: Kind of its values; `numbers` has one per finger.
        none: Meaning of None. Empty: None is rejected. `UNCHANGED`: the gripper keeps its value.
        limit: Attribute of `CommandLimits` with the range, or with the maximum of a range from 0.
            Empty: the controller's value is sent as it is.
        rate: Attribute of `CommandLimits` with the maximum rate per second. Empty: no such limit.
        step_max: Maximum change per control cycle.
    """

    column: str
    about: str
    unit: str = ""
    kind: Kind = "number"
    none: str = ""
    limit: str = ""
    rate: str = ""
    step_max: float = math.inf

    def read(self, value: Any) -> Any:
        """Return the field's value for that of a recording, where null or NaN is None."""
        if self.kind == "numbers":
            return None if any(map(_is_unknown, value)) else tuple(map(float, value))
        if self.kind == "number":
            return None if _is_unknown(value) else float(value)
        return value if self.kind == "table" else str(value)

    def write(self, value: Any, fingers: int) -> Any:
        """Return the value for a recording: NaN for None, one number per finger in lists."""
        if self.kind == "table":
            return dict(value)
        if value is None:
            return [math.nan] * fingers if self.kind == "numbers" else math.nan
        return value


def _is_unknown(value: Any) -> bool:
    return value is None or value != value


def _contract(**values: Any) -> dict[str, CommandField]:
    return {_CONTRACT: CommandField(**values)}


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

    opening: float = field(
        metadata=_contract(
            column="command_opening",
            unit="m",
            about="goal of the opening; 0: closed",
            limit="opening",
            rate="speed",
        )
    )
    force_limit: float | None = field(
        metadata=_contract(
            column="command_force_limit",
            unit="N",
            about="maximum servo force on each finger; 0: no force",
            none=UNCHANGED,
            limit="force",
        )
    )
    lift_height: float = field(
        default=0.0,
        metadata=_contract(
            column="command_lift_height",
            unit="m",
            about="goal of the gripper's height above its start",
            limit="lift",
            rate="lift_speed",
        ),
    )
    phase: str = field(
        default="approach",
        metadata=_contract(
            column="phase",
            about='approach, close, regulate, lift, hold, lower, release; "done" and '
            '"abort" end the run',
            kind="phase",
        ),
    )
    memory: Mapping[str, float] = field(
        default_factory=dict,
        metadata=_contract(
            column="memory", about="state of the controller for its next call", kind="table"
        ),
    )
    reason: str = field(
        default="",
        metadata=_contract(
            column="command_reason",
            about="reason of an abort, for result, log and report",
            kind="text",
        ),
    )
    gauge_pressure: tuple[float, ...] | None = field(
        default=None,
        metadata=_contract(
            column="command_pressure",
            unit="Pa",
            about="goal of the gauge pressure in each finger's chamber",
            kind="numbers",
            none="sealed chambers",
            limit="pressure",
            rate="pressure_rate",
            step_max=PRESSURE_STEP,
        ),
    )

    def __post_init__(self) -> None:
        for name, entry in COMMAND_FIELDS.items():
            value = getattr(self, name)
            if value is None and entry.none:
                continue
            checked = _CHECKS[entry.kind](value, name)
            if checked is not value:
                object.__setattr__(self, name, checked)

    def completed(self, last: Command) -> Command:
        """Replace each None that means "unchanged" by the value in force.

        Args:
            last: Previous command that was sent.

        Returns:
            This command, with the values of `last` in their place.
        """
        kept = {
            name: getattr(last, name)
            for name, entry in COMMAND_FIELDS.items()
            if entry.none == UNCHANGED and getattr(self, name) is None
        }
        return Command(**(self._values() | kept)) if kept else self

    def checked(self) -> Command:
        """Check every value again, also for a subclass, or for values changed without the checks.

        Returns:
            A plain Command of the same values.

        Raises:
            InputError: A value is invalid.
        """
        return Command(**self._values())

    def _values(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in COMMAND_FIELDS}

    def __reduce__(self):  # a mappingproxy does not pickle
        return Command, tuple((self._values() | {"memory": dict(self.memory)}).values())


COMMAND_FIELDS: Mapping[str, CommandField] = {
    field.name: field.metadata[_CONTRACT] for field in fields(Command)
}
"""Contract of each field of `Command`, in their order."""


def command_table() -> str:
    """Return the fields of `Command` as a table in Markdown."""
    lines = ["| field | unit | content | `None` | limits of the rig |", "|---" * 5 + "|"]
    for name, entry in COMMAND_FIELDS.items():
        limits = ", ".join(f"`{limit}`" for limit in (entry.limit, entry.rate) if limit)
        cells = (f"`{name}`", entry.unit, entry.about, entry.none, limits)
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"
