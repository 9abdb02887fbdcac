"""Jaw transmissions of rig files, for real and simulated grippers.

Each drive has a coordinate a. It is a servo's angle (rad) or the length of a simulated actuator.
That length is in rad, or in m for a slide or a tendon. The coordinate determines a part x (m) of
the gripper's opening by one of three laws:

- linear (a rack, a slide, a tendon): x = x0 + r a, with r m/rad of the pinion, or m/m;
- crank (a parallel linkage): x = x0 + r sin a, with the crank's length r m and |a| < 90 degrees;
- table: measured pairs (a, x), strictly monotonic in both, linear between.

A torque (or force) tau along a closes the jaws. The closing force is f = -tau / (dx/da), from
virtual work.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

LINEAR = "linear"
CRANK = "crank"
TABLE = "table"


@dataclass(frozen=True)
class JawLaw:
    """x(a) as above: `kind`, `offset` x0 m, `ratio` r, and for a table the pairs (a, x). Build one
    with `make_law`."""

    kind: str
    offset: float = 0.0
    ratio: float = 1.0
    table: tuple[tuple[float, float], ...] = ()

    def part(self, coordinate: float) -> float:
        """Return the jaw's part of the opening, m, at a coordinate."""
        if self.kind == TABLE:
            a, x = zip(*self.table, strict=True)
            return float(np.interp(coordinate, a, x))
        if self.kind == CRANK:
            angle = max(-math.pi / 2, min(math.pi / 2, coordinate))
            return self.offset + self.ratio * math.sin(angle)
        return self.offset + self.ratio * coordinate

    def coordinate(self, part: float) -> float:
        """Return the coordinate for a part of the opening, m, or the nearest reachable one."""
        if self.kind == TABLE:
            a, x = zip(*sorted(self.table, key=lambda pair: pair[1]), strict=True)
            return float(np.interp(part, x, a))
        coordinate = (part - self.offset) / self.ratio
        return math.asin(max(-1.0, min(1.0, coordinate))) if self.kind == CRANK else coordinate

    def slope(self, coordinate: float) -> float:
        """Return dx/da at a coordinate. A crank near its end has at least 1 % of `ratio`."""
        if self.kind == LINEAR:
            return self.ratio
        if self.kind == CRANK:
            return self.ratio * max(math.cos(coordinate), 0.01)
        a, x = zip(*self.table, strict=True)
        low = int(np.clip(np.searchsorted(a, coordinate) - 1, 0, len(a) - 2))
        return float((x[low + 1] - x[low]) / (a[low + 1] - a[low]))

    def is_reachable(self, coordinate: float) -> bool:
        """Return True if the coordinate is in the range of the law, with a tolerance of 5 %."""
        if self.kind == CRANK:
            return abs(coordinate) <= math.pi / 2 + 0.05
        if self.kind == TABLE:
            low = self.table[0][0]
            high = self.table[-1][0]
            slack = 0.05 * (high - low)
            return low - slack <= coordinate <= high + slack
        return True


def make_law(
    kind: str, offset: float, ratio: float, table: Sequence[tuple[float, float]] = ()
) -> JawLaw:
    """Create an invertible law. Raises ValueError with the reason if it is not invertible."""
    if kind != TABLE:
        if ratio == 0:
            raise ValueError("0 moves nothing")
        return JawLaw(kind, offset, ratio)
    parts = [x for _, x in table]
    rises = {b > a for a, b in pairwise(parts)}
    increases = all(b[0] > a[0] for a, b in pairwise(table))
    if len(table) < 2 or not increases or len(rises) != 1 or len(set(parts)) != len(parts):
        raise ValueError(
            "needs at least two pairs, with an increasing first column and openings that "
            "only increase or only decrease"
        )
    return JawLaw(kind, table=tuple(table))
