"""Success rate as a function of each sampled value: bins with intervals, and significance tests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import stats

from mjtactile.evaluate.wilson import Line, wilson

_BINS = 5
_CATEGORIES = 6
_LEVEL = 0.05
MEASURES = ("slip_mm", "force_error_N", "peak_to_break_ratio")
"""Continuous measures that vary even if no episode fails."""


def measures(line: Line) -> dict[str, float | None]:
    """Return slip, force error in the hold, and peak over breaking force; None if unknown."""
    force, force_true = line.get("hold_force_N"), line.get("hold_force_true_N")
    peak, limit = line.get("peak_force_true_N"), line.get("break_force_N")
    return {
        "slip_mm": line.get("slip_mm_true"),
        "force_error_N": None if force is None or force_true is None else force - force_true,
        "peak_to_break_ratio": None if peak is None or limit is None else peak / limit,
    }


def flat(line: Line) -> dict[str, float | str]:
    """Return the randomized values of one episode: numbers, words, vector components, counts."""
    values: dict[str, float | str] = {}
    for name, value in line.get("randomized", {}).items():
        if name.endswith("missing_markers"):
            values[name] = float(len(value))
        elif isinstance(value, list):
            values |= {f"{name}.{axis}": float(v) for axis, v in zip("xyz", value, strict=False)}
        else:
            values[name] = value
    return values


def against(lines: Sequence[Line], everybody: Sequence[Line] = ()) -> list[dict[str, Any]]:
    """Analyze the outcome against each sampled value.

    Each entry covers the episodes without an error:

    - `bins`: success rate per bin; the edges come from `everybody`'s lines.
    - `p`: p-value of the Mann-Whitney test between failures and successes. None without failures,
      or if the value is a word.
    - `both_ways`: True if the test is on the distance from the median instead of the value.
    - `stands_out`: True if p is below 5 % divided by the number of tests (Bonferroni).
    - `correlation`: Spearman's correlation with each of `MEASURES`.

    Entries are sorted by p, so that significant values come first. The second key is the strongest
    correlation.
    """
    ended = [line for line in lines if line["outcome"] != "error"]
    table = [flat(line) for line in ended]
    pool = [flat(line) for line in everybody or lines]
    names = list(dict.fromkeys(name for row in table for name in row))
    found: list[dict[str, Any]] = []
    for name in names:
        pairs = [(row[name], line) for row, line in zip(table, ended, strict=True) if name in row]
        one = _parameter_row(name, pairs, [row[name] for row in pool if name in row])
        if len(one["bins"]) > 1:
            found.append(one)
    tested = sum(one["p"] is not None for one in found)
    for one in found:
        one["stands_out"] = one["p"] is not None and one["p"] < _LEVEL / tested
    return sorted(found, key=_rank)


def _rank(row: Mapping[str, Any]) -> tuple[float, float]:
    """Return the sort key: p-value, then strongest correlation."""
    chance = 1.0 if row["p"] is None else row["p"]
    strongest = max((abs(rho) for rho in row["correlation"].values()), default=0.0)
    return chance, -strongest


def _parameter_row(
    name: str, pairs: Sequence[tuple[float | str, Line]], pool: Sequence[float | str]
) -> dict[str, Any]:
    values = [value for value, _ in pairs]
    held = np.array([line["outcome"] == "held" for _, line in pairs])
    words = any(isinstance(value, str) for value in values)
    p = None
    both = False
    correlation = {}
    if not words:
        samples = np.array(values, float)
        if held.any() and not held.all() and np.ptp(samples) > 0:
            p, both = _chance(samples, held)
        correlation = _correlations(samples, [measures(line) for _, line in pairs])
    return {
        "name": name,
        "p": p,
        "both_ways": both,
        "correlation": correlation,
        "bins": _bins(values, held, pool, words=words),
    }


def _chance(samples: np.ndarray, held: np.ndarray) -> tuple[float, bool]:
    """Return the p-value of the difference between failures and successes.

    It is twice the smaller of two: of the value, and of its distance from the median, which shows
    failures at both ends. The second result is True for the distance.
    """
    far = np.abs(samples - np.median(samples))
    plain = float(stats.mannwhitneyu(samples[held], samples[~held]).pvalue)
    distance = float(stats.mannwhitneyu(far[held], far[~held]).pvalue)
    return min(2 * min(plain, distance), 1.0), distance < plain


def _correlations(
    samples: np.ndarray, rows: Sequence[Mapping[str, float | None]]
) -> dict[str, float]:
    found = {}
    for measure in MEASURES:
        measured = np.array([row[measure] for row in rows], float)  # None: NaN
        known = np.isfinite(measured)
        if known.sum() < 5 or np.ptp(measured[known]) == 0 or np.ptp(samples[known]) == 0:
            continue
        correlation: Any = stats.spearmanr(samples[known], measured[known])
        found[measure] = round(float(correlation.statistic), 3)
    return found


def _bins(
    values: Sequence[float | str], held: np.ndarray, pool: Sequence[float | str], *, words: bool
) -> list[dict[str, Any]]:
    """Return the success rate per bin.

    Few values have one bin each. Otherwise each bin has the same number of the `pool`.
    """
    kinds = sorted(set(pool), key=str if words else float)  # type: ignore[arg-type]
    if words or len(kinds) <= _CATEGORIES:
        return [
            {"value": kind} | _success(held[[value == kind for value in values]])
            for kind in kinds
            if kind in values
        ]
    samples = np.array(values, float)
    edges = np.unique(np.quantile(np.array(pool, float), np.linspace(0, 1, _BINS + 1)))
    number = np.clip(np.searchsorted(edges, samples, side="right") - 1, 0, len(edges) - 2)
    found = []
    for k in range(len(edges) - 1):
        if (number == k).any():
            ends = {"from": float(f"{edges[k]:.4g}"), "to": float(f"{edges[k + 1]:.4g}")}
            found.append(ends | _success(held[number == k]))
    return found


def _success(held: np.ndarray) -> dict[str, Any]:
    count = int(held.sum())
    total = len(held)
    interval = list(wilson(count, total))
    return dict(episodes=total, held=count, success=count / total, success_interval=interval)
