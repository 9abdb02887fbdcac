"""Shares with their intervals, and the difference of two controllers that met the same episodes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from mjtactile.evaluate.episodes import OUTCOMES

_Z = 1.959964  # of a normal distribution: 95 %

Line = Mapping[str, Any]


def wilson(count: int, of: int) -> tuple[float, float]:
    """95 % interval of a share (Wilson, J. Am. Stat. Assoc. 22, 1927)."""
    if not of:
        return 0.0, 1.0
    p, z2 = count / of, _Z * _Z
    middle, half = p + z2 / (2 * of), _Z * math.sqrt(p * (1 - p) / of + z2 / (4 * of * of))
    # at 0 and 1 the bound is exact, whatever rounding says
    return (max((middle - half) / (1 + z2 / of), 0.0) if count else 0.0,
            min((middle + half) / (1 + z2 / of), 1.0) if count < of else 1.0)


def paired(first: Iterable[Line], second: Iterable[Line]) -> dict[str, Any]:
    """The share that `second` holds more often than `first`, of the episodes that both came to the end of, with its 95 % interval
    (Agresti & Min, Statistics in Medicine 24, 2005: half an episode added to each cell), and how many more episodes like these
    would put the interval to one side of zero (None: there is no difference to settle)."""
    held = [{line["episode"]: line["outcome"] == "held" for line in lines if line["outcome"] != "error"}
            for lines in (first, second)]
    both = sorted(held[0].keys() & held[1].keys())
    n = len(both)
    only_first = sum(held[0][k] and not held[1][k] for k in both)
    only_second = sum(held[1][k] and not held[0][k] for k in both)
    b, c, m = only_first + 0.5, only_second + 0.5, n + 2
    middle, half = (c - b) / m, _Z * math.sqrt(b + c - (c - b) ** 2 / m) / m
    more = None
    if only_first != only_second:
        share, apart = (only_first + only_second) / n, (only_second - only_first) / n
        more = max(0, math.ceil(_Z * _Z * (share - apart * apart) / (apart * apart)) - n)
    return {"episodes": n, "only_first": only_first, "only_second": only_second,
            "difference": (only_second - only_first) / n if n else 0.0,
            "difference_interval": [max(middle - half, -1.0), min(middle + half, 1.0)], "episodes_to_settle": more}


def summarise(lines: Sequence[Line]) -> dict[str, Any]:
    """Of each controller its success, overall and by object; of each pair of controllers the difference."""
    controllers = list(dict.fromkeys(line["controller"] for line in lines))
    own = {name: [line for line in lines if line["controller"] == name] for name in controllers}
    result: dict[str, Any] = {"episodes": len(lines), "controllers": {}, "paired": []}
    for name, mine in own.items():
        objects = list(dict.fromkeys(line["object"] for line in mine))
        result["controllers"][name] = _group(mine) | {
            "objects": {one: _group([line for line in mine if line["object"] == one]) for one in objects}}
    for k, first in enumerate(controllers):
        result["paired"] += [{"first": first, "second": second, **paired(own[first], own[second])}
                             for second in controllers[k + 1:]]
    return result


def _group(lines: Sequence[Line]) -> dict[str, Any]:
    counts = {outcome: sum(line["outcome"] == outcome for line in lines) for outcome in OUTCOMES}
    ended = len(lines) - counts["error"]
    return {"episodes": len(lines), **counts, "success": counts["held"] / ended if ended else math.nan,
            "success_interval": list(wilson(counts["held"], ended)),
            "slip_mm_true_median": _median(line["slip_mm_true"] for line in lines),
            "peak_share_of_breaking_most": max((line["peak_force_true_N"] / line["break_force_N"] for line in lines
                                                if line["peak_force_true_N"] and line["break_force_N"]), default=math.nan)}


def _median(values: Iterable[float | None]) -> float:
    known = sorted(value for value in values if value is not None)
    return known[len(known) // 2] if known else math.nan


def table(summary: Mapping[str, Any]) -> str:
    """The summary as Markdown."""
    lines = ["| controller | object | episodes | held | 95 % interval | dropped | crushed | errors |", "|---" * 8 + "|"]
    for name, mine in summary["controllers"].items():
        for label, group in (("all", mine), *mine["objects"].items()):
            low, high = group["success_interval"]
            share = f"{100 * group['success']:.0f} %" if group["episodes"] > group["error"] else "-"
            lines.append(f"| {name} | {label} | {group['episodes']} | {share} | {100 * low:.0f}-{100 * high:.0f} % | "
                         f"{group['dropped']} | {group['crushed']} | {group['error']} |")
    for pair in summary["paired"]:
        low, high = pair["difference_interval"]
        more = pair["episodes_to_settle"]
        settled = ("as good as each other here" if more is None else "settled" if not more else
                   f"{more} more episodes like these would settle it")
        lines += ["", f"{pair['second']} holds {100 * pair['difference']:+.1f} % of {pair['episodes']} episodes more often than "
                  f"{pair['first']} (95 %: {100 * low:+.1f} to {100 * high:+.1f} %): {settled}."]
    return "\n".join(lines) + "\n"
