"""Is there a touch at all, and the zero that follows the weather while there is none (Eq. F15).

A tenth of a kelvin of the chamber's gas, or 0.3 hPa of weather, moves the felt force by as much as a light touch. While
nothing touches, the amount of gas and the markers' offsets are followed slowly; in contact they are frozen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve

from mjtactile.core.types import Markers, Traction
from mjtactile.sensing.force.inverse import InverseMembrane, InverseRest, Shape
from mjtactile.sensing.settings import DEFAULTS, ZeroSettings


@dataclass(frozen=True, eq=False)
class Detection:
    """Whether something touches, and what the next image needs: `time` s, `touching`, since when all is quiet, `noise` N: the
    sd of the normal force from image to image, the number of `images` it was learnt from, the last `force`, N, and its
    `level`, a mean over the last few images that is as light a touch as can be told from noise."""

    time: float
    touching: bool
    quiet_since: float
    noise: float
    images: int
    force: float
    level: float


def threshold(noise: float, s: ZeroSettings = DEFAULTS.zero) -> float:
    """Normal force, N, above which there is a touch."""
    return max(s.touch_least, s.touch_sd * noise)


def detect_touch(time: float, traction: Traction, before: Detection | None, s: ZeroSettings = DEFAULTS.zero) -> Detection:
    """Decide on touch from the net force of an image at `time` s."""
    force, sd = -float(traction.wrench[2]), float(np.sqrt(traction.wrench_cov[2, 2]))
    if before is None or time < before.time:
        before = Detection(time, False, time, min(sd, s.noise_first), 0, force, 0.0)
    level = before.level + s.blend * (force - before.level)
    level = float(np.clip(level, force - s.jump_sd * before.noise, force + s.jump_sd * before.noise))
    release = s.release if before.touching else 1.0
    level_noise = float(np.sqrt(s.blend / (2 - s.blend))) * before.noise
    if force > threshold(before.noise, s) * release or level > threshold(level_noise, s) * release:
        return Detection(time, True, time, before.noise, before.images, force, level)
    images = min(before.images + 1, s.memory_images)
    change = (force - before.force) ** 2 / 2  # of two independent frames
    variance = before.noise**2 + ((change - before.noise**2) / images if before.images else 0.0)
    quiet_since = time if before.touching else before.quiet_since
    return Detection(time, False, quiet_since, float(np.sqrt(variance)), images, force, level)


def follow(estimator: InverseMembrane, rest: InverseRest, shape: Shape, markers: Markers, step: float,
           s: ZeroSettings = DEFAULTS.zero) -> InverseRest:
    """Rest state after `step` s more without touch: gas and offsets move a little towards what the markers show.

    The gas takes the part of the markers' motion that a change of its amount would make; the offsets take what is left.
    """
    blend = step / (step + s.follow)
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
        share = float(np.clip(blend * share, -s.drift_rate * step, s.drift_rate * step))
        gas, c = replace(gas, constant=gas.constant * (1 + share)), c + share * bulge
        apart = apart - share * moved
    offset = rest.offset.copy()
    offset[markers.ids] += s.offset_share * blend * apart
    return replace(rest, gas=gas, c=c, offset=offset)
