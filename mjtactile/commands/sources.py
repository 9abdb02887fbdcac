"""Images from what a user names: one file, a folder in file-name order, or a video."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile.errors import InputError

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm", ".webp")
VIDEO_SUFFIXES = (".mp4", ".avi", ".mkv", ".mov", ".webm", ".m4v")


@dataclass(frozen=True, eq=False)
class Frame:
    """`name` of the image, its pixels (H, W) or (H, W, 3) as stored, None when it cannot be read."""

    name: str
    pixels: NDArray | None


def read_frames(source: Path) -> Iterator[Frame]:
    """Yield the images of `source`. Raises InputError when there is none."""
    if source.is_dir():
        files = sorted(path for path in source.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)
        if not files:
            raise InputError("a folder without images", source=source, field="SOURCE", choices=IMAGE_SUFFIXES)
        yield from (_read(path) for path in files)
    elif not source.is_file():
        raise InputError("no such file or folder", source=source, field="SOURCE")
    elif source.suffix.lower() in VIDEO_SUFFIXES:
        yield from _read_video(source)
    else:
        frame = _read(source)
        if frame.pixels is None:
            raise InputError("not an image that can be read", source=source, field="SOURCE",
                             choices=(*IMAGE_SUFFIXES, *VIDEO_SUFFIXES))
        yield frame


def _read(path: Path) -> Frame:
    data = np.frombuffer(path.read_bytes(), np.uint8)  # not imread: it prints its own complaints
    pixels = None
    if len(data):
        try:
            pixels = cv2.imdecode(data, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH)
        except cv2.error:
            pixels = None
    return Frame(path.name, pixels)


def _read_video(path: Path) -> Iterator[Frame]:
    video = cv2.VideoCapture(str(path))
    count = 0
    try:
        while True:
            ok, pixels = video.read()
            if not ok:
                break
            yield Frame(f"{path.name}#{count:06d}", pixels)
            count += 1
    finally:
        video.release()
    if count == 0:
        raise InputError("a video without a frame that can be read", source=path, field="SOURCE")
