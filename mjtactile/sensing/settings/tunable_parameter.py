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
SCENES = "bench uncertainty: fitted to scenes with seeds below 1000, which its table excludes"
_FACTOR = 100.0
_ORDINALS = ("first", "second", "third", "fourth")


def number(
    default: Any,
    meaning: str,
    source: str = TRIED,
    *,
    low: float | None = None,
    high: float | None = None,
) -> Any:
    """Return a field of a frozen settings class; a test checks every field for both texts.

    Args:
        default: A float, a whole number, or a tuple of them.
        meaning: Its unit and effect.
        source: Derivation, or the benchmark used to fit it; tuned by hand if left out.
        low: Lowest value that `Settings.override` accepts; left out: a hundredth of the default, or
            1 for a count.
        high: Highest value; left out: a hundred times the default.

    Returns:
        The result of `dataclasses.field`.
    """
    values = default if isinstance(default, tuple) else (default,)
    integer = isinstance(values[0], int)
    sizes = [abs(value) for value in values]
    lowest = 1.0 if integer else min(sizes) / _FACTOR
    highest = _FACTOR * max(sizes)
    if values[0] < 0:
        lowest, highest = -highest, -lowest
    limits = {
        "key": "",
        "about": meaning,
        "low": lowest if low is None else low,
        "high": highest if high is None else high,
        "integer": integer,
    }
    kind = Number(**limits)
    if isinstance(default, tuple):
        kind = Numbers(**limits, names=_ORDINALS[: len(default)])
    return entry(kind, default, more={"meaning": meaning, "source": source})


def check(settings: Any, stage: str, name: str, value: Any) -> Any:
    """Return a valid value of the field `name` of a settings class, or raise InputError."""
    kind = replace(entries(type(settings))[name], key=name)
    table = {name: list(value) if isinstance(value, tuple) else value}
    return kind.read(Section(table, stage, "settings"), ...)


@lru_cache(maxsize=64)
def as_numbers(settings: Any) -> np.ndarray:
    """Return a settings class of plain numbers as an array for the kernels, in field order."""
    array = np.array(astuple(settings), float)
    array.flags.writeable = False
    return array
