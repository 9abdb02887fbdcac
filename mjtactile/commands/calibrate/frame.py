"""`mjtactile calibrate frame`: the camera's pose in the sensor, the markers' radii and the rest
state, from images."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from mjtactile import InputError, SensorDesign, load_sensor
from mjtactile.commands import arguments as arg
from mjtactile.commands.calibrate import output_options
from mjtactile.commands.calibrate.terminal import finish_all, notify
from mjtactile.commands.output import stdout_to_stderr
from mjtactile.report.frame_source import read_images
from mjtactile.types import Image

HELP = "camera pose and marker radii from the flat membrane"
DESCRIPTION = """\
Estimate the pose of the camera relative to the frame and the true radius of each marker, from
images with the valve open and no contact (the membrane is flat). With images of the inflated
membrane, also measure the rest state, the reference for forces. A result that contradicts the
sensor file is refused."""
EPILOG = """\
examples:
  mjtactile calibrate frame --rig my_gripper.toml
      both fingers, with their valves and cameras
  mjtactile calibrate frame flat/ --rest rest/ --pressure-kPa 1.0 --rig my_gripper.toml --finger \\
      left
  mjtactile calibrate frame flat/ --sensor my_sensor.toml --out left.json

For `mjtactile reconstruct --calibration`, which uses single images. `grasp`, `probe` and
`record` repeat this measurement at their start. Writes the part `frame` of each finger's
calibration file. JSON (of several fingers: {"fingers": {FINGER: …}}): {"sensor", "images",
"residual_px" (marker centers, rms), "scale_sd" (scatter of the radii over the images),
"radius_mm": [lowest, highest], "offset_mm" and "tilt_deg" of the camera relative to the sensor
file, "rest_stiffness_scale" (factor by which the elastic forces of the sensor file balance the
pressure; null without rest images), "verdict", "reasons", "date", "versions", "file"}.
Refused (exit code 1): markers missing or of a different size than in the sensor file, centers
off by more than 1 px.
"""

ARGUMENTS = (
    arg.positional(
        "source",
        "FLAT",
        "image, folder or video of the flat membrane, valve open",
        nargs="?",
        type=Path,
    ),
    *output_options.arguments("images are taken with its valves and cameras"),
    arg.option("--rest SOURCE", "images of the inflated membrane without contact", type=Path),
    arg.option(
        "--pressure-kPa P",
        "gauge pressure in the rest images, from the pressure sensor (default: the sensor's "
        "supply pressure)",
        dest="pressure",
        type=float,
    ),
    arg.choice("--valve", ["closed", "open"], "valve state after the rest images", "closed"),
)


def run(options: argparse.Namespace) -> int:
    from mjtactile.calibrate.frame import calibrate_frame
    from mjtactile.calibrate.result_io import stamp

    if options.source is None and options.rig is None:
        raise InputError(
            "no images are given: name them (FLAT), or add --rig to take some", field="FLAT"
        )
    targets = output_options.find_targets(options)
    with stdout_to_stderr():
        if options.source is None:
            taken = _live(options, targets)
        else:
            taken = [_recorded(options, targets[0].design)]
    results = {}
    for goal, (flat, rest, reading, sealed) in zip(targets, taken, strict=True):
        before = goal.load().used(goal.design)
        pressure = goal.design.chamber.supply_gauge if reading is None else before.pressure(reading)
        with stdout_to_stderr():
            part, report, reasons = calibrate_frame(
                goal.design, before, flat, rest, pressure, sealed=sealed
            )
        goal.write("frame", part, reasons)
        results[goal.finger] = goal.path, stamp("frame", reasons) | report, _lines(report)
    return finish_all(options, results)


CapturedImages = tuple[list[Image], list[Image], float | None, bool]
"""Images and pressure state of a calibration.

Images of the flat membrane, and of the inflated one (empty: only flat). Reading of the pressure
sensor, Pa (None: no sensor), and the sealed state of the chamber.
"""


def _recorded(options: argparse.Namespace, design: SensorDesign) -> CapturedImages:
    rest = [] if options.rest is None else read_images(options.rest, design)
    pressure = None if options.pressure is None else 1e3 * options.pressure
    return read_images(options.source, design), rest, pressure, options.valve == "closed"


def _live(
    options: argparse.Namespace, targets: list[output_options.OutputFile]
) -> list[CapturedImages]:
    """Open the valves, take images, inflate, seal, and take images again. The jaws do not move."""
    from mjtactile.calibrate.connect import live_fingers, live_rig
    from mjtactile.calibrate.interactive import reference_images

    design = load_sensor(options.sensor)
    with live_rig(options.rig, design) as (rig_file, _), live_fingers(rig_file, design) as rig:
        shots = reference_images(rig, notify)
    return [(*shots[index], True) for index in output_options.camera_indices(targets, rig_file)]


def _lines(report: dict[str, Any]) -> list[str]:
    lines = [f"{report['sensor']}: {report['images']} images of the flat membrane"]
    if "offset_mm" in report:
        offset = ", ".join(f"{v:+.3f}" for v in report["offset_mm"])
        low, high = report["radius_mm"]
        lines += [
            f"  marker center residual {report['residual_px']:.3f} px (rms)",
            f"  camera offset from the sensor file ({offset}) mm and {report['tilt_deg']:.3f} deg",
            f"  marker radii {low:.4f} to {high:.4f} mm, sd of each "
            f"{100 * report['scale_sd']:.2f} % from one image",
        ]
    if "fiducials" in report:
        lines.append(f"  {report['fiducials']} fiducials detected; their positions are stored")
    if report.get("rest_stiffness_scale") is not None:
        stiffer = 100 * (report["rest_stiffness_scale"] - 1)
        lines.append(f"  at rest the membrane is {stiffer:+.1f} % stiffer than in the sensor file")
    return lines
