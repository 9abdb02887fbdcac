"""`mjtactile reconstruct`: the complete sensing pipeline on recorded frames of one sensor: markers,
surface, contact."""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from mjtactile import (
    InputError,
    SensingPipeline,
    SensorDesign,
    StatefulPipeline,
    load_calibration,
    load_sensor,
)
from mjtactile.commands import arguments as arg
from mjtactile.commands import track_dots
from mjtactile.commands.output import optional_folder, print_result, save_plot, stdout_to_stderr
from mjtactile.recording.files import write_json
from mjtactile.report.frame_source import NamedImage, marker_overlay, read_frames, to_image
from mjtactile.report.summary_figure import plot_surface_map
from mjtactile.runtime.progress import Progress
from mjtactile.types import Contact, Markers, Status, StatusCode, Surface, Touch, Traction

SIMULATES = False
DESCRIPTION = """\
Run the sensing pipeline on an image, a folder of images or a video of one sensor. Results:
identified markers in the sensor frame S, the membrane surface, its area and volume. With a
calibration (see `mjtactile calibrate frame`) also the contact: area, depth and force.

With --marks, track the dots of any marked skin, without a sensor file: through the video, in
pixels, and with --camera and --radius-mm in space."""
EPILOG = """\
examples:
  mjtactile reconstruct frames/ --sensor dense --out shapes
  mjtactile reconstruct press.png --sensor my_sensor.toml --calibration left.json --json
  mjtactile reconstruct gelsight.avi --marks dark --out tracks      a gel's dots, in pixels
  mjtactile reconstruct tactip/ --marks bright --camera cam.yaml --radius-mm 0.8 --out tracks

With --marks: tracks.csv (frame, source, id, u_px, v_px, semi axes px, angle, status, x, y, z mm
in the camera frame), tracks.png, some frames; JSON {"frames": [{"source", "circles",
"followed", "trusted"}], "tracks": [{"id", "frames"}]}.

JSON: {"sensor": …, "frames": [{"source", "status", "markers": [{"id", "p_SM_mm", "normal",
"sd_mm"}],
  "surface": {"x_mm", "y_mm", "z_mm" (rows along y)}, "area_mm2", "area_sd_mm2", "volume_mL"
  (under the bulge), "volume_sd_mL", "contact_area_mm2",
  "contact_area_interval_mm2" (68 %), "contact_centroid_mm", "depth_mm",
  "force_N" ([x, y, z] on the membrane), "force_sd_N"}]}. Unknown values, and values that
  need a missing calibration, are null.
"""
FIGURES_MAX = 40
_STRETCH_MAX = 1.4  # mean stretch of the mounted membrane; rubber at 3 kPa and under load: 1.2
_CONTACT = ("contact_area_mm2", "contact_area_interval_mm2", "contact_centroid_mm", "depth_mm")


ARGUMENTS = (
    arg.positional("source", "SOURCE", "an image, a folder of images or a video", type=Path),
    arg.sensor(),
    arg.option(
        "--calibration FILE.json", "calibration of this sensor, by `mjtactile calibrate`", type=Path
    ),
    arg.choice(
        "--marks",
        ("dark", "bright"),
        "track the dots of any marked skin: dark dots on bright ground, or bright dots",
    ),
    arg.option(
        "--camera CAMERA.yaml",
        "with --marks: camera file of ROS, OpenCV or Kalibr; requires --radius-mm",
        type=Path,
    ),
    arg.option("--radius-mm R", "with --marks: radius of the dots", type=arg.number(0.01, 100)),
    arg.out(
        f"write reconstruct.json, overlays, and 3D figures (of at most {FIGURES_MAX} frames) there"
    ),
)


def run(options: argparse.Namespace) -> int:
    if options.marks is not None:
        return track_dots.run(options)
    for name in ("camera", "radius_mm"):
        if getattr(options, name) is not None:
            raise InputError("requires --marks", field=f"--{name.replace('_', '-')}")
    design = load_sensor(options.sensor)
    perception = load_perception(design, options.calibration)
    progress = Progress(quiet=options.json)
    with optional_folder(options.out, "reconstruct.json") as out:
        with stdout_to_stderr():
            evaluated = []
            for frame in read_frames(options.source):
                evaluated.append((frame.name, *_reconstruct(frame, perception, out)))
                if len(evaluated) % 50 == 0:
                    progress.message(f"{len(evaluated)} frames")
        if not any(touch is not None for _, _, touch in evaluated):
            message = (
                f"none of its {len(evaluated)} images can be used: {evaluated[0][1]['status']}"
            )
            raise InputError(message, source=options.source, field="SOURCE")
        result = {"sensor": design.name, "frames": [row for _, row, _ in evaluated]}
        if out is not None:
            write_json(out / "reconstruct.json", result)
            _figures(evaluated, out)
    print_result(options, result, lambda: _print_table(result["frames"], options.out))
    return 0


def load_perception(design: SensorDesign, path: Path | None) -> StatefulPipeline:
    """Return the sensing pipeline of a sensor, with its calibration file if given. Raises
    InputError if the file belongs to another sensor."""
    if path is None:
        return StatefulPipeline.of(design)
    calibration = load_calibration(path)
    calibration.check(design, calibration.finger, path)
    pipeline = SensingPipeline(design, calibration)
    return StatefulPipeline(pipeline, pipeline.restored_state())


