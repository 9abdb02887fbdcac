"""Figures of the experiments; each `plot_*` fills a matplotlib figure from the data of its
experiment."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.report.figures import new_figure

PAPER_CIRCLE_MM = 0.39
_COLOURS = {"solid": "tab:blue", "sponge": "tab:red"}  # as in the paper's Fig. 5


def save(name: str, result: Mapping[str, Any], out: Path) -> None:
    """Write `out`/NAME.png; report a missing matplotlib on stderr."""
    plot, size = _PLOTS[name]
    if (figure := new_figure(f"{name}.png", size, dpi=100)) is not None:
        plot(figure, result)
        figure.savefig(out / f"{name}.png")


def plot_fig5a(figure: Any, result: Mapping[str, Any]) -> None:
    """Plot estimate against load cell, and the change of area that dF = c dA uses."""
    axes = figure.subplots(2, len(result["runs"]), squeeze=False, sharex="col")
    for column, run in enumerate(result["runs"]):
        cell = [s["cell_N"] for s in run["steps"]]
        top, bottom = axes[:, column]
        top.plot([0, max(cell)], [0, max(cell)], "k-", lw=0.8)
        top.plot(
            cell,
            [s["ours_N"] for s in run["steps"]],
            "o",
            label=f"ours, {run['error_ours_N']:.3f} N",
        )
        top.plot(
            cell,
            [s["paper_N"] for s in run["steps"]],
            "s",
            mfc="none",
            label=f"dF = c dA, {run['error_paper_N']:.3f} N",
        )
        top.set(title=f"{run['sensor']}, valve {run['valve']}")
        top.legend(fontsize=8)
        bottom.plot(
            cell, [s["area_change_mm2"] for s in run["steps"]], "s-", mfc="none", color="tab:orange"
        )
        bottom.axhline(0, color="k", lw=0.8)
        bottom.set(xlabel="load cell, N")
    axes[0, 0].set(ylabel="estimate, N")
    axes[1, 0].set(ylabel="change of area, mm$^2$")


def plot_fig5b(figure: Any, result: Mapping[str, Any]) -> None:
    """Plot force against the sensor's travel and against the object's own deformation."""
    total, own = figure.subplots(1, 2)
    for name, colour in _COLOURS.items():
        curve = result[name]
        depth = np.asarray(curve["depth_mm"])
        force = np.asarray(curve["force_N"])
        total.plot(depth, force, ".", color=colour, label=name)
        own.plot(curve["own_deformation_mm"], force, ".", color=colour, label=name)
        for power, style in ((1, ":"), (2, "-")):
            columns = np.stack([depth**k for k in range(1, power + 1)], axis=1)
            fit = np.linalg.lstsq(columns, force, rcond=None)[0]
            total.plot(depth, columns @ fit, style, color=colour, lw=1)
    law = result["sponge_law"]
    d = np.linspace(0, np.nanmax(result["sponge"]["own_deformation_mm"]), 50)
    own.plot(
        d,
        1e-3 * d * (law["stiffness_true_N_m"] + law["stiffening_true_N_m2"] * 1e-3 * d),
        "k-",
        lw=0.8,
        label="the sponge's law (ground truth)",
    )
    total.set(
        xlabel="driven in, mm",
        ylabel="estimated force, N",
        title="as the paper plots it (dotted: line, full: parabola)",
    )
    own.set(xlabel="the object's own deformation, mm", title="without the membrane's share")
    total.legend()
    own.legend()


def plot_fig5c(figure: Any, result: Mapping[str, Any]) -> None:
    """Plot force over time."""
    axes = figure.subplots()
    for name, colour in _COLOURS.items():
        axes.plot(
            result[name]["time_s"],
            result[name]["force_N"],
            ".",
            ms=4,
            color=colour,
            label=f"{name}, estimated",
        )
        axes.plot(
            result[name]["time_s"],
            result[name]["cell_N"],
            "-",
            lw=1,
            color=colour,
            label=f"{name}, load cell",
        )
    axes.set(xlabel="time, s", ylabel="normal force, N")
    axes.legend()


def plot_fig6(figure: Any, result: Mapping[str, Any]) -> None:
    """Plot the error of every circle, and the histogram with the paper's mean."""
    each, spread = figure.subplots(1, 2)
    errors = np.asarray(result["distance_error_mm"])
    each.plot(errors, ".", ms=4)
    each.axhline(PAPER_CIRCLE_MM, color="tab:red", label="paper, mean")
    each.axhline(errors.mean(), color="k", label="ours, mean")
    each.set(yscale="log", xlabel="circle", ylabel="error of the centre, mm")
    each.legend()
    spread.hist(np.asarray(result["depth_error_mm"]) * 1e3, bins=30)
    spread.set(xlabel="depth error, um", ylabel="circles")


