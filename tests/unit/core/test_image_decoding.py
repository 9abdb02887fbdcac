"""Image files from anywhere: whole ones are read as OpenCV writes them, others are refused without
a word on stderr."""

import struct
import zlib

import cv2
import numpy as np
import pytest

from mjtactile.core.image_decoding import decode


def png(pixels):
    return bytes(cv2.imencode(".png", pixels)[1])


def test_whole_files_are_what_was_written():
    pixels = np.random.default_rng(0).integers(0, 65536, (7, 9), np.uint16)
    np.testing.assert_array_equal(decode(png(pixels), cv2.IMREAD_UNCHANGED), pixels)
    grey = (pixels >> 8).astype(np.uint8)
    np.testing.assert_array_equal(
        decode(bytes(cv2.imencode(".bmp", grey)[1]), cv2.IMREAD_GRAYSCALE), grey
    )


@pytest.mark.parametrize("place", [0, 9, 20, 30, 45, -20, -5])
def test_any_byte_that_changed_is_found(capfd, place):
    data = bytearray(png(np.zeros((20, 30), np.uint8)))
    data[place] ^= 0x55
    assert decode(bytes(data), cv2.IMREAD_GRAYSCALE) is None
    assert decode(bytes(data[:-1]), cv2.IMREAD_GRAYSCALE) is None
    assert capfd.readouterr().err == ""


def test_what_would_unpack_into_gigabytes_is_refused():
    def chunk(kind, data):
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    bomb = (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", struct.pack(">2I5B", 20_000, 20_000, 16, 6, 0, 0, 0))
        + chunk(b"IEND", b"")
    )
    assert decode(bomb, cv2.IMREAD_UNCHANGED) is None
    assert (
        decode(b"", cv2.IMREAD_UNCHANGED) is None
        and decode(b"no image", cv2.IMREAD_UNCHANGED) is None
    )
