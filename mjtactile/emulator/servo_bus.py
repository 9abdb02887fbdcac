"""Servos on one pty: decode instruction packets, execute them, reply after wire and USB delay.

Instructions follow https://emanual.robotis.com/docs/en/dxl/protocol2/, "Instruction Details".
Quotes are from that page.
"""

from __future__ import annotations

import termios
from collections.abc import Callable, Mapping, Sequence

from mjtactile.core import scaled_clock
from mjtactile.emulator import protocol2 as p2
from mjtactile.emulator.control_table import BAUDS
from mjtactile.emulator.faults import Faults
from mjtactile.emulator.pty_port import PtyPort
from mjtactile.emulator.registers import CRC_ERROR, INSTRUCTION_ERROR, LENGTH_ERROR
from mjtactile.emulator.servo import EmulatedServo

_TERMIOS_BAUD = {
    getattr(termios, f"B{baud}"): baud for baud in BAUDS if hasattr(termios, f"B{baud}")
}
_CLEAR = bytes((0x01, 0x44, 0x58, 0x4C, 0x22))  # "Clear", fixed values
_BACKUP = bytes((0x43, 0x54, 0x52, 0x4C))  # "Control Table Backup", fixed values
# the "Status Return Level" from which an instruction is answered; others: 2
_REPORTED_AT = {p2.PING: 0, p2.READ: 1}


