"""Figures of `bench accuracy`: error against cost, for each setting and for all settings."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

_OFFSETS = (
    *((x, y, align) for y in (4, -11) for x, align in ((4, "left"), (-4, "right"))),
    *((0, y, "center") for y in (12, -20, 22, -30, 32, -40, 42, -50)),
)
"""Positions of a label relative to its point, points, and its alignment, in order of preference."""
_LABELS = {
    "mesh": lambda r: f"{r['mesh'][0]}x{r['mesh'][1]}",
    "time step": lambda r: f"{r['timestep_ms']:.1f} ms",
    "tolerance": lambda r: f"{r['tolerance']:g}",
    "iterations": lambda r: f"{r['iterations']}",
    "contact softness": lambda r: f"{r['softness']:g}",
}


def plot(result: dict[str, Any], out: Path, notify: Callable[[str], None]) -> None:
    """Write accuracy.png (force) and accuracy_surface.png into `out`.

    Print a message if matplotlib is missing.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        notify("no plots: matplotlib is not installed (pip install 'mjtactile[plots]')")
        return
    for key, unit, scale, name in (
        ("force_error_N", "force error [mN]", 1e3, "accuracy.png"),
        ("surface_error_um", "surface error [um]", 1.0, "accuracy_surface.png"),
    ):
        figure = Figure(figsize=(11, 6.5), dpi=110, layout="constrained")
        axes = figure.subplots(2, 3).ravel()
        for panel, (sweep, rows) in zip(axes, result["sweeps"].items(), strict=False):
            _panel(panel, rows, key, scale, _LABELS[sweep])
            panel.set_title("maximum iterations" if sweep == "iterations" else sweep)
        _front(axes[5], result, key, scale)
        for panel in axes:
            panel.set(
                xscale="log", yscale="log", xlabel="core time [ms per simulated s]", ylabel=unit
            )
            panel.axvline(1000, color="0.7", lw=0.8, ls="--")
            _scale(panel.xaxis, panel.get_xlim(), panel.set_xlim)
            _scale(panel.yaxis, panel.get_ylim(), panel.set_ylim)
            panel.grid(alpha=0.3)
        figure.draw_without_rendering()  # final size of the panels
        for panel, (sweep, rows) in zip(axes, result["sweeps"].items(), strict=False):
            points = [(row["ms_per_s"], scale * row[key]) for row in _run(rows)]
            _add_labels(panel, points, [_LABELS[sweep](row) for row in _run(rows)])
        figure.savefig(out / name)


def _scale(
    axis: Any, limits: tuple[float, float], set_limits: Callable[[float, float], Any]
) -> None:
    """Set a logarithmic axis with plain tick labels at 1, 2 and 5.

    Its ends differ by at least a factor of four, so that noise does not appear as a slope.
    """
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    center = (limits[0] * limits[1]) ** 0.5
    half = max((limits[1] / limits[0]) ** 0.5, 2.0)
    set_limits(center / half, center * half)
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())


def _panel(
    panel: Any,
    rows: list[dict[str, Any]],
    key: str,
    scale: float,
    label: Callable[[dict[str, Any]], str],
) -> None:
    good = _run(rows)
    panel.plot([r["ms_per_s"] for r in good], [scale * r[key] for r in good], "o-", ms=4)
    failed = [label(row) for row in rows if "failed" in row]
    if failed:
        panel.text(
            0.02,
            0.02,
            f"failed: {', '.join(failed)}",
            transform=panel.transAxes,
            color="tab:red",
            fontsize=8,
        )


def _run(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [row for row in rows if "failed" not in row]


def _add_labels(panel: Any, points: list[tuple[float, float]], labels: list[str]) -> None:
    """Label each point where the text overlaps no other label, no point and no edge."""
    from matplotlib.text import Text
    from matplotlib.transforms import Bbox

    inside = panel.get_window_extent()
    pixels = panel.transData.transform(points)
    taken = [Bbox.from_extents(x - 4, y - 4, x + 4, y + 4) for x, y in pixels]
    for point, label in zip(points, labels, strict=True):
        for x, y, align in _OFFSETS:
            text = panel.annotate(
                label,
                point,
                textcoords="offset points",
                xytext=(x, y),
                ha=align,
                fontsize=7,
                arrowprops={"arrowstyle": "-", "lw": 0.4, "color": "0.4"} if x == 0 else None,
            )
            text.get_window_extent()  # updates the position
            frame = Text.get_window_extent(text).padded(1)
            free = not any(frame.overlaps(other) for other in taken)
            if free and inside.x0 <= frame.x0 and frame.x1 <= inside.x1 and frame.y1 <= inside.y1:
                break
            text.remove()
        else:
            continue
        taken.append(frame)


def _front(panel: Any, result: dict[str, Any], key: str, scale: float) -> None:
    rows = [
        row
        for sweep in (*result["sweeps"].values(), result["together"])
        for row in sweep
        if "failed" not in row
    ]
    panel.plot(
        [r["ms_per_s"] for r in rows],
        [scale * r[key] for r in rows],
        ".",
        color="0.6",
        label="all settings",
    )
    front = result["pareto"]
    panel.plot(
        [r["ms_per_s"] for r in front],
        [scale * r[key] for r in front],
        "o-",
        ms=4,
        color="tab:red",
        label="Pareto front (force)",
    )
    panel.set_title("all parameters; dashed: real time")
    panel.legend(fontsize=8)
