"""Confidence interval of a proportion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scipy import stats

Line = Mapping[str, Any]
"""One episode, as in `episodes.jsonl`."""


def wilson(count: int, of: int) -> tuple[float, float]:
    """Compute the 95 % interval of a proportion (Wilson, J. Am. Stat. Assoc. 22, 1927)."""
    if not of:
        return 0.0, 1.0
    interval = stats.binomtest(int(count), int(of)).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)
