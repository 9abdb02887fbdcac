"""Tone curve of the camera relative to the reference: exposure, gamma, and black level.

It is estimated from circles with known reference levels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mjtactile.core.types import Array

_ROUNDS = 5
_STEP_LIMIT = 0.3  # of ln gamma in a round
_FEWEST = 3
_AS_BEFORE = 0.02  # maximum relative change of all levels for an unchanged curve
_TOP = 255.0


@dataclass(frozen=True)
class Tone:
    """level = black + `light` top (level before / top)^(1/gamma), less `black`; NaN: unknown."""

    light: float
    gamma: float
    black: float


_UNKNOWN = Tone(math.nan, math.nan, math.nan)


def tone_of(inside: Array, outside: Array, inside_then: Array, outside_then: Array) -> Tone:
    """Fit the curve from the reference levels `_then` (n,) to the current levels inside circles and
    of the background around them, by least squares. Black and white determine two of its three
    parameters. Light that falls off toward the corners spreads either level over a range, whose
    slope gives the third."""
    then = np.concatenate([inside_then, outside_then])
    now = np.concatenate([inside, outside])
    known = np.isfinite(then + now) & (then > 0)
    if known.sum() < 2 * _FEWEST:
        return _UNKNOWN
    ratio = now[known] / then[known]
    if np.abs(ratio - 1).max() < _AS_BEFORE:
        return Tone(float(ratio.mean()), 1.0, 0.0)
    share = np.log(then[known] / _TOP)
    level = now[known] / _TOP
    power = 1.0
    for _ in range(_ROUNDS):
        curve = np.exp(power * share)
        columns = np.stack([np.ones_like(curve), curve, curve * share])
        normal = columns @ columns.T
        normal[2, 2] += 1e-12
        black, light, steeper = np.linalg.solve(normal, columns @ level)
        if not light > 0:
            return _UNKNOWN
        change = float(np.clip(steeper / light, -_STEP_LIMIT, _STEP_LIMIT))
        power = float(np.clip(power + change, 0.1, 10.0))
        if abs(change) < 1e-3:
            break
    return Tone(float(light), 1 / power, _TOP * float(black))
