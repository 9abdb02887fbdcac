"""Gas fit: amount, leak and heat exchange of the gas, from pressure and volume over time.

Amount and temperature of the closed chamber's gas follow the simulator's model
(`mjtactile.sim.sensor.gas.ChamberGas`, docs/theory/gas.md, G1 and G4-G6). Its input is the volume
measured by the markers. Its pressures are fitted to those of the pressure sensor.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array
from mjtactile.fit.gauss_newton import Scale, Solution, gauss_newton
from mjtactile.fit.measurements import Evidence
from mjtactile.fit.membrane_fit import is_fast
from mjtactile.fit.simulated_holds import Simulated
from mjtactile.sim.sensor.gas import ChamberGas

_OUTLIER = 3.0  # residual, in sd, above which the weight of a reading decreases
_START = 10  # readings that determine the start of a run
SHIFT_SD = 5.0  # standard deviation of a constant pressure error of a run, Pa
# minimum number of neighboring pressures with the same error, by the volume's errors; more if the
# residuals are correlated over a longer time
SHARED = 5.0
_UNCORRELATED = 0.05  # autocorrelation below which residuals count as independent
PRIOR = 0.1  # 1/sd of the scaled parameters without measurements
_ML = 1e-6
NAMES = ("extra_volume", "polytropic_exponent", "heat_exchange", "leak_conductance")


@dataclass(frozen=True, eq=False)
class Sealed:
    """A chamber with its valve closed: `time` s, gauge `pressure` Pa, `volume` m^3 under the
    membrane."""

    name: str
    time: Array
    pressure: Array
    volume: Array


@dataclass(frozen=True, eq=False)
class GasFit:
    """Result of the gas fit.

    `values` by name in SI, and their `cov` in the order of `names`. `noise_sd` is the residual of
    each run's pressures, Pa; `fitted` are the predicted gauge pressures, Pa.
    """

    values: Mapping[str, float]
    cov: Array
    names: tuple[str, ...]
    noise_sd: tuple[float, ...]
    runs: tuple[Sealed, ...]
    fitted: tuple[Array, ...]


def sealed_runs(
    evidence: Sequence[Evidence], simulated: Sequence[Sequence[Simulated]]
) -> list[Sealed]:
    """Return pressure and volume of each recording with a pressure sensor.

    The volume under the smoothed surface omits a small part. That part lies between the outermost
    markers, the frame and the edge of an indentation. A correction is fitted to the simulated
    holds. It is a function of this volume and of the pressure, which grows with the indentation
    depth.
    """
    runs = [e for e in evidence if e.has_pressure and len(e.series.time) > 10]
    smooth = []
    true = []
    for e, holds in zip(evidence, simulated, strict=True):
        for hold, sim in zip(e.holds, holds[1:], strict=True):
            if is_fast(hold):  # simulated as if it had been slow
                continue
            volume = float(np.interp(hold.time, e.series.time, e.series.volume)) / _ML
            smooth.append([1.0, volume, hold.pressure / 1e3])
            true.append(sim.volume)
    rows = np.array([row for row in smooth if math.isfinite(row[2])]).reshape(-1, 3)
    requested = np.array([v for v, row in zip(true, smooth, strict=True) if math.isfinite(row[2])])
    # few holds: the smooth volume as it is
    prior = np.diag(np.sqrt(len(rows) + 1) * 1e-2 * np.array([0.0, 1.0, 1.0]))
    weights = np.linalg.lstsq(
        np.vstack([rows, prior]),
        np.concatenate([requested / _ML - rows[:, 1], np.zeros(3)]),
        rcond=None,
    )[0]

    def corrected(e: Evidence) -> Array:
        p = e.series.pressure / 1e3
        v = e.series.volume / _ML
        return _ML * (v + weights[0] + weights[1] * v + weights[2] * p)

    return [Sealed(e.name, e.series.time, e.series.pressure, corrected(e)) for e in runs]


def predict(design: SensorDesign, run: Sealed) -> Array:
    """Return the gauge pressures, Pa, of the sealed gas over a run.

    The gas starts with the median of the run's first pressures and volumes, at wall temperature.
    """
    gas = ChamberGas(design.chamber)
    flat = design.chamber_volume_flat
    first = slice(_START)
    gas.seal(flat + float(np.median(run.volume[first])), float(np.median(run.pressure[first])))
    pressures = [gas.gauge_pressure]
    before = float(run.time[0])
    for time, volume in zip(run.time[1:].tolist(), run.volume[1:].tolist(), strict=True):
        gas.advance(flat + volume, time - before)
        pressures.append(gas.gauge_pressure)
        before = time
    return np.array(pressures)


Model = Callable[[SensorDesign, Sealed], Array]
"""Gauge pressures, Pa, of a sensor in a run."""


def fit_gas(
    design: SensorDesign,
    runs: Sequence[Sealed],
    *,
    known: Mapping[str, float],
    models: Sequence[Model] = (),
    modes: Sequence[Sequence[Array]] = (),
    iterations: int = 8,
) -> GasFit:
    """Fit the parameters in NAMES that are not `known` (SI values by name), starting at `design`.

    `models` replaces `predict` for each run. `modes` are further pressure errors, each scaled to
    one sd, Pa: an array for each run, (time,). Errors of one mode are common to its runs.
    """
    chamber = replace(design.chamber, **known)
    names = tuple(
        name
        for name in NAMES
        if name not in known
        and not (name == "heat_exchange" and known.get("polytropic_exponent") == 1)
    )
    start = {
        "polytropic_exponent": max(chamber.polytropic_exponent, 1.2),
        "heat_exchange": min(chamber.heat_exchange, 1.0),
    }
    chamber = replace(chamber, **{name: value for name, value in start.items() if name in names})
    return _Problem(
        replace(design, chamber=chamber), runs, names, models or [predict] * len(runs), modes
    ).solve(iterations)


class _Problem:
    """Least-squares problem of the gas fit.

    The first unknowns x are the gas parameters (see `Scale`). The others are the amplitudes, in sd,
    of the pressure error modes. These modes are a constant of each run and the given modes.
    """

    def __init__(
        self,
        design: SensorDesign,
        runs: Sequence[Sealed],
        names: tuple[str, ...],
        models: Sequence[Model],
        modes: Sequence[Sequence[Array]],
    ):
        self.design = design
        self.runs = runs
        self.names = names
        self._models = models
        self._ends = np.cumsum([len(run.time) for run in runs])
        constants = [
            [np.full(len(run.time), SHIFT_SD * (run is item)) for run in runs] for item in runs
        ]
        self._modes = np.array([np.concatenate(mode) for mode in (*constants, *modes)])
        empty = design.chamber_volume_flat - design.chamber.extra_volume
        scales = {
            "extra_volume": Scale(-0.95 * empty, 1e3 * empty, 0.1 * empty, 0.1),
            "polytropic_exponent": Scale(1.0, 1.7, 0.2, 0.05),
            "heat_exchange": Scale(0.02, 100.0, step=0.05),
            "leak_conductance": Scale(0.0, 1e-6, 1e-11, 0.1),
        }
        self._scales = [scales[name] for name in names]
        self._nominal = [getattr(design.chamber, name) for name in names]
        self._noise = [1.0] * len(runs)
        self._sd = np.ones(self._ends[-1])
        self._known: dict[bytes, list[Array]] = {}

    def solve(self, iterations: int) -> GasFit:
        ends = [
            (s.scaled(s.low, v), s.scaled(s.high, v))
            for s, v in zip(self._scales, self._nominal, strict=True)
        ]
        count = len(self._modes)
        low, high = np.array([*ends, *[(-np.inf, np.inf)] * count]).reshape(-1, 2).T
        n = len(self.names)
        x = np.zeros(len(low))
        rounds = 2 if iterations > 3 else 1
        for _ in range(rounds):  # repeated with the estimated noise
            self._noise, self._sd = self._errors(x)
            found = gauss_newton(
                self.residuals,
                self.jacobian,
                x,
                low=low,
                high=high,
                iterations=iterations // rounds,
            )
            x = found.x
        values = self.values(x)
        slopes = np.array(
            [s.slope(values[name]) for s, name in zip(self._scales, self.names, strict=True)]
        )
        cov = self._covariance(found)[:n, :n] * np.outer(slopes, slopes)  # pyright: ignore[reportPossiblyUnboundVariable]
        noise, _ = self._errors(x)
        return GasFit(
            values,
            cov,
            self.names,
            tuple(noise),
            tuple(self.runs),
            tuple(self._shifted_pressures(x)),
        )

    def _errors(self, x: Array) -> tuple[list[float], Array]:
        """Return the noise of each run, Pa, and the sd of each pressure, (time of all runs,) Pa.

        The sd is that of an independent pressure: it has the effect of the correlated ones.
        """
        noise = []
        sds = []
        for pressure, run in zip(self._shifted_pressures(x), self.runs, strict=True):
            left = pressure - run.pressure
            noise.append(_noise(left))
            sd = noise[-1] * math.sqrt(_correlated_count(_limited(left / noise[-1])))
            sds.append(np.full(len(left), sd))
        return noise, np.concatenate(sds)

    def _covariance(self, found: Solution) -> Array:
        """Return the covariance of the unknowns, with the errors of the final residuals.

        A misfit above these errors scales it.
        """
        _, sd = self._errors(found.x)
        jacobian = found.jacobian.copy()
        jacobian[: len(sd)] *= (self._sd / sd)[:, None]
        left = np.concatenate(self._shifted_pressures(found.x)) - np.concatenate(
            [run.pressure for run in self.runs]
        )
        parts = np.split(left, self._ends[:-1])
        z = np.concatenate([_limited(part / _noise(part)) for part in parts])
        misfit = max(1.0, float(np.mean(z**2)))
        return misfit * np.linalg.inv(jacobian.T @ jacobian)

    def values(self, x: Array) -> dict[str, float]:
        return {
            name: s.value(float(v), nominal)
            for name, s, v, nominal in zip(self.names, self._scales, x, self._nominal, strict=False)
        }

    def pressures(self, x: Array) -> list[Array]:
        n = len(self.names)
        key = x[:n].tobytes()
        if key not in self._known:
            made = replace(self.design, chamber=replace(self.design.chamber, **self.values(x)))
            self._known[key] = [
                model(made, run) for model, run in zip(self._models, self.runs, strict=True)
            ]
        return self._known[key]

    def _shifted_pressures(self, x: Array) -> list[Array]:
        """Return the pressures with the modes' parts."""
        moved = np.concatenate(self.pressures(x)) + x[len(self.names) :] @ self._modes
        return np.split(moved, self._ends[:-1])

    def residuals(self, x: Array) -> Array:
        """Return the residuals in sd, with Huber weights."""
        n = len(self.names)
        runs = zip(self._shifted_pressures(x), self.runs, self._noise, strict=True)
        z = np.concatenate([_limited((p - run.pressure) / noise) for p, run, noise in runs])
        noise = np.repeat(self._noise, np.diff(self._ends, prepend=0))
        return np.concatenate([z * noise / self._sd, PRIOR * x[:n], x[n:]])

    def jacobian(self, x: Array, _: Array) -> Array:
        """Return the derivative of `residuals`.

        Differences of pressures, which are smooth, times the slope of Huber's loss: differences of
        limited residuals would contain their noise, and count it as information.
        """
        n = len(self.names)
        pressures = np.concatenate(self.pressures(x))
        columns = []
        for i, scale in enumerate(self._scales):
            moved = x.copy()
            moved[i] += scale.step
            columns.append((np.concatenate(self.pressures(moved)) - pressures) / scale.step)
        noise = np.repeat(self._noise, np.diff(self._ends, prepend=0))
        recorded = np.concatenate([run.pressure for run in self.runs])
        size = np.abs(_limited((np.concatenate(self._shifted_pressures(x)) - recorded) / noise))
        slope = np.where(size < _OUTLIER, 1.0, _OUTLIER / np.maximum(size, _OUTLIER))
        rows = (slope / self._sd)[:, None] * np.column_stack([*columns, self._modes.T])
        priors = np.diag([PRIOR] * n + [1.0] * len(self._modes))
        return np.vstack([rows, priors])


def _limited(z: Array) -> Array:
    """Return residuals, in sd, whose squares are Huber's loss."""
    size = np.abs(z)
    return np.sign(z) * np.sqrt(np.where(size < _OUTLIER, z**2, _OUTLIER * (2 * size - _OUTLIER)))


def _correlated_count(z: Array) -> float:
    """Return the number of neighboring residuals that count as one: the integrated
    autocorrelation."""
    z = z - z.mean()
    variance = float(z @ z)
    count = 1.0
    for lag in range(1, len(z) // 4):
        rho = float(z[lag:] @ z[:-lag]) / max(variance, 1e-12)
        if rho < _UNCORRELATED:
            break
        count += 2 * rho
    return max(count, SHARED)


def _noise(left: Array) -> float:
    """Compute the robust standard deviation of residuals without their median; at least 1 Pa."""
    left = left - np.median(left)
    # median of a squared normal variable
    return max(1.0, float(np.sqrt(np.median(left**2) / 0.4549)))
