"""`mjtactile detect-circles`: position and covariance of each circular marker of an image.

It needs no sensor and no simulator.
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import cv2

from mjtactile import Camera, InputError, circles_to_records, detect_circles
from mjtactile.commands import arguments as arg
from mjtactile.commands.output import optional_folder, print_result, stdout_to_stderr
from mjtactile.recording.files import write_json
from mjtactile.report.frame_source import NamedImage, overlay, read_frames

SIMULATES = False
DESCRIPTION = """\
Detect circular markers of a known radius in an image, a folder of images or a video. Estimate
the center and normal of each marker in the camera frame (x right, y down, z forward).

Forty or more small circles (below 6 px) that clearly lie on one smooth surface, such as the
dots of a board, share information: a spline over the image smooths their depths, with a
stiffness estimated from the circles. Neither flatness nor any spacing is assumed, but the
depths are no longer independent; `--neighbours never` disables it."""
EPILOG = """\
examples:
  mjtactile detect-circles photo.png --camera camera.yaml --radius-mm 6.35
  mjtactile detect-circles photos/ --camera camera.yaml --radius-mm 6.35 --json > markers.json
  mjtactile detect-circles photo.png --camera camera.yaml --radius-mm 2 --glass-mm 5:1.5:120
  mjtactile detect-circles clip.mp4 --camera camera.yaml --radius-mm 1.5 --bright --out overlays

JSON: {"frames": [{"source": …, "status": "ok", or the reason for having no valid marker,
  "shared": [] or the quantities shared between circles ("elongation", "depth"),
  "overexposed": true if the bright side is clipped, which hides tenths of a pixel of size,
  "deformed": true if most outlines deviate from ellipses, as after processing in the camera,
  "gamma": {"assumed", "estimate" and "sd" (null: not observable), "wrong": true if they
  clearly differ}, "markers": [{
  "uv_px": projected center (distorted pixels; (0, 0) is the center of the top-left pixel),
  "ellipse_px": {"center", "semi_axes", "angle_deg"},
  "center_mm", "cov_center_mm2": 3x3, "normal" (facing the camera),
  "center_alt_mm", "cov_center_alt_mm2", "normal_alt": the other pose of the circle with the
  same image, "preferred_probability": probability that the first pose is the right one,
  "status": "ok", or the reason not to use it}],
  "rejected": all other candidates, [{"center_px", "semi_axes_px", "status": the reason for
  the rejection}]}]}
Camera files: ROS camera_info, the output of `ros2 topic echo`, OpenCV YAML and XML, Kalibr, ini.
Lens models: those of sensor files. A YAML file may have a glass in addition:
  glass: {thickness_mm: 5, refractive_index: 1.5, distance_mm: 120}
