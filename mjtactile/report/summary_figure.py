"""`summary.json` and `summary.png` of a run: camera images, estimated surface, and forces over
time.

matplotlib is an optional dependency (extra `plots`); without it only the figure is missing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core.errors import MjtactileError
from mjtactile.core.types import (
    Array,
    ContactShape,
    Ellipses,
    Image,
    Surface,
    SyntheticTouch,
    Touch,
)
from mjtactile.recording.log_schema import CycleLike
from mjtactile.recording.reader import Recording
from mjtactile.report.overlay import find_ellipses
from mjtactile.report.shape_wireframe import describe_shape, lines_of, true_lines
from mjtactile.report.software_renderer import SceneCamera, render_scene
from mjtactile.sensing.image.ellipse import boundary, shape_from_axes

PHASE_COLOURS = {
    "approach": "#e8eef5",
    "close": "#d3e3f3",
    "regulate": "#fdebd0",
    "lift": "#e3f1dc",
    "hold": "#c9e7bd",
    "lower": "#e3f1dc",
    "release": "#e8eef5",
    "abort": "#f8d0d0",
    "done": "#ffffff",
}
FINGER_COLOURS = ("#1f5fa8", "#d1571b", "#2e8b57", "#8e44ad", "#7f6000")
_ARROW = "#c0221c"
_TRUE_BODY = "#e07b00"
_MM = 1e3


def write_figure(
    path: Path,
    recording: Recording,
    snapshot: CycleLike | None,
    summary: Mapping[str, Any],
    scene: SceneCamera | None = None,
) -> None:
    """Write a run's figure (PNG) at the cycle `snapshot`. Raises MjtactileError."""
    figure_class, canvas_class = import_matplotlib()
    fingers = 1 if snapshot is None else len(snapshot.touch)
    columns = fingers + (scene is not None)
    width = max(4.6 * columns, 9.2)
    title = _title(summary)
    # Size in inches; no layout engine, since it would render everything twice
    figure = figure_class(figsize=(width, 11.4), dpi=100)
    canvas_class(figure)
    sides = {"left": 0.75 / width, "right": 1 - 0.4 / width, "wspace": 0.18}
    grid = figure.add_gridspec(
        2,
        columns,
        height_ratios=[1, 1.12],
        top=0.94 - 0.02 * title.count("\n"),
        bottom=0.345,
        hspace=0.36,
        **sides,
    )
    figure.suptitle(title, fontsize=14 if columns > 2 else 11, fontweight="bold", y=0.99)
    _plot_cycle(figure, grid, recording, snapshot, scene)
    below = figure.add_gridspec(1, 1, top=0.3, bottom=0.045, **sides)
    _plot_forces(figure.add_subplot(below[0]), recording, snapshot)
    part = path.with_name(path.name + ".part")
    # a third of the default's time
    figure.savefig(part, format="png", pil_kwargs={"compress_level": 3})
    part.replace(path)


def _plot_cycle(
    figure: Any,
    grid: Any,
    recording: Recording,
    snapshot: CycleLike | None,
    scene: SceneCamera | None,
) -> None:
    """Plot scene and fingers of the cycle `snapshot`, each in a grid column."""
    if snapshot is None:
        axes = figure.add_subplot(grid[:, :])
        axes.set_axis_off()
        axes.text(
            0.5, 0.5, "the run ended before the first image", ha="center", transform=axes.transAxes
        )
        return
    if scene is not None:
        axes = figure.add_subplot(grid[:, 0])
        render_scene(axes, scene, snapshot.touch, FINGER_COLOURS)
        axes.set_title(
            f"scene at t = {snapshot.time:.2f} s, with the estimated forces", fontsize=11
        )
    fingers = len(snapshot.touch)
    for finger, name in enumerate(recording.fingers[:fingers]):
        column = grid.ncols - fingers + finger
        _plot_finger(figure, grid[:, column], snapshot, finger, name, scene)


