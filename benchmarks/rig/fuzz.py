"""Corrupted bytes for the drivers of servo and valve, through their real ports.

An adversary at the other end of a pty answers each question. The answer is noise, headers in noise,
a damaged true answer, or sometimes the true one. Answers that a driver accepts are compared with
ground truth. Of random frames a servo's CRC-16 passes 1 in 65536, a valve's CRC-32 1 in 4 10^9.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

from mjtactile.core import scaled_clock
from mjtactile.core.errors import DeviceError
from mjtactile.devices.dynamixel.bus import BusError, DynamixelBus
from mjtactile.devices.valve.driver import ValveBoard
from mjtactile.emulator import protocol2 as p2
from mjtactile.emulator import valve
from mjtactile.emulator.pty_port import PtyPort
from mjtactile.rig.file import ValveConfig

SERVOS = (1, 2)
START = 126
SIZE = 21
_TRUE_FRACTION = 0.05  # fraction of true answers: a driver that accepts none would be useless
_PRESSURE = 1000
_MAX = 3000.0
_PATIENCE = 0.004  # timeout of an answer, s: most of them are none


class Adversary:
    """Peer on a pty that sends answers; `fed` counts the bad bytes.

    `answer(rng, data)` returns the bytes, and True if they are bad.
    """

    def __init__(self, answer: Callable[[random.Random, bytes], tuple[bytes, bool]], seed: int):
        self._rng = random.Random(seed)
        self._answer = answer
        self.fed = 0
        self.port = PtyPort(self._reply, "adversary")

    def _reply(self, data: bytes) -> None:
        answer, is_bad = self._answer(self._rng, data)
        self.fed += len(answer) if is_bad else 0
        self.port.write(answer)


def damage(rng: random.Random, data: bytes) -> bytes:
    """Flip bits, lose, repeat, insert or cut bytes: one to three of these.

    The result always differs from `data`.
    """
    result = bytearray(data)
    for _ in range(rng.randrange(1, 4)):
        place = rng.randrange(len(result))
        kind = rng.randrange(5)
        if kind == 0:
            result[place] ^= 1 << rng.randrange(8)
        elif kind == 1 and len(result) > 1:
            del result[place]
        elif kind == 2:
            result.insert(place, rng.randrange(256))
        elif kind == 3:
            result[place:place] = result[place : place + 4]
        elif len(result) > 1:
            del result[max(1, place) :]
    return bytes(result) if bytes(result) != data else damage(rng, data)


def payload(servo: int) -> bytes:
    """Return the true content of the block of servo `servo`."""
    return bytes((17 * servo + 5 * i) % 251 for i in range(SIZE))


def servo_answer(rng: random.Random, question: bytes) -> tuple[bytes, bool]:
    """Return an answer of two servos to a sync read: true, or with one kind of bus error."""
    packets = [p2.status(servo, 0, payload(servo)) for servo in SERVOS]
    if rng.random() < _TRUE_FRACTION:
        return b"".join(packets), False
    kind = rng.randrange(6)
    if kind == 0:
        return bytes(rng.randrange(256) for _ in range(rng.randrange(1, 400))), True
    if kind == 1:  # header-like bytes
        return bytes(
            rng.choice((0xFF, 0xFF, 0xFD, 0x00, 0x01, 0x55, rng.randrange(256))) for _ in range(200)
        ), True
    if kind == 2:  # an intact packet of the wrong length, servo or instruction
        data = payload(rng.choice(SERVOS))[: rng.randrange(SIZE)]
        return p2.status(rng.choice((*SERVOS, 7, 253)), rng.randrange(128), data), True
    if kind == 3:  # a header with a larger length than the packet
        return p2.HEADER + bytes([rng.choice(SERVOS)]) + rng.randrange(1, 1 << 16).to_bytes(
            2, "little"
        ) + rng.randbytes(60), True
    if kind == 4:  # interleaved packets
        cut = rng.randrange(1, len(packets[0]))
        return packets[0][:cut] + packets[1][cut // 2 :] + packets[0][cut:], True
    return b"".join(damage(rng, packet) for packet in packets) * rng.randrange(1, 8), True


def fuzz_servos(count: int, seed: int = 0) -> dict[str, Any]:
    """Send `count` bad bytes to the servo bus driver.

    Returns:
        Counts of accepted, wrong and refused replies, and the longest call, s.
    """
    adversary = Adversary(servo_answer, seed)
    bus = DynamixelBus(adversary.port.path, reply_timeout=0.002)
    # reject bad bytes, not a computer that is busy for 0.1 s
    bus._port.ser.write_timeout = 10.0
    tally: dict[str, Any] = {
        "bytes": 0,
        "calls": 0,
        "true": 0,
        "wrong": 0,
        "refused": 0,
        "longest_s": 0.0,
    }
    try:
        while adversary.fed < count:
            start = scaled_clock.monotonic()
            try:
                replies, failures = bus.read_many(SERVOS, START, SIZE)
            except BusError as error:
                if error.reason == "lost":
                    raise
                replies = {}
                failures = dict.fromkeys(SERVOS, error)
            tally["longest_s"] = max(tally["longest_s"], scaled_clock.monotonic() - start)
            tally["calls"] += 1
            tally["refused"] += len(failures)
            for servo, reply in replies.items():
                tally["true" if reply.data == payload(servo) else "wrong"] += 1
    finally:
        bus.close()
        adversary.port.close()
    return tally | {"bytes": adversary.fed}


class ValveAdversary:
    """A valve board that answers correctly until `bad` is set."""

    def __init__(self) -> None:
        self.bad = False

    def __call__(self, rng: random.Random, question: bytes) -> tuple[bytes, bool]:
        number, _, text = question.partition(b"*")[0].decode("ascii", "replace").partition(" ")
        answer = {"id": "id mjvalve 1.0 2 1 6000", "state 1": f"state 1 sealed {_PRESSURE} ok"}.get(
            text, text
        )
        true = valve.framed(f"{number} {answer}")
        if not self.bad or rng.random() < _TRUE_FRACTION:
            return true, False
        kind = rng.randrange(5)
        if kind == 0:
            return rng.randbytes(rng.randrange(1, 2000)) + b"\n", True
        if kind == 1:
            alphabet = b"state 1023479*ABCDEF-sealdok\n"
            return bytes(rng.choice(alphabet) for _ in range(rng.randrange(1, 120))) + b"\n", True
        if kind == 2:  # a line without end, or only an end
            return rng.choice((b"r" * 400, b"\n\n\n\n", b"1 state 1 ")) + b"\n", True
        if kind == 3:  # intact, but the answer to another command
            return valve.framed(
                f"{(int(number) + rng.randrange(1, 65536)) % 65536} state 1 set "
                f"{rng.randrange(6000)} ok"
            ), True
        bad = damage(rng, true)
        return (bad, True) if true.strip() not in bad else self(rng, question)


def fuzz_valve(count: int, seed: int = 0) -> dict[str, Any]:
    """Send `count` bad bytes to the driver of a valve board; see `fuzz_servos`."""
    answers = ValveAdversary()
    adversary = Adversary(answers, seed)
    board = ValveBoard(
        [ValveConfig("left", adversary.port.path, heartbeat=30.0, pressure_max=_MAX)]
    )
    tally: dict[str, Any] = {
        "bytes": 0,
        "calls": 0,
        "true": 0,
        "wrong": 0,
        "refused": 0,
        "longest_s": 0.0,
    }
    answers.bad = True
    try:
        while adversary.fed < count:
            start = scaled_clock.monotonic()
            tally["calls"] += 1
            try:
                reading = board.measure(1, _PATIENCE)
            except DeviceError:
                tally["refused"] += 1
                continue
            finally:
                tally["longest_s"] = max(tally["longest_s"], scaled_clock.monotonic() - start)
            tally[
                "wrong"
                if reading.is_open or reading.fault or reading.gauge_pressure != _PRESSURE
                else "true"
            ] += 1
    finally:
        answers.bad = False
        board.close(quiet=True)
        adversary.port.close()
    return tally | {"bytes": adversary.fed}
