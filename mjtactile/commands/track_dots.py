"""`mjtactile reconstruct --marks`: track the circles of any marked skin in a video.

Results are in pixels. They are also three-dimensional if the camera and the radius are known.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile import Camera, InputError, TrackedCircles, track_circles
from mjtactile.commands.output import optional_folder, print_result, stdout_to_stderr
from mjtactile.recording.files import write_json
from mjtactile.report.frame_source import NamedImage, overlay, read_frames
from mjtactile.runtime.progress import Progress

COLUMNS = (
    "frame", "source", "id", "u_px", "v_px", "semi_axis_a_px", "semi_axis_b_px", "angle_deg",
    "status", "x_mm", "y_mm", "z_mm",
)  # fmt: skip
OVERLAYS = 12
_ZOOM = 3  # magnification of the image of the tracks


def run(options: argparse.Namespace) -> int:
    """Track the circles, and write or print the results."""
    camera, radius = _camera_and_radius(options)
    progress = Progress(quiet=options.json)
    with optional_folder(options.out, "tracks.csv", "tracks.png", "reconstruct.json") as out:
        with stdout_to_stderr():
            frames: list[NamedImage] = []
            found = []
            images = _images(options.source, frames, camera)
            for tracked in track_circles(images, camera, radius, polarity=options.marks):
                found.append(tracked)
                if len(found) % 50 == 0:
                    progress.message(f"{len(found)} frames")
        result = _result([frame.name for frame in frames], found)
        if out is not None:
            write_json(out / "reconstruct.json", result)
            _write_csv(out / "tracks.csv", frames, found)
            _render(out, frames, found)
    print_result(options, result, lambda: _print(result, options.out))
    return 0


def _camera_and_radius(options: argparse.Namespace) -> tuple[Camera | None, float | None]:
    if (options.camera is None) != (options.radius_mm is None):
        raise InputError(
            "--camera and --radius-mm must be given together; without both, tracks are in pixels",
            field="--radius-mm",
        )
    if options.camera is None:
        return None, None
    return Camera.from_file(options.camera), 1e-3 * options.radius_mm


def _images(source: Path, frames: list[NamedImage], camera: Camera | None) -> Iterator[NDArray]:
    """Yield the readable images; each is also appended to `frames`."""
    for frame in read_frames(source):
        if frame.pixels is None:
            continue
        if camera and (mismatch := camera.size_mismatch(frame.pixels, "the camera file")):
            raise InputError(mismatch, source=frame.name, field="SOURCE")
        frames.append(frame)
        yield frame.pixels


def _result(names: Sequence[str], found: Sequence[TrackedCircles]) -> dict[str, Any]:
    if not names:
        raise InputError("none of its images can be read", field="SOURCE")
    counts: dict[int, int] = {}
    for tracked in found:
        for identity in tracked.ids[tracked.ids >= 0].tolist():
            counts[identity] = counts.get(identity, 0) + 1
    return {
        "frames": [
            {
                "source": name,
                "circles": len(tracked.ids),
                "followed": int((tracked.ids >= 0).sum()),
                "trusted": int((tracked.ellipses.status == "ok").sum()),
            }
            for name, tracked in zip(names, found, strict=True)
        ],
        "tracks": [{"id": identity, "frames": counts[identity]} for identity in sorted(counts)],
    }


def _write_csv(path: Path, frames: Sequence[NamedImage], found: Sequence[TrackedCircles]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(COLUMNS)
        for index, (frame, tracked) in enumerate(zip(frames, found, strict=True)):
            for i in np.flatnonzero(tracked.ids >= 0):
                position = ["", "", ""]
                if tracked.poses is not None and np.isfinite(tracked.poses.p_CM[i]).all():
                    position = [f"{1e3 * value:.4f}" for value in tracked.poses.p_CM[i]]
                ellipse = tracked.ellipses
                u, v = ellipse.center_px[i]
                a, b = ellipse.semi_axes_px[i]
                angle = np.degrees(ellipse.angle[i])
                shape = [f"{value:.4f}" for value in (u, v, a, b)]
                row = [index, frame.name, tracked.ids[i], *shape, f"{angle:.2f}"]
                table.writerow([*row, ellipse.status[i], *position])


def _render(out: Path, frames: Sequence[NamedImage], found: Sequence[TrackedCircles]) -> None:
    """Plot the paths of all circles over the last frame, and some frames with the detected
    circles."""
    last = frames[-1].pixels
    assert last is not None
    canvas = cv2.resize(_colour(last), None, fx=_ZOOM, fy=_ZOOM, interpolation=cv2.INTER_CUBIC)
    paths: dict[int, list[Any]] = {}
    for tracked in found:
        for i in np.flatnonzero(tracked.ids >= 0):
            paths.setdefault(int(tracked.ids[i]), []).append(tracked.ellipses.center_px[i])
    for path in paths.values():
        line = np.round((np.array(path) + 0.5) * _ZOOM).astype(np.int32)
        cv2.polylines(canvas, [line], False, (0, 255, 255), 1, cv2.LINE_AA)
        cv2.circle(canvas, line[0].tolist(), 3, (0, 160, 0), -1, cv2.LINE_AA)
        cv2.circle(canvas, line[-1].tolist(), 3, (0, 0, 255), -1, cv2.LINE_AA)
    cv2.imwrite(str(out / "tracks.png"), canvas)
    for k in np.unique(np.linspace(0, len(frames) - 1, min(OVERLAYS, len(frames))).astype(int)):
        pixels = frames[k].pixels
        assert pixels is not None
        image = overlay(pixels, found[k].ellipses, found[k].poses)
        cv2.imwrite(str(out / f"frame_{k:06d}.png"), image)


def _colour(pixels: NDArray) -> NDArray:
    eight = pixels if pixels.dtype == np.uint8 else (pixels >> 8).astype(np.uint8)
    return cv2.cvtColor(eight, cv2.COLOR_GRAY2BGR) if eight.ndim == 2 else eight[..., :3]


def _print(result: dict[str, Any], out: Path | None) -> None:
    frames = result["frames"]
    count = len(frames)
    print(f"{count} frames, {len(result['tracks'])} circles tracked")
    for name in ("circles", "followed", "trusted"):
        counts = [frame[name] for frame in frames]
        print(f"  {name:9s} {min(counts)} to {max(counts)} per frame")
    long = sum(track["frames"] >= 0.8 * count for track in result["tracks"])
    print(f"  {long} circles are visible in at least four fifths of the frames")
    if out is not None:
        print(f"tracks.csv, tracks.png and some frames are in {out}")