def _plot_finger(
    figure: Any, cell: Any, snapshot: CycleLike, finger: int, name: str, scene: SceneCamera | None
) -> None:
    """Plot one finger's image, if there is one, above its surface, in a grid column."""
    image = snapshot.images[finger]
    touch = snapshot.touch[finger]
    if isinstance(image, SyntheticTouch):
        _plot_estimate(figure.add_subplot(cell), touch, name)
        return
    grid = cell.get_gridspec()
    column = cell.colspan.start
    axes = figure.add_subplot(grid[0, column])
    _plot_image(axes, image, find_ellipses(image), f"camera of {name}")
    axes = figure.add_subplot(grid[1, column], projection="3d", computed_zorder=False)
    plot_surface_map(axes, touch, arrow_unit(snapshot.touch))
    if touch.shape is not None and touch.surface is not None:
        _plot_shape(axes, touch.shape, scene, finger)


def import_matplotlib() -> tuple[Any, Any]:
    """Import figure and canvas, without pyplot's global state. Raises MjtactileError."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        missing = "matplotlib is not installed: pip install 'mjtactile[plots]'"
        raise MjtactileError(missing) from error
    return Figure, FigureCanvasAgg


def _title(summary: Mapping[str, Any]) -> str:
    parts = [f"{summary.get('object', '?')}: {summary.get('outcome', '?')}"]
    labels = {"hold_force_N": "hold", "hold_force_true_N": "hold (ground truth)"}
    for key, label in (labels | {"peak_force_true_N": "peak (ground truth)"}).items():
        if isinstance(summary.get(key), (int, float)) and np.isfinite(summary[key]):
            parts.append(f"{label} {summary[key]:.2f} N")
    parts += [f"{key} {summary.get(key, '?')}" for key in ("sensor", "seed")]
    title = "   ·   ".join(parts)
    return f"{title}\n{summary['reason']}" if summary.get("reason") else title


def _plot_estimate(axes: Any, touch: Touch, name: str) -> None:
    """Write the estimated force as text. Synthetic touch has neither an image nor a surface."""
    axes.set_axis_off()
    force = f"{touch.force_normal:.2f} ± {touch.force_normal_sd:.2f} N"
    text = f"{name}: synthetic touch\nnormal force {force}"
    axes.text(0.5, 0.5, text, ha="center", transform=axes.transAxes, fontsize=11)


def _plot_image(axes: Any, image: Image, ellipses: Ellipses, title: str) -> None:
    """Plot the image with the ellipses; pixel (0, 0) is the top-left pixel's center."""
    height, width = image.pixels.shape
    if image.pixels.size:
        axes.imshow(image.pixels, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
    elif len(ellipses):  # no image was rendered: the markers define the visible area
        width, height = (ellipses.center_px + 2 * ellipses.semi_axes_px[:, :1]).max(axis=0)
        axes.set_aspect("equal")
    if len(ellipses):
        shapes = shape_from_axes(ellipses.semi_axes_px, ellipses.angle)
        curves, _ = boundary(ellipses.center_px, shapes, 60)
        gap = np.full((len(curves), 1, 2), np.nan)
        # each closed, all of them one line
        curves = np.concatenate([curves, curves[:, :1], gap], axis=1)
        axes.plot(*curves.reshape(-1, 2).T, color="#39d353", linewidth=1.1)
        axes.plot(*ellipses.center_px.T, "+", color="#ff5a4f", markersize=4)
    how = "fitted" if image.pixels.size else "(synthetic, no image)"
    axes.set_title(f"{title}: {len(ellipses)} ellipses {how}", fontsize=11)
    limits = {"xlim": (-0.5, width - 0.5), "ylim": (height - 0.5, -0.5)}
    axes.set(xlabel="u [px]", ylabel="v [px]", **limits)


def plot_surface_map(axes: Any, touch: Touch, unit: float | None = None) -> None:
    """Plot the reconstructed membrane.

    Arrows show the traction on the contact area, directed outward (minus sign) as in the paper's
    Fig. 7. The arrow in the corner corresponds to `unit` Pa (default: suitable for this touch).
    """
    surface = touch.surface
    unit = arrow_unit([touch]) if unit is None else unit
    if surface is None:
        axes.set_axis_off()
        axes.set_title(f"no surface: {touch.status}", fontsize=11)
        return
    x, y = np.meshgrid(surface.x * _MM, surface.y * _MM)
    z = surface.z * _MM
    edges = {"linewidth": 0.2, "edgecolor": "#00000030", "rcount": 30, "ccount": 30}
    axes.plot_surface(x, y, z, cmap="viridis", **edges, alpha=0.9, zorder=1)
    low = min(float(z.min()), 0.0)
    high = max(float(z.max()), 1.0)
    length = 0.5 * (high - low)  # of the unit's arrow
    top = max(high, _plot_arrows(axes, touch, surface, length / unit))
    corner = (x.min(), y.min(), low)
    style = {"color": _ARROW, "zorder": 3}
    axes.quiver(*corner, 0, 0, length, linewidth=1.6, arrow_length_ratio=0.25, **style)
    end = (*corner[:2], low + 1.1 * length)
    axes.text(*end, f"{1e-3 * unit:g} kPa", fontsize=9, ha="center", **style)
    axes.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    axes.set_zlim(low, top + 0.05 * (high - low))
    axes.set_box_aspect((float(np.ptp(x)), float(np.ptp(y)), 0.6 * float(np.ptp(y))), zoom=0.93)
    axes.view_init(elev=38, azim=-62)
    force = f"unknown: {touch.status}"
    if touch.status == "ok":
        force = f"{touch.force_normal:.2f} ± {touch.force_normal_sd:.2f} N"
    title = f"membrane, and traction with inverted sign\nnormal force {force}"
    axes.set_title(title, fontsize=11)


def _plot_shape(axes: Any, shape: ContactShape, scene: SceneCamera | None, finger: int) -> None:
    """Plot the estimated contact shape, and in simulation the ground truth."""
    true = [] if scene is None else true_lines(shape, scene, finger)
    for piece in true:
        axes.plot(*(_MM * piece.T), color=_TRUE_BODY, linewidth=2.0, zorder=4)
    for line in lines_of(shape):
        axes.plot(*(_MM * line.T), color="#111111", linewidth=1.3, zorder=5)
    text = describe_shape(shape) + ("; ground truth orange" if len(true) else "")
    axes.text2D(0.5, 0.98, text, transform=axes.transAxes, ha="center", va="top", fontsize=10)


def arrow_unit(touch: Sequence[Touch]) -> float:
    """Return the traction of the scale arrow, Pa: a round value up to the largest estimate."""
    norms = (np.linalg.norm(_tractions(estimate), axis=-1) for estimate in touch)
    largest = max((float(norm.max(initial=0.0)) for norm in norms), default=0.0)
    if largest <= 0:
        return 1000.0
    decade = 10.0 ** np.floor(np.log10(largest))
    return float(max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= largest))


