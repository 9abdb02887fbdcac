"""PNG files as other programs read them."""

import struct
import zlib

import cv2
import numpy as np
import pytest

from mjtactile.recording import png

RNG = np.random.default_rng(0)


@pytest.mark.parametrize(
    "pixels",
    [
        RNG.integers(0, 256, (48, 64), np.uint8),  # incompressible data
        np.rint(RNG.normal(120, 3, (480, 640))).astype(np.uint8),
        np.zeros((1, 1), np.uint8),
        np.full((3, 70000), 255, np.uint8),
        np.tile(np.arange(200, dtype=np.uint8), (50, 1))[:, ::2],  # not contiguous
    ],
    ids=["random", "noise", "a pixel", "long rows", "strided"],
)
def test_opencv_reads_the_written_file(pixels):
    read = cv2.imdecode(np.frombuffer(png.encode(pixels), np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(read, pixels)
    assert read.dtype == np.uint8


def test_chunks_are_as_the_format_states():
    """Lengths and checksums by zlib, and the rows by its inflate."""
    pixels = RNG.integers(0, 256, (5, 7), np.uint8)
    data = png.encode(pixels)[8:]
    chunks = {}
    while data:
        length, kind = struct.unpack(">I4s", data[:8])
        chunks[kind] = data[8 : 8 + length]
        assert struct.unpack(">I", data[8 + length : 12 + length])[0] == zlib.crc32(
            data[4 : 8 + length]
        )
        data = data[12 + length :]
    assert list(chunks) == [b"IHDR", b"IDAT", b"IEND"]
    rows = np.frombuffer(zlib.decompress(chunks[b"IDAT"]), np.uint8).reshape(5, 8)
    assert (rows[:, 0] == 2).all()  # each row less the one above
    np.testing.assert_array_equal(rows[:, 1:].cumsum(axis=0) % 256, pixels)
