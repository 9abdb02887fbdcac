"""A serial port for the SDK, and its packets."""

from __future__ import annotations

import contextlib
import select
from typing import Any

import serial
from dynamixel_sdk import PortHandler, Protocol2PacketHandler

from mjtactile.core import scaled_clock
from mjtactile.devices.serial_write import write

_FLOOD_FACTOR = 5  # times the time-out
# write timeout, s: pySerial counts time in which the computer was suspended, even after a complete
# write
_WRITE_TIME = 0.5


class Port(PortHandler):
    """Serial port of the SDK with exclusive access, monotonic timeouts and waiting without load."""

    def __init__(self, name: str, reply_timeout: float):
        super().__init__(name)
        self._reply_timeout_ms = 1e3 * reply_timeout

    def setupPort(self, cflag_baud: int) -> bool:
        self.ser = serial.Serial(
            port=self.port_name,
            baudrate=cflag_baud,
            timeout=0,
            write_timeout=scaled_clock.wall(_WRITE_TIME),
            exclusive=True,
        )
        with contextlib.suppress(OSError, ValueError, NotImplementedError):
            # FTDI's 16 ms latency timer to 1 ms; a pty has none
            self.ser.set_low_latency_mode(True)
        self.is_open = True
        self.ser.reset_input_buffer()
        self.tx_time_per_byte = 10 * 1e3 / cflag_baud
        return True

    def readPort(self, length: int) -> Any:
        data = self.ser.read(length)
        if not data and length > 0:
            # short, so that the time-out is still checked
            select.select([self.ser.fileno()], [], [], 5e-4)
            data = self.ser.read(length)
        return data

    def writePort(self, packet: Any) -> int:
        return write(self.ser, bytes(packet))

    def getCurrentTime(self) -> float:
        return 1e3 * scaled_clock.monotonic()

    def isPacketTimeout(self) -> bool:
        """Return True if the reply is late and no data is waiting to be read.

        With waiting data, this thread may have been late. A device that sends continuously gets no
        additional time.
        """
        passed = self.getTimeSinceStart()
        return passed > self.packet_timeout and (
            self.ser.in_waiting == 0 or passed > _FLOOD_FACTOR * self.packet_timeout
        )

    def setPacketTimeout(self, packet_length: int) -> None:
        self.setPacketTimeoutMillis(self.tx_time_per_byte * packet_length + self._reply_timeout_ms)


class PacketHandler(Protocol2PacketHandler):
    """Packet handler of the SDK with in-place byte stuffing, also several times in a packet."""

    def addStuffing(self, packet: list[int]) -> list[int]:
        length = packet[5] | packet[6] << 8
        head = packet[:7]
        body = packet[7 : 7 + length - 2]
        stuffed: list[int] = []
        last = packet[5:7]
        for byte in body:
            stuffed.append(byte)
            if byte == 0xFD and last[-2:] == [0xFF, 0xFF]:
                stuffed.append(0xFD)
            last = [*last[-1:], byte]
        new_length = len(stuffed) + 2
        packet[:] = [*head[:5], new_length & 0xFF, new_length >> 8, *stuffed, 0, 0]
        return packet

    def removeStuffing(self, packet: list[int]) -> list[int]:
        length = packet[5] | packet[6] << 8
        body = bytes(packet[7 : 7 + length - 2]).replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
        new_length = len(body) + 2
        packet[:] = [
            *packet[:5],
            new_length & 0xFF,
            new_length >> 8,
            *body,
            *packet[7 + length - 2 : 7 + length],
        ]
        return packet
