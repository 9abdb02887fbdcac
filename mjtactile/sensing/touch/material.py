"""Material classification from the object width as a function of the squeeze force.

All functions are pure functions of a `Squeeze`.

- Solid: the width stays constant, only the membranes deform.
- Soft: the width decreases with the force and recovers. The curve is parabolic if the material
  stiffens (the sponge of the paper).
- Amorphous: the object flows and keeps most of its deformation.

The membranes are in series with the object. Its width is measured separately from theirs. See
docs/theory/exploration.md, Eq. P1-P5.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import ndtr

from mjtactile.core.status import OK, Status, StatusCode
from mjtactile.core.types import MATERIALS, Array, Material
from mjtactile.sensing.settings import DEFAULTS, MaterialSettings
from mjtactile.sensing.touch.squeeze import Squeeze

_NO_COV = np.zeros((3, 3))
# fraction of the closing distance; the remainder may be the jaws' slow end, or flow
_CLOSING_FRACTION = 0.9


@dataclass(frozen=True, eq=False)
class _Phases:
    """Indices of the load, hold, release, and second-touch phases."""

    load: NDArray[np.int64]
    hold: NDArray[np.int64]
    release: NDArray[np.int64]
    second: NDArray[np.int64]


@dataclass(frozen=True)
class _Curve:
    """Deformation under load, d(F) = 2 a F / (1 + sqrt(1 + 4 q F)), so that F = d/a + (q/a^2) d^2.
    `free_width` m is the width at F = 0. `cov` (3, 3) is the covariance of (free width, a, q)."""

    free_width: float
    compliance: float
    stiffening: float
    cov: Array

    def width(self, force: Array) -> Array:
        """Return the width, m, under `force`, N."""
        return self.free_width - 2 * self.compliance * force / (
            1 + np.sqrt(1 + 4 * self.stiffening * force)
        )

    def sd(self, force: float = 0.0) -> float:
        """Return the standard deviation of the fitted width under `force` N, m."""
        root = math.sqrt(1 + 4 * self.stiffening * force)
        by_stiffening = 2 * self.compliance * force / (1 + root) ** 2 * 2 * force / root
        gradient = np.array([1.0, -2 * force / (1 + root), by_stiffening])
        return math.sqrt(max(float(gradient @ self.cov @ gradient), 0.0))


def estimate_material(squeeze: Squeeze, s: MaterialSettings = DEFAULTS.material) -> Material:
    """Classify the material from a probe: loading, hold, release and (optionally) a second touch.
    For "unknown" the `status` gives the reason."""
    seen = (
        np.isfinite(squeeze.width) & np.isfinite(squeeze.force) & (squeeze.force > s.force_traced)
    )
    maximum = float(np.max(squeeze.force[seen], initial=0.0))
    compression = float(np.ptp(squeeze.width[seen])) if seen.any() else 0.0
    if maximum < s.force_min and compression < s.shrunk_enough:
        return _unknown(
            StatusCode.INCOMPLETE_DATA,
            f"not enough contact yet: the maximum force is {maximum:.2f} N; at least "
            f"{s.force_min:g} N are needed",
        )
    phases = _phases(squeeze, np.flatnonzero(seen), s)
    if len(phases.load) < s.samples_min or len(phases.hold) < s.samples_min:
        return _unknown(
            StatusCode.INCOMPLETE_DATA,
            f"not enough contact yet: {len(phases.load)} images of the load and "
            f"{len(phases.hold)} of the hold; at least {s.samples_min} of each are needed",
        )
    return _verdict(squeeze, phases, _fit_press(squeeze, phases.load, s), s)


def _unknown(code: StatusCode, reason: str) -> Material:
    return Material(
        "unknown", dict.fromkeys(MATERIALS, 1 / len(MATERIALS)), status=Status(code, reason)
    )


def _phases(squeeze: Squeeze, seen: NDArray[np.int64], s: MaterialSettings) -> _Phases:
    """Split the history where contact is lost, and the first squeeze where the jaws stop and where
    they open."""
    gap = s.gap * float(np.median(np.diff(squeeze.time)))
    runs = np.split(seen, np.flatnonzero(np.diff(squeeze.time[seen]) > gap) + 1)
    peaks = [squeeze.force[run].max() for run in runs]
    first = next(
        i for i, peak in enumerate(peaks) if peak >= min(s.force_min, s.peak_fraction * max(peaks))
    )
    run = runs[first]
    opening = squeeze.opening[run]
    time = squeeze.time[run]
    speed = -np.gradient(opening, time) if len(run) > 2 else np.zeros(len(run))
    opened = opening > np.minimum.accumulate(opening) + s.opened
    end = int(np.argmax(opened)) if opened.any() else len(run)
    pressing = speed > s.pressing * _press_speed(opening[:end], speed[:end])
    stop = int(np.flatnonzero(pressing[:end]).max(initial=-1)) + 1
    second = runs[first + 1] if first + 1 < len(runs) else run[:0]
    return _Phases(run[:stop], run[stop:end], run[end:], second)


def _press_speed(opening: Array, speed: Array) -> float:
    """Return the median closing speed of the jaws during most of the loading, m/s. The first one or
    two images may still have the approach speed, which is ten times as high."""
    compression = opening[0] - opening
    in_transit = compression < _CLOSING_FRACTION * compression.max()
    return float(np.median(speed[in_transit])) if in_transit.any() else 0.0


def _fit_press(squeeze: Squeeze, load: NDArray[np.int64], s: MaterialSettings) -> _Curve:
    """Fit free width, compliance a and stiffening q by least squares (Eq. P2). The fit is robust
    against single bad widths. It uses samples up to half the maximum force: until then a flowing
    material has flowed only little."""
    gentle = load[
        (squeeze.force[load] > s.force_estimate)
        & (squeeze.force[load] <= s.gentle_fraction * squeeze.force[load].max())
    ]
    load = gentle if len(gentle) >= s.samples_min else load[: s.samples_min]
    force = squeeze.force[load]
    width = squeeze.width[load]
    sd = squeeze.width_sd[load]
    slope = max(float(-np.polyfit(force, width, 1)[0]), 1e-6)

    def residual(p: Array) -> Array:
        curve = _Curve(p[0], p[1] * slope, p[2], _NO_COV)
        # a prior: mild stiffening
        return np.concatenate([(curve.width(force) - width) / sd, [s.stiffening_prior * p[2]]])

    first = float(width[:3].max())  # width measured at `force_estimate` or slightly more
    start = np.array([first + min(slope * force[0], 0.5 * s.unseen_max), 1.0, 0.1])
    fit = least_squares(
        residual,
        start,
        bounds=([first - s.unseen_max, 0, 0], [first + s.unseen_max, 50, 100]),
        x_scale=[1e-4, 1, 1],
        loss="soft_l1",
    )
    scatter = max(1.0, math.sqrt(2 * fit.cost / max(len(load) - 3, 1)))
    unit = np.array([1.0, slope, 1.0])
    cov = scatter**2 * np.linalg.pinv(fit.jac.T @ fit.jac) * np.outer(unit, unit)
    return _Curve(float(fit.x[0]), float(fit.x[1]) * slope, float(fit.x[2]), cov)


def _verdict(squeeze: Squeeze, phases: _Phases, curve: _Curve, s: MaterialSettings) -> Material:
    last = phases.hold[-max(s.samples_min, len(phases.hold) // 4) :]  # samples after settling
    force = float(np.mean(squeeze.force[last]))
    deformation = curve.free_width - float(np.mean(squeeze.width[last]))
    sd = math.hypot(curve.sd(), s.width_bias)
    permanent, permanent_sd = _permanent_set(squeeze, phases, curve, s)
    probability = _probabilities(
        deformation, sd, max(force, s.force_min), permanent, permanent_sd, s
    )
    kind = max(probability, key=lambda name: probability[name])
    # a flowing object has no stiffness; the modulus of a solid one is too high to measure
    unknown = (math.nan, math.nan, math.nan)
    stiffness = _ratio(force, deformation, sd) if kind != "amorphous" else unknown
    relaxation_time, at_rest = _relaxation(squeeze, phases, force, s)
    if kind == "soft" and math.isfinite(at_rest):  # relaxation is incomplete at the end of the hold
        stiffness = (at_rest, min(at_rest, stiffness[1]), max(at_rest, stiffness[2]))
    area = float(np.median(squeeze.area[last]))
    if kind == "soft":
        modulus = _modulus(stiffness, curve.free_width, area, s.area_fraction_sd)
    else:
        modulus = unknown
    is_sure = probability[kind] >= s.sure
    return Material(
        kind if is_sure else "unknown",
        probability,
        force,
        deformation,
        stiffness[0],
        (stiffness[1], stiffness[2]),
        modulus[0],
        (modulus[1], modulus[2]),
        relaxation_time,
        permanent,
        permanent_sd,
        _flow_speed(squeeze, phases.hold, s.early),
        _status(phases, probability, is_sure=is_sure),
    )


def _status(phases: _Phases, probability: Mapping[str, float], *, is_sure: bool) -> Status:
    if not is_sure:
        first, other = sorted(probability, key=lambda name: -probability[name])[:2]
        return Status(StatusCode.AMBIGUOUS, f"undecided between {first} and {other}")
    if len(phases.second):
        return OK
    text = "no second touch: the permanent deformation is estimated from the release"
    return Status(StatusCode.INCOMPLETE_DATA, text)


def _probabilities(
    deformation: float,
    sd: float,
    force: float,
    permanent: float,
    permanent_sd: float,
    s: MaterialSettings,
) -> dict[str, float]:
    """Return the probabilities of the material classes, with the error of each criterion.
    Compliance separates solid from the others. The permanent fraction of the deformation separates
    soft from amorphous."""
    solid = float(ndtr((s.solid_compliance * force - deformation) / sd))
    scale = max(deformation, sd)
    fraction_sd = math.hypot(
        s.set_fraction_sd, math.hypot(permanent_sd, s.set_fraction * sd) / scale
    )
    amorphous = float(ndtr((permanent / scale - s.set_fraction) / fraction_sd))
    return {
        "solid": solid,
        "soft": (1 - solid) * (1 - amorphous),
        "amorphous": (1 - solid) * amorphous,
    }


def _permanent_set(
    squeeze: Squeeze, phases: _Phases, curve: _Curve, s: MaterialSettings
) -> tuple[float, float]:
    """Return the decrease in width at the same small force after the squeeze, m, and its sd."""
    after = phases.second[squeeze.force[phases.second] > s.force_estimate]
    if len(after) < 3:  # a paste yields before this force
        after = phases.second
    if len(after) < 3:  # the end of the release, where the force is small again
        small = max(
            s.released_fraction * float(np.max(squeeze.force[phases.load])), s.released_force
        )
        after = phases.release[squeeze.force[phases.release] < small]
    if not len(after):
        return 0.0, math.inf
    lost = curve.width(squeeze.force[after]) - squeeze.width[after]
    weight = squeeze.width_sd[after] ** -2.0
    force = float(np.average(squeeze.force[after], weights=weight))
    sd = math.hypot(curve.sd(force), s.width_bias, 1 / math.sqrt(float(weight.sum())))
    return float(np.average(lost, weights=weight)), sd


def _ratio(force: float, deformation: float, sd: float) -> tuple[float, float, float]:
    """Return the stiffness F / d, N/m, and its 68 % interval; inf if the deformation may be
    zero."""

    def over(d: float) -> float:
        return force / d if d > 0 else math.inf

    return over(deformation), over(deformation + sd), over(deformation - sd)


def _modulus(
    stiffness: tuple[float, float, float], length: float, area: float, area_sd: float
) -> tuple[float, float, float]:
    """Return E = K L / A, Pa, of an object between flat faces, and its 68 % interval (Eq. P4)."""
    if area <= 0:
        return math.nan, math.nan, math.nan
    best, low, high = (k * length / area for k in stiffness)
    return (
        best,
        best - math.hypot(best - low, area_sd * best),
        best + math.hypot(high - best, area_sd * best),
    )


def _flow_speed(squeeze: Squeeze, hold: NDArray[np.int64], early_time: float) -> float:
    """Return the speed, m/s, at which the width decreases in the first `early_time`, s, after the
    jaws stopped."""
    early = hold[squeeze.time[hold] <= squeeze.time[hold[0]] + early_time]
    if len(early) < 3:
        return math.nan
    return max(0.0, -float(np.polyfit(squeeze.time[early], squeeze.width[early], 1)[0]))


def _relaxation(
    squeeze: Squeeze, phases: _Phases, force: float, s: MaterialSettings
) -> tuple[float, float]:
    """Return the time constant of the stress at constant strain, s, and the relaxed stiffness, N/m.

    Time 0: the force stayed constant. NaN: it fell, but not like that of a standard linear solid.
    For such a solid, loading and hold obey

        F + tau F' = K d + tau (K + K_arm) d'    (Eq. P5)

    Integrated once over time this is linear in tau, K, tau (K + K_arm) and the unknown free width.
    It needs no derivatives, and holds for any motion of the membranes.
    """
    rows = np.concatenate([phases.load, phases.hold])
    time = squeeze.time[rows]
    F = squeeze.force[rows]
    d = squeeze.width[rows[0]] - squeeze.width[rows]
    start = float(np.mean(squeeze.force[phases.load[-3:]]))
    noise = float(np.median(squeeze.force_sd[rows]))
    if start - force < max(s.relaxed_min * start, s.relaxed_sd * noise):
        return 0.0, math.nan

    def integral(y: Array) -> Array:
        return np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(time))])

    columns = np.column_stack([-(F - F[0]), integral(d), d, time - time[0]])
    tau, stiffness, _, _ = np.linalg.lstsq(columns, integral(F), rcond=None)[0]
    if tau > 0 and stiffness > 0:
        return (float(tau), float(stiffness))
    return (math.nan, math.nan)
