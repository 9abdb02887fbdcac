"""`mjtactile bench perception`: accuracy of markers and surfaces relative to the physical limit,
consistency of their standard deviations, and speed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.paper import marker_accuracy, marker_methods
from benchmarks.paper.marker_accuracy import BLUR, NOISE
from benchmarks.perception import pipeline
from benchmarks.perception.plots import plot
from mjtactile.runtime.progress import Progress

TARGETS: dict[str, tuple[str, float, float]] = {
    "mean_mm": ("mean center error, nearer of two poses, mm", 0.020, 0.010),
    "mean_as_returned_mm": ("mean center error, returned pose, mm", 0.020, 0.010),
    "worst_mm": ("worst center error, nearer of two poses, mm", 0.10, 0.04),
    "worst_as_returned_mm": ("worst center error, returned pose, mm", 0.10, 0.04),
    "depth_bias_mm": ("depth bias, absolute value, mm", 0.010, 0.003),
    "cramer_rao_ratio": ("depth error / Cramer-Rao bound, rms", 2.0, 1.2),
    "detect_to_pose_80_ms": ("detection and pose, 80 markers, ms", 2.5, 1.5),
    "pipeline_median_ms": ("pipeline up to the surface, 81 markers: median, ms", 5.0, 3.0),
    "pipeline_p99_ms": ("pipeline up to the surface, 81 markers: 99th percentile, ms", 10.0, 6.0),
    "surface_rms_mm": ("surface error under a ball, rms, mm", 0.03, 0.015),
}
"""Quantity, required and target value, all upper limits. Chi-square has a range instead."""
CHI2 = (0.7, 1.4), (0.9, 1.1)


def run(
    out: Path, *, quick: bool = False, notify: Callable[[str], None] | None = None
) -> dict[str, Any]:
    """Measure all parts, and plot `perception.png` and `perception_methods.png` in `out`."""
    notify = notify or Progress().message
    cv2.setNumThreads(1)
    notify("accuracy of single circles")
    accuracy, errors = marker_accuracy.paper_like(images=4 if quick else 15)
    notify("other methods on the same images")
    result: dict[str, Any] = {
        "accuracy": accuracy,
        "methods": marker_methods.compare_methods(images=1 if quick else 5),
        "chord_noise": marker_methods.chord_noise(images=2 if quick else 15),
        "board_from_name": marker_methods.board_from_name(images=1 if quick else 10),
    }
    notify("blur; small circles through a cheap camera")
    result["bias_against_blur"] = marker_accuracy.bias_against_blur(repeats=2 if quick else 10)
    result["small_circles"] = marker_methods.small_circles(images=1 if quick else 5)
    notify("surfaces under a ball")
    result["surface"] = pipeline.pressed(frames=1 if quick else 10, repeats=40 if quick else 300)
    notify("speed")
    result["speed"] = pipeline.speed(repeats=10 if quick else 60)
    result["measured"] = _measured(result)
    plot(out, errors, result)
    return result


def _measured(result: Mapping[str, Any]) -> dict[str, float]:
    """Return the measured values that have a target."""
    eighty = next(row for row in result["speed"] if row["markers"] == 80)
    pipeline_ms = np.array(result["surface"]["pipeline_ms"])
    return {key: abs(result["accuracy"][key]) for key in tuple(TARGETS)[:6]} | {
        "chi2_per_dof": result["accuracy"]["chi2_per_dof"],
        "detect_to_pose_80_ms": eighty["total_ms"],
        "pipeline_median_ms": float(np.median(pipeline_ms)),
        "pipeline_p99_ms": float(np.percentile(pipeline_ms, 99)),
        "surface_rms_mm": result["surface"]["spline_rms_mm"],
    }


def table(result: Mapping[str, Any]) -> str:
    """Format the results in Markdown."""
    return (
        "\n\n".join(
            [
                _targets(result),
                _methods(result),
                _chord_noise(result),
                _board_from_name(result),
                _surface(result),
                _speed(result),
                _blur(result),
                _small(result),
            ]
        )
        + "\n"
    )


def _rows(head: str, rows: list[str]) -> str:
    return "\n".join([head, "|" + "---|" * (head.count("|") - 1), *rows])


def _targets(result: Mapping[str, Any]) -> str:
    a = result["accuracy"]
    m = result["measured"]
    rows = [
        f"| {name} | {m[key]:.3g}{'' if m[key] <= minimum else ': missed'} | {minimum:g} "
        f"({aim:g}) |"
        for key, (name, minimum, aim) in TARGETS.items()
    ]
    chi2 = m["chi2_per_dof"]
    low, high = CHI2[0]
    missed = "" if low <= chi2 <= high else ": missed"
    rows.insert(
        6,
        f"| chi-square per degree of freedom | {chi2:.3g}{missed} | {low:g}-{high:g} "
        f"({CHI2[1][0]:g}-{CHI2[1][1]:g}) |",
    )
    head = (
        f"{a['circles']:.0f} circles of 1.5 mm radius, 30-60 mm away, tilted by 0-45 degrees; "
        f"{a['missed']:.0f} missed. Images: 640 x 480 pixels, blur {BLUR:g} px, noise {NOISE:g} "
        "DN. Of the two possible poses of one circle in one image, the first was correct in "
        f"{100 * a['preferred_right']:.0f} %; `detect_circles` reported a mean probability of "
        f"{100 * a['preferred_probability']:.0f} %."
    )
    return head + "\n\n" + _rows("| quantity | measured | required (target) |", rows)


def _methods(result: Mapping[str, Any]) -> str:
    best = next(iter(result["methods"].values()))["mean_mm"]
    rows = [
        f"| {name} | {m['mean_mm']:.4f} | {m['mean_mm'] / best:.1f} | {m['worst_mm']:.3f} | "
        f"{m['depth_bias_mm']:+.4f} |"
        for name, m in result["methods"].items()
    ]
    return _rows(
        "| method, same images | mean error, mm | ratio | worst, mm | depth bias, mm |", rows
    )


def _chord_noise(result: Mapping[str, Any]) -> str:
    best = next(iter(result["chord_noise"].values()))["mean_mm"]
    rows = [
        f"| {name} | {m['mean_mm']:.4f} | {m['mean_mm'] / best:.1f} | {m['worst_mm']:.3f} |"
        for name, m in result["chord_noise"].items()
    ]
    return _rows(
        f"| edge points displaced by {marker_methods.CHORD_END_PX:g} px | mean error, mm | ratio | "
        "worst, mm |",
        rows,
    )


def _board_from_name(result: Mapping[str, Any]) -> str:
    rows = [
        f"| {name} | {m['mean_mm']:.4f} | {m['worst_mm']:.4f} |"
        for name, m in result["board_from_name"].items()
    ]
    return _rows("| flat board of 16 circles | mean error, mm | worst, mm |", rows)


def _surface(result: Mapping[str, Any]) -> str:
    s = result["surface"]
    rows = [
        f"| {name} | {s[key + '_rms_mm']:.4f} | {s[key + '_rms_mm'] / s['spline_rms_mm']:.1f} | "
        f"{s[key + '_worst_mm']:.3f} |"
        for name, key in (
            ("smoothing spline (default)", "spline"),
            ("method of the paper: Delaunay, grid, B-spline", "delaunay"),
        )
    ]
    return _rows(
        f"| membrane under a ball, {s['markers']} markers, {s['frames']} images | rms error, mm "
        "| ratio | worst, mm |",
        rows,
    )


def _speed(result: Mapping[str, Any]) -> str:
    rows = [
        f"| {r['markers']} | {r['detect_ms']:.2f} | {r['pose_ms']:.2f} | {r['total_ms']:.2f} | "
        f"{1e3 * r['total_ms'] / r['markers']:.0f} | {r['blob_detector_ms']:.1f} | "
        f"{r['blob_detector_ms'] / r['total_ms']:.1f} | {r['opencv_sine_ms']:.1f} |"
        for r in result["speed"]
    ]
    return _rows(
        "| markers | detection, ms | pose, ms | total, ms | us per marker | SimpleBlobDetector, "
        "ms | ratio | findContours + fitEllipse + sine rule, ms |",
        rows,
    )


def _blur(result: Mapping[str, Any]) -> str:
    rows = [
        f"| {r['blur_px']:g} | {r['bias_um']:+.2f} | {r['sd_um']:.2f} | {r['uncorrected_um']:.1f} |"
        for r in result["bias_against_blur"]
    ]
    return _rows("| blur, px | depth bias, um | sd, um | bias without correction, um |", rows)


def _small(result: Mapping[str, Any]) -> str:
    rows = [
        f"| {r['surface']} | {r['depth_shared']} | {r['scatter_never_percent']:.2f} | "
        f"{r['scatter_auto_percent']:.2f} |"
        for r in result["small_circles"]
    ]
    return _rows(
        "| 100 circles of 4 px, low-cost camera | images with smoothed depth | depth scatter, each "
        "circle alone, % | depth scatter of `detect_circles`, % |",
        rows,
    )
