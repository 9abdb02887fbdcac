"""Forces, pressure and opening over the last seconds, with the phases as bands behind them."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from mujoco.studio.dear_imgui import dear_imgui as imgui
from mujoco.studio.implot import implot

from mjtactile.core.types import Array
from mjtactile.report.summary_figure import PHASE_COLOURS
from mjtactile.runtime.supervisor import STATES
from mjtactile.studio.snapshot import Curves

_BARS = 5  # points from one error bar to the next
_UNEASY = "#f8b0a0"
_UNKNOWN = "#eeeeee"
_ALPHA = 0.35
_LEGEND = int(implot.LegendFlags.Outside) | int(implot.LegendFlags.Horizontal)
_FIT = int(implot.AxisFlags.AutoFit)


def build(curves: Curves | None, names: Sequence[str]) -> None:
    """Build one tab per quantity; quantities without finite values are left out."""
    if curves is None or not imgui.BeginTabBar("##curves"):
        return
    if imgui.BeginTabItem("force"):
        if _begin_plot("normal force, N", curves):
            _forces(curves, names)
            implot.EndPlot()
        imgui.EndTabItem()
    for title, label, values, factor in (
        ("pressure", "gauge pressure, kPa", curves.pressure, 1e-3),
        ("opening", "opening, mm", curves.opening[None], 1e3),
    ):
        if np.isfinite(values).any() and imgui.BeginTabItem(title):
            if _begin_plot(label, curves):
                for name, value in zip(names if len(values) > 1 else [title], values, strict=False):
                    _line(name, curves.time, factor * value)
                implot.EndPlot()
            imgui.EndTabItem()
    imgui.EndTabBar()


def _begin_plot(label: str, curves: Curves) -> bool:
    if not implot.BeginPlot(f"##{label}", imgui.Vec2(-1, -1)):
        return False
    implot.SetupAxes("t, s", label, _FIT, _FIT)
    implot.SetupLegend(int(implot.Location.South), _LEGEND)
    _bands(curves)
    return True


def _forces(curves: Curves, names: Sequence[str]) -> None:
    for k, name in enumerate(names):
        known = np.isfinite(curves.estimated[k])
        time = curves.time[known]
        estimated = curves.estimated[k][known]
        sd = curves.sd[k][known]
        _line(f"{name}, estimated", time, estimated)
        some = slice(len(time) % _BARS, None, _BARS)
        implot.PlotErrorBars(f"{name}, estimated", time[some], estimated[some], 2 * sd[some])
        if np.isfinite(curves.true[k]).any():
            _line(f"{name}, ground truth", curves.time, curves.true[k])


def _line(name: str, time: Array, values: Array) -> None:
    implot.PlotLine(name, time, values)


def _bands(curves: Curves) -> None:
    """Plot phases as bands behind the curves. Interventions of the supervisor are red."""
    implot.SetupFinish()
    corner = implot.GetPlotPos()
    size = implot.GetPlotSize()
    canvas = imgui.GetWindowDrawList()
    ink = imgui.GetColorU32(int(imgui.Col.Text), 0.6)
    implot.PushPlotClipRect()
    for name, start, end in curves.spans:
        left, right = (implot.PlotToPixels(time, 0.0).x for time in (start, end))
        if not math.isfinite(left + right) or right < corner.x or left > corner.x + size.x:
            continue
        canvas.AddRectFilled(
            imgui.Vec2(left, corner.y), imgui.Vec2(right, corner.y + size.y), _colour(name)
        )
        if right - left > 7 * len(name):
            canvas.AddText(imgui.Vec2(max(left, corner.x) + 3, corner.y + 2), ink, name)
    if math.isfinite(curves.now):
        x = implot.PlotToPixels(curves.now, 0.0).x
        canvas.AddLine(imgui.Vec2(x, corner.y), imgui.Vec2(x, corner.y + size.y), ink, 2.0)
    implot.PopPlotClipRect()


def _colour(name: str) -> int:
    text = _UNEASY if name in STATES else PHASE_COLOURS.get(name, _UNKNOWN)
    return imgui.GetColorU32(
        imgui.Vec4(*(int(text[i : i + 2], 16) / 255 for i in (1, 3, 5)), _ALPHA)
    )
