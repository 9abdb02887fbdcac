"""`summary.json` and `summary.png` of a run: what the camera saw, the surface felt, and the forces over time.

matplotlib is an optional dependency (extra `plots`); without it only the picture is left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.errors import MjtactileError
from mjtactile.recording import FINGERS, CycleLike, Recording
from mjtactile.sensing.ellipse import boundary, shape_from_axes
from mjtactile.sensing.markers import detect
from mjtactile.types import Ellipses, Image, Touch

PHASE_COLOURS = {
    "approach": "#e8eef5", "close": "#d3e3f3", "regulate": "#fdebd0", "lift": "#e3f1dc", "hold": "#c9e7bd",
    "lower": "#e3f1dc", "release": "#e8eef5", "abort": "#f8d0d0", "done": "#ffffff",
}  # fmt: skip
FINGER_COLOURS = ("#1f5fa8", "#d1571b")
_MM = 1e3


def write_figure(path: Path, recording: Recording, snapshot: CycleLike | None, summary: Mapping[str, Any]) -> None:
    """Draw the run's picture into `path` (PNG); `snapshot` is the cycle whose left image and surface are shown.

    Raises MjtactileError when matplotlib is not installed.
    """
    figure_class, canvas_class = _matplotlib()
    figure = figure_class(figsize=(12.8, 9.6), dpi=110, layout="constrained")
    canvas_class(figure)
    grid = figure.add_gridspec(2, 2, height_ratios=[1.12, 1], width_ratios=[1.12, 1])
    figure.suptitle(_title(summary), fontsize=14, fontweight="bold")
    left, right = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[0, 1], projection="3d", computed_zorder=False)
    if snapshot is None:
        for axes in (left, right):
            axes.set_axis_off()
        left.text(0.5, 0.5, "the run ended before the first image", ha="center", transform=left.transAxes)
    else:
        touch = snapshot.touch[0]
        _draw_image(left, snapshot.images[0], detect(snapshot.images[0]), f"left finger's camera, t = {snapshot.time:.2f} s")
        draw_surface(right, touch)
    _draw_forces(figure.add_subplot(grid[1, :]), recording, snapshot)
    part = path.with_name(path.name + ".part")
    figure.savefig(part, format="png")
    part.replace(path)


def _matplotlib() -> tuple[Any, Any]:
    """The figure and the canvas class; no pyplot, so no display and no global state."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MjtactileError("matplotlib is not installed: pip install 'mjtactile[plots]'") from error
    return Figure, FigureCanvasAgg


def _title(summary: Mapping[str, Any]) -> str:
    parts = [f"{summary.get('object', '?')}: {summary.get('outcome', '?')}"]
    for key, label in (("hold_force_N", "hold"), ("hold_force_true_N", "hold (true)"), ("peak_force_true_N", "peak (true)")):
        if isinstance(summary.get(key), (int, float)) and np.isfinite(summary[key]):
            parts.append(f"{label} {summary[key]:.2f} N")
    return "   ·   ".join([*parts, f"sensor {summary.get('sensor', '?')}", f"seed {summary.get('seed', '?')}"])