def _tractions(touch: Touch) -> Array:
    """Return the force per area (ny, nx, 3), Pa, at the nodes in contact; zero elsewhere."""
    traction = touch.traction
    contact = touch.contact
    if traction is None or contact is None or not touch.touching or not traction.force.size:
        return np.zeros((1, 1, 3))
    if contact.mask.shape != traction.force.shape[:2]:
        return np.zeros((1, 1, 3))
    area = float(np.diff(traction.x).mean() * np.diff(traction.y).mean())
    return np.where(contact.mask[..., None], np.nan_to_num(traction.force), 0.0) / area


def arrows(touch: Touch, surface: Surface) -> tuple[Array, Array]:
    """Return positions (n, 3), mm, and tractions (n, 3), Pa, in the contact area."""
    stress = _tractions(touch)
    size = np.linalg.norm(stress, axis=-1)
    keep = np.zeros(size.shape, dtype=bool)
    step = max(1, round(max(size.shape) / 24))  # at most about 24 arrows per row
    keep[::step, ::step] = True
    keep &= size > 0.03 * size.max(initial=0.0)
    if touch.traction is None or not keep.any():
        return np.zeros((0, 3)), np.zeros((0, 3))
    gx, gy = np.meshgrid(touch.traction.x, touch.traction.y)
    iy = np.abs(surface.y[:, None] - gy[keep]).argmin(axis=0)
    ix = np.abs(surface.x[:, None] - gx[keep]).argmin(axis=0)
    return _MM * np.column_stack([gx[keep], gy[keep], surface.z[iy, ix]]), stress[keep]