class ServoBus:
    """Servos on a bus; each answer is delayed by the adapter's latency timer, `usb_latency` s.

    `on_packet(time, instruction)` receives every packet.
    """

    def __init__(
        self,
        servos: Mapping[int, EmulatedServo],
        faults: Faults,
        *,
        usb_latency: float = 1e-3,
        on_packet: Callable[[float, p2.Instruction], None] | None = None,
    ):
        self._servos = servos
        self._faults = faults
        self._usb_latency = usb_latency
        self._on_packet = on_packet
        self._decoder = p2.Decoder()
        self._port = PtyPort(self._receive, "servo bus")
        self.path = self._port.path

    def close(self) -> None:
        self._port.close()

    def is_busy(self) -> bool:
        """Return True if received bytes are not processed yet: the host is not silent."""
        return self._port.has_input

    def _receive(self, data: bytes) -> None:
        baud = _TERMIOS_BAUD.get(self._port.baud)
        if baud is None or all(servo.baud != baud for servo in self._servos.values()):
            return  # another baud rate: the servos receive noise
        now = scaled_clock.monotonic()
        for packet in self._decoder.feed(data):
            if self._on_packet is not None:
                self._on_packet(now, packet)
            answer = self.answer(packet, now, baud)
            if answer:
                self._send(answer, len(data), baud)

    def answer(self, packet: p2.Instruction, now: float, baud: int | None = None) -> bytes:
        """Return the servos' reply to a packet, or b""; `baud` None: all receive it."""
        silent_id = int(self._faults.get("servo_silent")) or None
        awake = [
            s
            for s in self._servos.values()
            if not s.is_silent(now) and s.id != silent_id and baud in (None, s.baud)
        ]
        for servo in awake:
            servo.last_packet = now
        if packet.code in _GROUPS:
            if packet.intact:
                return _GROUPS[packet.code](self, packet.parameters, awake)
            return b""
        if packet.servo == p2.BROADCAST:
            return self._broadcast(packet, awake, now) if packet.intact else b""
        answer = b"".join(
            self._single(servo, packet, now) for servo in awake if servo.id == packet.servo
        )
        for servo in awake:
            if (
                servo.secondary_id == packet.servo != servo.id
                and packet.intact
                and packet.code == p2.WRITE
            ):
                # "the Status Packet will not be returned"
                servo.write(*_write_block(packet.parameters), ram_only=True)
        return answer

    def _single(self, servo: EmulatedServo, packet: p2.Instruction, now: float) -> bytes:
        """Execute a packet and answer with the old id; a new id applies from the next packet on."""
        sender = servo.id
        level = servo.get("Status Return Level")
        error, data = _execute(servo, packet, now) if packet.intact else (CRC_ERROR, b"")
        if level < _REPORTED_AT.get(packet.code, 2):
            return b""
        return self._status(servo, error, data, sender)

    def _broadcast(
        self, packet: p2.Instruction, awake: Sequence[EmulatedServo], now: float
    ) -> bytes:
        """Execute a broadcast instruction on all servos.

        Only a ping is answered, "according to their arranged order". A reset of everything is
        ignored: "Factory Reset Instruction(0x06) will NOT be activated" for all ids together.
        """
        if packet.code == p2.FACTORY_RESET and packet.parameters[:1] == b"\xff":
            return b""
        answer = b""
        for servo in sorted(awake, key=lambda s: s.id):
            error, data = _execute(servo, packet, now)
            answer += self._status(servo, error, data) if packet.code == p2.PING else b""
        return answer

    # -- several servos in one packet; a broken one is ignored as a whole

    def _sync_read(self, parameters: bytes, awake: Sequence[EmulatedServo]) -> bytes:
        return self._read_each(_same_block(parameters), awake)

    def _bulk_read(self, parameters: bytes, awake: Sequence[EmulatedServo]) -> bytes:
        return self._read_each(_own_blocks(parameters), awake)

    def _read_each(
        self, blocks: Sequence[tuple[int, int, int]], awake: Sequence[EmulatedServo]
    ) -> bytes:
        """Return the status packets of all servos; a missing one sends none.

        "Each device individually returns Status Packet".
        """
        answer = b""
        for servo_id, address, size in blocks:
            for servo in awake:
                if servo.id == servo_id and servo.get("Status Return Level") >= 1:
                    answer += self._status(servo, *servo.read(address, size))
        return answer

    def _fast_sync_read(self, parameters: bytes, awake: Sequence[EmulatedServo]) -> bytes:
        return self._read_fast(_same_block(parameters), awake)

    def _fast_bulk_read(self, parameters: bytes, awake: Sequence[EmulatedServo]) -> bytes:
        return self._read_fast(_own_blocks(parameters), awake)

    def _read_fast(
        self, blocks: Sequence[tuple[int, int, int]], awake: Sequence[EmulatedServo]
    ) -> bytes:
        """Return one packet of each servo's part; it ends at the first missing servo."""
        by_id = {servo.id: servo for servo in awake}
        if self._faults.occurs("servo_drop"):
            return b""
        parts = []
        lengths = []
        for servo_id, address, size in blocks:
            lengths.append(size)
            servo = by_id.get(servo_id)
            if servo is None or len(parts) < len(lengths) - 1:
                continue
            error, data = servo.read(address, size)
            parts.append((servo_id, error | servo.alert, data.ljust(size, b"\0")))
        return p2.fast_status(parts, sum(lengths) + 4 * len(lengths)) if parts else b""

    def _sync_write(self, parameters: bytes, awake: Sequence[EmulatedServo]) -> bytes:
        address, size = _two_registers(parameters[:4])
        for start in range(4, len(parameters) - size, size + 1):
            for servo in awake:
                if servo.id == parameters[start]:
                    servo.write(address, parameters[start + 1 : start + 1 + size])
        return b""

    def _bulk_write(self, parameters: bytes, awake: Sequence[EmulatedServo]) -> bytes:
        offset = 0
        while offset + 5 <= len(parameters):
            address, size = _two_registers(parameters[offset + 1 : offset + 5])
            for servo in awake:
                if servo.id == parameters[offset]:
                    servo.write(address, parameters[offset + 5 : offset + 5 + size])
            offset += 5 + size
        return b""

    def _status(
        self, servo: EmulatedServo, error: int, data: bytes, sender: int | None = None
    ) -> bytes:
        if self._faults.occurs("servo_drop"):
            return b""
        if self._faults.occurs("servo_short"):
            data = data[:-1]
        return p2.status(servo.id if sender is None else sender, error | servo.alert, data)

    def _send(self, answer: bytes, received: int, baud: int) -> None:
        """Wait as long as wire, return delay and USB take; a pty has none of these."""
        delay = (received + len(answer)) * 10 / baud + self._usb_latency
        delay += 2e-6 * next(iter(self._servos.values())).get(
            "Return Delay Time"
        ) + self._faults.get("servo_late")
        if self._faults.occurs("servo_corrupt"):
            index = self._faults.rng.randrange(len(answer))
            changed = answer[index] ^ (1 << self._faults.rng.randrange(8))
            answer = answer[:index] + bytes([changed]) + answer[index + 1 :]
        scaled_clock.sleep(delay)
        self._port.write(answer)


