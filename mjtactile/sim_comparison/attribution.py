"""Attribution of a difference to the single cause that explains its largest fraction.

Each cause is simulated, and its effect is fitted to the difference by least squares. The difference
is expressed in tolerances (`signals.TOLERANCE`). Forces, markers and pressures have equal weight. S
is the sum over these kinds of the mean of (difference / tolerance)^2. Cause j has columns J_j (the
change per unit on finger f). Nuisance parameters have columns N and standard deviations s:

    S_j = min over a, n of |d - J_j a - N n|^2_W + |n / s|^2 / m,

with the number of kinds m. The cause with the smallest S_j is reported under two conditions. It
explains at least half of S, and it leaves clearly less than the nuisance parameters alone. The
simulator then runs with this cause. The reported remainder comes from that run, not from the linear
fit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mjtactile.core.errors import DeviceError, SimulationError
from mjtactile.core.types import Array
from mjtactile.sim_comparison.discrepancy_parameters import DiscrepancyParameter
from mjtactile.sim_comparison.signals import KINDS, TOLERANCE, Signals, differences

POINTS = 90
"""Number of times at which rigs are compared."""
_MIN_EXPLAINED = 0.5
_LESS_LEFT = 0.6
"""Maximum remainder with a reported cause, as a fraction of the remainder without a cause."""
_CONTENDERS = 3
"""Number of causes tested in the simulator, if they explain about as much as the best."""
_NEAR = 0.08
_ALIKE = 0.03
"""Differences in explained fraction below which causes count as close, and as indistinguishable."""

Simulate = Callable[[Mapping[str, Sequence[float]]], Signals]
"""Simulation of given amounts of the causes. Raises DeviceError or SimulationError."""
_Run = Callable[[Mapping[str, Sequence[float]]], Signals | None]


@dataclass(frozen=True)
class TestedParameter:
    """Cause with `amounts` per finger, SI, their sd, and explained fraction, in all."""

    cause: DiscrepancyParameter
    amounts: tuple[float, ...]
    sd: tuple[float, ...]
    explains: float


@dataclass(frozen=True, eq=False)
class SimComparison:
    """Comparison of a recording with its simulation.

    Attributes:
        recorded: Signals of the rig, at the compared times.
        simulated: Signals of the simulator.
        explained: Signals of the simulator with the reported cause; None without one.
        differences: Rms difference of each kind and finger, SI.
        left: Rms difference between `recorded` and `explained`.
        tried: All causes, in order of decreasing explained fraction.
        named: The reported cause; None if nothing differs or no single cause explains the
            difference.
        differs: True if any kind differs by more than its tolerance.
        alike: Other causes with the same explained fraction, which the recording cannot
            distinguish.
        allowed: Amounts of the nuisance parameters, by cause, SI.
        explains: Fraction of the difference that the simulation with the cause removes.
    """

    recorded: Signals
    simulated: Signals
    explained: Signals | None
    differences: Mapping[str, Array]
    left: Mapping[str, Array]
    tried: tuple[TestedParameter, ...]
    named: TestedParameter | None
    differs: bool
    alike: tuple[TestedParameter, ...] = ()
    allowed: Mapping[str, float] = field(default_factory=dict)
    explains: float = 0.0


@dataclass(frozen=True, eq=False)
class _Rows:
    """Signals in units of their tolerances: mask of the finite values, and weights."""

    time: Array
    fingers: int
    known: Mapping[str, Array]
    weight: Mapping[str, Array]

    @classmethod
    def of(cls, signals: Sequence[Signals]) -> _Rows:
        """Create rows of the values that are finite in all `signals`."""
        known = {}
        weight = {}
        for kind in KINDS:
            is_finite_value = np.all([np.isfinite(signal.of(kind)) for signal in signals], axis=0)
            known[kind] = is_finite_value
            weight[kind] = np.sqrt(1.0 / max(int(is_finite_value.sum()), 1)) / TOLERANCE[kind]
        return cls(signals[0].time, signals[0].fingers, known, weight)

    def vector(self, signals: Signals, finger: int | None = None) -> Array:
        """Return all rows. With a `finger`, those of the others are zero."""
        parts = []
        for kind in KINDS:
            values = np.where(self.known[kind], signals.of(kind), 0.0) * self.weight[kind]
            if finger is not None:
                others = np.arange(values.shape[1]) != finger
                values[:, others] = 0.0
            parts.append(values[self.known[kind]])
        return np.concatenate(parts)


def compare_times(recorded: Signals, simulated: Signals) -> Array:
    """Return the times for which both have signals."""
    last = min(recorded.time[-1], simulated.time[-1])
    return np.linspace(0.0, last, min(POINTS, len(recorded.time)))


def explain(
    recorded: Signals,
    simulate: Simulate,
    causes: Sequence[DiscrepancyParameter],
    *,
    many: Callable[[Sequence[Mapping[str, Sequence[float]]]], Sequence[Signals | None]]
    | None = None,
    notify: Callable[[str], None] = lambda _: None,
) -> SimComparison:
    """Simulate the recording and, if it differs, simulate it with each cause.

    Args:
        recorded: Signals of the rig.
        simulate: Function that runs the simulator with amounts of causes.
        causes: Possible causes.
        many: Function for several runs, None for each failed one; without it runs are sequential.
        notify: Callback for progress messages.

    Returns:
        Both signals, their differences, and the cause that explains them.
    """
    plain = simulate({})
    time = compare_times(recorded, plain)
    there = recorded.at(time)
    here = plain.at(time)
    found = differences(there, here)
    tolerances = {kind: found[kind] / TOLERANCE[kind] for kind in KINDS}
    differs = any(np.nanmax(values, initial=0.0) > 1.0 for values in tolerances.values())
    if not differs:
        return SimComparison(there, here, None, found, {}, (), None, differs=False)
    notify(f"recording and simulation differ: {len(causes)} causes are tested")
    fingers = there.fingers
    asked = [{cause.name: (cause.probe,) * fingers} for cause in causes]
    run_all = many or (
        lambda requested: [attempted(simulate, parameter) for parameter in requested]
    )
    probes = [here if parameter is None else parameter.at(time) for parameter in run_all(asked)]
    tried, allowed = _tested_parameters(there, here, causes, probes, _shift(plain, time))
    checked = _contenders(tried, allowed, there, here, simulate, time)
    best = checked[0]
    linear = next(parameter for parameter in tried if parameter.cause is best.tried.cause)
    is_named = _is_named(best, linear, allowed[""]["left"])
    alike = [
        parameter.tried for parameter in checked[1:] if best.explains - parameter.explains < _ALIKE
    ]
    return SimComparison(
        there,
        here,
        best.signals if is_named else None,
        found,
        differences(there, best.signals) if is_named else {},
        tuple(tried),
        best.tried if is_named else None,
        differs=True,
        alike=tuple(alike) if is_named else (),
        allowed={k: v for k, v in allowed[linear.cause.name].items() if k != "left"},
        explains=best.explains,
    )


@dataclass(frozen=True, eq=False)
class _Checked:
    """A cause after simulation with its amount: resulting signals and explained fraction."""

    tried: TestedParameter
    signals: Signals
    explains: float


def _is_named(best: _Checked, linear: TestedParameter, left: float) -> bool:
    """Return True if a cause explains enough, both simulated and in the linear fit."""
    explains = min(best.explains, linear.explains) >= _MIN_EXPLAINED
    return explains and (linear.cause.spread > 0 or 1 - linear.explains <= _LESS_LEFT * left)


def _contenders(
    tried: Sequence[TestedParameter],
    allowed: Mapping[str, Mapping[str, float]],
    there: Signals,
    here: Signals,
    simulate: Simulate,
    time: Array,
) -> list[_Checked]:
    """Return the simulator's results with the causes that explain the most, the best first."""

    def run(amounts: Mapping[str, Sequence[float]]) -> Signals | None:
        signals = attempted(simulate, amounts)
        return None if signals is None else signals.at(time)

    checked = [
        _checked(parameter, allowed[parameter.cause.name], there, here, run)
        for parameter in tried[:_CONTENDERS]
        if parameter.explains >= tried[0].explains - _NEAR
    ]
    return sorted(checked, key=lambda parameter: -parameter.explains)


