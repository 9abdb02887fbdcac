"""Contact detection, and a zero that tracks temperature and weather (Eq. F15).

A change of 0.1 K in the gas, or 0.3 hPa in the ambient pressure, resembles a light touch. Both
change the estimated force by as much. Without contact, the gas amount and the marker offsets are
tracked slowly. In contact they are frozen. The force does not detect a contact that grows slowly.
But such a contact is local, while weather is not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mjtactile.core.types import Array, Markers, Traction
from mjtactile.sensing.force.inverse_fem import InverseMembrane
from mjtactile.sensing.force.linearization import Shape
from mjtactile.sensing.force.rest_equilibrium import InverseRest
from mjtactile.sensing.settings import DEFAULTS, ContactDetectionSettings


@dataclass(frozen=True, eq=False)
class Detection:
    """Contact detection result, with the values for the next image. `time`, s, and `touching`;
    `quiet_since`, s, the start of the phase without contact. `noise` is the standard deviation of
    the normal force between images, N, from `images` images. `force` is the last force, N. `level`
    is its mean over the last few images, N, which detects lighter contacts."""

    time: float
    touching: bool
    quiet_since: float
    noise: float
    images: int
    force: float
    level: float


def threshold(noise: float, s: ContactDetectionSettings = DEFAULTS.zero) -> float:
    """Return the normal force, N, above which contact is detected."""
    return max(s.touch_min, s.touch_sd * noise)


def min_force(sd: float, s: ContactDetectionSettings = DEFAULTS.zero) -> float:
    """Return the minimum normal force, N, that the mean of the last images detects, if the markers
    of one image show it with the standard deviation `sd`, N."""
    return s.touch_sd * _level_fraction(s) * sd


def _level_fraction(s: ContactDetectionSettings) -> float:
    """Return the standard deviation of the mean force of the last images, relative to that of one
    image."""
    return float(np.sqrt(s.blend / (2 - s.blend)))


def detect_touch(
    time: float,
    traction: Traction,
    before: Detection | None,
    s: ContactDetectionSettings = DEFAULTS.zero,
) -> Detection:
    """Decide on touch from the net force of an image at `time` s."""
    force = -float(traction.wrench[2])
    sd = float(np.sqrt(traction.wrench_cov[2, 2]))
    if before is None or time < before.time:
        before = Detection(time, False, time, min(sd, s.noise_first), 0, force, 0.0)
    level = before.level + s.blend * (force - before.level)
    level = float(
        np.clip(level, force - s.jump_sd * before.noise, force + s.jump_sd * before.noise)
    )
    release = s.release if before.touching else 1.0
    level_noise = _level_fraction(s) * before.noise
    if force > threshold(before.noise, s) * release or level > threshold(level_noise, s) * release:
        return Detection(time, True, time, before.noise, before.images, force, level)
    images = min(before.images + 1, s.memory_images)
    change = (force - before.force) ** 2 / 2  # of two independent frames
    variance = before.noise**2 + ((change - before.noise**2) / images if before.images else 0.0)
    quiet_since = time if before.touching else before.quiet_since
    return Detection(time, False, quiet_since, float(np.sqrt(variance)), images, force, level)


@dataclass(frozen=True, eq=False)
class RestTracker:
    """Tracked rest state.

    `offsets` (N, 3), m, is the deviation of all markers from it, averaged over about
    `ContactDetectionSettings.smooth` s. `fraction` is the last relative correction of its gas.
    """

    rest: InverseRest
    offsets: Array
    fraction: float = 0.0

    @classmethod
    def of(cls, rest: InverseRest) -> RestTracker:
        return cls(rest, np.zeros_like(rest.offset))


def follow(
    estimator: InverseMembrane,
    zero: RestTracker,
    shape: Shape,
    markers: Markers,
    step: float,
    s: ContactDetectionSettings = DEFAULTS.zero,
) -> RestTracker:
    """Track the zero over `step` s without contact: gas and offsets move slightly toward the
    markers. The gas takes the part of the marker motion that a change of its amount would cause.
    The offsets take the remainder. Motion that neither gas nor camera drift explains is a touch too
    light to detect. Then gas and offsets hardly move."""
    rest = zero.rest
    ids = markers.ids
    blend = step / (step + s.smooth)
    predicted = estimator.positions(rest.c)[ids] + rest.offset[ids]
    offsets = zero.offsets.copy()
    offsets[ids] += blend * (markers.p_SM - predicted - offsets[ids])
    bulge = _bulge_change(estimator, rest, shape)
    moved = estimator.positions(bulge) - estimator.positions(0 * bulge)
    fraction, local = _explain(offsets[ids], moved[ids], markers.cov_p)
    rate = step / (step + s.follow) * (s.slowly if local > s.local_max else 1.0)
    largest = step * (s.drift_rate if rest.gas_sd is None else s.measured_rate)
    fraction = float(np.clip(rate * fraction, -largest, largest))
    if rest.gas.constant is None:
        gas = rest.gas
    else:
        gas = replace(rest.gas, constant=rest.gas.constant * (1 + fraction))
    left = np.zeros_like(offsets)
    left[ids] = s.offset_fraction * rate * (offsets[ids] - fraction * moved[ids])
    return RestTracker(
        replace(rest, gas=gas, c=rest.c + fraction * bulge, offset=rest.offset + left),
        offsets - fraction * moved - left,
        fraction,
    )


def _bulge_change(estimator: InverseMembrane, rest: InverseRest, shape: Shape) -> Array:
    """Return the bulge change (3, n), m, in coefficients, per relative change of the gas amount. It
    is 0 where a valve keeps the pressure."""
    if rest.gas.constant is None and rest.gas_sd is None:
        return np.zeros_like(rest.c)
    state = estimator.membrane.state(rest.c, rest.young)
    chamber = estimator.design.chamber
    if rest.gas.constant is None:
        return shape.gain.stiffness.solve(
            (chamber.ambient + rest.gas.gauge_pressure) * state.gradient
        )
    # pressure per relative change of the gas amount, Pa
    per_fraction = (
        rest.gas.constant
        / (estimator.design.chamber_volume_flat + state.volume) ** chamber.polytropic_exponent
    )
    return shape.gain.stiffness.solve(per_fraction * state.gradient)


def _explain(offsets: Array, moved: Array, cov: Array) -> tuple[float, float]:
    """Return the fraction of the gas motion `moved` (m, 3) in `offsets` (m, 3), and the misfit. The
    misfit is the mean square of the remainder after gas and camera motion. It is relative to the
    markers' covariance `cov` (m, 3, 3)."""
    whiten = np.linalg.inv(np.linalg.cholesky(cov))
    camera = np.broadcast_to(np.eye(3), (len(offsets), 3, 3))
    columns = np.concatenate([moved[:, :, None], camera], axis=2) if moved.any() else camera
    A = (whiten @ columns).reshape(3 * len(offsets), -1)
    b = (whiten @ offsets[:, :, None]).ravel()
    found, *_ = np.linalg.lstsq(A, b, rcond=None)
    return float(found[0]) if moved.any() else 0.0, float(((b - A @ found) ** 2).mean())
