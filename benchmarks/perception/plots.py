"""Plots of `mjtactile bench perception`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtri

from mjtactile.core.types import Array
from mjtactile.report.figures import new_figure


def plot(out: Path, errors: Mapping[str, Array], result: Mapping[str, Any]) -> None:
    """Plot `perception.png` (accuracy, standard deviations, blur, speed) and
    `perception_methods.png`."""
    if (figure := new_figure("perception.png", (11, 8))) is None:
        return
    axes = figure.subplots(2, 2)
    _against_bound(axes[0, 0], errors)
    _error_bars(axes[0, 1], errors)
    _blur(axes[1, 0], result["bias_against_blur"])
    _speed(axes[1, 1], result)
    figure.savefig(out / "perception.png")
    figure = new_figure("perception_methods.png", (11, 4.6))
    axes = figure.subplots(1, 2)
    _bars(axes[0], result["methods"], "error of a circle's centre, same images")
    surface = result["surface"]
    routes = {
        "smoothing spline (default)": "spline",
        "Delaunay, grid, B-spline (paper)": "delaunay",
    }
    _bars(
        axes[1],
        {
            name: {"mean_mm": surface[f"{key}_rms_mm"], "worst_mm": surface[f"{key}_worst_mm"]}
            for name, key in routes.items()
        },
        "error of the surface under a ball",
        "RMS",
    )
    figure.savefig(out / "perception_methods.png")


def _against_bound(axes: Any, errors: Mapping[str, Array]) -> None:
    bound = errors["bound_z"] * 1e6
    error = np.abs(errors["error"][:, 2]) * 1e6
    axes.plot(bound, error, ".", ms=4, label="one circle")
    line = np.array([0.0, bound.max()])
    for k, style in ((1, "k-"), (2, "k--"), (3, "k:")):
        axes.plot(line, k * line, style, lw=1, label=f"{k} sd of the best possible estimator")
    axes.set(
        xlabel="Cramér-Rao bound: least possible sd of depth [µm]",
        ylabel="depth error, absolute [µm]",
        title="depth error against the physical limit",
    )
    axes.legend(fontsize=8)


def _error_bars(axes: Any, errors: Mapping[str, Array]) -> None:
    normal = np.sort(errors["error"][:, 2] / errors["sd_z"])
    axes.plot(
        ndtri((np.arange(len(normal)) + 0.5) / len(normal)), normal, ".", ms=4, label="one circle"
    )
    axes.plot([-3, 3], [-3, 3], "k-", lw=1, label="error bars that are exactly right")
    axes.set(
        xlabel="normal distribution [sd]",
        ylabel="depth error / its reported sd",
        title="are the error bars right?",
    )
    axes.legend(fontsize=8)


def _blur(axes: Any, rows: list[dict[str, float]]) -> None:
    blur = [r["blur_px"] for r in rows]
    spread = [r["sd_um"] / np.sqrt(r["found"]) for r in rows]
    axes.errorbar(
        blur,
        [r["bias_um"] for r in rows],
        spread,
        fmt="o-",
        label="measured, with its standard error",
    )
    axes.plot(
        blur,
        [r["uncorrected_um"] for r in rows],
        "--",
        label="if a curved edge's blur were not corrected",
    )
    axes.set(
        xlabel="blur of the image, sd [px]",
        ylabel="mean depth error [µm]",
        title="bias of depth against blur (40 mm away, 20° tilt)",
    )
    axes.legend(fontsize=8)


def _speed(axes: Any, result: Mapping[str, Any]) -> None:
    counts = [r["markers"] for r in result["speed"]]
    for key, style, label in (
        ("total_ms", "o-", "image to poses"),
        ("blob_detector_ms", "s--", "cv2.SimpleBlobDetector alone"),
        ("opencv_sine_ms", "^--", "cv2.findContours + fitEllipse + sine rule"),
    ):
        axes.plot(counts, [r[key] for r in result["speed"]], style, label=label)
    pipeline = np.array(result["surface"]["pipeline_ms"])
    low, median, high = np.percentile(pipeline, [1, 50, 99])
    axes.errorbar(
        [result["surface"]["markers"]],
        [median],
        [[median - low], [high - median]],
        fmt="D",
        capsize=4,
        label="image to surface: median, 1-99 %",
    )
    axes.set(
        xlabel="markers in a 640 x 480 image",
        ylabel="time on one core [ms]",
        title="speed",
        ylim=(0, 1.4 * max(r["blob_detector_ms"] for r in result["speed"])),
    )
    axes.legend(fontsize=8)


def _bars(
    axes: Any, methods: Mapping[str, Mapping[str, float]], title: str, mean: str = "mean"
) -> None:
    names = list(methods)[::-1]
    where = np.arange(len(names))
    axes.barh(where + 0.2, [methods[n]["mean_mm"] for n in names], 0.38, label=mean)
    axes.barh(
        where - 0.2, [methods[n]["worst_mm"] for n in names], 0.38, label="worst", color="0.75"
    )
    for k, name in enumerate(names):
        axes.text(
            methods[name]["mean_mm"] * 1.05,
            k + 0.2,
            f"{methods[name]['mean_mm']:.3g}",
            va="center",
            fontsize=8,
        )
    axes.set(
        yticks=where,
        yticklabels=names,
        xscale="log",
        xlim=(1e-3, 30),
        xlabel="error [mm], logarithmic",
        title=title,
    )
    axes.tick_params(axis="y", labelsize=8)
    axes.legend(fontsize=8)
