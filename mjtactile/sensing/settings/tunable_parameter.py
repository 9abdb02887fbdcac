"""One number with what it is and where it comes from."""

from __future__ import annotations

from dataclasses import astuple, replace
from functools import lru_cache
from typing import Any

import numpy as np

from mjtactile.core.config_fields import entries, entry
from mjtactile.core.field_types import Number, Numbers
from mjtactile.core.toml import Section

TRIED = "tried: docs/reference/parameters.md has what half and twice of it do"
GAUGED = "tried: bench gauge (docs/reference/parameters.md has what half and twice of it do)"
SEEN = "tried: bench seen (docs/reference/parameters.md has what half and twice of it do)"
PRESSED = "tried: bench bodies (docs/reference/parameters.md has what half and twice of it do)"
_FACTOR = 100.0
_PLACES = ("first", "second", "third", "fourth")


def number(
    default: Any, meaning: str, source: str, *, low: float | None = None, high: float | None = None
) -> Any:
    """A field of a frozen settings class; a test asks every field for both texts.

    Args:
        default: A float, a whole number, or a tuple of them.
        meaning: Its unit, and what it does.
        source: What it was derived from or fitted with.
        low: Lowest value that `Settings.override` takes; left out: a hundredth of the default, or
            1 of something that is counted.
        high: Highest value; left out: a hundred times the default.

    Returns:
        What `dataclasses.field` returns.
    """
    values = default if isinstance(default, tuple) else (default,)
    whole = isinstance(values[0], int)
    sizes = [abs(value) for value in values]
    lowest = 1.0 if whole else min(sizes) / _FACTOR
    highest = _FACTOR * max(sizes)
    if values[0] < 0:
        lowest, highest = -highest, -lowest
    limits = {
        "key": "",
        "about": meaning,
        "low": lowest if low is None else low,
        "high": highest if high is None else high,
        "whole": whole,
    }
    found = Number(**limits)
    if isinstance(default, tuple):
        found = Numbers(**limits, names=_PLACES[: len(default)])
    return entry(found, default, more={"meaning": meaning, "source": source})


def check(settings: Any, stage: str, name: str, value: Any) -> Any:
    """A value for the field `name` of a settings class. Raises InputError for one of another kind
    or out of range."""
    found = replace(entries(type(settings))[name], key=name)
    table = {name: list(value) if isinstance(value, tuple) else value}
    return found.read(Section(table, stage, "settings"), ...)


@lru_cache(maxsize=64)
def as_numbers(settings: Any) -> np.ndarray:
    """A settings class of plain numbers as the kernels take it: one a field, in their order."""
    array = np.array(astuple(settings), float)
    array.flags.writeable = False
    return array
