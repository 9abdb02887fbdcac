"""What an object is made of, from how its width answers to the force of a squeeze. Pure functions of a `Squeeze`.

Solid: the width stays, all that gives way are the membranes. Soft: it shrinks with the force and comes back; the curve
is parabolic where the material stiffens (the paper's sponge). Amorphous: it flows, and keeps most of its deformation.
The membranes are in series with the object, but its width is measured apart from theirs (docs/equations.md, Eq. P1-P5).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import ndtr

from mjtactile.core.status import OK, Status, StatusCode
from mjtactile.core.types import MATERIALS, Array, Material
from mjtactile.sensing.touch.squeeze import Squeeze

FORCE_LEAST = 0.35  # N that must have been felt before anything is said
SHRUNK_ENOUGH = 2e-3  # m by which a width must have changed to speak for itself: a paste never pushes back so hard
FORCE_TRACED = 0.05  # N down to which the width is followed
FORCE_SEEN = 0.1  # N from which on the contact is wide enough to measure the width
SOLID_COMPLIANCE = 0.12e-3  # m/N: what gives way less than this is called solid (8 kN/m; an eraser has 5)
SET_SHARE = 0.35  # of the deformation that stays: more of it is amorphous
SURE = 0.6  # probability below which no class is named
_WIDTH_BIAS = 40e-6  # m by which the width of a rigid object seems to change with force: bending at sharp edges
_SET_SHARE_SD = 0.08  # spread of real materials about the two classes
_AREA_SHARE_SD = 0.3  # of the contact's area: half of all presses are more than 20 % off (`bench touch`)
_RELAXED_LEAST = 0.04  # share of the force that must go before a relaxation time is given
_SAMPLES_LEAST = 5
_UNSEEN_MOST = 1.5e-3  # m by which an object may have given way before its width was first seen (80 N/m)
_NO_COV = np.zeros((3, 3))
_GENTLE_SHARE = 0.6  # of the press's force: from there on its curve is not used for the free width


@dataclass(frozen=True, eq=False)
class _Phases:
    """Indices of the press, of the hold after it, of the release, and of the second touch (may be empty)."""

    load: NDArray[np.int64]
    hold: NDArray[np.int64]
    release: NDArray[np.int64]
    second: NDArray[np.int64]


@dataclass(frozen=True)
class _Curve:
    """Deformation d(F) = 2 a F / (1 + sqrt(1 + 4 q F)) of the press, so that F = d/a + (q/a^2) d^2; `free_width` m at F = 0
    and the covariance `cov` (3, 3) of (free width, a, q)."""

    free_width: float
    compliance: float
    stiffening: float
    cov: Array

    def width(self, force: Array) -> Array:
        """Width, m, under `force` N."""
        return self.free_width - 2 * self.compliance * force / (1 + np.sqrt(1 + 4 * self.stiffening * force))

    def sd(self, force: float = 0.0) -> float:
        """Standard deviation of the width under `force` N that the fit leaves, m."""
        root = math.sqrt(1 + 4 * self.stiffening * force)
        by_stiffening = 2 * self.compliance * force / (1 + root) ** 2 * 2 * force / root
        gradient = np.array([1.0, -2 * force / (1 + root), by_stiffening])
        return math.sqrt(max(float(gradient @ self.cov @ gradient), 0.0))


def judge(squeeze: Squeeze) -> Material:
    """The verdict on a probe: press, hold, release and (better) a second touch. "unknown" says why in `status`."""
    seen = np.isfinite(squeeze.width) & np.isfinite(squeeze.force) & (squeeze.force > FORCE_TRACED)
    most = float(np.max(squeeze.force[seen], initial=0.0))
    shrunk = float(np.ptp(squeeze.width[seen])) if seen.any() else 0.0
    if most < FORCE_LEAST and shrunk < SHRUNK_ENOUGH:
        return _unknown(StatusCode.TOO_LITTLE_SEEN, f"not enough contact yet: felt {most:.2f} N, needs {FORCE_LEAST:g} N")
    phases = _phases(squeeze, np.flatnonzero(seen))
    if len(phases.load) < _SAMPLES_LEAST or len(phases.hold) < _SAMPLES_LEAST:
        return _unknown(StatusCode.TOO_LITTLE_SEEN, f"not enough contact yet: {len(phases.load)} images of the press and "
                                                    f"{len(phases.hold)} of the hold, needs {_SAMPLES_LEAST} of each")
    return _verdict(squeeze, phases, _fit_press(squeeze, phases.load))


def _unknown(code: StatusCode, reason: str) -> Material:
    return Material("unknown", dict.fromkeys(MATERIALS, 1 / len(MATERIALS)), status=Status(code, reason))


def _phases(squeeze: Squeeze, seen: NDArray[np.int64]) -> _Phases:
    """Split the history where contact is lost, and the first squeeze where the jaws stop and where they open."""
    gap = 4 * float(np.median(np.diff(squeeze.time)))
    runs = np.split(seen, np.flatnonzero(np.diff(squeeze.time[seen]) > gap) + 1)
    peaks = [squeeze.force[run].max() for run in runs]
    first = next(i for i, peak in enumerate(peaks) if peak >= min(FORCE_LEAST, 0.7 * max(peaks)))
    run = runs[first]
    opening, time = squeeze.opening[run], squeeze.time[run]
    speed = -np.gradient(opening, time) if len(run) > 2 else np.zeros(len(run))
    pressing = speed > 0.4 * np.percentile(speed, 95)
    opened = opening > np.minimum.accumulate(opening) + 3e-4
    end = int(np.argmax(opened)) if opened.any() else len(run)
    stop = int(np.flatnonzero(pressing[:end]).max(initial=-1)) + 1
    second = runs[first + 1] if first + 1 < len(runs) else run[:0]
    return _Phases(run[:stop], run[stop:end], run[end:], second)


def _fit_press(squeeze: Squeeze, load: NDArray[np.int64]) -> _Curve:
    """Least squares for free width, compliance a and stiffening q (Eq. P2), robust against single bad widths.

    Up to half the force: what flows has not flowed much by then.
    """
    gentle = load[(squeeze.force[load] > FORCE_SEEN) & (squeeze.force[load] <= _GENTLE_SHARE * squeeze.force[load].max())]
    load = gentle if len(gentle) >= _SAMPLES_LEAST else load[:_SAMPLES_LEAST]
    force, width, sd = squeeze.force[load], squeeze.width[load], squeeze.width_sd[load]
    slope = max(float(-np.polyfit(force, width, 1)[0]), 1e-6)

    def residual(p: Array) -> Array:
        curve = _Curve(p[0], p[1] * slope, p[2], _NO_COV)
        return np.concatenate([(curve.width(force) - width) / sd, [0.3 * p[2]]])  # a prior: mild stiffening

    first = float(width[:3].max())  # seen at FORCE_SEEN or a little more
    start = np.array([first + min(slope * force[0], 0.5 * _UNSEEN_MOST), 1.0, 0.1])
    fit = least_squares(residual, start, bounds=([first - _UNSEEN_MOST, 0, 0], [first + _UNSEEN_MOST, 50, 100]),
                        x_scale=[1e-4, 1, 1], loss="soft_l1")
    scatter = max(1.0, math.sqrt(2 * fit.cost / max(len(load) - 3, 1)))
    unit = np.array([1.0, slope, 1.0])
    cov = scatter**2 * np.linalg.pinv(fit.jac.T @ fit.jac) * np.outer(unit, unit)
    return _Curve(float(fit.x[0]), float(fit.x[1]) * slope, float(fit.x[2]), cov)


def _verdict(squeeze: Squeeze, phases: _Phases, curve: _Curve) -> Material:
    last = phases.hold[-max(_SAMPLES_LEAST, len(phases.hold) // 4):]  # where it has come to rest
    force = float(np.mean(squeeze.force[last]))
    deformation = curve.free_width - float(np.mean(squeeze.width[last]))
    sd = math.hypot(curve.sd(), _WIDTH_BIAS)
    stayed, stayed_sd = _permanent_set(squeeze, phases, curve)
    probability = _probabilities(deformation, sd, max(force, FORCE_LEAST), stayed, stayed_sd)
    kind = max(probability, key=lambda name: probability[name])
    # a body that flows has no stiffness of its own, and of one that stays the modulus cannot be seen
    unknown = (math.nan, math.nan, math.nan)
    stiffness = _ratio(force, deformation, sd) if kind != "amorphous" else unknown
    relaxation_time, at_rest = _relaxation(squeeze, phases, force)
    if kind == "soft" and math.isfinite(at_rest):  # not all has relaxed by the end of the hold
        stiffness = (at_rest, min(at_rest, stiffness[1]), max(at_rest, stiffness[2]))
    area = float(np.median(squeeze.area[last]))
    modulus = _modulus(stiffness, curve.free_width, area) if kind == "soft" else unknown
    status = OK
    if probability[kind] < SURE:
        first, other = sorted(probability, key=lambda name: -probability[name])[:2]
        kind, status = "unknown", Status(StatusCode.UNDECIDED, f"undecided between {first} and {other}")
    elif not len(phases.second):
        status = Status(StatusCode.TOO_LITTLE_SEEN, "no second touch: what stayed is judged from the release")
    return Material(kind, probability, force, deformation, stiffness[0], (stiffness[1], stiffness[2]), modulus[0],
                    (modulus[1], modulus[2]),
                    relaxation_time, stayed, stayed_sd, _flow_speed(squeeze, phases.hold), status)


def _probabilities(deformation: float, sd: float, force: float, stayed: float, stayed_sd: float) -> dict[str, float]:
    """Solid against not by the compliance, soft against amorphous by the share that stayed, each with its error."""
    solid = float(ndtr((SOLID_COMPLIANCE * force - deformation) / sd))
    scale = max(deformation, sd)
    share_sd = math.hypot(_SET_SHARE_SD, math.hypot(stayed_sd, SET_SHARE * sd) / scale)
    amorphous = float(ndtr((stayed / scale - SET_SHARE) / share_sd))
    return {"solid": solid, "soft": (1 - solid) * (1 - amorphous), "amorphous": (1 - solid) * amorphous}


def _permanent_set(squeeze: Squeeze, phases: _Phases, curve: _Curve) -> tuple[float, float]:
    """How much narrower the object is at the same small force afterwards, m, and its sd."""
    after = phases.second[squeeze.force[phases.second] > FORCE_SEEN]
    if len(after) < 3:  # a paste yields before it pushes back so hard
        after = phases.second
    if len(after) < 3:  # the end of the release, where the force is small again
        after = phases.release[squeeze.force[phases.release] < max(0.5 * float(np.max(squeeze.force[phases.load])), 0.15)]
    if not len(after):
        return 0.0, math.inf
    lost = curve.width(squeeze.force[after]) - squeeze.width[after]
    weight = squeeze.width_sd[after] ** -2.0
    force = float(np.average(squeeze.force[after], weights=weight))
    sd = math.hypot(curve.sd(force), _WIDTH_BIAS, 1 / math.sqrt(float(weight.sum())))
    return float(np.average(lost, weights=weight)), sd


def _ratio(force: float, deformation: float, sd: float) -> tuple[float, float, float]:
    """Stiffness F / d, N/m, and its 68 % interval; inf where the deformation may be nothing."""
    def over(d: float) -> float:
        return force / d if d > 0 else math.inf

    return over(deformation), over(deformation + sd), over(deformation - sd)


def _modulus(stiffness: tuple[float, float, float], length: float, area: float) -> tuple[float, float, float]:
    """E = K L / A, Pa, of a body between flat faces, and its 68 % interval (Eq. P4)."""
    if area <= 0:
        return math.nan, math.nan, math.nan
    best, low, high = (k * length / area for k in stiffness)
    return best, best - math.hypot(best - low, _AREA_SHARE_SD * best), best + math.hypot(high - best, _AREA_SHARE_SD * best)


def _flow_speed(squeeze: Squeeze, hold: NDArray[np.int64]) -> float:
    """Speed, m/s, at which the width shrinks in the first half second after the jaws stopped."""
    early = hold[squeeze.time[hold] <= squeeze.time[hold[0]] + 0.5]
    if len(early) < 3:
        return math.nan
    return max(0.0, -float(np.polyfit(squeeze.time[early], squeeze.width[early], 1)[0]))


def _relaxation(squeeze: Squeeze, phases: _Phases, force: float) -> tuple[float, float]:
    """Time constant, s, of the stress at constant strain, and stiffness at rest, N/m.

    Time 0: the force stayed. NaN: it fell, but not as a standard linear solid's. Press and hold of such a solid obey
    F + tau F' = K d + tau (K + K_arm) d'  (Eq. P5). Integrated once over time this is linear in tau, K, tau (K + K_arm)
    and the unknown free width; it needs no derivatives, and holds whatever the membranes do meanwhile.
    """
    rows = np.concatenate([phases.load, phases.hold])
    time, F = squeeze.time[rows], squeeze.force[rows]
    d = squeeze.width[rows[0]] - squeeze.width[rows]
    start = float(np.mean(squeeze.force[phases.load[-3:]]))
    noise = float(np.median(squeeze.force_sd[rows]))
    if start - force < max(_RELAXED_LEAST * start, 3 * noise):
        return 0.0, math.nan

    def integral(y: Array) -> Array:
        return np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(time))])

    columns = np.column_stack([-(F - F[0]), integral(d), d, time - time[0]])
    tau, stiffness, _, _ = np.linalg.lstsq(columns, integral(F), rcond=None)[0]
    return (float(tau), float(stiffness)) if tau > 0 and stiffness > 0 else (math.nan, math.nan)