_GROUPS: Mapping[int, Callable[[ServoBus, bytes, Sequence[EmulatedServo]], bytes]] = {
    p2.SYNC_READ: ServoBus._sync_read,
    p2.FAST_SYNC_READ: ServoBus._fast_sync_read,
    p2.SYNC_WRITE: ServoBus._sync_write,
    p2.BULK_READ: ServoBus._bulk_read,
    p2.FAST_BULK_READ: ServoBus._fast_bulk_read,
    p2.BULK_WRITE: ServoBus._bulk_write,
}


def _execute(servo: EmulatedServo, packet: p2.Instruction, now: float) -> tuple[int, bytes]:
    """Execute one instruction. Return error number and data of its status."""
    act = _INSTRUCTIONS.get(packet.code)
    if act is None:
        return INSTRUCTION_ERROR, b""
    result = act(servo, packet.parameters, now)
    return result if isinstance(result, tuple) else (result, b"")


def _ping(servo: EmulatedServo, parameters: bytes, now: float) -> tuple[int, bytes]:
    return 0, servo.get("Model Number").to_bytes(2, "little") + bytes(
        [servo.get("Firmware Version")]
    )


def _read(servo: EmulatedServo, parameters: bytes, now: float) -> tuple[int, bytes]:
    if len(parameters) == 4:
        return servo.read(*_two_registers(parameters))
    return (LENGTH_ERROR, b"")


def _reboot(servo: EmulatedServo, parameters: bytes, now: float) -> int:
    servo.reboot(now)
    return 0


def _reset(servo: EmulatedServo, parameters: bytes, now: float) -> int:
    return servo.factory_reset(parameters[0], now) if len(parameters) == 1 else LENGTH_ERROR


def _clear(servo: EmulatedServo, parameters: bytes, now: float) -> int:
    return servo.clear() if parameters == _CLEAR else INSTRUCTION_ERROR


def _back_up(servo: EmulatedServo, parameters: bytes, now: float) -> int:
    return servo.back_up(parameters[0], now) if parameters[1:] == _BACKUP else INSTRUCTION_ERROR


_INSTRUCTIONS: Mapping[int, Callable[[EmulatedServo, bytes, float], tuple[int, bytes] | int]] = {
    p2.PING: _ping,
    p2.READ: _read,
    p2.REBOOT: _reboot,
    p2.FACTORY_RESET: _reset,
    p2.CLEAR: _clear,
    p2.BACKUP: _back_up,
    p2.WRITE: lambda servo, parameters, now: servo.write(*_write_block(parameters)),
    p2.REG_WRITE: lambda servo, parameters, now: servo.register(*_write_block(parameters)),
    p2.ACTION: lambda servo, parameters, now: servo.act(),
}


def _write_block(parameters: bytes) -> tuple[int, bytes]:
    return int.from_bytes(parameters[:2], "little"), parameters[2:]


def _same_block(parameters: bytes) -> list[tuple[int, int, int]]:
    address, size = _two_registers(parameters[:4])
    return [(servo, address, size) for servo in parameters[4:]]


def _own_blocks(parameters: bytes) -> list[tuple[int, int, int]]:
    return [
        (parameters[i], *_two_registers(parameters[i + 1 : i + 5]))
        for i in range(0, len(parameters) - 4, 5)
    ]


def _two_registers(parameters: bytes) -> tuple[int, int]:
    return int.from_bytes(parameters[:2], "little"), int.from_bytes(parameters[2:4], "little")
