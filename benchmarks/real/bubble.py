"""`mjtactile bench bubble --data FOLDER`: force on a real air-filled bubble, pressed once to about
4.8 N.

The force follows from surface and pressure (`mjtactile.estimate_force_from_surface`). It is
compared with the wrench of a wrist sensor.

The recording is `demo/0` of uiuc-iml/punyo_force_estimation. FOLDER holds its `data.json`, rows of
[time s, absolute pressure hPa, six joint angles, wrench of a wrist sensor N, N m], and
`points.npz`, `pc_K` the depth image of row K as points (h, w, 3) m. Neither the ambient air
pressure nor the frame was recorded.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile import InputError, RestSurface, estimate_force_from_surface
from mjtactile.core.types import Array
from mjtactile.recording.files import write_json
from mjtactile.report.figures import new_figure

AMBIENT = 98_700.0
"""Standard atmosphere at 222 m, the altitude of the recording, Pa; weather changes it by 1 kPa."""
OUTLINE = np.array([[-27, -36], [62, -36], [62, 40], [-27, 40]]) * 1e-3
"""Outline of the visible bubble in the camera's frame, m; the image cuts off its right end."""
DEPTHS = (0.055, 0.11)  # depth range of the bubble, m; other points are missing or background
REST = (0, 10, 20, 40)  # rows without contact
QUIET = slice(30, 60)  # rows before the touch, with the arm where it presses
PRESSING = slice(70, 101)  # rows of the hold
LOADING = 72  # last row that the factor is fitted to
SMOOTHING = 4e-3


