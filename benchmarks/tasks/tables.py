"""Markdown of `mjtactile bench tasks`; its first line names the level of simulation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.tasks.compared_controllers import CONTROLLERS, READY, SHOWN
from benchmarks.tasks.simulation_levels import LEVELS, MESH
from mjtactile.evaluate.episodes import STOPPED

FEWEST = 5
"""Episodes of a task below which a controller is left out."""


def table(result: Mapping[str, Any]) -> str:
    """Return a Markdown table.

    It lists episodes held without damage, in percent with intervals. Grip over required force, and
    the specific results of each task follow. Controllers and tasks with fewer than `FEWEST`
    episodes are left out, if others have more.
    """
    every = result["together"]
    tasks = result["tasks"]
    fewest = min(FEWEST, max(_episodes_max(task) for task in tasks.values()))
    names = [
        name
        for name in SHOWN
        if any(_episodes_max(task, name) >= fewest for task in tasks.values())
    ]
    head = " | ".join(names)
    lines = [
        f"Level `{LEVELS[result['level']].label}`: {LEVELS[result['level']].about}.",
        "",
        f"| held without damage | {head} | adaptive minus touchless, points |",
        "|---" * (len(names) + 2) + "|",
    ]
    for task, summary in tasks.items():
        cells = [_fraction(summary["controllers"].get(name)) for name in names]
        lines.append(f"| {task} | {' | '.join(cells)} | {_difference(summary)} |")
    cells = [_fraction(every["controllers"].get(name)) for name in names]
    lines.append(f"| all {len(result['tasks'])} | {' | '.join(cells)} | {_difference(every)} |")
    harsh = {task: one for task, one in result["harsh"].items() if _episodes_max(one) >= fewest}
    for task, summary in harsh.items():
        cells = [_fraction(summary["controllers"].get(name)) for name in names]
        lines.append(f"| {task}, `harsh` | {' | '.join(cells)} | {_difference(summary)} |")
    lines += [
        "",
        "Cells: crushed/dropped/stopped/simulation failed; grip force relative to required force, "
        "median.",
        "",
        f"| failures; grip | {head} |",
        "|---" * (len(names) + 1) + "|",
    ]
    for task, summary in tasks.items():
        cells = [_failures(summary["controllers"].get(name)) for name in names]
        lines.append(f"| {task} | {' | '.join(cells)} |")
    lines += ["", f"| other measures | {head} |", "|---" * (len(names) + 1) + "|"]
    for task, key, label, form in (
        ("place", "impact_N_s", "impact at placement, N s: median; 95 %", "{:.3f}"),
        ("hand-over", "release_delay_s", "release delay, s: median; 95 %", "{:.2f}"),
    ):
        own = result["tasks"][task]["controllers"]
        cells = [_spread(own.get(name), key, form) for name in names]
        lines.append(f"| {label} | {' | '.join(cells)} |")
    for task, key, which, label in (
        ("bump", "margin_ready", "median", f"bump: {READY}"),
        ("hand-over", "margin_ready", "median", f"hand-over: {READY}"),
        ("", "margin", "median", "grip force relative to required force, all tasks, median"),
        ("", "margin", "p95", "the same, 95 %"),
    ):
        own = (result["tasks"][task] if task else every)["controllers"]
        cells = [_value(own.get(name), key, "{:.1f}", which) for name in names]
        lines.append(f"| {label} | {' | '.join(cells)} |")
    found = result["weighed"]
    if found["objects"] > 1:
        lines += [
            "",
            f"Mass estimates of `adaptive`, {found['objects']} objects of at least 20 g: mean "
            f"error {100 * found['mean_share']:+.1f} %, sd {100 * found['sd_share']:.1f} %; rms "
            f"error {found['over_asked']:.2f} times the required 4 % + 1 g.",
        ]
    lines += _agreement(result)
    return "\n".join(lines) + "\n"


def _agreement(result: Mapping[str, Any]) -> list[str]:
    """Return table rows: fraction of episodes with the same outcome as on the mesh."""
    found = {
        name: result_row
        for name, result_row in result["agreement"].items()
        if result_row["episodes"]
    }
    if not found:
        return []
    level = LEVELS[result["level"]].label
    lines = [
        "",
        f"| same episodes at both levels | same outcome | held, `{MESH}` / `{level}` | grip force "
        f"relative to required force, median, `{MESH}` / `{level}` |",
        "|---" * 4 + "|",
    ]
    for name, result_row in found.items():
        low, high = (100 * bound for bound in result_row["alike_interval"])
        held = " / ".join(str(count) for count in result_row["held"])
        margin = " / ".join(
            "" if value is None else f"{value:.1f}" for value in result_row["margin"]
        )
        lines.append(
            f"| {name} | {result_row['alike']} of {result_row['episodes']} "
            f"({low:.0f}-{high:.0f} %) | {held} | {margin} |"
        )
    return lines


def _episodes_max(summary: Mapping[str, Any], *names: str) -> int:
    """Return the largest number of episodes of a controller, or of those in `names`."""
    groups = summary["controllers"]
    counts = (groups[name]["episodes"] for name in names or groups if name in groups)
    return max(counts, default=0)


def _fraction(group: Mapping[str, Any] | None) -> str:
    if group is None:
        return ""
    low, high = group["success_interval"]
    ended = group["episodes"] - group["error"]
    return f"{group['held']} of {ended} ({100 * low:.0f}-{100 * high:.0f} %)"


def _failures(group: Mapping[str, Any] | None) -> str:
    if group is None:
        return ""
    stopped = sum(group[kind] for kind in STOPPED)
    counts = f"{group['crushed']}/{group['dropped']}/{stopped}/{group['error']}"
    grip = _value(group, "margin", "{:.1f}")
    return f"{counts}; {grip}" if grip else counts


def _difference(summary: Mapping[str, Any]) -> str:
    """Format the difference of the first controller to touchless, in points."""
    for pair in summary["paired"]:
        if (pair["first"], pair["second"]) == (CONTROLLERS[0], CONTROLLERS[-1]):
            low, high = pair["difference_interval"]
            return f"{0 - 100 * pair['difference']:+.0f} ({-100 * high:+.0f} to {-100 * low:+.0f})"
    return ""


def _spread(group: Mapping[str, Any] | None, key: str, form: str) -> str:
    """Format median and 95th percentile."""
    median, high = (_value(group, key, form, which) for which in ("median", "p95"))
    return f"{median}; {high}" if median else ""


def _value(group: Mapping[str, Any] | None, key: str, form: str, which: str = "median") -> str:
    value = None if group is None else group[key][which]
    return "" if value is None else form.format(value)
