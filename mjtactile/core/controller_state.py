"""Serializable part of a controller's memory (`Command.memory`).

It is for recordings and other processes. It holds numbers, strings, and lists and tables of them,
within size limits.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

# maximum count of numbers and letters in a cycle's line, which is then some 100 kB long
ENTRIES_MAX = 10_000
DEEPEST = 16  # lists within lists; a list that contains itself is deeper
_LARGEST = 2**63  # limit of integers in JSON readers
_NAMED_MAX = 20  # maximum number of omitted entries that are named


class _NotSerializable(Exception):
    """The value has another type, or exceeds the size limit."""


_NUMBERS = frozenset({float, bool, type(None)})
"""Types copied unchanged, without further checks. They make up the majority of a memory."""


class _SizeBudget:
    """Remaining count of numbers and letters."""

    def __init__(self, left: int):
        self.left = left

    def has(self, count: int) -> None:
        if count > self.left:
            raise _NotSerializable

    def spend(self, count: int) -> None:
        if count > self.left:
            raise _NotSerializable
        self.left -= count


def plain(memory: Mapping[Any, Any]) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Copy the serializable entries of a controller's memory, at most `ENTRIES_MAX` in total.

    These are numbers, strings, None, and lists, arrays and tables of them. Also return the names of
    the other entries with their types.
    """
    kept: dict[str, Any] = {}
    left_out: list[str] = []
    budget = _SizeBudget(ENTRIES_MAX)
    for key, value in memory.items():
        before = budget.left
        try:
            name = _name(key, budget)
            kept[name] = _copy(value, budget, 0)
        except Exception:  # noqa: BLE001  # the object's own methods may raise anything
            budget.left = before
            name = key[:40] if isinstance(key, str) else "an entry"
            left_out.append(f"{name} ({type(value).__name__})")
            if len(left_out) == _NAMED_MAX:
                break
    return kept, tuple(left_out)


def _name(key: object, budget: _SizeBudget) -> str:
    if not isinstance(key, (str, int)):
        raise _NotSerializable
    name = str(key)
    budget.spend(len(name))
    return name


def _copy(value: Any, budget: _SizeBudget, depth: int) -> Any:
    """Return a copy of plain Python types. Raises _NotSerializable."""
    if type(value) in _NUMBERS:  # first: the other type checks take five times as long
        budget.spend(1)
        return value
    if depth > DEEPEST:
        raise _NotSerializable
    if isinstance(value, (np.generic, np.ndarray)):
        budget.has(value.size)
        value = value.tolist()
    if isinstance(value, (dict, Mapping)):  # dict first: the check for it is faster
        budget.has(len(value))
        return {_name(key, budget): _copy(item, budget, depth + 1) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        budget.has(len(value))
        return [_copy(item, budget, depth + 1) for item in value]
    return _plain_scalar(value, budget)


def _plain_scalar(value: Any, budget: _SizeBudget) -> Any:
    """Return a number or string as a plain type. An Enum loses its type, which other processes
    lack."""
    budget.spend(1 + len(value) if isinstance(value, str) else 1)
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, int) and abs(value) < _LARGEST:
        return int(value)
    if isinstance(value, float):
        return float(value)
    if isinstance(value, str):
        return "".join(value)
    raise _NotSerializable