def _checked(
    parameter: TestedParameter,
    allowed: Mapping[str, float],
    there: Signals,
    here: Signals,
    run: _Run,
) -> _Checked:
    """Simulate the cause, and again with the amount that fits the difference best."""
    best = _Checked(parameter, here, 0.0)
    parameter = _on_each_finger(parameter, allowed, there, here, run)
    for _ in range(2):
        signals = run(_amounts(parameter, allowed))
        if signals is None:
            break
        rows = _Rows.of([there, here, signals])
        base = rows.vector(here)
        change = rows.vector(signals) - base
        target = rows.vector(there) - base
        explains = 1 - float(np.sum((target - change) ** 2) / (target @ target))
        if explains > best.explains or best.signals is here:
            best = _Checked(parameter, signals, explains)
        factor = float(np.clip(target @ change / max(change @ change, 1e-12), 0.3, 2.0))
        parameter = replace(
            parameter, amounts=tuple(factor * amount for amount in parameter.amounts)
        )
    return best


def _on_each_finger(
    parameter: TestedParameter,
    allowed: Mapping[str, float],
    there: Signals,
    here: Signals,
    run: _Run,
) -> TestedParameter:
    """Fit each finger's amount with its effect on all fingers, which share forces."""
    fingers = there.fingers
    if parameter.cause.on != "sensor" or fingers < 2:
        return parameter
    size = max(map(abs, parameter.amounts)) or parameter.cause.probe
    steps = [(0.0,) * fingers, *(tuple(row) for row in (size * np.eye(fingers)).tolist())]
    results = [run(_amounts(replace(parameter, amounts=step), allowed)) for step in steps]
    found = [signals for signals in results if signals is not None]
    if len(found) < len(steps):
        return parameter
    rows = _Rows.of([there, here, *found])
    base = rows.vector(found[0])
    columns = np.column_stack([(rows.vector(signals) - base) / size for signals in found[1:]])
    amounts, *_ = np.linalg.lstsq(columns, rows.vector(there) - base, rcond=None)
    return replace(parameter, amounts=tuple(np.maximum(amounts, parameter.cause.low).tolist()))


