"""Dynamixel bus on top of the SDK's packet layer, with corrections of its defects.

Behavior of the SDK 4.1.0, and the correction here:

- group reads drop the alert byte: replies are parsed here and keep it;
- a short reply counts as success and fails later: the length is checked;
- an exception leaves `is_using` set, and every later call fails: it is cleared on every exit;
- two threads on one port disturb each other: one lock around each transaction;
- a missing reply costs 34 ms (LATENCY_TIMER): the timeout is the transmission time plus the rig
  file's allowance;
- timeouts use the wall clock: here the monotonic one; the port is opened exclusively;
- it waits by busy polling: here in `select`, so that the camera's thread gets the processor;
- byte stuffing of a growing packet is computed and discarded: here it is sent.
"""

from __future__ import annotations

import contextlib
import select
import termios
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import serial
from dynamixel_sdk import COMM_RX_CORRUPT, COMM_RX_TIMEOUT, COMM_SUCCESS

from mjtactile.core import scaled_clock
from mjtactile.core.errors import DeviceError
from mjtactile.devices.dynamixel.port import PacketHandler, Port

# byte positions in a status packet
_ID = 4
_LENGTH = 5
_ERROR = 8
_PARAMETERS = 9
_OVERHEAD = 11  # bytes of a status packet around its parameters
ALERT = 0x80
_DRAIN_MAX = 0.05  # maximum time of discarding noise, s
_LOST = (serial.SerialException, OSError, termios.error, TypeError)
"""Exceptions of pyserial for a lost port: termios.error is not an OSError, and a closed port raises
TypeError."""
_STATUS_ERRORS = {
    1: "could not execute the instruction",
    2: "does not support the instruction",
    3: "received a wrong CRC",
    4: "reports a value out of range",
    5: "reports a wrong length",
    6: "reports a value beyond its limit",
    7: "denies access to that register",
}


class BusError(DeviceError):
    """Failed transaction of a `servo`: "no reply", "corrupt", "short", "refused" or "lost"."""

    def __init__(self, message: str, *, servo: int | None, reason: str):
        super().__init__(message)
        self.servo = servo
        self.reason = reason


@dataclass(frozen=True)
class Reply:
    """Data of one servo's reply; `alert`: it has latched a hardware error."""

    data: bytes
    alert: bool

    def value(self, offset: int, size: int) -> int:
        """Return the unsigned little-endian value of `size` bytes at `offset`."""
        return int.from_bytes(self.data[offset : offset + size], "little")


