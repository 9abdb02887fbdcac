"""`mjtactile press`: drive an indenter into a sensor in steps, as in the paper's experiment."""

from __future__ import annotations

import argparse
import math
import textwrap
from pathlib import Path
from typing import Any

from mjtactile import InputError, SensorDesign, load_sensor
from mjtactile.commands import arguments as arg
from mjtactile.commands import effects
from mjtactile.commands.output import (
    exit_code_of_steps,
    optional_folder,
    print_flags,
    print_result,
    save_plot,
    stdout_to_stderr,
)
from mjtactile.recording.files import write_json
from mjtactile.runtime.progress import Progress

DESCRIPTION = """\
Mount one simulated sensor, take its references, then drive a rigid indenter into its membrane
in steps. Depth counts from first contact. The force estimate uses camera images and a pressure
sensor with noise."""
EPILOG = """\
examples:
  mjtactile press --indenter cylinder:5 --depth-mm 0:4:1
  mjtactile press --indenter sphere:8 --position-mm -5,3 --depth-mm 2 --shear-mm 1 --valve open
  mjtactile press --indenter part.stl --tilt-deg 10 --depth-mm 0.5:3:0.5 --out runs/part

JSON: {"sensor": …, "mesh": [nx, ny],
"steps": [{"depth_mm", "force_true_N" and "force_estimated_N" ([x, y, z]
on the membrane, frame S: z is negative under load), "wrench_estimated" (force N, torque N m
about the frame center), "force_estimated_sd_N", "drive_force_N" (load cell on the drive),
"contact_area_mm2", "contact_area_interval_mm2" (68 %), "contact_area_true_mm2",
"penetration_mm" (penetration of the simulated objects: the contact error), "pressure_kPa",
"volume_mL", "converged", "status"}],
"shape": {contact shape estimated from the images: "kind" (smooth, flat, edge, point, multiple,
unknown), "probabilities", "curvatures_per_m", "radius_mm", "direction_deg", "area_mm2",
"area_interval_mm2" (68 %), "force_normal_N", "pose", "outline_mm", "misfit", "status",
"parts" (of several objects at once, each)},
"stopped": null, or the reason for missing steps (interrupted, simulation failed), with exit code 3,
"flags": {kind: {"reason", "first_s", "last_s", "fraction"}}}
"""

ARGUMENTS = (
    arg.sensor(),
    arg.option(
        "--indenter SHAPE",
        "sphere:R_mm, cylinder:R_mm (end face down), box:EDGE_mm, FILE.stl or FILE.obj in "
        "mm, or FILE.xml: all geoms of an MJCF file, moved along -z",
        required=True,
    ),
    arg.option("--position-mm X_mm,Y_mm", "position of the indenter", "0,0", type=arg.pair),
    arg.option(
        "--depth-mm A[:B:STEP]",
        "depth below first contact, or a range, both ends included",
        "1:3:1",
        dest="depths",
        type=arg.values,
    ),
    arg.option("--tilt-deg T", "rotation of the indenter about y", 0.0, type=arg.number(-60, 60)),
    arg.option("--shear-mm S", "drag along x at each depth", 0.0, type=arg.number()),
    arg.choice(
        "--valve",
        ["closed", "open"],
        "closed: the chamber keeps its gas (default); open: it keeps its pressure",
        "closed",
    ),
    arg.option("--seed N", "seed of the camera noise", 0, type=arg.integer(0)),
    *effects.SHARED,
    arg.option(
        "--mesh NXxNY",
        "vertices of the simulated membrane along x and y (default: that of --accuracy, or one "
        "fine enough for the contact shape, 25x21 for most sensors)",
        type=arg.mesh,
    ),
    effects.ESTIMATE,
    arg.out("write press.json and press.png there"),
)
_FLAT_RADIUS_MM = 1e3
"""Radius from which a surface is printed as flat; it falls by 0.2 mm within 20 mm."""


def run(options: argparse.Namespace) -> int:
    from mjtactile.experiments.fidelity_options import simulation_of
    from mjtactile.experiments.indentation import IndentationPlan, Indenter, press, with_shape_mesh

    design = load_sensor(options.sensor)
    _check(options, design)
    plan = IndentationPlan(
        Indenter.parse(options.indenter),
        [1e-3 * d for d in options.depths],
        (1e-3 * options.position_mm[0], 1e-3 * options.position_mm[1]),
        math.radians(options.tilt_deg),
        1e-3 * options.shear_mm,
        sealed=options.valve == "closed",
    )
    notify = Progress(quiet=options.json).message
    design, simulation = simulation_of(
        design, options.accuracy or "", options.effects, options.mesh
    )
    simulation = with_shape_mesh(design, simulation, notify)
    with optional_folder(options.out, "press.json", "press.png") as out:
        with stdout_to_stderr():
            result = press(
                design,
                plan,
                seed=options.seed,
                notify=notify,
                error_estimate=options.error_estimate,
                keep_partial=True,
                **simulation,
            )
        if out is not None:
            write_json(out / "press.json", result)
            save_plot(out / "press.png", lambda figure: _plot(figure, result, design), (11.0, 4.2))
    print_result(options, result, lambda: _print_table(result, options.out))
    return exit_code_of_steps(result, len(plan.depths))


