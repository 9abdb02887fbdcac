"""Tests of lines of the valve board's protocol: damaged lines are rejected."""

import random
import zlib

import pytest

from benchmarks.rig.fuzz import damage, fuzz_valve
from mjtactile.devices.valve import protocol
from mjtactile.emulator import valve as emulated


def test_the_crc_is_that_of_ethernet():
    """Its check value, and two implementations."""
    assert emulated.crc32(b"123456789") == zlib.crc32(b"123456789") == 0xCBF43926
    line = b"7 set 1 1000*%08X\n" % zlib.crc32(b"7 set 1 1000")
    assert protocol.encode(7, "set 1 1000") == emulated.framed("7 set 1 1000") == line


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"1 id",
        b"1 id*00000000",
        b"1 id*" + b"%08x" % zlib.crc32(b"1 id"),
        b"x id*",
        b"1 i\xffd*1",
        b"1  *" + b"%08X" % zlib.crc32(b"2 "),
    ],
)
def test_damaged_lines_are_rejected(line):
    assert protocol.decode(line) is None
    assert emulated.unframed(line) is None


def test_a_damaged_line_is_not_read():
    """30 000 here; one in 4 10^9 could pass."""
    rng = random.Random(0)
    lines = [protocol.encode(n, f"state 1 sealed {n % 4000} ok").rstrip() for n in range(100)]
    accepted = 0
    for i in range(30_000):
        line = lines[i % 100]
        accepted += protocol.decode(damage(rng, line)) is not None
    assert accepted == 0
    assert all(
        protocol.decode(line) == (n, f"state 1 sealed {n} ok") for n, line in enumerate(lines)
    )


def test_invalid_lines_give_no_reading():
    """A seeded 20 kB through a port; `mjtactile bench rig` feeds 10^7 bytes."""
    result = fuzz_valve(20_000)
    assert result["wrong"] == 0 and result["refused"] > 15
    assert result["true"] > 0  # the correct answers among them were accepted
    assert result["longest_s"] < 10.0  # the reader does not block
