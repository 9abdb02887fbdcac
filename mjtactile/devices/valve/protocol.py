"""Lines of "mjvalve", the protocol of the board in firmware/valve/: `SEQUENCE WORD ARGUMENTS*CRC`,
ended by a newline.

CRC is the CRC-32 of the text before the `*`, as in zlib, in eight hexadecimal digits. An answer has
the sequence number of its command and repeats it, or is `error REASON`. The complete protocol:
firmware/valve/README.md.
"""

from __future__ import annotations

import re
import zlib

NAME = "mjvalve"
VERSION_MIN = (1, 0)
HOLD_VERSION = (1, 1)
"""First version of a board that can hold the chambers' state for a late host."""
SEQUENCES = 65536
LONGEST = 80  # bytes of a line without its end
STATES = {"vent": True, "set": True, "sealed": False}
"""States of a channel, and whether its chamber is then open to a supply or the air."""
FAULTS = {
    "ok": "",
    "start": "the board has restarted",
    "silent": "the host was silent for longer than the heartbeat time",
    "sensor": "its pressure sensor failed",
    "pressure": "its pressure was too high",
}
"""Reasons of a channel that vented by itself."""
_LINE = re.compile(rb"([0-9]{1,5}) ([ -)+-~]+)\*([0-9A-F]{8})")
_HEAD = re.compile(rb"[0-9]{1,5} [ -)+-~]+")


def encode(sequence: int, text: str) -> bytes:
    """Return a whole line."""
    body = f"{sequence} {text}".encode("ascii")
    assert _HEAD.fullmatch(body) and len(body) + 9 <= LONGEST, body
    return body + b"*%08X\n" % zlib.crc32(body)


def decode(line: bytes) -> tuple[int, str] | None:
    """Return sequence number and text of a line without its end; None for a damaged line."""
    match = _LINE.fullmatch(line)
    if match is None or len(line) > LONGEST or zlib.crc32(line[:-9]) != int(match[3], 16):
        return None
    return int(match[1]), match[2].decode("ascii")