class DynamixelBus:
    """Thread-safe bus at `port`. Raises DeviceError when the port is missing or taken."""

    def __init__(self, port: str, baud: int = 1_000_000, *, reply_timeout: float = 0.008):
        """Open the bus; `reply_timeout`, s: USB latency and return delay, without transmission."""
        self.name = port
        self._lock = threading.RLock()
        self._port = Port(port, reply_timeout)
        self._packets = PacketHandler()
        self._port.baudrate = baud
        self._dirty = False
        self._quiet = reply_timeout  # wait for a late reply, s: equal to the reply timeout
        try:
            if not self._port.setBaudRate(baud):
                raise DeviceError(f"{port}: the SDK does not support the baud rate {baud}")
        except (serial.SerialException, OSError, ValueError) as error:
            raise DeviceError(f"servo port {port} cannot be opened: {_one_line(error)}") from error

    def close(self) -> None:
        with self._lock:
            if self._port.is_open:
                self._port.closePort()

    def ping(self, servo: int) -> tuple[int, int]:
        """Return model number and firmware version of a servo. Raises BusError."""
        with self._transaction(servo):
            packet = self._exchange(servo, [1], reply=3)
            return packet.value(0, 2), packet.value(2, 1)

    def read(self, servo: int, address: int, size: int, *, again: bool = False) -> Reply:
        """Read `size` bytes of one servo. Raises BusError.

        `again`: the same read was requested just before, so a late answer to it is valid.
        """
        body = [2, *_bytes_of_word(address), *_bytes_of_word(size)]
        with self._transaction(servo, again=again):
            return self._exchange(servo, body, reply=size)

    def write(self, servo: int, address: int, size: int, value: int) -> bool:
        """Write one register and return the alert bit of the status. Raises BusError."""
        data = (value & ((1 << 8 * size) - 1)).to_bytes(size, "little")
        with self._transaction(servo):
            return self._exchange(servo, [3, *_bytes_of_word(address), *data], reply=0).alert

    def reboot(self, servo: int) -> None:
        """Restart one servo, only on the user's request.

        The torque is off afterwards, and a latched hardware error is cleared.
        """
        with self._transaction(servo):
            self._exchange(servo, [8], reply=0)

    def write_many(self, address: int, blocks: Mapping[int, bytes]) -> None:
        """Write the same registers of several servos in one packet, without a reply (sync
        write)."""
        size = len(next(iter(blocks.values())))
        parameters = [byte for servo, data in blocks.items() for byte in (servo, *data)]
        with self._transaction(None):
            result = self._packets.syncWriteTxOnly(
                self._port, address, size, parameters, len(parameters)
            )
            if result != COMM_SUCCESS:
                raise self._failed(None, result)

    def read_many(
        self, servos: Sequence[int], address: int, size: int, *, fast: bool = False
    ) -> tuple[dict[int, Reply], dict[int, BusError]]:
        """Read the same registers of several servos (sync or fast sync read).

        Return replies, and the errors of other servos. Raises BusError when the port fails.
        """
        self.request_many(servos, address, size, fast=fast)
        return self.answers(servos, size, fast=fast)

    def request_many(
        self, servos: Sequence[int], address: int, size: int, *, fast: bool = False
    ) -> None:
        """Send the request of `read_many`; the replies arrive in the port's buffer."""
        with self._transaction(None):
            result = self._packets.syncReadTx(
                self._port, address, size, list(servos), len(servos), fast
            )
            if result != COMM_SUCCESS:
                raise self._failed(None, result)
            self._port.setPacketTimeout((_OVERHEAD + size) * len(servos))
            self._dirty = True  # any other transaction must first discard the pending answers

    def answers(
        self, servos: Sequence[int], size: int, *, fast: bool = False
    ) -> tuple[dict[int, Reply], dict[int, BusError]]:
        """Return the servos' replies to `request_many` with the same arguments; see `read_many`."""
        with self._transaction(None, again=True):
            receive = self._receive_fast if fast else self._receive_each
            replies, failures = receive(servos, size)
            self._dirty = bool(failures)
            return replies, failures

    # -- inside

    @contextlib.contextmanager
    def _transaction(self, servo: int | None, *, again: bool = False) -> Iterator[None]:
        """Lock the bus. On any error, leave it usable and name the port in the exception."""
        with self._lock:
            try:
                if self._dirty and not again:
                    self._drain()
                yield
            except BusError as error:
                self._dirty = error.reason != "refused"
                raise
            except _LOST as error:
                reason_text = f"servo port {self.name} is lost: {_one_line(error)}"
                raise BusError(reason_text, servo=servo, reason="lost") from error
            except (IndexError, ValueError, UnboundLocalError) as error:
                # the SDK's parser on bad bytes
                self._dirty = True
                reason_text = f"servo port {self.name}: unreadable reply ({type(error).__name__})"
                raise BusError(reason_text, servo=servo, reason="corrupt") from error
            finally:
                self._port.is_using = False

    def _drain(self) -> None:
        """Discard late replies, which the next request would take as its own."""
        deadline = scaled_clock.monotonic() + _DRAIN_MAX
        while (
            scaled_clock.monotonic() < deadline
            and select.select([self._port.ser.fileno()], [], [], scaled_clock.wall(self._quiet))[0]
        ):
            if not self._port.ser.read(4096):
                break

    def _exchange(self, servo: int, body: list[int], *, reply: int) -> Reply:
        """Send one instruction; return its reply, which must have `reply` bytes."""
        length = len(body) + 2
        packet = [0, 0, 0, 0, servo, length & 0xFF, length >> 8, *body, 0, 0]
        result = self._packets.txPacket(self._port, packet)
        if result != COMM_SUCCESS:
            raise self._failed(servo, result)
        self._port.setPacketTimeout(_OVERHEAD + reply)
        while True:
            received, result = self._packets.rxPacket(self._port, False)
            if result != COMM_SUCCESS:
                raise self._failed(servo, result)
            if received[_ID] != servo or self._dirty and self._length(received) != reply:
                continue  # a reply of another servo, or a late reply to an earlier request
            answer = self._parse(servo, received, reply)
            self._dirty = False
            return answer

    @staticmethod
    def _length(packet: Sequence[int]) -> int:
        """Return the number of parameter bytes in a status packet."""
        return (packet[_LENGTH] | packet[_LENGTH + 1] << 8) - 4

    def _parse(self, servo: int, packet: Sequence[int], expected: int) -> Reply:
        error = packet[_ERROR]
        if error & ~ALERT:
            reason_text = _STATUS_ERRORS.get(
                error & ~ALERT, f"answered with error {error & ~ALERT}"
            )
            raise BusError(
                f"servo {servo} on {self.name} {reason_text}", servo=servo, reason="refused"
            )
        count = self._length(packet)
        if count != expected:
            reason_text = f"servo {servo} on {self.name} sent {count} bytes instead of {expected}"
            raise BusError(reason_text, servo=servo, reason="short")
        return Reply(bytes(packet[_PARAMETERS : _PARAMETERS + count]), bool(error & ALERT))

    def _receive_each(
        self, servos: Sequence[int], size: int
    ) -> tuple[dict[int, Reply], dict[int, BusError]]:
        """Receive one status packet per servo, in any order, within a common timeout."""
        replies: dict[int, Reply] = {}
        failures: dict[int, BusError] = {}
        while len(replies) + len(failures) < len(servos):
            packet, result = self._packets.rxPacket(self._port, False)
            if result != COMM_SUCCESS:
                error = self._failed(None, result)
                for servo in servos:
                    if servo not in replies:
                        failures.setdefault(
                            servo,
                            BusError(f"servo {servo}: {error}", servo=servo, reason=error.reason),
                        )
                break
            servo = packet[_ID]
            if servo not in servos or servo in replies:
                continue
            self._collect(
                servo, lambda s=servo, p=packet: self._parse(s, p, size), replies, failures
            )
        return replies, failures

    def _receive_fast(
        self, servos: Sequence[int], size: int
    ) -> tuple[dict[int, Reply], dict[int, BusError]]:
        """Receive one packet of (error, id, data, CRC) per servo; the last CRC covers all."""
        packet, result = self._packets.rxPacket(self._port, True)
        if result == COMM_SUCCESS and len(packet) != 8 + (size + 4) * len(servos):
            result = COMM_RX_CORRUPT
        if result != COMM_SUCCESS:
            error = self._failed(None, result)
            return {}, {
                s: BusError(f"servo {s}: {error}", servo=s, reason=error.reason) for s in servos
            }
        replies: dict[int, Reply] = {}
        failures: dict[int, BusError] = {}
        for index, servo in enumerate(servos):
            start = 8 + index * (size + 4)
            error = packet[start]
            found = packet[start + 1]
            status = [
                *packet[:5],
                (size + 4) & 0xFF,
                (size + 4) >> 8,
                0x55,
                error,
                *packet[start + 2 : start + 2 + size],
            ]
            if found != servo:
                failures[servo] = BusError(
                    f"servo {found} answered instead of servo {servo}",
                    servo=servo,
                    reason="corrupt",
                )
            else:
                self._collect(
                    servo, lambda s=servo, p=status: self._parse(s, p, size), replies, failures
                )
        return replies, failures

    @staticmethod
    def _collect(
        servo: int,
        parse: Callable[[], Reply],
        replies: dict[int, Reply],
        failures: dict[int, BusError],
    ) -> None:
        try:
            replies[servo] = parse()
        except BusError as error:
            failures[servo] = error

    def _failed(self, servo: int | None, result: int) -> BusError:
        device = f"servo {servo} on {self.name}" if servo is not None else f"bus {self.name}"
        if result == COMM_RX_TIMEOUT:
            return BusError(f"{device}: no reply", servo=servo, reason="no reply")
        if result == COMM_RX_CORRUPT:
            return BusError(
                f"{device}: broken reply (wrong CRC or cut off)", servo=servo, reason="corrupt"
            )
        text = self._packets.getTxRxResult(result).replace("[TxRxResult] ", "").rstrip("!.")
        return BusError(f"{device}: {text or result}", servo=servo, reason="lost")


def _bytes_of_word(value: int) -> tuple[int, int]:
    return value & 0xFF, value >> 8


def _one_line(error: BaseException) -> str:
    return " ".join(str(getattr(error, "strerror", None) or error).split())