def plot_fig7(figure: Any, result: Mapping[str, Any]) -> None:
    """Plot the image, the reconstruction with forces and the force field from above.

    The sign of the forces is inverted, as in the paper.
    """
    for row, (name, data) in enumerate(result.items()):
        image = figure.add_subplot(len(result), 3, 3 * row + 1)
        image.imshow(data["image"], cmap="gray")
        image.set_title(name)
        image.axis("off")
        shape = figure.add_subplot(len(result), 3, 3 * row + 2, projection="3d")
        x, y = np.meshgrid(1e3 * data["x"], 1e3 * data["y"])
        shape.plot_surface(x, y, 1e3 * data["z"], cmap="viridis", rcount=30, ccount=40, linewidth=0)
        shape.set_zlabel("mm")
        field = figure.add_subplot(len(result), 3, 3 * row + 3)
        pressing = -1e3 * data["force"][..., 2]
        sampled = field.pcolormesh(
            1e3 * data["grid_x"], 1e3 * data["grid_y"], pressing, cmap="magma", shading="nearest"
        )
        field.quiver(
            1e3 * data["grid_x"],
            1e3 * data["grid_y"],
            -data["force"][..., 0],
            -data["force"][..., 1],
            color="w",
            scale=0.4,
        )
        field.set_title(f"estimated {data['force_N']:.2f} N, load cell {data['cell_N']:.2f} N")
        field.set_aspect("equal")
        figure.colorbar(sampled, ax=field, label="mN a node")


def plot_pressure(figure: Any, result: Mapping[str, Any]) -> None:
    """Plot stiffness and noise against pressure, and against the amount of air."""
    runs = [run for run in result["runs"] if run["valve"] == "closed"]
    airs = [run["air_mL"] for run in runs]
    axes = figure.subplots(1, 2)
    by_pressure = [r for r in runs if r["air_mL"] > 0.9 * np.median(airs)]
    by_air = [r for r in runs if abs(r["supply_kPa"] - 1) < 1e-6]
    for panel, rows, key, label in (
        (axes[0], by_pressure, "supply_kPa", "supply, kPa"),
        (axes[1], by_air, "air_mL", "air, mL"),
    ):
        rows = sorted(rows, key=lambda r: r[key])
        panel.plot([r[key] for r in rows], [r["stiffness_N_mm"] for r in rows], "o-")
        panel.set(xscale="log", xlabel=label, ylabel="N for the first mm")
        noise = panel.twinx()
        noise.plot(
            [r[key] for r in rows], [1e3 * r["noise_N"] for r in rows], "s--", color="tab:orange"
        )
        noise.set_ylabel("noise-equivalent force, mN", color="tab:orange")
        noise.set_ylim(0, None)


_PLOTS = {
    "fig5a": (plot_fig5a, (16.5, 5.4)),
    "fig5b": (plot_fig5b, (9.5, 4.2)),
    "fig5c": (plot_fig5c, (6.4, 4.2)),
    "fig6": (plot_fig6, (9.0, 3.8)),
    "fig7": (plot_fig7, (10.0, 8.5)),
    "air": (plot_pressure, (9.5, 3.8)),
}