def run(
    out: Path,
    *,
    quick: bool = False,
    data: Path | None = None,
    notify: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """Estimate the force of each depth image, and plot it next to the wrist sensor's in `out`."""
    if data is None:
        raise InputError("needs the recording's folder", field="--data")
    rows, clouds = _read(Path(data))
    gauge = 100 * rows[:, 1] - AMBIENT
    zero = rows[QUIET, 8:11].mean(axis=0)
    wrist = np.linalg.norm(rows[:, 8:11] - zero, axis=1)
    untouched = np.concatenate([clouds[row] for row in REST])
    rest = RestSurface(untouched, float(gauge[: max(REST)].mean()))
    found = []
    field = None
    for row in sorted(clouds):
        if quick and row % 20:
            continue
        estimated = estimate_force_from_surface(
            clouds[row], gauge[row], OUTLINE, rest, smoothing=SMOOTHING
        )
        found.append(
            {
                "row": row,
                "time_s": rows[row, 0] - rows[0, 0],
                "force_N": estimated.force.tolist(),
                "estimated_N": float(np.linalg.norm(estimated.force)),
                "wrist_N": float(wrist[row]),
                "area_mm2": 1e6 * estimated.area,
            }
        )
        notify(f"row {row}: {found[-1]['estimated_N']:.2f} N, wrist {found[-1]['wrist_N']:.2f} N")
        if field is None or estimated.area > field.area:
            field = estimated
    result = {
        "rows": found,
        "gauge_kPa": 1e-3 * rest.pressure,
        "noise_wrist_N": float(wrist[QUIET].std()),
        **summary(found, rest.pressure),
    }
    write_json(Path(out) / "bubble.json", result)
    _plot(Path(out), rows[:, 0] - rows[0, 0], wrist, result, field)
    return result


def summary(found: list[dict[str, Any]], gauge: float) -> dict[str, float]:
    """Return the force errors relative to the wrist sensor, N.

    They are given without a correction, and with one factor fitted to the loading phase.
    """
    row, estimated, wrist = (
        np.array([item[key] for item in found]) for key in ("row", "estimated_N", "wrist_N")
    )
    held = (row >= PRESSING.start) & (row < PRESSING.stop)
    growing = (estimated > 0) & (row <= LOADING)
    later = (estimated > 0) & (row > LOADING)
    factor = float(
        wrist[growing] @ estimated[growing] / max(estimated[growing] @ estimated[growing], 1e-12)
    )
    return {
        "wrist_held_N": float(wrist[held].mean()),
        "estimated_held_N": float(estimated[held].mean()),
        "untouched_most_N": float(estimated[row < 61].max(initial=0.0)),
        "factor": factor,
        "ambient_by_factor_kPa": 1e-3 * (AMBIENT + gauge - factor * gauge),
        "later_rms_N": float(np.sqrt(np.mean((factor * estimated[later] - wrist[later]) ** 2))),
    }


def table(result: Mapping[str, Any]) -> str:
    """Return the results in Markdown."""
    held, estimated = result["wrist_held_N"], result["estimated_held_N"]
    rows = [
        ("gauge pressure at rest with the standard atmosphere, kPa", "gauge_kPa", 2),
        ("wrist sensor during the hold, N", "wrist_held_N", 2),
        ("estimate from surface and pressure, N", "estimated_held_N", 2),
        ("largest estimate without contact, N", "untouched_most_N", 2),
        ("factor fitted to the increasing load", "factor", 2),
        ("rms error of hold and release with this factor, N", "later_rms_N", 2),
        ("ambient pressure that would explain the factor, kPa", "ambient_by_factor_kPa", 1),
    ]
    lines = ["| real bubble sensor, one load |  |", "|---|---|"]
    lines += [f"| {words} | {result[key]:.{digits}f} |" for words, key, digits in rows]
    lines.insert(5, f"| error | {100 * (estimated / held - 1):+.0f} % |")
    return "\n".join(lines)


def _read(folder: Path) -> tuple[Array, dict[int, Array]]:
    """Read the rows (n, 14), and the points (m, 3), m, of those that have any."""
    try:
        given = json.loads((folder / "data.json").read_text(encoding="utf-8"))
        with np.load(folder / "points.npz") as stored:
            clouds = {int(name[3:]): np.asarray(stored[name], float) for name in stored.files}
    except (OSError, ValueError) as error:
        raise InputError(
            f"holds no data.json and points.npz: {error}", source=folder, field="--data"
        ) from error
    rows = np.array(
        [[time, pressure, *joints, *wrench] for time, pressure, joints, wrench in given]
    )
    near, far = DEPTHS
    return rows, {
        row: flat[(flat[:, 2] > near) & (flat[:, 2] < far)]
        for row, points in clouds.items()
        for flat in [points.reshape(-1, 3)]
    }


def _plot(out: Path, time: Array, wrist: Array, result: Mapping[str, Any], field: Any) -> None:
    figure = new_figure("bubble.png", (10.0, 3.8))
    if figure is None:
        return
    curves, surface = figure.subplots(1, 2, width_ratios=(3, 2))
    at = [row["time_s"] for row in result["rows"]]
    estimated = np.array([row["estimated_N"] for row in result["rows"]])
    curves.plot(time, wrist, "k-", lw=1, label="wrist's wrench, magnitude")
    curves.plot(at, estimated, "o-", ms=4, label="surface and gauge, by statics")
    curves.plot(
        at, result["factor"] * estimated, "s:", ms=3, label=f"that, times {result['factor']:.2f}"
    )
    curves.set(xlabel="time, s", ylabel="force, N", title="a real bubble, pressed once")
    curves.grid(alpha=0.3)
    curves.legend(fontsize=8)
    sampled = surface.pcolormesh(
        1e3 * field.x, 1e3 * field.y, 1e-3 * field.pressing.T, cmap="RdBu_r", vmin=-20, vmax=20
    )
    surface.contour(
        1e3 * field.x, 1e3 * field.y, 1e3 * field.heights.T, 12, colors="k", linewidths=0.4
    )
    surface.set(xlabel="x, mm", ylabel="y, mm", aspect="equal", title="what presses, kPa")
    figure.colorbar(sampled, ax=surface)
    figure.savefig(out / "bubble.png")