One image of one circle allows two poses. The circles around it decide between them if they lie
on a smooth surface; otherwise the less tilted pose is slightly more probable.
exit codes: 0 done (also when no marker was found), 2 bad input.
"""


def _gamma(text: str) -> float | Literal["auto"]:
    return "auto" if text == "auto" else _POSITIVE(text)


_POSITIVE = arg.POSITIVE
ARGUMENTS = (
    arg.positional("source", "SOURCE", "an image, a folder of images or a video", type=Path),
    arg.option(
        "--camera CAMERA.yaml", "camera file of ROS, OpenCV or Kalibr", type=Path, required=True
    ),
    arg.option(
        "--glass-mm T:N:D",
        "glass in front of the camera, normal to its axis: thickness in mm, refractive "
        "index, distance of its near face from the camera center in mm, such as 5:1.5:120 "
        "(default: the glass entry of the camera file)",
    ),
    arg.option("--radius-mm R", "radius of the markers in mm", type=_POSITIVE, required=True),
    arg.OneOf(
        (
            arg.flag(
                "--dark",
                "dark markers on a bright background (default)",
                dest="polarity",
                action="store_const",
                const="dark",
                default="dark",
            ),
            arg.flag(
                "--bright",
                "bright markers on a dark background",
                dest="polarity",
                action="store_const",
                const="bright",
            ),
        )
    ),
    arg.choice(
        "--neighbours",
        ["auto", "always", "never"],
        "share information between many circles on one smooth surface: small ones (auto, the "
        "default), of any size, or never",
        "auto",
    ),
    arg.option(
        "--gamma G|auto",
        "camera gamma: grey levels are light to the power of 1/G (default: 1; sRGB: 2.2); "
        "auto: estimate it from the circles of each image",
        1.0,
        type=_gamma,
    ),
    arg.out("write an overlay of each image and locate.json there"),
)


def run(options: argparse.Namespace) -> int:
    camera = Camera.from_file(options.camera)
    camera = camera if options.glass_mm is None else _behind_glass(camera, options.glass_mm)
    with optional_folder(options.out, "locate.json") as out:
        with stdout_to_stderr():
            frames = [_locate(frame, camera, options, out) for frame in read_frames(options.source)]
        if not any(frame["usable"] for frame in frames):
            message = (
                f"none of the {len(frames)} images can be used; {frames[0]['source']}: "
                f"{frames[0]['status']}"
            )
            raise InputError(message, source=options.source, field="SOURCE")
        if out is not None:
            write_json(out / "locate.json", {"frames": [_public(frame) for frame in frames]})
    print_result(
        options,
        {"frames": [_public(frame) for frame in frames]},
        lambda: _print_table(frames, options.out),
    )
    return 0


def _behind_glass(camera: Camera, text: str) -> Camera:
    try:
        thickness, index, distance = map(float, text.split(":"))
        return camera.behind_glass(1e-3 * thickness, index, 1e-3 * distance)
    except (ValueError, InputError) as error:
        raise InputError(
            f"{text!r} is not a glass specification",
            field="--glass-mm",
            choices=["THICKNESS:INDEX:DISTANCE, such as 5:1.5:120"],
        ) from error


def _public(frame: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in frame.items() if key not in ("ms", "usable")}


def _locate(
    frame: NamedImage, camera: Camera, options: argparse.Namespace, out: Path | None
) -> dict[str, Any]:
    """Detect the circles of one frame, and return its row of the JSON.

    The row also has the time `ms` for the table, and `usable`.
    """
    if frame.pixels is None:
        return _without_markers(frame, "cannot be read")
    if mismatch := camera.size_mismatch(frame.pixels, "the camera file"):
        return _without_markers(frame, mismatch)
    start = time.perf_counter()
    found = detect_circles(
        frame.pixels,
        camera,
        options.radius_mm * 1e-3,
        polarity=options.polarity,
        neighbours=options.neighbours,
        gamma=options.gamma,
    )
    spent = 1e3 * (time.perf_counter() - start)
    if out is not None:
        name = f"{Path(frame.name).stem}{_index(frame.name)}_overlay.png"
        cv2.imwrite(str(out / name), overlay(frame.pixels, found.ellipses, found.poses))
    return {
        "source": frame.name,
        "status": found.status,
        "shared": list(found.shared),
        "overexposed": found.overexposed,
        "deformed": found.deformed,
        "gamma": {
            "assumed": found.assumed,
            "estimate": found.gamma.value,
            "sd": found.gamma.sd,
            "wrong": found.nonlinear,
        },
        "markers": circles_to_records(found),
        "rejected": found.rejected.records(),
        "ms": spent,
        "usable": True,
    }


def _without_markers(frame: NamedImage, status: str) -> dict[str, Any]:
    return {
        "source": frame.name,
        "status": status,
        "shared": [],
        "overexposed": False,
        "deformed": False,
        "gamma": None,
        "markers": [],
        "rejected": [],
        "ms": 0.0,
        "usable": False,
    }


def _index(name: str) -> str:
    """Return the suffix `_000012` for a frame of a video; "" for an image file."""
    return "_" + name.rsplit("#", 1)[1] if "#" in name else ""


def _gamma_note(gamma: dict[str, Any]) -> str:
    return (
        f"gamma is not {gamma['assumed']:g} but about {gamma['estimate']:.1f} (sd "
        f"{gamma['sd']:.1f}): set --gamma"
    )


def _print_table(frames: Sequence[dict[str, Any]], out: Path | None) -> None:
    print(
        f"{'source':<40} {'markers':>7} {'ok':>5} {'rejected':>8} {'sd of depth mm':>15} {'ms':>7}"
    )
    for frame in frames:
        good = [m for m in frame["markers"] if m["status"] == "ok"]
        if good:
            depth = statistics.median(
                math.sqrt(m["cov_center_mm2"][2][2] or math.nan) for m in good
            )
        else:
            depth = math.nan
        note = [] if frame["status"] == "ok" else [frame["status"]]
        note += ["depth shared"] * ("depth" in frame["shared"]) + ["over-exposed"] * frame[
            "overexposed"
        ]
        note += ["outlines deformed"] * frame["deformed"]
        note += [_gamma_note(frame["gamma"])] if frame["gamma"] and frame["gamma"]["wrong"] else []
        print(
            f"{frame['source'][-40:]:<40} {len(frame['markers']):>7} {len(good):>5} "
            f"{len(frame['rejected']):>8} {depth:>15.4f} {frame['ms']:>7.1f}  "
            f"{', '.join(note)}".rstrip()
        )
    if out is not None:
        print(f"overlays and locate.json were written to {out}")
