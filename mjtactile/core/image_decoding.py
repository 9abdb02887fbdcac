"""Image files that may come from anywhere, unpacked."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
from numpy.typing import NDArray

LARGEST = 1 << 26
"""Pixels; a PNG file of 2 MB may hold a thousand times as many, and OpenCV unpacks them all."""
_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def decode(data: bytes, flags: int) -> NDArray | None:
    """Return the pixels of an image file (`flags`: cv2.IMREAD_*).

    None if it is damaged, too large, or not an image.
    """
    if data.startswith(_SIGNATURE) and not _is_sound_png(data):
        return None
    try:
        if data:
            return cv2.imdecode(np.frombuffer(data, np.uint8), flags)
        return None
    except cv2.error:
        return None


def is_sound(data: bytes) -> bool:
    """Return True if an image file is complete; a PNG file is only checked, not decoded."""
    if data.startswith(_SIGNATURE):
        return _is_sound_png(data)
    return decode(data, cv2.IMREAD_GRAYSCALE) is not None


def _is_sound_png(data: bytes) -> bool:
    """Return True if each chunk is complete with a valid checksum.

    The image size must also be within limits. libpng only prints errors and continues.
    """
    start = len(_SIGNATURE)
    while len(data) >= start + 12:
        size, kind = struct.unpack_from(">I4s", data, start)
        end = start + 12 + size
        if data[end - 4 : end] != struct.pack(">I", zlib.crc32(data[start + 4 : end - 4])):
            return False
        if kind == b"IHDR" and (
            size != 13
            or np.prod(struct.unpack_from(">2I", data, start + 8), dtype=np.uint64) > LARGEST
        ):
            return False
        if kind == b"IEND":
            return True
        start = end
    return False