def _plot_arrows(axes: Any, touch: Touch, surface: Surface, mm_per_Pa: float) -> float:
    """Plot the traction at the contact; returns the highest arrow tip, mm."""
    foot, stress = arrows(touch, surface)
    if not len(foot):
        return float(surface.z.max()) * _MM
    arrow = -stress * mm_per_Pa
    axes.quiver(*foot.T, *arrow.T, color=_ARROW, linewidth=1.1, arrow_length_ratio=0.22, zorder=2)
    return float((foot + arrow)[:, 2].max())


def _plot_forces(axes: Any, recording: Recording, snapshot: CycleLike | None) -> None:
    """Plot estimated (line, 2 sd) and true (dashed) normal forces, with phases."""
    time = recording.columns["time"]
    axes.set_xlabel("time [s]")
    axes.set_ylabel("normal force per finger [N]")
    if len(time) == 0:
        axes.text(0.5, 0.5, "no cycle was recorded", ha="center", transform=axes.transAxes)
        return
    keys = ("force_normal", "force_normal_sd", "force_normal_true")
    estimated, sd, true = map(recording.column, keys)
    dashed = {"linewidth": 1.4, "linestyle": (0, (4, 2))}
    for i, (name, colour) in enumerate(zip(recording.fingers, FINGER_COLOURS, strict=False)):
        low = estimated[:, i] - 2 * sd[:, i]
        high = estimated[:, i] + 2 * sd[:, i]
        axes.fill_between(time, low, high, color=colour, alpha=0.18, linewidth=0)
        axes.plot(
            time, estimated[:, i], color=colour, linewidth=1.8, label=f"{name}: estimated ± 2 sd"
        )
        if np.isfinite(true[:, i]).any():
            axes.plot(time, true[:, i], color=colour, label=f"{name}: ground truth", **dashed)
    values = np.concatenate([estimated.ravel(), true.ravel()])
    top = 1.35 * float(np.nanmax(values, initial=0.2))
    top = _plot_break_force(axes, recording.notes.get("break_force_N"), top)
    axes.set_ylim(min(-0.05 * top, 1.1 * float(np.nanmin(values, initial=0.0))), top)
    axes.set_xlim(time[0], max(time[-1], time[0] + 1e-3))
    _shade_phases(axes, recording)
    if snapshot is not None:
        axes.axvline(snapshot.time, color="#444444", linewidth=0.9, linestyle=":")
    axes.grid(axis="y", color="#00000018")
    axes.legend(loc="upper left", ncols=3, fontsize=9, framealpha=0.9)


def _plot_break_force(axes: Any, force: Any, top: float) -> float:
    """Plot the break force, or a note if it is too high. Return the upper limit."""
    if not isinstance(force, (int, float)) or not np.isfinite(force):
        return top
    if force > 2.5 * top:
        at = {"transform": axes.transAxes, "ha": "right", "va": "top"}
        style = {"color": "#b00020", "fontsize": 10, "fontweight": "bold"}
        axes.text(0.995, 0.97, f"object breaks at {force:g} N  \u2191", **at, **style)
        return top
    axes.axhline(force, color="#b00020", linewidth=1.4, label=f"object breaks at {force:g} N")
    return max(top, 1.25 * force)


def _shade_phases(axes: Any, recording: Recording) -> None:
    """Shade the time of each phase and write its name above it."""
    duration = recording.columns["time"][-1] - recording.columns["time"][0]
    for name, start, end in recording.phases():
        if name == "done":
            continue  # the last cycle ends the run
        axes.axvspan(start, end, color=PHASE_COLOURS.get(name, "#eeeeee"), zorder=0, linewidth=0)
        rotation = 0 if end - start > 0.07 * duration else 40
        align = {"rotation": rotation, "ha": "left" if rotation else "center", "va": "bottom"}
        style = {"transform": axes.get_xaxis_transform(), "fontsize": 9.5, "color": "#333333"}
        axes.text((start + end) / 2, 1.015, name, **align, **style)
