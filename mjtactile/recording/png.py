"""PNG encoder for grayscale images, fast enough for two cameras during a control loop.

The format: https://www.w3.org/TR/png-3/. Image noise hardly compresses, so a low compression level
is used. ISA-L compresses an image in a third of the time of OpenCV's encoder. Its files are 10 %
larger.
"""

from __future__ import annotations

import struct

import numpy as np
from isal import isal_zlib
from numpy.typing import NDArray

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_LEVEL = 1  # compression level, 0 to 3; 2 takes a quarter longer for files 5 % smaller
_UP = 2  # first byte of each row: less the row above, which saves a sixth of the file


def encode(pixels: NDArray[np.uint8]) -> bytes:
    """Encode 8-bit gray `pixels` (H, W) as a PNG file."""
    height, width = pixels.shape
    rows = np.empty((height, width + 1), np.uint8)
    rows[:, 0] = _UP
    rows[:1, 1:] = pixels[:1]
    np.subtract(pixels[1:], pixels[:-1], out=rows[1:, 1:])  # modulo 256, as the format has it
    depth = 8
    grey = 0
    deflate = 0
    filters = 0
    progressive = 0
    header = struct.pack(">2I5B", width, height, depth, grey, deflate, filters, progressive)
    packed = isal_zlib.compress(rows, _LEVEL)
    return b"".join(
        [_SIGNATURE, *_chunk(b"IHDR", header), *_chunk(b"IDAT", packed), *_chunk(b"IEND", b"")]
    )


def _chunk(kind: bytes, data: bytes) -> tuple[bytes, bytes, bytes, bytes]:
    return (
        struct.pack(">I", len(data)),
        kind,
        data,
        struct.pack(">I", isal_zlib.crc32(data, isal_zlib.crc32(kind))),
    )
