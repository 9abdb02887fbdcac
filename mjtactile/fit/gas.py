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
from mjtactile.fit.gauss_newton import Scale, differences, gauss_newton
from mjtactile.fit.measurements import Evidence
from mjtactile.fit.membrane_fit import Simulated, is_fast
from mjtactile.sim.sensor.gas import ChamberGas

_OUTLIER = 3.0  # sd: from there on a reading counts less
SHIFT_SD = 5.0  # standard deviation of a constant pressure error of a run, Pa
SHARED = 5.0  # neighbouring pressures that are wrong alike, by the volume's errors
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

    The gas starts with the run's first pressure and first volume, at wall temperature.
    """
    gas = ChamberGas(design.chamber)
    flat = design.chamber_volume_flat
    gas.seal(flat + float(run.volume[0]), float(np.median(run.pressure[:10])))
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
    modes: Sequence[Array] = (),
    iterations: int = 8,
) -> GasFit:
    """Fit the parameters in NAMES that are not `known` (SI values by name), starting at `design`.

    `models` replaces `predict` for each run. `modes` (k, time) are further pressure errors, each
    scaled to one sd, Pa.
    """
    chamber = replace(design.chamber, **known)
    names = tuple(
        name
        for name in NAMES
        if name not in known
        and not (name == "heat_exchange" and known.get("polytropic_exponent") == 1)
    )
    begin = {
        "polytropic_exponent": max(chamber.polytropic_exponent, 1.2),
        "heat_exchange": min(chamber.heat_exchange, 1.0),
    }
    chamber = replace(chamber, **{name: value for name, value in begin.items() if name in names})
    modes = modes or [np.empty((0, len(run.time))) for run in runs]
    return _Problem(
        replace(design, chamber=chamber), runs, names, models or [predict] * len(runs), modes
    ).solve(iterations)


class _Problem:
    """Least-squares problem of the gas fit.

    The first unknowns x are the gas parameters (see `Scale`). The others are the amplitudes, in sd,
    of each run's pressure error modes. These modes are a constant and the given modes.
    """

    def __init__(
        self,
        design: SensorDesign,
        runs: Sequence[Sealed],
        names: tuple[str, ...],
        models: Sequence[Model],
        modes: Sequence[Array],
    ):
        self.design = design
        self.runs = runs
        self.names = names
        self._models = models
        self._modes = [
            np.vstack([np.full(len(run.time), SHIFT_SD), more])
            for run, more in zip(runs, modes, strict=True)
        ]
        self._mode_count = sum(len(mode) for mode in self._modes)
        empty = design.chamber_volume_flat - design.chamber.extra_volume
        scales = {
            "extra_volume": Scale(-0.95 * empty, 1e3 * empty, 0.1 * empty, 0.1),
            "polytropic_exponent": Scale(1.0, 1.7, 0.2, 0.05),
            "heat_exchange": Scale(0.02, 100.0, step=0.05),
            "leak_conductance": Scale(0.0, 1e-6, 1e-11, 0.1),
        }
        self._scales = [scales[name] for name in names]
        self._nominal = [getattr(design.chamber, name) for name in names]
        self._sd = [1.0] * len(runs)
        self._last = (np.empty(0), [np.empty(0)])

    def solve(self, iterations: int) -> GasFit:
        ends = [
            (s.scaled(s.low, v), s.scaled(s.high, v))
            for s, v in zip(self._scales, self._nominal, strict=True)
        ]
        low, high = np.array([*ends, *[(-np.inf, np.inf)] * self._mode_count]).reshape(-1, 2).T
        steps = np.array([*(s.step for s in self._scales), *[1.0] * self._mode_count])
        n = len(self.names)
        x = np.zeros(len(low))
        rounds = 2 if iterations > 3 else 1
        for _ in range(rounds):  # repeated with the estimated noise
            pairs = zip(self.pressures(x), self.runs, strict=True)
            self._sd = [_noise(pressure - run.pressure) for pressure, run in pairs]
            found = gauss_newton(
                self.residuals,
                differences(self.residuals, steps),
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
        cov = np.linalg.inv(found.information)[:n, :n] * np.outer(slopes, slopes)  # pyright: ignore[reportPossiblyUnboundVariable]
        return GasFit(
            values, cov, self.names, tuple(self._sd), tuple(self.runs), tuple(self._moved(x))
        )

    def values(self, x: Array) -> dict[str, float]:
        return {
            name: s.value(float(v), nominal)
            for name, s, v, nominal in zip(self.names, self._scales, x, self._nominal, strict=False)
        }

    def pressures(self, x: Array) -> list[Array]:
        n = len(self.names)
        if not np.array_equal(self._last[0], x[:n]) or not len(self._last[1]):
            made = replace(self.design, chamber=replace(self.design.chamber, **self.values(x)))
            self._last = (
                x[:n].copy(),
                [model(made, run) for model, run in zip(self._models, self.runs, strict=True)],
            )
        return self._last[1]

    def _moved(self, x: Array) -> list[Array]:
        """Pressures with the modes' parts."""
        parts = np.split(x[len(self.names) :], np.cumsum([len(mode) for mode in self._modes])[:-1])
        return [
            p + part @ mode
            for p, part, mode in zip(self.pressures(x), parts, self._modes, strict=True)
        ]

    def residuals(self, x: Array) -> Array:
        """Return the residuals in sd, with Huber weights.

        Neighboring pressures have a common model error. The residuals are therefore divided by
        sqrt(SHARED).
        """
        n = len(self.names)
        runs = zip(self._moved(x), self.runs, self._sd, strict=True)
        z = np.concatenate([(pressure - run.pressure) / sd for pressure, run, sd in runs])
        z = np.sign(z) * np.sqrt(
            np.where(np.abs(z) < _OUTLIER, z**2, _OUTLIER * (2 * np.abs(z) - _OUTLIER))
        )
        return np.concatenate([z / math.sqrt(SHARED), PRIOR * x[:n], x[n:]])


def _noise(left: Array) -> float:
    """Compute the robust standard deviation of residuals without their median; at least 1 Pa."""
    left = left - np.median(left)
    # median of a squared normal variable
    return max(1.0, float(np.sqrt(np.median(left**2) / 0.4549)))