def _reconstruct(
    frame: NamedImage, perception: StatefulPipeline, out: Path | None
) -> tuple[dict[str, Any], Touch | None]:
    """Evaluate one frame; return its row of the JSON, and its touch."""
    pipeline = perception.pipeline
    state = perception.state
    image = to_image(frame, pipeline.design)
    if isinstance(image, str):
        return _row(frame.name, image, None), None
    if state.reference is not None:
        touch = perception.perceive(image, time.monotonic())
    else:
        markers, perception.state = pipeline.detect_markers(state, image)
        status = pipeline.check_markers(markers)
        surface = pipeline.fitter.fit(markers) if status == "ok" else None
        if surface is not None and (problem := _impossible(surface, pipeline.design)):
            status, surface = problem, None
        touch = Touch(
            0.0, 0.0, np.nan, np.nan, False, surface=surface, markers=markers, status=status
        )
    if out is not None:
        cv2.imwrite(
            str(out / f"{_stem(frame.name)}_overlay.png"),
            marker_overlay(image, pipeline.camera, pipeline.design),
        )
    return _row(frame.name, touch.status, touch), touch


def _impossible(surface: Surface, design: SensorDesign) -> Status | None:
    """Return a status for a surface that rubber cannot have; None if it can."""
    stretch = math.sqrt(surface.area / design.frame.area)
    if stretch <= _STRETCH_MAX:
        return None
    return Status(
        StatusCode.FIT_FAILED,
        f"a surface of {1e6 * surface.area:.0f} mm2 would stretch the membrane to "
        f"{stretch:.2f} times its length; check that sensor {design.name} took the image",
    )


def _stem(name: str) -> str:
    if "#" not in name:
        return Path(name).stem
    return name.replace("#", "_").replace(".", "_")


def _row(name: str, status: str, touch: Touch | None) -> dict[str, Any]:
    """Return one frame of the JSON; unknown values are null."""
    surface = None if touch is None else touch.surface
    markers = None if touch is None else touch.markers
    contact = None if touch is None else touch.contact
    traction = None if touch is None else touch.traction
    return {
        "source": name,
        "status": status,
        **_shape(surface),
        "markers": [] if markers is None else _markers(markers),
        **_contact(contact),
        **_force(traction),
    }


def _contact(contact: Contact | None) -> dict[str, Any]:
    if contact is None:
        return dict.fromkeys(_CONTACT)
    return {
        "contact_area_mm2": 1e6 * contact.area,
        "contact_area_interval_mm2": 1e6 * contact.area_interval,
        "contact_centroid_mm": 1e3 * contact.centroid,
        "depth_mm": 1e3 * contact.depth,
    }


def _force(traction: Traction | None) -> dict[str, Any]:
    if traction is None:
        return dict.fromkeys(("force_N", "force_sd_N"))
    return {"force_N": traction.wrench[:3], "force_sd_N": np.sqrt(np.diag(traction.wrench_cov)[:3])}


def _shape(surface: Surface | None) -> dict[str, Any]:
    if surface is None:
        return dict.fromkeys(("surface", "area_mm2", "area_sd_mm2", "volume_mL", "volume_sd_mL"))
    return {
        "surface": {"x_mm": 1e3 * surface.x, "y_mm": 1e3 * surface.y, "z_mm": 1e3 * surface.z},
        "area_mm2": 1e6 * surface.area,
        "area_sd_mm2": 1e6 * surface.area_sd,
        "volume_mL": 1e6 * surface.volume,
        "volume_sd_mL": 1e6 * surface.volume_sd,
    }


def _markers(markers: Markers) -> list[dict[str, Any]]:
    sd = 1e3 * np.sqrt(np.einsum("nii->ni", markers.cov_p))
    return [
        {
            "id": markers.ids[i],
            "p_SM_mm": 1e3 * markers.p_SM[i],
            "normal": markers.n_S[i],
            "sd_mm": sd[i],
        }
        for i in range(len(markers))
    ]


def _figures(frames: Sequence[tuple[str, dict[str, Any], Touch | None]], out: Path) -> None:
    """Plot 3D figures of up to FIGURES_MAX frames, evenly spaced over the source."""
    shown = [
        (name, touch)
        for name, _, touch in frames
        if touch is not None and touch.surface is not None
    ]
    if not shown:
        return
    spread = np.linspace(0, len(shown) - 1, min(FIGURES_MAX, len(shown)))
    for i in np.unique(spread.astype(int)):
        name, touch = shown[i]
        save_plot(
            out / f"{_stem(name)}_surface.png",
            lambda figure, touch=touch: plot_surface_map(
                figure.add_subplot(projection="3d"), touch
            ),
            size=(7, 5),
        )


def _print_table(rows: Sequence[dict[str, Any]], out: Path | None) -> None:
    def number(value: Any, width: int, digits: int) -> str:
        if value is not None:
            return f"{value:{width}.{digits}f}"
        return " " * (width - 1) + "-"

    print(
        f"{'source':<32} {'markers':>7} {'area mm2':>10} {'volume mL':>10} {'contact mm2':>11} "
        f"{'depth mm':>9} {'force N':>8}"
    )
    for row in rows:
        force = None if row["force_N"] is None else -row["force_N"][2]
        print(
            f"{row['source'][-32:]:<32} {len(row['markers']):>7} {number(row['area_mm2'], 10, 2)} "
            f"{number(row['volume_mL'], 10, 4)} {number(row['contact_area_mm2'], 11, 1)} "
            f"{number(row['depth_mm'], 9, 3)} "
            f"{number(force, 8, 3)}{'' if row['status'] == 'ok' else '  ' + row['status']}"
        )
    if out is not None:
        print(f"reconstruct.json, overlays and figures are in {out}")