def _check(options: argparse.Namespace, design: SensorDesign) -> None:
    """Reject invalid values, such as a position outside of the frame or depths beyond the glass."""
    for value, size, axis in zip(
        options.position_mm, (design.frame.length, design.frame.width), "xy", strict=True
    ):
        if abs(value) * 1e-3 >= size / 2:
            message = f"{axis} = {value:g} mm is outside of the frame (+-{500 * size:g} mm)"
            raise InputError(message, field="--position-mm")
    if max(options.depths) * 1e-3 >= design.chamber.depth:
        raise InputError(
            f"{max(options.depths):g} mm is not less than the chamber depth of "
            f"{1e3 * design.chamber.depth:g} mm",
            field="--depth-mm",
        )
    if min(options.depths) < -1:
        raise InputError(
            f"{min(options.depths):g} mm is more than 1 mm above first contact", field="--depth-mm"
        )


def _print_table(result: dict[str, Any], out: Path | None) -> None:
    print(
        "depth mm   ground truth N [x, y, z]   est. N [x, y, z]    area mm2: est. (68 %)  "
        "true   penetr. mm  gauge kPa"
    )
    for s in result["steps"]:
        true, estimated = (
            " ".join(f"{v:8.4f}" for v in s[key]) for key in ("force_true_N", "force_estimated_N")
        )
        low, high = s["contact_area_interval_mm2"]
        print(
            f"{s['depth_mm']:8.3f} {true} {estimated} {s['contact_area_mm2']:8.1f} "
            f"({low:5.1f}-{high:5.1f}) {s['contact_area_true_mm2']:6.1f} "
            f"{s['penetration_mm']:11.4f} "
            f"{s['pressure_kPa']:10.4f}{'' if s['converged'] else '  not settled'}"
            f"{'' if s['status'] == 'ok' else '  ' + s['status']}"
        )
    print(_shape_line(result["shape"]))
    print_flags(result["flags"])
    if out is not None:
        print(f"press.json and press.png are in {out}")


def _shape_line(shape: dict[str, Any]) -> str:
    """Describe the estimated contact shape in one line."""
    if shape["kind"] == "unknown":
        return f"shape unknown: {shape['status']}"
    fraction = shape["probabilities"][shape["kind"]]
    words = [f"shape: {shape['kind']} ({100 * fraction:.0f} %), best model {shape['family']}"]
    is_flat = (shape["radius_mm"] or 0.0) > _FLAT_RADIUS_MM
    if is_flat:
        words.append("flat as far as the frame shows")
    elif shape["radius_mm"] is not None:
        words.append(f"radius {shape['radius_mm']:.1f} +- {shape['radius_sd_mm']:.1f} mm")
    elif shape["kind"] == "smooth":
        words.append("curvatures {:.0f} and {:.0f} /m".format(*shape["curvatures_per_m"]))
    if shape["direction_deg"] is not None and not is_flat:
        words.append(f"along {shape['direction_deg']:.0f} deg")
    low, high = shape["area_interval_mm2"]
    words.append(f"area {shape['area_mm2']:.0f} mm2 (68 %: {low:.0f} to {high:.0f})")
    return ", ".join(words)


def _plot(figure: Any, result: dict[str, Any], design: SensorDesign) -> None:
    steps = result["steps"]
    force, gas, body = figure.subplots(1, 3)
    depths = [s["depth_mm"] for s in steps]
    force.plot(depths, [-s["force_true_N"][2] for s in steps], "k-o", ms=4, label="ground truth")
    force.errorbar(
        depths,
        [-s["force_estimated_N"][2] for s in steps],
        [2 * s["force_estimated_sd_N"] for s in steps],
        fmt="s",
        ms=5,
        capsize=3,
        label="estimated, 2 sd",
    )
    force.set(
        xlabel="depth below first contact, mm",
        ylabel="normal force, N",
        title=f"sensor {result['sensor']}",
    )
    force.legend()
    gas.plot(depths, [s["pressure_kPa"] for s in steps], "o-", ms=4)
    gas.set(xlabel="depth below first contact, mm", ylabel="gauge pressure, kPa")
    _plot_shape(body, result["shape"], design)
    for axes in (force, gas, body):
        axes.grid(alpha=0.3)


def _plot_shape(axes: Any, shape: dict[str, Any], design: SensorDesign) -> None:
    """Plot the estimated contact outline on the membrane, in frame S."""
    outline = shape["outline_mm"]
    if outline:
        x, y = zip(*[*outline, outline[0]], strict=True)
        axes.fill(x, y, alpha=0.3)
        axes.plot(x, y, "-", lw=1)
    half = [500 * side for side in (design.frame.length, design.frame.width)]
    axes.set(
        xlim=(-half[0], half[0]),
        ylim=(-half[1], half[1]),
        aspect="equal",
        xlabel="x, mm",
        ylabel="y, mm",
        title=textwrap.fill(_shape_line(shape).split(",")[0], 36),
    )
