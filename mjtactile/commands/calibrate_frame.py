"""`mjtactile calibrate frame`: the camera's pose in the sensor, the markers' radii and the rest state, from images."""

from __future__ import annotations

import argparse
import contextlib
import json
from pathlib import Path
from typing import Any

from mjtactile.commands.calibration import check_folder, finish, say
from mjtactile.commands.output import stdout_to_stderr
from mjtactile.commands.reconstruct import to_image
from mjtactile.commands.sources import read_frames
from mjtactile.design import SensorDesign, load_sensor
from mjtactile.errors import DeviceError, InputError
from mjtactile.sensing.pipeline import SensorPipeline
from mjtactile.sensing.reference import FlatReference, save_reference
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
  mjtactile calibrate frame --rig my_gripper.toml --finger left --sensor my_sensor.toml

Use the file with `mjtactile reconstruct --reference`. JSON: {"sensor", "images", "residual_px" (marker centres, rms),
"scale_sd" (scatter of the radii over the images), "radius_mm": [lowest, highest], "offset_mm" and "tilt_deg" of the
camera against the sensor file, "rest_stiffness_scale" (elastic forces of the sensor file times this balance the
pressure; null without --rest), "verdict", "reasons", "date", "versions", "file"}.
Refused (exit code 1): markers missing or of another size than the sensor file says, centres off by more than 1 px.
"""

_RESIDUAL_MAX_PX = 1.0  # centres of markers in focus are found to 0.05 px; a bent frame or a wrong lens shows as more


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("source", nargs="?", type=Path, metavar="FLAT",
                        help="image, folder or video of the flat membrane, valve open")
    parser.add_argument("--sensor", default="dense", metavar="NAME|FILE.toml", help="the sensor (default: dense)")
    parser.add_argument("--rest", type=Path, metavar="SOURCE", help="images of the inflated membrane, nothing touching")
    parser.add_argument("--pressure-kPa", dest="pressure", type=float, metavar="P",
                        help="gauge pressure in the rest images (default: the sensor's supply pressure)")
    parser.add_argument("--valve", choices=["closed", "open"], default="closed", help="in use after the rest images")
    parser.add_argument("--rig", metavar="NAME|FILE.toml", help="take both with this rig's valve and camera instead")
    parser.add_argument("--finger", choices=["left", "right"], default="left", help="which sensor of the rig (default: left)")
    parser.add_argument("--out", type=Path, default=None, metavar="FILE.json", help="default: SENSOR_reference.json, here")


def run(options: argparse.Namespace) -> int:
    from mjtactile.calibrate.verdict import stamp, write
    from mjtactile.recording import write_json

    if (options.source is None) == (options.rig is None):
        raise InputError("give either images (FLAT) or --rig", field="FLAT")
    design = load_sensor(options.sensor)
    path = check_folder(options.out or Path(f"{design.name}_reference.json"))
    pipeline = SensorPipeline(design)
    with stdout_to_stderr():
        flat_images, rest_images, pressure, sealed = _live(options, design) if options.rig else _recorded(options, design)
    try:
        with stdout_to_stderr():
            flat = pipeline.take_flat(flat_images)
            rest = (pipeline.take_rest(rest_images, pressure, sealed=sealed), pressure, sealed) if rest_images else None
    except DeviceError as error:  # the pictures do not agree with the sensor file
        result: dict[str, Any] = stamp("frame", [str(error)]) | {"sensor": design.name, "images": len(flat_images)}
        return finish(options, write(path, result), result, [f"{design.name}: {len(flat_images)} images"])
    reasons = [f"the marker centres are off by {flat.residual_px:.2f} px (rms), at most {_RESIDUAL_MAX_PX:g} is good: camera "
               "calibration, marker positions in the sensor file, something that touches"] * (flat.residual_px > _RESIDUAL_MAX_PX)
    result = stamp("frame", reasons) | _result(design, pipeline, flat, len(flat_images))

    def with_verdict(path: Path, _: Any) -> None:
        save_reference(path, design, flat, rest)
        write_json(path, {**json.loads(path.read_text(encoding="utf-8")), "calibration": stamp("frame", reasons)})

    return finish(options, write(path, result, with_verdict), result, _lines(result))


def _result(design: SensorDesign, pipeline: SensorPipeline, flat: FlatReference, count: int) -> dict[str, Any]:
    import numpy as np

    tilt = np.degrees(np.arccos(np.clip((np.trace(flat.R_SC) - 1) / 2, -1, 1)))
    radii = 1e3 * design.markers.radius * np.array([flat.scale.min(), flat.scale.max()])
    return {"sensor": design.name, "images": count, "residual_px": flat.residual_px, "scale_sd": flat.scale_sd,
            "radius_mm": radii, "offset_mm": 1e3 * (flat.p_SC - design.camera.p_SC), "tilt_deg": tilt,
            "rest_stiffness_scale": pipeline.reference.rest.stiffness_scale if pipeline.reference else None}


Taken = tuple[list[Image], list[Image], float, bool]
"""Images of the flat membrane, of the inflated one (none: only flat), its gauge pressure Pa, and whether it is sealed."""


def _recorded(options: argparse.Namespace, design: SensorDesign) -> Taken:
    pressure = design.chamber.supply_gauge if options.pressure is None else 1e3 * options.pressure
    rest = [] if options.rest is None else _images(options.rest, design)
    return _images(options.source, design), rest, pressure, options.valve == "closed"


def _live(options: argparse.Namespace, design: SensorDesign) -> Taken:
    """Open the valve, take pictures, inflate, seal, take pictures: of one finger of a rig whose jaws stand still."""
    from mjtactile.calibrate.live import live_rig
    from mjtactile.control import take_references
    from mjtactile.devices.rig import build_device_rig

    finger, taken = ("left", "right").index(options.finger), {}
    with contextlib.ExitStack() as stack:
        rig_file, _ = stack.enter_context(live_rig(options.rig, design))
        if finger >= len(rig_file.cameras):
            raise InputError(f"the rig has no {options.finger} camera", source=rig_file.path, field="--finger")
        rig = build_device_rig(rig_file, design, name=rig_file.name)
        stack.callback(rig.close)
        try:
            take_references(rig, [SensorPipeline(design) for _ in rig.cameras], report=say,
                            on_reference=lambda stage, shots, pressure: taken.update({stage: (shots, pressure)}))
        except DeviceError:
            if "flat" not in taken:  # a device; else the pictures are there to be judged
                raise
    flat, rest = taken["flat"], taken.get("rest", ([[]] * 2, [None] * 2))
    measured = rest[1][finger] if rest[1] else None
    return flat[0][finger], rest[0][finger], design.chamber.supply_gauge if measured is None else measured, True


def _images(source: Path, design: SensorDesign) -> list[Image]:
    """All images of a source; one that cannot be used is an error here, since a calibration should not be guesswork."""
    images = []
    for frame in read_frames(source):
        image = to_image(frame, design)
        if isinstance(image, str):
            raise InputError(image, source=frame.name, field="image")
        images.append(image)
    return images


def _lines(result: dict[str, Any]) -> list[str]:
    offset = ", ".join(f"{v:+.3f}" for v in result["offset_mm"])
    low, high = result["radius_mm"]
    lines = [f"{result['sensor']}: {result['images']} images of the flat membrane",
             f"  marker centres fit to {result['residual_px']:.3f} px (rms)",
             f"  camera is off the sensor file by ({offset}) mm and {result['tilt_deg']:.3f} deg",
             f"  marker radii {low:.4f} to {high:.4f} mm, each known to {100 * result['scale_sd']:.2f} % from one image"]
    if result["rest_stiffness_scale"] is not None:
        stiffer = 100 * (result["rest_stiffness_scale"] - 1)
        lines.append(f"  at rest the membrane is {stiffer:+.1f} % stiffer than the sensor file says")
    return lines
