"""Confidence interval of a proportion."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

Z = 1.959964  # of a normal distribution: 95 %

Line = Mapping[str, Any]
"""One episode, as in `episodes.jsonl`."""


def wilson(count: int, of: int) -> tuple[float, float]:
    """Compute the 95 % interval of a proportion (Wilson, J. Am. Stat. Assoc. 22, 1927)."""
    if not of:
        return 0.0, 1.0
    p = count / of
    z2 = Z * Z
    middle = p + z2 / (2 * of)
    half = Z * math.sqrt(p * (1 - p) / of + z2 / (4 * of * of))
    # at 0 and 1 the bound is exact; avoid rounding errors
    return (
        max((middle - half) / (1 + z2 / of), 0.0) if count else 0.0,
        min((middle + half) / (1 + z2 / of), 1.0) if count < of else 1.0,
    )
