"""`mjtactile design`: predict the performance of a sensor file, or search for designs.

The prediction needs no built sensor. The search returns files that meet requirements.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from mjtactile import SensorDesign, load_sensor
from mjtactile.commands import arguments as arg
from mjtactile.commands.output import optional_folder, print_json, save_plot, stdout_to_stderr
from mjtactile.recording.files import write_json
from mjtactile.runtime.progress import Progress

DESCRIPTION = """\
Predict the performance of a sensor file without simulating it: detection threshold, standard
deviations of force, contact position and edge position over the membrane, the maximum force, and
the benefit of more pressure, markers or focal length. With a requirement (--detect-force-mN,
--range-N, --edge-mm, --radius-mm), sample designs around the file, predict each, list the
Pareto-optimal ones and write the best as sensor files.

The quasi-static membrane predicts marker positions, the camera's bound their noise, and the
covariance of the sensing pipeline the uncertainty of the estimates."""
EPILOG = """\
examples:
  mjtactile design --sensor dense                      performance of this file
  mjtactile design --sensor my_sensor.toml --force-N 0.2 --out runs/mine
  mjtactile design --detect-force-mN 10 --edge-mm 0.15 --range-N 3 --out runs/wanted
      find designs that detect 10 mN and locate an edge to 0.15 mm
  mjtactile design --sensor paper16 --detect-force-mN 10 --frame-mm 24,20 --camera-px 320,240
  mjtactile design --detect-force-mN 10 --check 3 --out runs/wanted    also simulate the best three

An sd is the standard deviation that the pipeline would report; it covers 68 % of contacts.
"touch_by_noise" is the limit of the pixel noise alone. The pipeline reports no contact below
20 mN, because weather and a warming camera have effects of this size. The edge has a radius of
2.5 mm, spans the membrane and presses with --force-N, as does a ball of 4 mm. "-": the
quasi-static membrane has no solution for this force.