def attempted(simulate: Simulate, amounts: Mapping[str, Sequence[float]]) -> Signals | None:
    """Return the simulator's signals with these amounts; None if the simulation fails."""
    try:
        return simulate(amounts)
    except (DeviceError, SimulationError):
        return None


def _amounts(best: TestedParameter, allowed: Mapping[str, float]) -> dict[str, Sequence[float]]:
    count = len(best.amounts)
    amounts: dict[str, Sequence[float]] = {
        name: (value,) * count for name, value in allowed.items() if name not in ("left", "time")
    }
    return amounts | {best.cause.name: best.amounts}


def _shift(plain: Signals, time: Array) -> tuple[Signals, Signals]:
    """Return the simulation one sample later and one earlier, to detect a clock offset."""
    step = float(np.median(np.diff(plain.time)))
    return plain.at(time + step), plain.at(time - step)


_CLOCK = 0.05  # standard deviation of the clock offset, s


def _tested_parameters(
    there: Signals,
    here: Signals,
    causes: Sequence[DiscrepancyParameter],
    probes: Sequence[Signals],
    shifted: tuple[Signals, Signals],
) -> tuple[list[TestedParameter], dict[str, dict[str, float]]]:
    """Return all causes, best first, and the nuisance parameters for each ("": without a cause)."""
    rows = _Rows.of([there, here, *probes, *shifted])
    base = rows.vector(here)
    difference = rows.vector(there) - base
    total = float(difference @ difference)
    step = float(np.median(np.diff(here.time)))
    later, earlier = (rows.vector(item) for item in shifted)
    nuisance = {"time": ((later - earlier) / (2 * step), _CLOCK)}
    columns = {}
    for cause, probe in zip(causes, probes, strict=True):
        change = rows.vector(probe) - base
        if cause.on == "sensor":
            shifts = [rows.vector(probe, f) - rows.vector(here, f) for f in range(there.fingers)]
            columns[cause.name] = np.column_stack(shifts) / cause.probe
        else:
            columns[cause.name] = change[:, None] / cause.probe
        if cause.spread:
            nuisance[cause.name] = (change / cause.probe, cause.spread)
    allowed = {"": _solve(difference, np.zeros((len(base), 0)), nuisance)[1]}
    tried = []
    for cause in causes:
        others = {name: one for name, one in nuisance.items() if name != cause.name}
        amounts, found, sd = _solve(difference, columns[cause.name], others)
        if (amounts < cause.low).any():
            held = np.maximum(amounts, cause.low)
            rest = difference - columns[cause.name] @ held
            _, found, _ = _solve(rest, np.zeros((len(base), 0)), others)
            amounts = held
        allowed[cause.name] = found
        everywhere = tuple(np.broadcast_to(amounts, there.fingers).tolist())
        sds = tuple(np.broadcast_to(sd, there.fingers).tolist())
        tried.append(TestedParameter(cause, everywhere, sds, 1 - found["left"] / total))
    for found in allowed.values():
        found["left"] /= total
    return sorted(tried, key=lambda one: -one.explains), allowed


def _solve(
    difference: Array, columns: Array, nuisance: Mapping[str, tuple[Array, float]]
) -> tuple[Array, dict[str, float], Array]:
    """Return amounts of `columns`, nuisance parameters with remainder, and amounts' sd."""
    names = list(nuisance)
    allowed = [nuisance[name][0] for name in names]
    J = np.column_stack([columns, *allowed]) if allowed else columns
    count = columns.shape[1]
    prior = np.concatenate([np.zeros(count), [1 / nuisance[name][1] for name in names]])
    stacked = np.vstack([J, np.diag(prior) / np.sqrt(len(KINDS) * 30)])
    target = np.concatenate([difference, np.zeros(J.shape[1])])
    found, *_ = np.linalg.lstsq(stacked, target, rcond=None)
    rest = target - stacked @ found
    left = float(rest @ rest)
    spread = np.sqrt(np.diag(np.linalg.pinv(stacked.T @ stacked)) * left / max(len(KINDS), 1))
    amounts = dict(zip(names, map(float, found[count:]), strict=True))
    return found[:count], amounts | {"left": left}, spread[:count]
