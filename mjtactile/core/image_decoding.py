"""Image files that may come from anywhere, unpacked."""

from __future__ import annotations

import math
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile.core import foreign_file

LARGEST = 1 << 26
"""Pixels; a PNG file of 2 MB may hold a thousand times as many, and OpenCV unpacks them all."""
LARGEST_FILE = 1 << 28
"""Maximum size of an image file, bytes."""
_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def read_file(path: Path) -> bytes:
    """Return the content of an image file.

    Raises InputError for a missing or larger file, and for pipes and devices.
    """
    return foreign_file.read_bytes(path, LARGEST_FILE, "an image")


def decode(data: bytes, flags: int) -> NDArray | None:
    """Return the pixels of an image file (`flags`: cv2.IMREAD_*).

    None if it is damaged, too large, or not an image of a supported format.
    """
    is_png = data.startswith(_SIGNATURE)
    if is_png and not _is_sound_png(data):
        return None
    if not is_png and not 0 < _pixels(data) <= LARGEST:
        return None
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        return None


def is_sound(data: bytes) -> bool:
    """Return True if an image file is complete. A PNG file is only checked, not decoded."""
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
            size != 13 or not 0 < math.prod(struct.unpack_from(">2I", data, start + 8)) <= LARGEST
        ):
            return False
        if kind == b"IEND":
            return True
        start = end
    return False


# -- sizes of the other formats, from their headers: OpenCV allocates all pixels before it reads any


def _pixels(data: bytes) -> int:
    """Return the number of pixels that an image file states; 0 if this is not a known format."""
    for start, read in _SIZES.items():
        if data.startswith(start):
            try:
                return read(data)
            except (struct.error, ValueError, IndexError):
                return 0
    return 0


def _jpeg(data: bytes) -> int:
    """Return the largest size of all frame headers."""
    return max(_jpeg_frames(data), default=0)


def _jpeg_frames(data: bytes) -> Iterator[int]:
    start = 2
    while start + 9 <= len(data) and data[start] == 0xFF:
        marker = data[start + 1]
        if marker == 0xFF or 0xD0 <= marker <= 0xD8 or marker == 0x01:  # filler, or without size
            start += 1 if marker == 0xFF else 2
            continue
        if marker == 0xDA:  # pixels
            return
        size, _, height, width = struct.unpack_from(">HBHH", data, start + 2)
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            yield height * width
        start += 2 + size


def _bmp(data: bytes) -> int:
    if struct.unpack_from("<I", data, 14)[0] == 12:
        return math.prod(struct.unpack_from("<HH", data, 18))
    return abs(math.prod(struct.unpack_from("<ii", data, 18)))


def _pnm(data: bytes) -> int:
    text = re.sub(rb"#[^\n]*", b"", data[2:4096])
    width, height = (int(word[:12]) for word in text.split(maxsplit=2)[:2])
    return width * height


def _webp(data: bytes) -> int:
    kind = data[12:16]
    if data[8:12] != b"WEBP":
        return 0
    if kind == b"VP8X":
        width, height = (1 + int.from_bytes(data[k : k + 3], "little") for k in (24, 27))
        return width * height
    if kind == b"VP8L":
        bits = struct.unpack_from("<I", data, 21)[0]
        return (1 + (bits & 0x3FFF)) * (1 + (bits >> 14 & 0x3FFF))
    width, height = struct.unpack_from("<HH", data, 26)
    return (width & 0x3FFF) * (height & 0x3FFF)


def _tiff(data: bytes) -> int:
    """Return the size of the first image."""
    order = "<" if data.startswith(b"II") else ">"
    start = struct.unpack_from(order + "I", data, 4)[0]
    sizes = {}
    for k in range(struct.unpack_from(order + "H", data, start)[0]):
        tag, kind = struct.unpack_from(order + "HH", data, start + 2 + 12 * k)
        if tag in (256, 257):
            form = "H" if kind == 3 else "I"
            sizes[tag] = struct.unpack_from(order + form, data, start + 10 + 12 * k)[0]
    return sizes.get(256, 0) * sizes.get(257, 0)


_SIZES: dict[bytes, Callable[[bytes], int]] = {
    b"\xff\xd8": _jpeg,
    b"BM": _bmp,
    **{b"P%d" % k: _pnm for k in range(1, 7)},
    b"RIFF": _webp,
    b"II*\0": _tiff,
    b"MM\0*": _tiff,
}
"""First bytes of a file to the reader of its size."""
