"""Tests of image files of any origin: complete files are read as OpenCV writes them, others are
refused without output on stderr."""

import struct
import zlib

import cv2
import numpy as np
import pytest

from mjtactile.core import image_decoding
from mjtactile.core.image_decoding import decode


def png(pixels):
    return bytes(cv2.imencode(".png", pixels)[1])


def test_complete_files_are_decoded_exactly():
    pixels = np.random.default_rng(0).integers(0, 65536, (7, 9), np.uint16)
    np.testing.assert_array_equal(decode(png(pixels), cv2.IMREAD_UNCHANGED), pixels)
    grey = (pixels >> 8).astype(np.uint8)
    np.testing.assert_array_equal(
        decode(bytes(cv2.imencode(".bmp", grey)[1]), cv2.IMREAD_GRAYSCALE), grey
    )


@pytest.mark.parametrize("place", [0, 9, 20, 30, 45, -20, -5])
def test_every_changed_byte_is_detected(capfd, place):
    data = bytearray(png(np.zeros((20, 30), np.uint8)))
    data[place] ^= 0x55
    assert decode(bytes(data), cv2.IMREAD_GRAYSCALE) is None
    assert decode(bytes(data[:-1]), cv2.IMREAD_GRAYSCALE) is None
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(("width", "height"), [(20_000, 20_000), (0, 10)])
def test_impossible_sizes_are_refused(capfd, width, height):
    def chunk(kind, data):
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    bomb = (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", struct.pack(">2I5B", width, height, 16, 6, 0, 0, 0))
        + chunk(b"IEND", b"")
    )
    assert decode(bomb, cv2.IMREAD_UNCHANGED) is None
    assert (
        decode(b"", cv2.IMREAD_UNCHANGED) is None
        and decode(b"no image", cv2.IMREAD_UNCHANGED) is None
    )
    assert capfd.readouterr().err == ""


FORMATS = (".jpg", ".bmp", ".pgm", ".ppm", ".webp", ".tif")


@pytest.mark.parametrize("suffix", FORMATS)
def test_every_format_is_read_after_a_check_of_its_size(suffix):
    """The size from the header is that of the pixels, for each format that is accepted."""
    pixels = np.random.default_rng(0).integers(0, 255, (37, 53, 3), np.uint8)
    data = bytes(cv2.imencode(suffix, pixels if suffix != ".pgm" else pixels[..., 0])[1])
    assert image_decoding._pixels(data) == 37 * 53
    assert decode(data, cv2.IMREAD_GRAYSCALE).shape == (37, 53)


def enlarged(suffix):
    """Return a small file whose header states 60 000 x 60 000 pixels."""
    data = bytearray(cv2.imencode(suffix, np.zeros((37, 53), np.uint8))[1])
    size = 60_000
    if suffix == ".jpg":
        at = data.index(b"\xff\xc0") + 5
        struct.pack_into(">HH", data, at, size, size)
    if suffix == ".bmp":
        struct.pack_into("<ii", data, 18, size, size)
    if suffix == ".pgm":
        return bytes(data).replace(b"53 37", b"60000 60000")
    if suffix == ".webp":  # at most 16383
        return b"RIFF\0\0\0\0WEBPVP8X\x0a\0\0\0\0\0\0\0" + b"\xff\xff\xff" * 2 + data[12:]
    if suffix == ".tif":
        for value in (53, 37):
            at = data.index(struct.pack("<HIHH", 3, 1, value, 0))
            struct.pack_into("<HII", data, at, 4, 1, size)
    return bytes(data)


@pytest.mark.parametrize("suffix", [item for item in FORMATS if item != ".ppm"])
def test_a_header_with_too_many_pixels_is_refused(suffix):
    assert image_decoding._pixels(enlarged(suffix)) > image_decoding.LARGEST
    assert decode(enlarged(suffix), cv2.IMREAD_GRAYSCALE) is None


@pytest.mark.parametrize(
    "data",
    [
        *(b"\xff\xd8", b"\xff\xd8\xff", b"\xff\xd8\xff\xc0\0", b"\xff\xd8" + b"\xff" * 99),
        *(b"BM", b"BM" + b"\0" * 30, b"P5", b"P5 x y 255 ", b"P2 1", b"RIFF", b"RIFF\0\0\0\0WEBP"),
        *(b"II*\0", b"II*\0\xff\xff\xff\xff", b"MM\0*" + b"\xff" * 40, b"II*\0\x04\0\0\0\xff\xff"),
        *(b"GIF89a" + b"\xff" * 20, b"#?RADIANCE\n\n-Y 99999 +X 99999\n", b"v/1\x01" + b"\0" * 99),
    ],
)
def test_a_damaged_header_or_another_format_is_refused(data):
    assert decode(data, cv2.IMREAD_GRAYSCALE) is None
