"""Grey images as PNG files, fast enough to write two cameras' beside a control loop.

The format: https://www.w3.org/TR/png-3/. Noise has no strings that come again, so that none are
looked for: each row is taken less the mean of its neighbours before, and then only Huffman's code
of single bytes is used (kernels/png.c).
"""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from mjtactile.kernels import kernel

_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def encode(pixels: NDArray[np.uint8]) -> bytes:
    """`pixels` (H, W), 8 bit grey, as a PNG file."""
    height, width = pixels.shape
    depth = 8
    grey = 0
    deflate = 0
    filters = 0
    progressive = 0
    header = struct.pack(">2I5B", width, height, depth, grey, deflate, filters, progressive)
    room = np.empty(2 * height * (width + 1) + 512, np.uint8)  # as kernels.h has it
    packed = room[: kernel("pack_png")(height, width, pixels, room)].data
    return b"".join(
        [_SIGNATURE, *_chunk(b"IHDR", header), *_chunk(b"IDAT", packed), *_chunk(b"IEND", b"")]
    )


def _chunk(kind: bytes, data: bytes | memoryview) -> tuple[bytes, bytes, bytes | memoryview, bytes]:
    return (
        struct.pack(">I", len(data)),
        kind,
        data,
        struct.pack(">I", zlib.crc32(data, zlib.crc32(kind))),
    )
