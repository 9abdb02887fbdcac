"""`mjtactile design`: predict the performance of a sensor file, or search for designs.

The prediction needs no built sensor. The search returns files that meet requirements.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjtactile import Camera, InputError, SensorDesign, load_sensor
from mjtactile.commands import arguments as arg
from mjtactile.commands.output import optional_folder, print_result, save_plot, stdout_to_stderr
from mjtactile.core import foreign_file, signals
from mjtactile.recording.files import write_json
from mjtactile.runtime.progress import Progress

if TYPE_CHECKING:
    from mjtactile.design_study.design_sweep import Requirements

DESCRIPTION = """\
Predict the performance of a sensor file without simulating it: detection threshold, standard
deviations of force, contact position and edge position over the membrane, the maximum force, and
the benefit of more pressure, markers or focal length. With a requirement (--detect-force-mN,
--range-N, --edge-mm, --radius-mm), sample designs around the file, predict each, list the
Pareto-optimal ones and write the best as sensor files.

The quasi-static membrane predicts marker positions, the Cramer-Rao bound their noise, and
the sensing pipeline the covariance of its estimates."""
EPILOG = """\
examples:
  mjtactile design --sensor dense                      performance of this file
  mjtactile design --sensor my_sensor.toml --force-N 0.2 --out runs/mine
  mjtactile design --detect-force-mN 20 --edge-mm 0.15 --range-N 3 --out runs/wanted
      find designs that detect 20 mN and locate an edge to 0.15 mm
  mjtactile design --sensor paper16 --edge-mm 0.2 --frame-mm 24,20 --camera-px 320,240
  mjtactile design --edge-mm 0.2 --fov-deg 60 --focus-mm 30 --camera-px 640,480
      for an existing camera: lens and focus are fixed, markers are adapted
  mjtactile design --edge-mm 0.15 --check 3 --out runs/wanted    also simulate the best three

An sd is the standard deviation that the pipeline would report; it covers 68 % of contacts.
"by noise" is the limit of the pixel noise alone. The pipeline reports no contact below 20 mN,
because weather and a warming camera have effects of this size; --detect-force-mN includes this
limit. All proposals pass the checks of `mjtactile fabricate` with its default options. The edge
has a radius of 2.5 mm, spans the membrane and presses with --force-N, as does a ball of 4 mm. "-":
the quasi-static membrane has no solution for this force.

