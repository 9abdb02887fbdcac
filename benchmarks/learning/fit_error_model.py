"""`mjtactile bench error-model`: fitted error model of a sensing pipeline, for `--effects
-mesh,-pipeline`.

Random objects are gripped with forces that vary from 0.05 to 2.2 N, and lifted. Images and the
whole chain run over quasi-static membranes. The estimate from each image is compared with the load
of the membrane. The model of `mjtactile/sim/sensing_error_model.py` is fitted to every other seed.
Errors sampled from it are checked on the seeds between. The written model is fitted to all
seeds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.accuracy.run import stamp
from benchmarks.learning.check_error_model import check
from benchmarks.learning.random_grasps import squeeze
from mjtactile.core.calibration_parts import fingerprint
from mjtactile.core.design import load_sensor
from mjtactile.core.errors import MjtactileError
from mjtactile.core.scenario import Scenario
from mjtactile.core.types import Array
from mjtactile.recording.files import write_json
from mjtactile.runtime.progress import Progress
from mjtactile.sensing.settings import DEFAULTS
from mjtactile.sim.sensing_error_model import SensingErrorModel, path_of

LOADS = np.array([0.0, 0.03, 0.1, 0.25, 0.5, 1.0, 1.6])
GRASPS, GRASPS_QUICK = 40, 2
FIRST_SEED = 6000  # evaluate and bench learning begin below
_PRESSED = 0.03  # minimum normal force for the fit of gains, N
_LAGS = 30  # images over which errors are followed
_OUTLIER = 5.0  # sd
_DRAGGED = 0.05  # minimum shear force for a grasp's shear gain, N
_MEDIAN = 0.6745  # median magnitude of a normal variable, over its sd
_LOADED = 0.1  # minimum normal force for a grasp's own error factor, N
_FEW = 30
"""Minimum number of images at a load for a fit to these images alone."""
_FEW_OF_GRASP, _FEW_GRASPS = 8, 16  # images of a grasp at a load, and grasps
_GOES_WITH = ([], [], [], [3, 1], [4, 0], [5])
"""Wrench components that the mean error of each component is proportional to; the shear error is
specific to each grasp."""
_RIDGE = 0.01
WORLDS = {"errors": "none", "varied": "default"}
"""Name of a set of errors in the file, and the randomization during its measurement."""

Rows = dict[str, Array]
Notify = Callable[[str], None]


def run(
    out: Path, *, quick: bool = False, sensor: str = "dense", notify: Notify | None = None
) -> dict[str, Any]:
    """Fit and write the error model of a design, and check it on the other half of the seeds."""
    notify = notify or Progress().message
    design = load_sensor(sensor)
    count = GRASPS_QUICK if quick else GRASPS
    table: dict[str, Any] = {
        "sensor": design.name,
        "fingerprint": fingerprint(design),
        "stamp": stamp(),
    }
    checks = {}
    for name, randomization in WORLDS.items():
        grasps = list(_grasps(sensor, randomization, count, notify))
        fitted, checked = grasps[::2], grasps[1::2]
        checks[name] = check(fit(joined(fitted)), joined(checked)) | {"grasps": len(grasps)}
        table[name] = fit(joined(grasps)).table()
    write_json(out / f"{design.name}.json", table)
    if not quick:
        write_json(path_of(design), table)
    return {"sensor": design.name, "file": table, "checks": checks}


def _grasps(sensor: str, randomization: str, count: int, notify: Notify) -> Iterator[Rows]:
    for seed in range(FIRST_SEED, FIRST_SEED + count):
        notify(f"--randomization {randomization}, grasp {seed - FIRST_SEED + 1} of {count}")
        scenario = Scenario(
            object=f"random:{seed}",
            seed=seed,
            sensor=sensor,
            randomization=randomization,
            effects="-mesh,-images",
        )
        try:
            yield squeeze(scenario)
        except MjtactileError as error:
            notify(f"seed {seed}: {error}")


def joined(grasps: Sequence[Rows]) -> Rows:
    """Concatenate the rows of several grasps."""
    return {name: np.concatenate([grasp[name] for grasp in grasps]) for name in grasps[0]}


# -- fit -------------------------------------------------------------------------------------------


def fit(rows: Rows) -> SensingErrorModel:
    """Fit the error model of the pipeline that produced these rows."""
    known = np.asarray(rows["status"] == "ok")
    load = np.maximum(-rows["wrench"][:, 2], 0.0)
    fraction = _shares(load)
    estimated = _taken(rows, known)
    near = fraction[known]
    error = estimated["estimated"] - estimated["wrench"]
    gain = _gain(estimated["wrench"], error)
    own, shear_gain = _shear_gains(estimated["wrench"], error, estimated)
    left = error - estimated["wrench"] @ gain.T
    left[:, :2] -= own[:, None] * estimated["wrench"][:, :2]
    mean, sd, between, spread = _by_grasps(left, near, estimated)
    z = (left - near @ mean) / (near @ sd) / between[:, None]
    far = np.asarray((np.abs(z) > _OUTLIER).any(axis=1))
    deviation, average = _alone(left, estimated)
    # white noise: var(b - (a + c) / 2) is 3/2 of var(b)
    noise = _median_at(np.abs(deviation.mean(axis=0)), near[average]) / _MEDIAN / math.sqrt(1.5)
    fresh = np.minimum(noise, sd)
    # a lasting step is no single error
    jumps = np.where(deviation[0] * deviation[1] > 0, np.abs(deviation).min(axis=0), 0.0)
    jumps = jumps / (near[average] @ fresh)
    out = np.asarray((jumps > _OUTLIER).any(axis=1))
    reported = np.sqrt(np.diagonal(estimated["cov"], axis1=1, axis2=2))
    ratio = estimated["cov"] / (reported[:, :, None] * reported[:, None])
    touching = estimated["touching"] & (estimated["area"] > 0) & (estimated["estimated_area"] > 0)
    log_area = np.log(estimated["estimated_area"][touching] / estimated["area"][touching])
    aside = (estimated["estimated_centroid"] - estimated["centroid"])[touching]
    area, area_sd = _moments(log_area[:, None], near[touching])
    _, centroid_sd = _moments(aside.reshape(-1, 1), np.repeat(near[touching], 2, axis=0))
    zero = DEFAULTS.zero
    return SensingErrorModel(
        loads=LOADS,
        gain=gain,
        mean=mean,
        sd=sd,
        fresh=fresh,
        correlation=_correlation(z[~far]),
        reported_sd=_mean_at(reported, near),
        reported_correlation=_correlation_of(np.median(ratio, axis=0)),
        shear_gain=shear_gain,
        between=spread,
        slow_time=_memory(z, estimated),
        outliers=_mean_at(out[:, None].astype(float), near[average])[:, 0],
        outlier_size=np.maximum(np.sqrt(np.mean(jumps[out] ** 2, axis=0)), 1.0)
        if out.any()
        else np.ones(6),
        unknown=_mean_at(1.0 - known[:, None], fraction)[:, 0],
        touch_force=max(zero.touch_min, zero.touch_sd * float(fresh[0, 2])),
        release=zero.release,
        area=area[:, 0],
        area_sd=area_sd[:, 0],
        centroid_sd=centroid_sd[:, 0],
        depth=float(
            np.median(
                (estimated["estimated_depth"] / np.maximum(estimated["depth"], 1e-6))[touching]
            )
        ),
        slip_displacement=DEFAULTS.slip.min_displacement,
        incipient=DEFAULTS.slip.incipient,
    )


def _taken(rows: Rows, which: Array) -> Rows:
    return {name: values[which] for name, values in rows.items()}


def _shares(load: Array) -> Array:
    """Return the weight (n, k) of each row at each of LOADS: 1 at the load, 0 at the next."""
    at = np.clip(load, LOADS[0], LOADS[-1])
    return np.stack([np.interp(at, LOADS, item) for item in np.eye(len(LOADS))], axis=1)


def _gain(true: Array, error: Array) -> Array:
    """Return the gains (6, 6) of the error per unit of wrench, under load.

    Each component depends on its own true value. A torque also depends on the shear across it,
    through a lever. The fit is least squares, each row divided by its force. The normal force's
    gain is left to its mean at each load.
    """
    pressed = -true[:, 2] > _PRESSED
    size = np.maximum(-true[pressed, 2], 0.1)[:, None]
    a = true[pressed] / size
    b = error[pressed] / size
    gain = np.zeros((6, 6))
    for part, by in enumerate(_GOES_WITH):
        if by and len(a):
            scale = np.maximum(np.sqrt((a[:, by] ** 2).mean(axis=0)), 1e-9)
            columns = a[:, by] / scale
            normal = columns.T @ columns + _RIDGE * len(a) * np.eye(len(by))
            gain[part, by] = np.linalg.solve(normal, columns.T @ b[:, part]) / scale
    return gain


def _shear_gains(true: Array, error: Array, rows: Rows) -> tuple[Array, float]:
    """Return the relative shear error (n,) of each row's grasp and finger, and its sd between
    grasps.

    It lasts for the whole grasp. Both values are medians, since an edge may cancel the error for a
    while. The median is not due to the pipeline alone: the friction of a quasi-static membrane
    agrees with that of a mesh within 4 to 9 % (X7).
    """
    drag = np.linalg.norm(true[:, :2], axis=1)
    along = (error[:, :2] * true[:, :2]).sum(axis=1) / np.maximum(drag, 1e-9) ** 2
    is_informative = (drag > _DRAGGED) & (-true[:, 2] > _LOADED)
    gains = np.full(len(true), np.nan)
    found = []
    for own in _each(rows):
        if (own & is_informative).sum() >= _FEW:
            gains[own] = np.median(along[own & is_informative])
            found.append(gains[own][0])
    if not found:
        return np.zeros(len(true)), 0.0
    typical = float(np.median(found))
    sd = float(np.median(np.abs(np.array(found) - typical))) / _MEDIAN
    return np.where(np.isnan(gains), typical, gains), sd


def _mean_at(values: Array, fraction: Array) -> Array:
    """Return the mean (k, m) of `values` (n, m) at each load.

    A load with too few images gets the mean of the nearest load with enough.
    """
    weight = fraction.sum(axis=0)
    mean = fraction.T @ values / np.maximum(weight, 1e-9)[:, None]
    enough = np.flatnonzero(weight >= _FEW)
    if not len(enough):
        return np.repeat(values.mean(axis=0, keepdims=True), len(LOADS), axis=0)
    nearest = [enough[np.abs(enough - k).argmin()] for k in range(len(LOADS))]
    return mean[nearest]


def _moments(values: Array, fraction: Array) -> tuple[Array, Array]:
    """Return mean and standard deviation (k, m) at each load."""
    mean = _mean_at(values, fraction)
    off = values - fraction @ mean
    return mean, np.maximum(np.sqrt(_mean_at(off**2, fraction)), 1e-9)


def _by_grasps(left: Array, near: Array, rows: Rows) -> tuple[Array, Array, Array, Array]:
    """Return the moments of a typical grasp, medians over grasps and fingers.

    A few grasps have ten times the usual error, mostly under high pressure. Without medians they
    would dominate the samples.

    Returns:
        Mean and sd (k, 6) at each load, the factor (n,) of each row's grasp, and at each load the
        standard deviation (k,) of a factor's logarithm. The squared factor has mean one for a
        log-normal factor.
    """
    mean = _typical(left, near, rows, _mean)
    mean[:, :2] = 0.0  # gravity acts in the same direction on all objects: it would be a gain
    off = left - near @ mean
    sd = np.maximum(_typical(off, near, rows, _root_mean_square), 1e-9)
    z = off / (near @ sd)
    spread = _typical(z, near, rows, _logarithm, np.std)[:, 0]
    spread[0] = 0.0  # errors without a load have no factor
    rms = np.exp(spread**2)  # rms of a log-normal factor over its median
    return mean, rms[:, None] * sd, _between(z, rows) / (near @ rms), spread


def _typical(
    values: Array,
    fraction: Array,
    rows: Rows,
    of: Callable[[Array], Array],
    over: Callable[..., Any] = np.median,
) -> Array:
    """Return the median (k, m), or the statistic `over`, of grasps and fingers at each load.

    `of` reduces the `values` (n, m) of one grasp. A load with too few grasps gets the result of the
    nearest load with enough.
    """
    nearest = fraction.argmax(axis=1)
    found: list[Array | None] = []
    for k in range(len(LOADS)):
        own = [values[which & (nearest == k)] for which in _each(rows)]
        values_of = [of(item) for item in own if len(item) >= _FEW_OF_GRASP]
        found.append(over(values_of, axis=0) if len(values_of) >= _FEW_GRASPS else None)
    enough = np.array([k for k, one in enumerate(found) if one is not None])
    if not len(enough):
        return np.repeat(of(values)[None], len(LOADS), axis=0)
    return np.array([found[enough[np.abs(enough - k).argmin()]] for k in range(len(LOADS))])


def _each(rows: Rows) -> Iterator[Array]:
    """Yield the mask (n,) of the rows of each grasp and finger."""
    for seed in np.unique(rows["seed"]):
        for finger in np.unique(rows["finger"]):
            own = (rows["seed"] == seed) & (rows["finger"] == finger)
            if own.any():
                yield own


def _mean(values: Array) -> Array:
    return values.mean(axis=0)


def _logarithm(values: Array) -> Array:
    return np.log(np.sqrt(np.mean(values**2, keepdims=True)))[0]


def _root_mean_square(values: Array) -> Array:
    return np.sqrt(np.mean(values**2, axis=0))


def _between(z: Array, rows: Rows) -> Array:
    """Return for each row (n,) the rms value of its grasp and finger, over the loaded rows."""
    factors = np.ones(len(z))
    pressed = -rows["wrench"][:, 2] > _LOADED
    for own in _each(rows):
        if (own & pressed).sum() >= _FEW:
            factors[own] = math.sqrt(float(np.mean(z[own & pressed] ** 2)))
    return factors


def _correlation(z: Array) -> Array:
    return _correlation_of(z.T @ z / len(z))


def _correlation_of(cov: Array) -> Array:
    """Return the nearest positive definite correlation matrix, with ones on its diagonal."""
    sd = np.sqrt(np.diag(cov))
    values, vectors = np.linalg.eigh(cov / np.outer(sd, sd))
    positive = (vectors * np.maximum(values, 1e-3)) @ vectors.T
    sd = np.sqrt(np.diag(positive))
    return positive / np.outer(sd, sd)


def _alone(left: Array, rows: Rows) -> tuple[Array, Array]:
    """Compute the difference of each image's errors (n, 6) from those of its neighbors.

    Returns:
        (2, m, 6) error minus that of the previous image, and minus that of the next; and the
        indices (m,) of the rows: those with two neighbors.
    """
    found = []
    inner = []
    for which in _each(rows):
        own = np.flatnonzero(which)
        here = left[own[1:-1]]
        found.append(np.stack([here - left[own[:-2]], here - left[own[2:]]]))
        inner.append(own[1:-1])
    return np.concatenate(found, axis=1), np.concatenate(inner)


def _median_at(values: Array, fraction: Array) -> Array:
    """Return the median (k, m) of `values` (n, m) over the images nearest to each load.

    A load with too few images gets the median of the nearest load with enough.
    """
    nearest = fraction.argmax(axis=1)
    counts = np.bincount(nearest, minlength=len(LOADS))
    enough = np.flatnonzero(counts >= _FEW)
    if not len(enough):
        return np.repeat(np.median(values, axis=0, keepdims=True), len(LOADS), axis=0)
    taken = [enough[np.abs(enough - k).argmin()] for k in range(len(LOADS))]
    return np.array([np.median(values[nearest == k], axis=0) for k in taken])


def _memory(z: Array, rows: Rows) -> float:
    """Return the time constant T, s, of the lasting part of the error.

    The autocorrelation of z over a second is fitted by s exp(-t/T).
    """
    sums = np.zeros(_LAGS + 1)
    counts = np.zeros(_LAGS + 1)
    z = np.clip(z, -_OUTLIER, _OUTLIER)
    period = 1.0
    for own in _each(rows):
        series = z[own]
        if len(series) < 2:
            continue
        period = float(np.median(np.diff(rows["time"][own])))
        for lag in range(min(_LAGS, len(series) - 1) + 1):
            product = series[lag:] * series[: len(series) - lag]
            sums[lag] += product.sum()
            counts[lag] += product.size
    lags = np.arange(1, _LAGS + 1)
    correlation = np.clip(sums / np.maximum(counts, 1) / (sums[0] / counts[0]), 0.01, 1.0)[1:]
    slope, _ = np.polyfit(lags * period, np.log(correlation), 1, w=np.sqrt(correlation))
    return float(1 / max(-slope, 0.1))


# -- table -----------------------------------------------------------------------------------------


def table(result: dict[str, Any]) -> str:
    """Format the check as a Markdown table."""
    grasps = " and ".join(str(check["grasps"]) for check in result["checks"].values())
    words = {"errors": "nominal", "varied": "`--randomization default`"}
    lines = [
        f"`{result['sensor']}`, {grasps} grasps. Every other one is used for the fit, the rest for "
        "the table. Normal force: rms error of the pipeline / of the sampled touch. Ratios: error "
        "/ sd of the model at that load.",
        "",
        "| sensor | load, N | images | force error, mN | force ratio | shear ratio | torque ratio "
        "|",
        "|---" * 7 + "|",
    ]
    for name, checked in result["checks"].items():
        lines += [
            f"| {words[name]} | {row['from_N']:g}-{row['to_N']:g} | {row['images']} "
            f"| {row['force_rms_mN']:.1f} / {row['sampled_rms_mN']:.1f} | {row['force_ratio']:.2f} "
            f"| {row['shear_ratio']:.2f} | {row['torque_ratio']:.2f} |"
            for row in checked["rows"]
        ]
    return "\n".join(lines) + "\n"
