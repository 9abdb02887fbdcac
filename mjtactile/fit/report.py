"""Report of a fit: text and a figure of the residuals."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mjtactile.fit.parameter_info import NOT_FITTED, SD95, FittedParameter, digits
from mjtactile.fit.result import FitResult


def text_of(result: FitResult) -> str:
    """Return the text: fitted values, correlations, undetermined values and held-out errors."""
    fitted = [n for n in result.parameters if n.state == "fitted"]
    lines = [f"{'field':28} {'file':>10} {'found':>10}   95 % interval"]
    lines += [
        f"{n.field:28} {n.before:10.5g} {digits(n.value, n.sd):>10}   {_interval(n)}"
        for n in fitted
    ]
    lines += [
        f"{n.field:28} {n.before:10.5g} {n.value:10.5g}   measured by hand"
        for n in result.parameters
        if n.state == "known"
    ]
    lines += ["", "not in these recordings (the file's value stays):"]
    lines += [
        f"  {n.field}: {n.comment.partition('; ')[2]}"
        for n in result.parameters
        if n.state == "not in these recordings"
    ]
    lines += [f"  {name}: {why}" for name, why in NOT_FITTED.items()]
    if result.correlations:
        lines += ["", *result.correlations]
    membrane = result.design.membrane
    lines += [
        "",
        f"modulus times thickness: {membrane.young * membrane.thickness:.4g} N/m, the scale of all "
        "forces",
        f"marker residual: {1e6 * result.membrane.rms:.1f} um (rms), "
        f"{result.membrane.misfit:.1f} times its expected size (above 1: intervals are scaled)",
        result.lens,
    ]
    if result.gas is not None:
        lines += [
            f"pressure residual of {run.name}: "
            f"{float(np.sqrt(np.mean((p - run.pressure) ** 2))):.1f} Pa (rms)"
            for run, p in zip(result.gas.runs, result.gas.fitted, strict=True)
        ]
    lines += [""] * bool(result.held_out) + [_held_out_text(row) for row in result.held_out]
    return "\n".join([*lines, f"took {result.seconds:.0f} s"]) + "\n"


def _interval(parameter: FittedParameter) -> str:
    low, high = parameter.interval
    return f"{digits(low, parameter.sd)} to {digits(high, parameter.sd)}"


def _held_out_text(row: Any) -> str:
    if math.isnan(row.depth):
        where = "no depth"
    else:
        where = f"{1e3 * row.depth:g} mm deep, {1e3 * row.shear:g} mm along x"
    force = "" if math.isnan(row.force_measured) else f", load cell {row.force_measured:.4f} N"
    return (
        f"held out, {row.recording}, {where}, {row.pressure:.0f} Pa: marker error "
        f"{1e6 * row.rms:.1f} um (rms), predicted {row.force:.4f} N{force}"
    )


def plot(figure: Any, result: FitResult) -> None:
    """Plot the result into an empty matplotlib figure."""
    boxes = figure.subplots(2, 3)
    _plot_parameters(boxes[0, 0], result)
    _plot_markers(boxes[0, 1], result)
    _plot_map(boxes[0, 2], result)
    _plot_pressures(boxes[1, 0], result)
    _plot_light(figure, boxes[1, 1], result)
    _plot_held_out(boxes[1, 2], result)


def _plot_parameters(axes: Any, result: FitResult) -> None:
    fitted = [n for n in result.parameters if n.state == "fitted" and n.before]
    rows = range(len(fitted))
    axes.errorbar(
        [100 * (n.value / n.before - 1) for n in fitted],
        list(rows),
        xerr=[100 * SD95 * n.sd / abs(n.before) for n in fitted],
        fmt="o",
        ms=4,
        capsize=3,
    )
    axes.set_yticks(list(rows), [n.field.partition(".")[2] for n in fitted], fontsize=7)
    axes.axvline(0.0, color="k", lw=0.8)
    axes.set(xlabel="change from the sensor file, %", title="numbers, 95 %")
    axes.grid(alpha=0.3)


def _plot_markers(axes: Any, result: FitResult) -> None:
    for evidence, holds in zip(result.evidence, result.membrane.holds, strict=True):
        errors = [
            1e6 * float(np.sqrt(np.nanmean(np.square(found.p_SM - hold.p_SM))))
            for hold, found in zip(evidence.states, holds, strict=True)
        ]
        axes.plot(errors, "o-", ms=4, label=evidence.name[-24:])
    axes.set(
        xlabel="hold",
        ylabel="marker error, um (rms)",
        title="markers, simulated minus measured",
        ylim=(0, None),
    )
    axes.legend(fontsize=6)
    axes.grid(alpha=0.3)


def _plot_map(axes: Any, result: FitResult) -> None:
    """Plot the height residual of each marker, mean over all holds."""
    errors = [
        found.p_SM[:, 2] - hold.p_SM[:, 2]
        for e, holds in zip(result.evidence, result.membrane.holds, strict=True)
        for hold, found in zip(e.states, holds, strict=True)
    ]
    p = 1e3 * result.design.markers.p_SM
    maximum = 1e6 * float(np.nanmax(np.abs(np.nanmean(errors, axis=0))))
    shown = axes.scatter(
        p[:, 0],
        p[:, 1],
        c=1e6 * np.nanmean(errors, axis=0),
        cmap="coolwarm",
        vmin=-maximum,
        vmax=maximum,
        s=60,
    )
    axes.figure.colorbar(shown, ax=axes, label="um")
    axes.set(xlabel="x, mm", ylabel="y, mm", title="height residual, mean", aspect="equal")


def _plot_pressures(axes: Any, result: FitResult) -> None:
    if result.gas is None:
        axes.set_axis_off()
        return
    for run, fitted in zip(result.gas.runs, result.gas.fitted, strict=True):
        axes.plot(run.time, fitted - run.pressure, lw=0.7, label=run.name[-24:])
    axes.set(xlabel="s", ylabel="Pa", title="pressure, simulated minus measured")
    axes.legend(fontsize=6)
    axes.grid(alpha=0.3)


def _plot_light(figure: Any, axes: Any, result: FitResult) -> None:
    shown = axes.imshow(
        result.image.residual, cmap="coolwarm", vmin=-3, vmax=3, interpolation="nearest"
    )
    figure.colorbar(shown, ax=axes, label="grey levels")
    axes.set(title="light, measured minus fitted", xticks=[], yticks=[])


def _plot_held_out(axes: Any, result: FitResult) -> None:
    if not result.held_out:
        axes.set_axis_off()
        return
    rows = result.held_out
    axes.plot([row.force for row in rows], "o", ms=4, label="predicted")
    if any(math.isfinite(row.force_measured) for row in rows):
        axes.plot([row.force_measured for row in rows], "k_", ms=10, label="load cell")
    axes.set(xlabel="hold", ylabel="force, N", title="kept aside")
    axes.legend(fontsize=7)
    axes.grid(alpha=0.3)
