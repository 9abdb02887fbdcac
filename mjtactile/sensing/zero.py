"""Is there a touch at all, and the zero that follows the weather while there is none (Eq. F15).

A tenth of a kelvin of the chamber's gas, or 0.3 hPa of weather, moves the felt force by as much as a light touch. While
nothing touches, the amount of gas and the markers' offsets are followed slowly; in contact they are frozen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve

from mjtactile.sensing.inverse import InverseMembrane, InverseRest, Shape
from mjtactile.types import Markers, Traction

TOUCH_SD, TOUCH_LEAST = 5.0, 0.02  # noise's sd, and N, that a force, or its level, must exceed to be a touch
BLEND = 0.5  # of the newest frame in the level
LEVEL_SD = np.sqrt(BLEND / (2 - BLEND))  # of the level, over that of a frame
JUMP_SD = 4.0  # a change by more than so many sd is no noise: the level follows at once
PULL_MOST = 0.15  # N; nothing pulls on the membrane, so more than this says that the zero is lost
DRIFT_MOST = 30.0  # mean square of the drift found over its variance: the same, said by the shape
RELEASE = 0.6  # of that threshold: below it a touch ends
NOISE_FIRST = 0.01  # N, believed at first, or what is predicted where that is less
MEMORY_FRAMES = 30  # over which the noise is learnt
QUIET = 0.5  # s without touch before the zero follows
FOLLOW = 4.0  # s, time constant of the zero
DRIFT_RATE = 2e-4  # 1/s, fastest change of the gas that is weather and no touch: 0.06 K/s


@dataclass(frozen=True, eq=False)
class Watch:
    """What the next frame needs: `time` s, whether something `touching`, since when all is quiet, `noise` N: the sd of
    the normal force from frame to frame, the number of `frames` it was learnt from, the last `force`, N, and its `level`, a
    mean over the last few frames that is as light a touch as can be told from noise."""

    time: float
    touching: bool
    quiet_since: float
    noise: float
    frames: int
    force: float
    level: float

    @property
    def threshold(self) -> float:
        """Normal force, N, above which there is a touch."""
        return max(TOUCH_LEAST, TOUCH_SD * self.noise)

    @property
    def threshold_level(self) -> float:
        """Mean normal force, N, above which there is a touch."""
        return max(TOUCH_LEAST, TOUCH_SD * LEVEL_SD * self.noise)


def watch(time: float, traction: Traction, before: Watch | None) -> Watch:
    """Decide on touch from the net force. """
    force, sd = -float(traction.wrench[2]), float(np.sqrt(traction.wrench_cov[2, 2]))
    if before is None or time < before.time:
        before = Watch(time, False, time, min(sd, NOISE_FIRST), 0, force, 0.0)
    level = before.level + BLEND * (force - before.level)
    level = float(np.clip(level, force - JUMP_SD * before.noise, force + JUMP_SD * before.noise))
    release = RELEASE if before.touching else 1.0
    if force > before.threshold * release or level > before.threshold_level * release:
        return Watch(time, True, time, before.noise, before.frames, force, level)
    frames = min(before.frames + 1, MEMORY_FRAMES)
    change = (force - before.force) ** 2 / 2  # of two independent frames
    variance = before.noise**2 + ((change - before.noise**2) / frames if before.frames else 0.0)
    quiet_since = time if before.touching else before.quiet_since
    return Watch(time, False, quiet_since, float(np.sqrt(variance)), frames, force, level)


def follow(estimator: InverseMembrane, rest: InverseRest, shape: Shape, markers: Markers, step: float) -> InverseRest:
    """Rest state after `step` s more without touch: gas and offsets move a little towards what the markers show.

    The gas takes the part of the markers' motion that a change of its amount would make; the offsets take what is left.
    """
    blend = step / (step + FOLLOW)
    state = estimator.sheet.state(rest.c, rest.stiffness_scale)
    c, gas = rest.c, rest.gas
    seen = estimator.positions(c)[markers.ids] + rest.offset[markers.ids]
    apart = markers.p_SM - seen
    if gas.constant is not None:
        volume = estimator.design.chamber_volume_flat + state.volume
        gradient = estimator.sheet.volume_gradient(state).ravel()
        gamma = estimator.design.chamber.heat_ratio
        per_share = gas.constant / volume**gamma  # Pa of pressure for a whole more of the gas
        bulge = cho_solve(shape.gain.stiffness, per_share * gradient).reshape(3, -1)
        moved = estimator.positions(bulge)[markers.ids] - estimator.positions(0 * bulge)[markers.ids]
        share = float((moved * apart).sum() / (moved * moved).sum())
        share = float(np.clip(blend * share, -DRIFT_RATE * step, DRIFT_RATE * step))
        gas, c = replace(gas, constant=gas.constant * (1 + share)), c + share * bulge
        apart = apart - share * moved
    offset = rest.offset.copy()
    offset[markers.ids] += 0.1 * blend * apart
    return replace(rest, gas=gas, c=c, offset=offset)
