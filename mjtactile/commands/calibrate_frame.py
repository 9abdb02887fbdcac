"""`mjtactile calibrate frame`: the camera's pose in the sensor, the markers' radii and the rest state, from images."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from mjtactile.commands.output import print_json, stdout_to_stderr
from mjtactile.commands.reconstruct import to_image
from mjtactile.commands.sources import read_frames
from mjtactile.design import SensorDesign, load_sensor
from mjtactile.errors import InputError
from mjtactile.sensing.pipeline import SensorPipeline
from mjtactile.sensing.reference import save_reference
from mjtactile.types import Image

HELP = "camera pose and marker radii from the flat membrane"
DESCRIPTION = """\
From images with the valve open and nothing touching (the membrane is flat), find the
camera's pose against the frame and each marker's true radius. With images of the inflated
membrane too, the rest state that forces are measured against. Refuses what does not agree
with the sensor file."""
EPILOG = """\
examples:
  mjtactile calibrate frame flat/ --sensor my_sensor.toml --out my_reference.json
  mjtactile calibrate frame flat/ --rest rest/ --pressure-kPa 1.0 --sensor dense --out dense_reference.json

Use the file with `mjtactile reconstruct --reference`. JSON: {"sensor", "images", "residual_px" (marker centres, rms),
"scale_sd" (scatter of the radii over the images), "radius_mm": [lowest, highest], "offset_mm" and "tilt_deg" of the
camera against the sensor file, "rest_stiffness_scale" (elastic forces of the sensor file times this balance the
pressure; null without --rest), "file"}.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("source", type=Path, metavar="FLAT", help="image, folder or video of the flat membrane, valve open")
    parser.add_argument("--sensor", default="dense", metavar="NAME|FILE.toml", help="the sensor (default: dense)")
    parser.add_argument("--rest", type=Path, metavar="SOURCE", help="images of the inflated membrane, nothing touching")
    parser.add_argument("--pressure-kPa", dest="pressure", type=float, metavar="P",
                        help="gauge pressure in the rest images (default: the sensor's supply pressure)")
    parser.add_argument("--valve", choices=["closed", "open"], default="closed", help="in use after the rest images")
    parser.add_argument("--out", type=Path, default=None, metavar="FILE.json", help="default: SENSOR_reference.json, here")


def run(options: argparse.Namespace) -> int:
    import numpy as np

    design = load_sensor(options.sensor)
    path = options.out or Path(f"{design.name}_reference.json")
    if not path.parent.is_dir():
        raise InputError("no such folder", source=path.parent, field="--out")
    pipeline = SensorPipeline(design)
    with stdout_to_stderr():
        images = _images(options.source, design)
        flat = pipeline.take_flat(images)
        rest = None
        if options.rest is not None:
            pressure = design.chamber.supply_gauge if options.pressure is None else 1e3 * options.pressure
            sealed = options.valve == "closed"
            rest = (pipeline.take_rest(_images(options.rest, design), pressure, sealed=sealed), pressure, sealed)
    save_reference(path, design, flat, rest)
    tilt = np.degrees(np.arccos(np.clip((np.trace(flat.R_SC) - 1) / 2, -1, 1)))
    radii = 1e3 * design.markers.radius * np.array([flat.scale.min(), flat.scale.max()])
    result = {"sensor": design.name, "images": len(images), "residual_px": flat.residual_px, "scale_sd": flat.scale_sd,
              "radius_mm": radii, "offset_mm": 1e3 * (flat.p_SC - design.camera.p_SC), "tilt_deg": tilt,
              "rest_stiffness_scale": pipeline.reference.rest.stiffness_scale if pipeline.reference else None, "file": path}
    if options.json:
        print_json(result)
    else:
        _print(result)
    return 0


def _images(source: Path, design: SensorDesign) -> list[Image]:
    """All images of a source; one that cannot be used is an error here, since a calibration should not be guesswork."""
    images = []
    for frame in read_frames(source):
        image = to_image(frame, design)
        if isinstance(image, str):
            raise InputError(image, source=frame.name, field="image")
        images.append(image)
    return images


def _print(result: dict[str, Any]) -> None:
    offset = ", ".join(f"{v:+.3f}" for v in result["offset_mm"])
    low, high = result["radius_mm"]
    print(f"{result['sensor']}: {result['images']} images of the flat membrane\n"
          f"  marker centres fit to {result['residual_px']:.3f} px (rms)\n"
          f"  camera is off the sensor file by ({offset}) mm and {result['tilt_deg']:.3f} deg\n"
          f"  marker radii {low:.4f} to {high:.4f} mm, each known to {100 * result['scale_sd']:.2f} % from one image")
    if result["rest_stiffness_scale"] is not None:
        print(f"  at rest the membrane is {100 * (result['rest_stiffness_scale'] - 1):+.1f} % stiffer than the sensor file says")
    print(f"  written to {result['file']}")
