"""Servos on one pty: reads instruction packets, lets each servo act, answers after the time that wire and USB take."""

from __future__ import annotations

import termios
import time
from collections.abc import Callable, Mapping

from mjtactile.emulator import protocol2 as p2
from mjtactile.emulator.faults import Faults
from mjtactile.emulator.pty_port import PtyPort
from mjtactile.emulator.servo import CRC_ERROR, INSTRUCTION_ERROR, LENGTH_ERROR, EmulatedServo

_BAUDS = (9600, 57600, 115200, 1_000_000, 2_000_000, 3_000_000, 4_000_000)
_TERMIOS_BAUD = {getattr(termios, f"B{baud}"): baud for baud in _BAUDS}


class ServoBus:
    """`usb_latency` s of the adapter's latency timer on each answer; `on_packet(time, instruction)` sees every packet."""

    def __init__(self, servos: Mapping[int, EmulatedServo], faults: Faults, *, baud: int = 1_000_000,
                 usb_latency: float = 1e-3, on_packet: Callable[[float, p2.Instruction], None] | None = None):
        self._servos, self._faults, self._baud, self._usb_latency = servos, faults, baud, usb_latency
        self._on_packet = on_packet
        self._decoder = p2.Decoder()
        self._pending: dict[int, tuple[int, bytes]] = {}  # reg write, waiting for action
        self._port = PtyPort(self._receive, "servo bus")
        self.path = self._port.path

    def close(self) -> None:
        self._port.close()

    def is_busy(self) -> bool:
        """Bytes have arrived that nobody has looked at yet: that this process is slow is no silence of the host."""
        return self._port.has_input

    def _receive(self, data: bytes) -> None:
        if _TERMIOS_BAUD.get(self._port.baud) != self._baud:
            return  # another baud rate: the servos hear noise
        now = time.monotonic()
        for packet in self._decoder.feed(data):
            if self._on_packet is not None:
                self._on_packet(now, packet)
            answer = self.answer(packet, now)
            if answer:
                self._send(answer, len(data))

    def answer(self, packet: p2.Instruction, now: float) -> bytes:
        """What the servos reply to one packet, b"" for nothing."""
        awake = {i: s for i, s in self._servos.items() if not s.is_silent(now) and self._faults.get("servo_silent") != i}
        for servo in awake.values():
            servo.last_packet = now
        if packet.code == p2.SYNC_READ:
            return self._sync_read(packet.parameters, awake)
        if packet.code == p2.FAST_SYNC_READ:
            return self._fast_sync_read(packet.parameters, awake)
        if packet.code in (p2.SYNC_WRITE, p2.BULK_WRITE, p2.BULK_READ):
            return self._group(packet, awake)
        if packet.servo == p2.BROADCAST:
            return self._broadcast(packet, awake, now)
        servo = awake.get(packet.servo)
        if servo is None:
            return b""
        error, data = self._single(servo, packet, now)
        return self._status(servo, error, data)

    def _single(self, servo: EmulatedServo, packet: p2.Instruction, now: float) -> tuple[int, bytes]:  # one row an instruction
        parameters = packet.parameters
        if not packet.intact:
            return CRC_ERROR, b""
        if packet.code == p2.PING:
            return 0, servo.get("Model Number").to_bytes(2, "little") + bytes([servo.get("Firmware Version")])
        if packet.code == p2.READ:
            return servo.read(*_two_words(parameters)) if len(parameters) == 4 else (LENGTH_ERROR, b"")
        if packet.code == p2.WRITE:
            if len(parameters) < 3:
                return LENGTH_ERROR, b""
            return servo.write(int.from_bytes(parameters[:2], "little"), parameters[2:]), b""
        if packet.code == p2.REG_WRITE:
            self._pending[servo.id] = int.from_bytes(parameters[:2], "little"), parameters[2:]
            return 0, b""
        if packet.code == p2.ACTION:
            address, data = self._pending.pop(servo.id, (0, b""))
            return (servo.write(address, data) if data else 0), b""
        if packet.code == p2.REBOOT:
            servo.reboot(now)
            return 0, b""
        if packet.code == p2.CLEAR:
            return 0, b""
        return INSTRUCTION_ERROR, b""

    def _broadcast(self, packet: p2.Instruction, awake: Mapping[int, EmulatedServo], now: float) -> bytes:
        answer = b""
        for servo in awake.values():
            error, data = self._single(servo, packet, now)
            if packet.code == p2.PING:
                answer += self._status(servo, error, data)
        return answer

    def _sync_read(self, parameters: bytes, awake: Mapping[int, EmulatedServo]) -> bytes:
        """Each servo answers when the one before it has; the first that is silent ends it."""
        address, size = _two_words(parameters[:4])
        answer = b""
        for servo_id in parameters[4:]:
            servo = awake.get(servo_id)
            part = self._status(servo, *servo.read(address, size)) if servo else b""
            if not part:
                break
            answer += part
        return answer

    def _fast_sync_read(self, parameters: bytes, awake: Mapping[int, EmulatedServo]) -> bytes:
        address, size = _two_words(parameters[:4])
        if self._faults.strikes("servo_drop") or any(i not in awake for i in parameters[4:]):
            return b""
        parts = []
        for servo_id in parameters[4:]:
            error, data = awake[servo_id].read(address, size)
            parts.append((servo_id, error | awake[servo_id].alert, data))
        return p2.fast_status(parts)

    def _group(self, packet: p2.Instruction, awake: Mapping[int, EmulatedServo]) -> bytes:
        """Sync write, bulk write (no answer) and bulk read. A broken one is ignored as a whole."""
        parameters, answer = packet.parameters, b""
        if not packet.intact:
            return b""
        if packet.code == p2.SYNC_WRITE:
            address, size = _two_words(parameters[:4])
            for start in range(4, len(parameters) - size, size + 1):
                servo = awake.get(parameters[start])
                if servo is not None:
                    servo.write(address, parameters[start + 1 : start + 1 + size])
            return b""
        place = 0
        while place + 5 <= len(parameters):
            servo = awake.get(parameters[place])
            address, size = _two_words(parameters[place + 1 : place + 5])
            place += 5
            if packet.code == p2.BULK_READ:
                answer += self._status(servo, *servo.read(address, size)) if servo else b""
            else:
                if servo is not None:
                    servo.write(address, parameters[place : place + size])
                place += size
        return answer

    def _status(self, servo: EmulatedServo, error: int, data: bytes) -> bytes:
        if self._faults.strikes("servo_drop"):
            return b""
        if self._faults.strikes("servo_short"):
            data = data[:-1]
        return p2.status(servo.id, error | servo.alert, data)

    def _send(self, answer: bytes, received: int) -> None:
        """Wait as long as wire, return delay and USB take; a pty has none of these."""
        delay = (received + len(answer)) * 10 / self._baud + self._usb_latency
        delay += 2e-6 * next(iter(self._servos.values())).get("Return Delay Time") + self._faults.get("servo_late")
        if self._faults.strikes("servo_corrupt"):
            place = self._faults.rng.randrange(len(answer))
            changed = answer[place] ^ (1 << self._faults.rng.randrange(8))
            answer = answer[:place] + bytes([changed]) + answer[place + 1 :]
        time.sleep(delay)
        self._port.write(answer)


def _two_words(parameters: bytes) -> tuple[int, int]:
    return int.from_bytes(parameters[:2], "little"), int.from_bytes(parameters[2:4], "little")