JSON, of a file: {"sensor", "force_N", "reaches": {"touch_mN", "touch_by_noise_mN", "force_sd_mN",
"force_noise_mN", "position_sd_mm", "edge_sd_mm", "smallest_radius_mm", "force_max_N"}, "picture":
{"width_used", "height_used", "longest_lens"}, "face": [{"x_mm", "y_mm", ...}], "changes":
[{"what", "reaches", "why_not"}]}; of a requirement: {"sensor", "force_N", "requirements",
"initial", "candidates": [{"reaches", "missed", "meets", "on_front", "rows", "columns", ...}],
"best": [{"file", ...}], "checked": [...]}. More: `mjtactile docs how-to/design`."""
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
                "maximum force threshold of a contact, limited by pixel noise",
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
            arg.option("--frame-mm X,Y", "frame opening (default: the sensor's)", type=arg.pair),
            arg.option(
                "--camera-px W,H",
                "image size (default: the sensor's); the field of view stays the same",
                type=arg.pair,
            ),
        ),
    ),
    arg.option("--count N", "number of designs to sample", 48, type=arg.whole(1, 2000)),
    arg.option(
        "--check N",
        "load the best N designs, or the file, in the full simulation and compare (default: "
        "0; some minutes each)",
        0,
        type=arg.whole(0, 20),
    ),
    arg.option("--seed N", "seed of the sampling", 0, type=int),
    arg.out(
        "folder for design.json, and face.png and design.html of a file, or front.png and "
        "best_1.toml, … of a search"
    ),
)


def run(options: argparse.Namespace) -> int:
    from mjtactile.design_study import json_output

    design = _base_sensor(options)
    requirements = _requirements(options)
    names = (
        ("design.json", "face.png", "design.html")
        if requirements is None
        else ("design.json", "front.png", "best_1.toml")
    )
    with optional_folder(options.out, *names) as out:
        with stdout_to_stderr():
            progress = Progress(quiet=options.json)
            if requirements is None:
                result = json_output.of_file(
                    design, options.force_N, check=options.check, say=progress.message
                )
            else:
                result, files = json_output.from_requirements(
                    design,
                    options.force_N,
                    requirements,
                    count=options.count,
                    seed=options.seed,
                    check=options.check,
                    say=progress.message,
                )
            progress.close()
        if out is not None:
            write_json(out / "design.json", result)
            if requirements is None:
                _write_file_figures(out, result)
            else:
                _write_requirements(out, result, files)  # pyright: ignore[reportPossiblyUnboundVariable]
    if options.json:
        print_json(result)
    elif requirements is None:
        _print_file(result)
    else:
        _print_requirements(result, options.out)
    return 0


def _base_sensor(options: argparse.Namespace) -> SensorDesign:
    """Return the sensor with the requested frame and camera."""
    from mjtactile.design_study import sensor_file_edit

    design = load_sensor(options.sensor)
    if options.frame_mm is not None or any(
        getattr(options, name) is not None for name in _REQUIREMENTS
    ):
        design.require_rectangle("the design search")
    if options.frame_mm is not None:
        design = sensor_file_edit.with_frame(design, *(1e-3 * side for side in options.frame_mm))
    if options.camera_px is not None:
        design = sensor_file_edit.with_picture(design, *(round(side) for side in options.camera_px))
    return sensor_file_edit.rebuilt(design)


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
    picture = path.read_bytes() if path.exists() else None
    (out / "design.html").write_text(plots.page(result, picture), encoding="utf-8")


def _write_requirements(out: Path, result: dict[str, Any], files: dict[str, str]) -> None:
    from mjtactile.design_study import plots

    for name, text in files.items():
        (out / name).write_text(text, encoding="utf-8")
    save_plot(out / "front.png", lambda figure: plots.plot_front(figure, result))


def _print_file(result: dict[str, Any]) -> None:
    from mjtactile.design_study import plots

    print(f"sensor {result['sensor']}, predicted for contacts of {result['force_N']:g} N:")
    for key, (words, unit) in plots.WORDS.items():
        print(f"  {words:50s} {plots.number(result['reaches'][key]):>7s} {unit}")
    print(f"  {plots.image_quality_text(result['picture'])}")
    print("Effect of changes, as a factor on the present value:")
    print(f"  {'':58s}" + "".join(f"{words:>15s}" for words in plots.CHANGED.values()))
    for what, *factors in plots.change_rows(result):
        print(f"  {what:58s}" + "".join(f"{factor:>15s}" for factor in factors))
    _print_checked(result.get("checked", []))


def _print_requirements(result: dict[str, Any], out: Path | None) -> None:
    from mjtactile.design_study import plots

    rows = [{"file": result["sensor"], "meets": not result["initial"]["missed"]}]
    rows[0] |= result["initial"]
    meeting = sum(one["meets"] for one in result["candidates"])
    count = len(result["candidates"])
    print(
        f"{meeting} of {count} designs meet the requirements. Predicted for contacts of "
        f"{result['force_N']:g} N:"
    )
    print(
        "file          markers  radius mm  fx px  thick mm  stretch    kPa   touch mN  force "
        "mN  edge mm  range N  missed"
    )
    for one in rows + result["best"]:
        reached = one["reaches"]
        made = (
            " " * 51
            if "rows" not in one
            else f"{one['columns']:3d} x {one['rows']:2d} {one['marker_radius_mm']:10.2f} "
            f"{one['fx_px']:6.0f} {one['thickness_mm']:9.2f} {one['pre_stretch']:8.2f} "
            f"{one['supply_pressure_kPa']:6.2f}"
        )
        values = (
            f"{plots.number(reached[key]):>9s}"
            for key in ("touch_by_noise_mN", "force_sd_mN", "edge_sd_mm", "force_max_N")
        )
        print(f"{one['file']:13s} {made} {' '.join(values)}  {', '.join(one['missed']) or '-'}")
    _print_checked(result["checked"])
    if out is not None:
        print(f"design.json, front.png and the sensor files were written to {out}")


def _print_checked(checked: list[dict[str, Any]]) -> None:
    from mjtactile.design_study.plots import number

    for one in checked:
        error, times, placed = (
            number(one[key]) for key in ("force_error_rms_mN", "force_ratio", "place_ratio")
        )
        print(
            f"full simulation of {one['sensor']}: {one['presses']} contacts, force error "
            f"{error} mN rms, {times} times the predicted sd; position {placed} times"
        )
