"""Images from a user's file, folder (in file-name order) or video, and overlays of markers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile.core import foreign_file
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.optics import Camera
from mjtactile.core.types import CirclePoses, Ellipses, Image
from mjtactile.report.overlay import find_ellipses
from mjtactile.sensing.image.ellipse import boundary, shape_from_axes
from mjtactile.sensing.image.markers import grey_image
from mjtactile.sensing.pose.circles import estimate_poses
from mjtactile.sensing.pose.circles_from_images import IMAGE_SUFFIXES, load_image

VIDEO_SUFFIXES = (".mp4", ".avi", ".mkv", ".mov", ".webm", ".m4v")


@dataclass(frozen=True, eq=False)
class NamedImage:
    """Name and pixels (H, W) or (H, W, 3) of an image, None when it cannot be read."""

    name: str
    pixels: NDArray | None

    def grey(self) -> NDArray | None:
        """Return the gray channel (H, W), uint8; None if the file cannot be read."""
        if self.pixels is None:
            return None
        grey = grey_image(self.pixels)
        return grey if grey.dtype == np.uint8 else (grey >> 8).astype(np.uint8)


def read_frames(source: Path) -> Iterator[NamedImage]:
    """Yield the images of `source`. Raises InputError when there is none."""
    if foreign_file.is_dir(source):
        files = sorted(path for path in source.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)
        if not files:
            raise InputError(
                "the folder contains no images",
                source=source,
                field="SOURCE",
                choices=IMAGE_SUFFIXES,
            )
        yield from (_read(path) for path in files)
    elif not foreign_file.is_file(source):
        raise InputError("no such file or folder", source=source, field="SOURCE")
    elif source.suffix.lower() in VIDEO_SUFFIXES:
        yield from _read_video(source)
    else:
        yield NamedImage(source.name, load_image(source))


def _read(path: Path) -> NamedImage:
    try:
        return NamedImage(path.name, load_image(path))
    except InputError:
        return NamedImage(path.name, None)


def _read_video(path: Path) -> Iterator[NamedImage]:
    video = cv2.VideoCapture(str(path))
    count = 0
    try:
        while True:
            ok, pixels = video.read()
            if not ok:
                break
            yield NamedImage(f"{path.name}#{count:06d}", pixels)
            count += 1
    finally:
        video.release()
    if count == 0:
        raise InputError("the video contains no readable frame", source=path, field="SOURCE")


def to_image(frame: NamedImage, design: SensorDesign) -> Image | str:
    """Return the frame as an image of the sensor's camera, or the reason why it is unusable."""
    pixels = frame.grey()
    if pixels is None:
        return "cannot be read"
    return design.camera.size_mismatch(pixels, "the sensor's camera") or Image(pixels)


def read_images(source: Path, design: SensorDesign) -> list[Image]:
    """Return all images of a source. Raises InputError for one that the sensor cannot have."""
    images = []
    folder = source if foreign_file.is_dir(source) else source.parent
    for frame in read_frames(source):
        image = to_image(frame, design)
        if isinstance(image, str):
            raise InputError(image, source=folder / frame.name, field="image")
        images.append(image)
    return images


def marker_overlay(image: Image, camera: Camera, design: SensorDesign) -> NDArray[np.uint8]:
    """Return the `overlay` of the markers that are detected in a sensor's image."""
    ellipses = find_ellipses(image)
    return overlay(image.pixels, ellipses, estimate_poses(ellipses, camera, design.markers.radius))


def overlay(pixels: NDArray, ellipses: Ellipses, poses: CirclePoses | None) -> NDArray[np.uint8]:
    """Return the image with each ellipse (green: ok, orange: unreliable) and its center.

    The center is the projected circle center. Without `poses` it is that of the ellipse.
    """
    if pixels.dtype == np.uint8:
        eight = pixels
    else:
        eight = cv2.convertScaleAbs(pixels, alpha=255 / max(int(pixels.max()), 1))
    if eight.ndim == 2:
        canvas = cv2.cvtColor(eight, cv2.COLOR_GRAY2BGR)
    else:
        canvas = np.ascontiguousarray(eight[..., :3])
    zoom = max(1, round(1280 / canvas.shape[1]))
    canvas = cv2.resize(canvas, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_NEAREST)
    if not len(ellipses):
        return canvas
    points, _ = boundary(
        ellipses.center_px, shape_from_axes(ellipses.semi_axes_px, ellipses.angle), 48
    )
    status, centers = (
        (ellipses.status, ellipses.center_px) if poses is None else (poses.status, poses.uv_px)
    )
    for i, curve in enumerate(points):
        colour = (80, 220, 60) if status[i] == "ok" else (0, 150, 255)
        cv2.polylines(canvas, [_fixed(curve, zoom)], True, colour, 1, cv2.LINE_AA, 4)
        cross = centers[i] + np.array([[-2, 0], [2, 0], [0, -2], [0, 2]]) / zoom
        for line in (cross[:2], cross[2:]):
            cv2.polylines(canvas, [_fixed(line, zoom)], False, (60, 60, 255), 1, cv2.LINE_AA, 4)
    return canvas


def _fixed(uv: NDArray, zoom: int) -> NDArray[np.int32]:
    """Convert pixels to OpenCV's fixed point (4 bits) in the enlarged image."""
    return np.rint(((uv + 0.5) * zoom - 0.5) * 16).astype(np.int32)
