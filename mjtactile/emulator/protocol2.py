"""Dynamixel Protocol 2.0, servo side, written from
https://emanual.robotis.com/docs/en/dxl/protocol2/.

The CRC is this module's own implementation (bit by bit, no table). Tests compare it with packets
printed in that manual, so that an error in the SDK's CRC would show.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

HEADER = b"\xff\xff\xfd\x00"
BROADCAST = 0xFE
PING = 1
READ = 2
WRITE = 3
REG_WRITE = 4
ACTION = 5
FACTORY_RESET = 6
REBOOT = 8
CLEAR = 0x10
BACKUP = 0x20
STATUS = 0x55
SYNC_READ = 0x82
SYNC_WRITE = 0x83
FAST_SYNC_READ = 0x8A
BULK_READ = 0x92
BULK_WRITE = 0x93
FAST_BULK_READ = 0x9A
ALERT = 0x80
_LONGEST = 1024  # bytes; a longer length is a broken packet


def crc16(data: bytes) -> int:
    """Compute the CRC-16, most significant bit first, with initial value 0.

    The polynomial is x^16 + x^15 + x^2 + 1 (0x8005).
    """
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x8005 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


_TABLE = [crc16(bytes([i])) for i in range(256)]


def fast_crc16(data: bytes, crc: int = 0) -> int:
    """Compute the same CRC byte by byte; `crc` is the CRC of the preceding bytes."""
    for byte in data:
        crc = (crc << 8 & 0xFF00) ^ _TABLE[crc >> 8 ^ byte]
    return crc


def stuff(body: bytes) -> bytes:
    """Add FD after each FF FF FD of instruction and parameters.

    No header can then appear inside a packet.
    """
    return body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")


def unstuff(body: bytes) -> bytes:
    return body.replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")


def encode(servo: int, instruction: int, parameters: bytes = b"") -> bytes:
    """Return a whole packet."""
    body = stuff(bytes([instruction]) + parameters)
    packet = HEADER + bytes([servo]) + (len(body) + 2).to_bytes(2, "little") + body
    return packet + fast_crc16(packet).to_bytes(2, "little")


def status(servo: int, error: int, parameters: bytes = b"") -> bytes:
    """Return a status packet."""
    return encode(servo, STATUS, bytes([error]) + parameters)


def fast_status(parts: Sequence[tuple[int, int, bytes]], promised: int | None = None) -> bytes:
    """Encode the single reply to a fast read.

    It holds (id, error, data) of each servo, each followed by the CRC of all preceding bytes.
    `promised` is the length announced in the header, bytes. It exceeds the actual length if a servo
    is missing.
    """
    length = 1 + (sum(len(data) + 4 for _, _, data in parts) if promised is None else promised)
    packet = HEADER + bytes([BROADCAST]) + length.to_bytes(2, "little") + bytes([STATUS])
    for servo, error, data in parts:
        packet += bytes([error, servo]) + data
        packet += fast_crc16(packet).to_bytes(2, "little")
    return packet


@dataclass(frozen=True)
class Instruction:
    """One packet from the host, unstuffed. `intact` is False when its CRC is wrong."""

    servo: int
    code: int
    parameters: bytes
    intact: bool = True


class Decoder:
    """Decoder of instruction packets in a stream of bytes with arbitrary noise."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> Iterator[Instruction]:
        """Receive data, and yield every packet that is now complete."""
        self._buffer += data
        while (packet := self._next()) is not None:
            body = unstuff(bytes(packet[7:-2]))
            intact = fast_crc16(bytes(packet[:-2])) == int.from_bytes(packet[-2:], "little")
            yield Instruction(packet[4], body[0], body[1:], intact)

    def _next(self) -> bytearray | None:
        buffer = self._buffer
        while True:
            start = buffer.find(HEADER[:3])
            if start < 0:
                del buffer[:-2]  # the header's first bytes may be here already
                return None
            del buffer[:start]
            if len(buffer) < 7:
                return None
            length = int.from_bytes(buffer[5:7], "little")
            if buffer[3] != 0 or not 3 <= length <= _LONGEST:
                del buffer[:3]
                continue
            if len(buffer) < 7 + length:
                return None
            packet = buffer[: 7 + length]
            del buffer[: 7 + length]
            if packet[7] != STATUS:  # ignore the replies of other servos
                return packet
