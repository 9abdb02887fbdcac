"""Definition of one tunable parameter with its meaning and source."""

from __future__ import annotations

from dataclasses import astuple, replace
from functools import lru_cache
from typing import Any

import numpy as np

from mjtactile.core.config_fields import entries, entry
from mjtactile.core.field_types import Number, Numbers
from mjtactile.core.toml import Section

TRIED = "tuned; sensitivity: docs/reference/parameters.md"
GAUGED = "tuned; sensitivity: bench gas-filter-sensitivity, docs/reference/parameters.md"
SEEN = "tuned; sensitivity: bench detection-sensitivity, docs/reference/parameters.md"
PRESSED = "tuned; sensitivity: bench shape-sensitivity, docs/reference/parameters.md"
_FACTOR = 100.0
_PLACES = ("first", "second", "third", "fourth")


def number(
    default: Any, meaning: str, source: str, *, low: float | None = None, high: float | None = None
) -> Any:
    """Return a field of a frozen settings class; a test checks every field for both texts.

    Args:
        default: A float, a whole number, or a tuple of them.
        meaning: Its unit and effect.
        source: Derivation, or the benchmark used to fit it.
        low: Lowest value that `Settings.override` accepts; left out: a hundredth of the default, or
            1 for a count.
        high: Highest value; left out: a hundred times the default.

    Returns:
        The result of `dataclasses.field`.
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
    """Return a settings class of plain numbers as an array for the kernels.

    The array holds one number per field, in field order.
    """
    array = np.array(astuple(settings), float)
    array.flags.writeable = False
    return array
