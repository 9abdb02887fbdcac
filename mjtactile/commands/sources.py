"""Images from what a user names: one file, a folder in file-name order, or a video."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
from numpy.typing import NDArray

from mjtactile.core.errors import InputError
from mjtactile.sensing.pose.locate import IMAGE_SUFFIXES, load_image

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
        yield Frame(source.name, load_image(source))


def _read(path: Path) -> Frame:
    try:
        return Frame(path.name, load_image(path))
    except InputError:
        return Frame(path.name, None)


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