def _draw_image(axes: Any, image: Image, ellipses: Ellipses, title: str) -> None:
    """The camera image with the fitted ellipses; pixel (0, 0) is the centre of the top-left pixel."""
    axes.imshow(image.pixels, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
    if len(ellipses):
        curves, _ = boundary(ellipses.center_px, shape_from_axes(ellipses.semi_axes_px, ellipses.angle), 60)
        curves = np.concatenate([curves, curves[:, :1]], axis=1)  # closed
        axes.plot(*curves.transpose(2, 1, 0), color="#39d353", linewidth=1.1)
        axes.plot(*ellipses.center_px.T, "+", color="#ff5a4f", markersize=4)
    axes.set_title(f"{title}: {len(ellipses)} ellipses fitted", fontsize=11)
    axes.set_xlabel("u [px]")
    axes.set_ylabel("v [px]")
    height, width = image.pixels.shape
    axes.set_xlim(-0.5, width - 0.5)
    axes.set_ylim(height - 0.5, -0.5)


def draw_surface(axes: Any, touch: Touch) -> None:
    """The reconstructed membrane; arrows are the force on it, drawn outward (minus sign) like in the paper's Fig. 7."""
    surface, traction = touch.surface, touch.traction
    if surface is None:
        axes.set_axis_off()
        axes.set_title(f"no surface: {touch.status}", fontsize=11)
        return
    x, y = np.meshgrid(surface.x * _MM, surface.y * _MM)
    z = surface.z * _MM
    axes.plot_surface(x, y, z, cmap="viridis", linewidth=0.2, edgecolor="#00000030", rcount=40, ccount=40, alpha=0.9,
                      zorder=1)
    span = max(float(np.ptp(z)), 1.0)
    top = float(z.max())
    if traction is not None and traction.status == "ok":
        top = max(top, _draw_arrows(axes, traction, surface, span))
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("y [mm]")
    axes.set_zlabel("z [mm]")
    axes.set_zlim(min(float(z.min()), 0.0), top + 0.05 * span)
    axes.set_box_aspect((float(np.ptp(x)), float(np.ptp(y)), 0.6 * float(np.ptp(y))))
    axes.view_init(elev=38, azim=-62)
    title = "membrane in the sensor's frame S"
    if touch.status != "ok" or np.isfinite(touch.force_normal):
        known = f"{touch.force_normal:.2f} ± {touch.force_normal_sd:.2f} N"
        felt = known if touch.status == "ok" else f"unknown: {touch.status}"
        title = f"membrane (sensor frame S) and force on it, shown with a minus sign\nnormal force {felt}"
    axes.set_title(title, fontsize=11)


def _draw_arrows(axes: Any, traction: Any, surface: Any, span: float) -> float:
    """Draw the force at the nodes where it is more than 15 % of the largest; returns the highest tip, mm."""
    force = traction.force
    size = np.linalg.norm(force, axis=-1)
    step = max(1, round(max(size.shape) / 24))  # no more than about 24 arrows a row
    keep = np.zeros(size.shape, dtype=bool)
    keep[::step, ::step] = True
    keep &= size > 0.15 * size.max(initial=0.0)
    if not keep.any():
        return float(surface.z.max()) * _MM
    gx, gy = np.meshgrid(traction.x, traction.y)
    iy = np.abs(surface.y[:, None] - gy[keep]).argmin(axis=0)
    ix = np.abs(surface.x[:, None] - gx[keep]).argmin(axis=0)
    foot_z = surface.z[iy, ix] * _MM
    arrow = -force[keep] / size.max() * 1.3 * span
    axes.quiver(gx[keep] * _MM, gy[keep] * _MM, foot_z, *arrow.T, color="#c0221c", linewidth=1.1, arrow_length_ratio=0.22,
                zorder=2)
    return float((foot_z + arrow[:, 2]).max())


def _draw_forces(axes: Any, recording: Recording, snapshot: CycleLike | None) -> None:
    """Estimated (line, with a band of two sd) and true (dashed) normal force per finger, phases shaded and named."""
    time = recording.columns["time"]
    axes.set_xlabel("time [s]")
    axes.set_ylabel("normal force on a finger [N]")
    if len(time) == 0:
        axes.text(0.5, 0.5, "no cycle was recorded", ha="center", transform=axes.transAxes)
        return
    estimated, sd, true = (recording.column(key) for key in ("force_normal", "force_normal_sd", "force_normal_true"))
    for i, colour in enumerate(FINGER_COLOURS[: estimated.shape[1]]):
        low, high = estimated[:, i] - 2 * sd[:, i], estimated[:, i] + 2 * sd[:, i]
        axes.fill_between(time, low, high, color=colour, alpha=0.18, linewidth=0)
        axes.plot(time, estimated[:, i], color=colour, linewidth=1.8, label=f"{FINGERS[i]}: estimated ± 2 sd")
        if np.isfinite(true[:, i]).any():
            axes.plot(time, true[:, i], color=colour, linewidth=1.4, linestyle=(0, (4, 2)), label=f"{FINGERS[i]}: true")
    values = np.concatenate([estimated.ravel(), true.ravel()])
    top = _draw_break_force(axes, recording.notes.get("break_force_N"), 1.35 * float(np.nanmax(values, initial=0.2)))
    axes.set_ylim(min(-0.05 * top, 1.1 * float(np.nanmin(values, initial=0.0))), top)
    axes.set_xlim(time[0], max(time[-1], time[0] + 1e-3))
    _shade_phases(axes, recording)
    if snapshot is not None:
        axes.axvline(snapshot.time, color="#444444", linewidth=0.9, linestyle=":")
    axes.grid(axis="y", color="#00000018")
    axes.legend(loc="upper left", ncols=3, fontsize=9, framealpha=0.9)


def _draw_break_force(axes: Any, force: Any, top: float) -> float:
    """A line where the object breaks, or a note when that is so far up that it would flatten the curves; the new top."""
    if not isinstance(force, (int, float)) or not np.isfinite(force):
        return top
    if force > 2.5 * top:
        axes.text(0.995, 0.97, f"object breaks at {force:g} N  \u2191", transform=axes.transAxes, ha="right", va="top",
                  color="#b00020", fontsize=10, fontweight="bold")
        return top
    axes.axhline(force, color="#b00020", linewidth=1.4, label=f"object breaks at {force:g} N")
    return max(top, 1.25 * force)


def _shade_phases(axes: Any, recording: Recording) -> None:
    """Colour the time of each phase and write its name above it."""
    duration = recording.columns["time"][-1] - recording.columns["time"][0]
    for name, start, end in recording.phases():
        if name == "done":
            continue  # it is the one cycle that ends the run
        axes.axvspan(start, end, color=PHASE_COLOURS.get(name, "#eeeeee"), zorder=0, linewidth=0)
        turn = 0 if end - start > 0.07 * duration else 40
        axes.text((start + end) / 2, 1.015, name, transform=axes.get_xaxis_transform(), rotation=turn,
                  ha="center" if turn == 0 else "left", va="bottom", fontsize=9.5, color="#333333")
