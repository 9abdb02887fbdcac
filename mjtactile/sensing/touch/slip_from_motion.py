"""Slip detection for a known contact shape with known motion relative to the rubber.

The position of the object is more accurate than the center of pressure. That center moves when a
face tilts. An object that rotates about its own normal leaves that center unchanged. Only its
motion reveals the slip (docs/theory/slip.md, Eq. F22).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from mjtactile.core.types import RelativeMotion, Slip
from mjtactile.sensing.settings import DEFAULTS, SlipSettings
from mjtactile.sensing.touch.slip import SlipHistory


def with_motion(
    slip: Slip,
    history: SlipHistory | None,
    motion: RelativeMotion | None,
    s: SlipSettings = DEFAULTS.slip,
) -> tuple[Slip, SlipHistory | None]:
    """Return the slip with the object's own velocity, and its history. The state is also "slipping"
    where the object slides along the shear, or spins, significantly faster than the limit. Nothing
    changes if the motion is unknown (None)."""
    if motion is None or history is None or slip.state not in ("sticking", "incipient", "slipping"):
        return slip, history
    moved = replace(slip, velocity=motion.velocity)
    if slip.state == "slipping" or not (slides(motion, history, s) or spins(motion, s)):
        return moved, history
    samples = history.samples
    elapsed = samples[-1].time - samples[-2].time if len(samples) > 1 else 0.0
    distance = history.distance + float(np.linalg.norm(motion.velocity)) * elapsed
    moved = replace(moved, state="slipping", distance=distance, stick_ratio=0.0)
    return moved, replace(history, distance=distance)


def slides(motion: RelativeMotion, history: SlipHistory, s: SlipSettings = DEFAULTS.slip) -> bool:
    """Return True if the object slides along the newest shear over the rubber, beyond partial slip.
    An object with too little shear rolls."""
    samples = history.samples
    ratio = samples[-1].ratio
    load = float(np.linalg.norm(ratio))
    elapsed = samples[-1].time - samples[0].time
    if load < s.min_load or elapsed <= 0:
        return False
    along = ratio[:2] / load
    speed = float(along @ motion.velocity)
    sd = math.sqrt(float(along @ motion.velocity_cov @ along))
    dragged = abs(float(ratio @ (samples[-1].dragged - samples[0].dragged))) / load
    left = speed - s.follows * dragged / elapsed
    return left > max(s.shape_speed, s.shape_sure * sd)


def spins(motion: RelativeMotion, s: SlipSettings = DEFAULTS.slip) -> bool:
    """Return True if the object rotates about its normal over the rubber."""
    return abs(motion.spinning) > max(s.shape_spin, s.shape_sure * motion.spinning_sd)
