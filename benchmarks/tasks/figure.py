"""Overview figure: episodes held without damage, by controller."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mjtactile.report.figures import new_figure

_STYLES = {
    "oracle": ("#999999", "oracle: knows mass and friction"),
    "adaptive": ("#1f5fa8", "adaptive: touch, as hard as required"),
    "slip_aware": ("#5fa05f", "slip_aware: touch, harder at a slip"),
    "gentle": ("#d08020", "gentle: touch, always 0.6 N"),
    "touchless": ("#c0221c", "touchless: servo current only"),
}
_STEP = 0.15  # distance of the dots, as a fraction of a task's row


def plot(result: Mapping[str, Any], path: Path) -> None:
    """Plot one row per task and one dot per controller, with its 95 % interval."""
    if (figure := new_figure(path.name, (8.0, 5.2))) is None:
        return
    axes = figure.subplots()
    tasks = list(result["tasks"])
    for rank, (name, (color, label)) in enumerate(_STYLES.items()):
        for row, task in enumerate(tasks):
            group = result["tasks"][task]["controllers"].get(name)
            if group is None or group["episodes"] == group["error"]:
                continue
            low, high = (100 * bound for bound in group["success_interval"])
            at = row + _STEP * (rank - 2)
            axes.plot([low, high], [at, at], color=color, linewidth=2, alpha=0.45)
            axes.plot(
                100 * group["success"], at, "o", color=color, ms=6, label="" if row else label
            )
    axes.set_yticks(range(len(tasks)), tasks)
    axes.invert_yaxis()
    axes.set(xlim=(-2, 102), xlabel="held without damage, % of episodes, with 95 % intervals")
    axes.grid(axis="x", alpha=0.3)
    axes.legend(loc="lower center", bbox_to_anchor=(0.45, 1.0), ncol=2, frameon=False)
    figure.savefig(path)
