"""Summary, table and figure of `mjtactile bench touch`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.touch import sharp_indenters
from mjtactile.report.figures import new_figure

LIGHT = 0.03  # required detection threshold, N
_DIRECTION_MIN = 0.3  # minimum shear force for a direction error, N


def summary(name: str, result: Mapping[str, Any]) -> dict[str, Any]:
    """Summarize the results of one sensor."""
    rows = [row for row in result["touches"] if row["sensor"] == name]
    error = np.array([r["error_N"] for r in rows])
    true = np.array([r["force_true_N"] for r in rows])
    torque = np.array([r["torque_error_Nmm"] for r in rows])
    sd = np.array([r["sd"] for r in rows])
    full = np.linalg.norm(true, axis=1)
    estimated = [r for r in rows if r["touching"] and -r["force_true_N"][2] > 0.1]
    fraction = np.array([r["area_mm2"] / r["area_true_mm2"] - 1 for r in estimated])
    light = [r["touching"] for r in rows if LIGHT <= -r["force_true_N"][2] < 2 * LIGHT]
    levels = {
        level: float(np.mean(np.abs([r[level] + r["force_true_N"][2] for r in rows])))
        for level in ("level1_N", "level2_N", "weak_form_N")
    }

    return {
        "touches": len(rows),
        "normal_mae_N": _mean(np.abs(error[:, 2])),
        "normal_bias_N": _mean(error[:, 2]),
        "normal_worst_N": float(np.abs(error[:, 2]).max()),
        "shear_mae_N": _mean(np.hypot(error[:, 0], error[:, 1])),
        "direction_deg": _mean(
            [
                r["direction_error_deg"]
                for r, f in zip(rows, full, strict=True)
                if f > _DIRECTION_MIN
            ]
        ),
        "torque_Nmm": _mean(np.linalg.norm(torque, axis=1)),
        "centroid_mm": _mean([r["centroid_error_mm"] for r in estimated]),
        "area_share": float(np.median(np.abs(fraction))) if len(fraction) else float("nan"),
        "area_bias_share": float(np.median(fraction)) if len(fraction) else float("nan"),
        "light_touches": len(light),
        "light_detected": sum(light),
        **levels,
        "chi_square": ((error / sd[:, :3]) ** 2).mean(axis=0),
        "chi_square_torque": ((1e-3 * torque / sd[:, 3:]) ** 2).mean(axis=0),
        "milliseconds": result["milliseconds"][name],
        "milliseconds_p95": result["milliseconds_p95"][name],
    }


def _mean(values: Any) -> float:
    return float(np.nanmean(values)) if len(values) else float("nan")


def table(result: Mapping[str, Any]) -> str:
    """Return the result as Markdown, next to the requirements."""
    sensors = result["sensors"]
    lines = [
        "| quantity | required (target) | " + " | ".join(sensors) + " |",
        "|---" * (2 + len(sensors)) + "|",
    ]

    def line(quantity: str, limit: str, aim: str, show: Callable[[Mapping[str, Any]], str]) -> None:
        lines.append(
            f"| {quantity} | {f'{limit} ({aim})' if aim else limit} | "
            + " | ".join(show(s) for s in sensors.values())
            + " |"
        )

    line(
        "normal force, mean absolute error (worst), N",
        ".02 / .04",
        ".01 / .02",
        lambda s: f"{s['normal_mae_N']:.4f} ({s['normal_worst_N']:.3f})",
    )
    line("… weak form on interpolated markers", "", "", lambda s: f"{s['weak_form_N']:.4f}")
    line(
        "… level 1: dF = c dA, c calibrated on a cylinder", "", "", lambda s: f"{s['level1_N']:.4f}"
    )
    line("… level 2: grid of springs", "", "", lambda s: f"{s['level2_N']:.4f}")
    line("shear force, mean absolute error, N", ".03", ".015", lambda s: f"{s['shear_mae_N']:.4f}")
    line(
        "force direction above 0.3 N, mean error, deg",
        "3",
        "1.5",
        lambda s: f"{s['direction_deg']:.2f}",
    )
    line(
        "torque about the frame center, mean error, N mm",
        "",
        "",
        lambda s: f"{s['torque_Nmm']:.3f}",
    )
    line("contact centroid, mean error, mm", ".3", ".15", lambda s: f"{s['centroid_mm']:.3f}")
    line(
        "contact area, median relative error (bias), %",
        "10",
        "7",
        lambda s: f"{100 * s['area_share']:.0f} ({100 * s['area_bias_share']:+.0f})",
    )
    line(
        "contacts of 0.03-0.06 N detected",
        "all",
        "",
        lambda s: f"{s['light_detected']} of {s['light_touches']}",
    )
    line(
        "chi-square per degree of freedom: force x, y, z",
        ".6-1.6",
        ".8-1.2",
        lambda s: ", ".join(f"{v:.2f}" for v in s["chi_square"]),
    )
    line(
        "time per image after the surface fit, median (95 %), ms",
        "3",
        "1.5",
        lambda s: f"{s['milliseconds']:.1f} ({s['milliseconds_p95']:.1f})",
    )
    lines += ["", *sharp_indenters.lines(result["sharp_sensors"])]
    return "\n".join([*lines, "", *_quiet(result), "", *_off_nominal(result)]) + "\n"


def _quiet(result: Mapping[str, Any]) -> Sequence[str]:
    lines = [
        "| no contact | images | false alarms | mean, N | sd (reported), N | largest, N |",
        "|---" * 6 + "|",
    ]
    for name, q in result["quiet"].items():
        lines.append(
            f"| {name} | {q['frames']} | {q['false_alarms']} | {q['mean_N']:+.4f} | "
            f"{q['sd_N']:.4f} ({q['predicted_sd_N']:.4f}) | {q['largest_N']:.4f} |"
        )
    return lines


def _off_nominal(result: Mapping[str, Any]) -> Sequence[str]:
    rows = result["off_nominal"]
    sensors = list(dict.fromkeys(row["sensor"] for row in rows))
    lines = [
        "| deviation from the sensor file, sphere pressed 3 mm | ground truth, N | error / sd, N: "
        + " | ".join(sensors)
        + " |",
        "|---" * (2 + len(sensors)) + "|",
    ]
    for case in dict.fromkeys(row["case"] for row in rows):
        by_sensor = {row["sensor"]: row for row in rows if row["case"] == case}
        true = next(iter(by_sensor.values()))["force_true_N"]
        shown = [_deviation(by_sensor[sensor]) for sensor in sensors]
        lines.append(f"| {case} | {true:.3f} | " + " | ".join(shown) + " |")
    return lines


def _deviation(row: Mapping[str, Any]) -> str:
    status = "" if row["status"] == "ok" else f" ({row['status']})"
    return f"{row['force_N'] - row['force_true_N']:+.3f} / {row['sd_N']:.3f}{status}"


def plot(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Plot estimated against true normal force, and the errors of normal and shear force with their
    standard deviations."""
    if (figure := new_figure(path.name, (9.6, 4.2))) is None:
        return
    left, right = figure.subplots(1, 2)
    colours = (("dense", "#1f5fa8"), ("paper16", "#c0221c"), ("fine", "#2e7d32"))
    for name, color in colours:
        selected = [r for r in rows if r["sensor"] == name]
        true = -np.array([r["force_true_N"][2] for r in selected])
        error = -np.array([r["error_N"][2] for r in selected])
        left.errorbar(
            true,
            error,
            [r["sd"][2] for r in selected],
            fmt="o",
            ms=3,
            lw=0.8,
            color=color,
            label=name,
        )
        shear = [float(np.hypot(*r["force_true_N"][:2])) for r in selected]
        right.plot(
            shear,
            [float(np.hypot(*r["error_N"][:2])) for r in selected],
            "o",
            ms=3,
            color=color,
            label=name,
        )
    for axes, force in ((left, "normal"), (right, "shear")):
        axes.set_xlabel(f"true {force} force [N]")
        axes.set_ylabel(f"error of the {force} force [N]")
        axes.grid(alpha=0.3)
        axes.legend()
    left.axhspan(-0.02, 0.02, color="#00000010", linewidth=0)
    right.axhline(0.03, color="black", linewidth=0.6)
    figure.savefig(path)
