"""Causes of a failed grasp that are known outside of the controller: flags and actuator forces."""

from __future__ import annotations

import math

from mjtactile.core.flags import Flags, bypassing_loads
from mjtactile.rig.finger import Rig

_ENOUGH = 0.99  # fraction of the force limit of the rig


def failure_causes(rig: Rig, flags: Flags, opening: float | None) -> list[str]:
    """Return the causes as text, one line each.

    `opening`, m, is that of the jaws at the object (None: unknown).
    """
    weak = None if opening is None else actuator_limit(rig, opening)
    return [*bypassing_loads(flags), *([] if weak is None else [weak])]


def actuator_limit(rig: Rig, opening: float) -> str | None:
    """Return a note if the actuators of `rig` cannot reach its force limit at `opening`, m."""
    if rig.grip_force_available is None:
        return None
    available = rig.grip_force_available(opening)
    if not math.isfinite(available) or available >= _ENOUGH * rig.limits.force:
        return None
    return (
        f"the actuators close each finger with at most {available:.2g} N at an opening of "
        f"{1e3 * opening:.1f} mm, less than the force limit of {rig.limits.force:g} N"
    )