JSON, of a file: {"sensor", "force_N", "performance": {"detection_mN",
"detection_by_noise_mN", "force_sd_mN", "force_noise_mN", "position_sd_mm", "edge_sd_mm",
"smallest_radius_mm", "force_max_N"}, "image":
{"width_used", "height_used", "longest_lens"}, "face": [{"x_mm", "y_mm", ...}], "changes":
[{"change", "performance", "why_not"}]}; of a requirement: {"sensor", "force_N", "requirements",
"initial", "candidates": [{"performance", "missed", "meets", "on_front", "rows", "columns", ...}],
"best": [{"file", ...}], "requirement_table": [{"requirement", "required", "limit", "met", "of"}],
"checked": [{..., "range": {"claimed", "confirmed", "is_confirmed", ...}}],
"stopped": null, or "interrupted" (with exit code 3): the results are those of a part}.
More: `mjtactile docs how-to/design`."""
_REQUIREMENTS = ("detect_force_mN", "range_N", "edge_mm", "radius_mm")

ARGUMENTS = (
    arg.sensor("sensor to evaluate, or starting point of the designs"),
    arg.option(
        "--force-N F",
        "contact force for the predictions of force, position, edge and radius",
        0.5,
        type=arg.number(0.01, 100),
    ),
    arg.Group(
        "requirements (each is optional)",
        (
            arg.option(
                "--detect-force-mN F",
                "maximum detection threshold of a contact; the pipeline's own limit is 20 mN",
                type=arg.number(0.1, 1e4),
            ),
            arg.option("--range-N F", "largest force", type=arg.number(0.01, 1e3)),
            arg.option(
                "--edge-mm S", "maximum sd of the position of an edge", type=arg.number(1e-3, 10)
            ),
            arg.option(
                "--radius-mm R",
                "smallest ball whose radius is estimated to 25 %%",
                type=arg.number(0.5, 50),
            ),
        ),
    ),
    arg.Group(
        "existing hardware (fixed values)",
        (
            arg.option("--frame-mm X,Y", "frame opening (default: the sensor's)", type=arg.pair),
            arg.option(
                "--camera-px W,H",
                "image size (default: the sensor's); the field of view stays the same",
                type=arg.pair,
            ),
            arg.option(
                "--fov-deg A",
                "horizontal field of view of the lens, without distortion (default: sampled)",
                type=arg.number(5, 150),
            ),
            arg.option(
                "--lens FILE",
                "camera file with the lens and image size, as of `mjtactile calibrate camera`",
                type=Path,
            ),
            arg.option(
                "--focus-mm Z",
                "distance from the lens to its sharp plane, where the flat membrane is placed",
                type=arg.number(2, 2000),
            ),
        ),
    ),
    arg.option("--count N", "number of designs to sample", 48, type=arg.integer(1, 2000)),
    arg.option(
        "--check N",
        "load the best N designs, or the file, in the full simulation and compare (default: "
        "0; some minutes each)",
        0,
        type=arg.integer(0, 20),
    ),
    arg.option("--seed N", "seed of the sampling", 0, type=arg.integer(0)),
    arg.out(
        "folder for design.json, and face.png and design.html of a file, or front.png and "
        "best_1.toml, … of a search"
    ),
)


def run(options: argparse.Namespace) -> int:
    design = _base_sensor(options)
    requirements = _requirements(options)
    run = _run_file if requirements is None else partial(_run_search, requirements=requirements)
    return run(options, design)


def _run_file(options: argparse.Namespace, design: SensorDesign) -> int:
    """Predict the performance of a file."""
    from mjtactile.design_study import json_output

    with optional_folder(options.out, "design.json", "face.png", "design.html") as out:
        with stdout_to_stderr(), contextlib.closing(Progress(quiet=options.json)) as progress:
            result = json_output.of_file(
                design, options.force_N, check=options.check, notify=progress.message
            )
        if out is not None:
            write_json(out / "design.json", result)
            _write_file_figures(out, result)
    print_result(options, result, lambda: _print_file(result))
    return 0


def _run_search(
    options: argparse.Namespace, design: SensorDesign, requirements: Requirements
) -> int:
    """Search designs that meet the requirements."""
    from mjtactile.design_study import json_output

    with optional_folder(options.out, "design.json", "front.png", "best_1.toml") as out:
        with stdout_to_stderr(), contextlib.closing(Progress(quiet=options.json)) as progress:
            result, files = json_output.from_requirements(
                design,
                options.force_N,
                requirements,
                given=_given_hardware(options),
                count=options.count,
                seed=options.seed,
                check=options.check,
                notify=progress.message,
            )
        if out is not None:
            write_json(out / "design.json", result)
            _write_requirements(out, result, files)
    print_result(options, result, lambda: _print_requirements(result, options.out))
    if result["stopped"] is None:
        return 0
    complete = f"{len(result['candidates'])} of {options.count} designs"
    print(f"mjtactile: {result['stopped']}; the result is that of {complete}", file=sys.stderr)
    return signals.EXIT_CODE


def _base_sensor(options: argparse.Namespace) -> SensorDesign:
    """Return the sensor with the requested frame and camera."""
    from mjtactile.design_study import given_hardware, sensor_file_edit

    design = load_sensor(options.sensor)
    is_search = any(getattr(options, name) is not None for name in _REQUIREMENTS)
    if options.frame_mm is not None or is_search:
        design.require_rectangle("the design search")
    if options.frame_mm is not None:
        design = sensor_file_edit.with_frame(design, *(1e-3 * side for side in options.frame_mm))
    if options.camera_px is not None:
        design = sensor_file_edit.with_picture(design, *(round(side) for side in options.camera_px))
    if options.lens is not None:
        for name in ("fov_deg", "camera_px"):
            if getattr(options, name) is not None:
                message = "has the field of view and the image size: use one of the two options"
                raise InputError(message, field=f"--lens, --{name.replace('_', '-')}")
        design = given_hardware.with_camera_file(design, Camera.from_file(options.lens))
    if options.fov_deg is not None:
        design = given_hardware.with_field_of_view(design, math.radians(options.fov_deg))
    if options.focus_mm is not None:
        design = given_hardware.with_focus(design, 1e-3 * options.focus_mm)
    # a search places the markers in the view of a given camera
    return design if is_search else sensor_file_edit.rebuilt(design)


def _given_hardware(options: argparse.Namespace) -> Any:
    from mjtactile.design_study.given_hardware import GivenHardware

    lens = options.lens is not None or options.fov_deg is not None
    return GivenHardware(lens=lens, focus=options.focus_mm is not None)


def _requirements(options: argparse.Namespace) -> Any:
    """Return the requirements; None if none are given, so that the file itself is evaluated."""
    from mjtactile.design_study.design_sweep import Requirements

    if all(getattr(options, name) is None for name in _REQUIREMENTS):
        return None

    def milli(value: float | None) -> float | None:
        return None if value is None else 1e-3 * value

    return Requirements(
        touch=milli(options.detect_force_mN),
        maximum=options.range_N,
        edge=milli(options.edge_mm),
        radius=milli(options.radius_mm),
    )


def _write_file_figures(out: Path, result: dict[str, Any]) -> None:
    from mjtactile.design_study import plots

    path = out / "face.png"
    save_plot(path, lambda figure: plots.plot_face(figure, result), size=(13.0, 3.3))
    image = path.read_bytes() if foreign_file.exists(path) else None
    (out / "design.html").write_text(plots.page(result, image), encoding="utf-8")


def _write_requirements(out: Path, result: dict[str, Any], files: dict[str, str]) -> None:
    from mjtactile.design_study import plots

    for name, text in files.items():
        (out / name).write_text(text, encoding="utf-8")
    save_plot(out / "front.png", lambda figure: plots.plot_front(figure, result))


def _print_file(result: dict[str, Any]) -> None:
    from mjtactile.design_study import plots

    print(f"sensor {result['sensor']}, predicted for contacts of {result['force_N']:g} N:")
    for key, (words, unit) in plots.WORDS.items():
        print(f"  {words:50s} {plots.number(result['performance'][key]):>7s} {unit}")
    print(f"  {plots.image_quality_text(result['image'])}")
    print("Effect of changes, as a factor on the present value:")
    print(f"  {'':58s}" + "".join(f"{words:>15s}" for words in plots.CHANGED.values()))
    for change, *factors in plots.change_rows(result):
        print(f"  {change:58s}" + "".join(f"{factor:>15s}" for factor in factors))
    _print_checked(result.get("checked", []))


def _print_requirements(result: dict[str, Any], out: Path | None) -> None:

    _print_requirement_table(result)
    print(f"Predicted for contacts of {result['force_N']:g} N:")
    print(
        "file          markers  radius mm  fx px  camera mm  depth mm  thick mm  stretch    kPa  "
        "touch mN  by noise  force mN   edge mm   range N  missed"
    )
    initial = result["initial"]
    if initial["performance"] is None:
        print(f"{result['sensor']:13s} cannot be used with this hardware: {initial['why_not']}")
    else:
        _print_design({"file": result["sensor"]} | initial)
    for candidate in result["best"]:
        _print_design(candidate)
    _print_checked(result["checked"])
    if out is not None:
        print(f"design.json, front.png and the sensor files were written to {out}")


def _print_requirement_table(result: dict[str, Any]) -> None:
    """Print the requirements, the limits of the pipeline, and the designs that meet them."""
    from mjtactile.design_study import plots

    count = len(result["candidates"])
    meeting = sum(candidate["meets"] for candidate in result["candidates"])
    refused = result["refused_by_fabricate"]
    for row in result["requirement_table"]:
        limit = "" if row["limit"] is None else f", limit of the pipeline {row['limit']:g}"
        noise = f" ({row['met_by_noise']} by pixel noise alone)" if "met_by_noise" in row else ""
        print(
            f"{row['requirement']:16s} {plots.number(row['required']):>6s}{limit}: met by "
            f"{row['met']} of {row['of']} designs{noise}"
        )
    more = f"; {refused} more cannot be fabricated" if refused else ""
    print(f"{meeting} of {count} designs meet all requirements{more}.")


def _print_design(row: dict[str, Any]) -> None:
    from mjtactile.design_study import plots

    made = " " * 72
    if "rows" in row:
        made = (
            f"{row['columns']:3d} x {row['rows']:2d} {row['marker_radius_mm']:10.2f} "
            f"{row['fx_px']:6.0f} {row['camera_distance_mm']:10.1f} {row['chamber_depth_mm']:9.1f} "
            f"{row['thickness_mm']:9.2f} "
            f"{row['pre_stretch']:8.3f} {row['supply_pressure_kPa']:6.2f}"
        )
    keys = ("detection_mN", "detection_by_noise_mN", "force_sd_mN", "edge_sd_mm", "force_max_N")
    values = (f"{plots.number(row['performance'][key]):>9s}" for key in keys)
    print(f"{row['file']:13s} {made} {' '.join(values)}  {', '.join(row['missed']) or '-'}")


def _print_checked(checked: list[dict[str, Any]]) -> None:
    from mjtactile.design_study.plots import number

    for press in checked:
        error, times, placed = (
            number(press[key]) for key in ("force_error_rms_mN", "force_ratio", "place_ratio")
        )
        print(
            f"full simulation of {press['sensor']}: {press['presses']} contacts, force error "
            f"{error} mN rms, {times} times the predicted sd; position {placed} times"
        )
        tested = press["range"]
        if tested is None:
            continue
        claimed, confirmed = (number(tested[key]) for key in ("claimed", "confirmed"))
        verdict = "confirmed" if tested["is_confirmed"] else f"NOT confirmed beyond {confirmed} N"
        print(
            f"  predicted range {claimed} N: {verdict} (force error within 10 % in indentations "
            f"to {number(max(tested['forces'], default=None))} N)"
        )
