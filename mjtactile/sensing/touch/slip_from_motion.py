"""Slip, where it is known what body touches and how it moves against the rubber.

A body's place is known better than the centre of what presses, which wanders where a face leans;
and a body that turns on the spot, about its own normal, leaves that centre where it was: nothing
else shows it (docs/theory/slip.md, Eq. F22).
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
    """Say whether a body slips, by its motion too.

    Args:
        slip: By the centre of what presses.
        history: Its history, of this image.
        motion: Of the body against the rubber; None: it is not known.
        s: Settings.

    Returns:
        The slip with the body's own velocity; "slipping", too, where the body slides along the
        shear, or spins, faster than is allowed for and surely so. And its history.
    """
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
    """Whether a body goes along the shear over the rubber, beyond what partial slip explains.

    Args:
        motion: The body's.
        history: Of the touch; its newest shear is what counts.
        s: Settings.

    Returns:
        Whether it does. What carries too little shear rolls.
    """
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
    return left > max(s.body_speed, s.body_sure * sd)


def spins(motion: RelativeMotion, s: SlipSettings = DEFAULTS.slip) -> bool:
    """Whether a body turns about its normal over the rubber.

    Args:
        motion: The body's.
        s: Settings.

    Returns:
        Whether it does; False for what looks the same all around.
    """
    return abs(motion.spinning) > max(s.body_spin, s.body_sure * motion.spinning_sd)
