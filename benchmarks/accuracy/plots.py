"""The figures of `bench accuracy`: error against cost, one knob at a time and all together."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

_LABELS = {
    "mesh": lambda r: f"{r['mesh'][0]}x{r['mesh'][1]}",
    "time step": lambda r: f"{r['timestep_ms']:.1f} ms",
    "tolerance": lambda r: f"{r['tolerance']:g}",
    "iterations": lambda r: f"{r['iterations']}",
    "contact softness": lambda r: f"{r['softness']:g}",
}


def draw(result: dict[str, Any], out: Path, say: Callable[[str], None]) -> None:
    """Write accuracy.png (force) and accuracy_surface.png into `out`.

    Print a message if matplotlib is missing.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        say("no plots: matplotlib is not installed (pip install 'mjtactile[plots]')")
        return
    for key, unit, scale, name in (
        ("force_error_N", "force error [mN]", 1e3, "accuracy.png"),
        ("surface_error_um", "surface error [um]", 1.0, "accuracy_surface.png"),
    ):
        figure = Figure(figsize=(11, 6.5), dpi=110, layout="constrained")
        axes = figure.subplots(2, 3).ravel()
        for panel, (sweep, rows) in zip(axes, result["sweeps"].items(), strict=False):
            _panel(panel, rows, key, scale, _LABELS[sweep])
            panel.set_title(sweep)
        _front(axes[5], result, key, scale)
        for panel in axes:
            panel.set(
                xscale="log", yscale="log", xlabel="core time [ms per simulated s]", ylabel=unit
            )
            panel.axvline(1000, color="0.7", lw=0.8, ls="--")
            _scale(panel.xaxis, panel.get_xlim(), panel.set_xlim)
            _scale(panel.yaxis, panel.get_ylim(), panel.set_ylim)
            panel.grid(alpha=0.3)
        figure.savefig(out / name)


def _scale(
    axis: Any, limits: tuple[float, float], set_limits: Callable[[float, float], Any]
) -> None:
    """Plain numbers at 1, 2 and 5, and at least a factor of four between the ends, so that noise
    does not look like a slope."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    middle = (limits[0] * limits[1]) ** 0.5
    half = max((limits[1] / limits[0]) ** 0.5, 2.0)
    set_limits(middle / half, middle * half)
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
    good = [row for row in rows if "failed" not in row]
    panel.plot([r["ms_per_s"] for r in good], [scale * r[key] for r in good], "o-")
    for row in good:
        panel.annotate(
            label(row),
            (row["ms_per_s"], scale * row[key]),
            textcoords="offset points",
            xytext=(4, 4),
            fontsize=7,
        )
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
        label="all that ran",
    )
    front = result["pareto"]
    panel.plot(
        [r["ms_per_s"] for r in front],
        [scale * r[key] for r in front],
        "o-",
        color="tab:red",
        label="front (force)",
    )
    panel.set_title("all together; dashed: real time")
    panel.legend(fontsize=8)
