"""Bad bytes for the servo's and the valve's drivers, through their real ports: an adversary sits at the other end of a pty.

It answers each question with noise, with headers in noise, or with a true answer that was damaged; now and then with the
true one. What a driver accepts is compared with the truth. The servo protocol has a CRC; the valve's lines have none, so
that there a reading counts as wrong when it is off by more than the driver says it can tell (5 % of the largest pressure).
"""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from typing import Any

from mjtactile.core.errors import DeviceError
from mjtactile.devices.dynamixel.bus import BusError, DynamixelBus
from mjtactile.devices.valve.driver import ValveBoard
from mjtactile.emulator import protocol2 as p2
from mjtactile.emulator.pty_port import PtyPort
from mjtactile.rig.file import ValveConfig

SERVOS, START, SIZE = (1, 2), 126, 21
_TRUE_SHARE = 0.05  # of the answers: a driver that accepted nothing at all would be no use
_PRESSURE, _MAX = 1000.0, 3000.0


class Adversary:
    """Answers on a pty; `fed` counts the bad bytes. `answer(rng, data)` gives the bytes and whether they are bad."""

    def __init__(self, answer: Callable[[random.Random, bytes], tuple[bytes, bool]], seed: int):
        self._rng, self._answer, self.fed = random.Random(seed), answer, 0
        self.port = PtyPort(self._reply, "adversary")

    def _reply(self, data: bytes) -> None:
        answer, is_bad = self._answer(self._rng, data)
        self.fed += len(answer) if is_bad else 0
        self.port.write(answer)


def damage(rng: random.Random, data: bytes) -> bytes:
    """Flip bits, lose, repeat, insert or cut bytes: one to three of these. Never returns `data` itself."""
    result = bytearray(data)
    for _ in range(rng.randrange(1, 4)):
        place, kind = rng.randrange(len(result)), rng.randrange(5)
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
    """What servo `servo` truly holds in the block."""
    return bytes((17 * servo + 5 * i) % 251 for i in range(SIZE))


def servo_answer(rng: random.Random, question: bytes) -> tuple[bytes, bool]:
    """An answer of two servos to a sync read: true, or bad in one of the ways a bus goes bad."""
    packets = [p2.status(servo, 0, payload(servo)) for servo in SERVOS]
    if rng.random() < _TRUE_SHARE:
        return b"".join(packets), False
    kind = rng.randrange(6)
    if kind == 0:
        return bytes(rng.randrange(256) for _ in range(rng.randrange(1, 400))), True
    if kind == 1:  # what looks like headers
        return bytes(rng.choice((0xFF, 0xFF, 0xFD, 0x00, 0x01, 0x55, rng.randrange(256))) for _ in range(200)), True
    if kind == 2:  # an intact packet of the wrong length, servo or instruction
        data = payload(rng.choice(SERVOS))[: rng.randrange(SIZE)]
        return p2.status(rng.choice((*SERVOS, 7, 253)), rng.randrange(128), data), True
    if kind == 3:  # a header that promises more than comes
        return p2.HEADER + bytes([rng.choice(SERVOS)]) + rng.randrange(1, 1 << 16).to_bytes(2, "little") + rng.randbytes(60), True
    if kind == 4:  # packets cut into each other
        cut = rng.randrange(1, len(packets[0]))
        return packets[0][:cut] + packets[1][cut // 2 :] + packets[0][cut:], True
    return b"".join(damage(rng, packet) for packet in packets) * rng.randrange(1, 8), True


def fuzz_servos(count: int, seed: int = 0) -> dict[str, Any]:
    """`count` bad bytes to the servo bus; how many replies were accepted, how many of them wrong, the longest call in s."""
    adversary = Adversary(servo_answer, seed)
    bus = DynamixelBus(adversary.port.path, reply_timeout=0.002)
    tally: dict[str, Any] = {"bytes": 0, "calls": 0, "true": 0, "wrong": 0, "refused": 0, "longest_s": 0.0}
    try:
        while adversary.fed < count:
            begin = time.monotonic()
            try:
                replies, failures = bus.read_many(SERVOS, START, SIZE)
            except BusError as error:
                if error.reason == "lost":
                    raise
                replies, failures = {}, dict.fromkeys(SERVOS, error)
            tally["longest_s"] = max(tally["longest_s"], time.monotonic() - begin)
            tally["calls"] += 1
            tally["refused"] += len(failures)
            for servo, reply in replies.items():
                tally["true" if reply.data == payload(servo) else "wrong"] += 1
    finally:
        bus.close()
        adversary.port.close()
    return tally | {"bytes": adversary.fed}


class ValveAdversary:
    """A ctrlp board that is honest until `bad` is set."""

    def __init__(self) -> None:
        self.bad = False

    def __call__(self, rng: random.Random, question: bytes) -> tuple[bytes, bool]:
        line = question.decode("ascii", "replace").strip()
        honest = {"version": "version;ctrl-p;2.4"}.get(line, line)
        if line.startswith("read"):
            honest = f"read;1;{1e-3 * _PRESSURE:.3f};closed"
        true = honest.encode() + b"\n"
        if not self.bad or rng.random() < _TRUE_SHARE:
            return true, False
        kind = rng.randrange(4)
        if kind == 0:
            return rng.randbytes(rng.randrange(1, 2000)) + b"\n", True
        if kind == 1:
            alphabet = b"read;1.0239-openclosdvt\n"
            return bytes(rng.choice(alphabet) for _ in range(rng.randrange(1, 120))) + b"\n", True
        if kind == 2:  # a line without end, or only an end
            return rng.choice((b"r" * 400, b"\n\n\n\n", b"read;1;")) + b"\n", True
        return damage(rng, true), True


def fuzz_valve(count: int, seed: int = 0) -> dict[str, Any]:
    """The same to a valve board's driver."""
    answers = ValveAdversary()
    adversary = Adversary(answers, seed)
    board = ValveBoard([ValveConfig("left", adversary.port.path, heartbeat=30.0, pressure_max=_MAX)])
    tally: dict[str, Any] = {"bytes": 0, "calls": 0, "true": 0, "wrong": 0, "refused": 0, "longest_s": 0.0}
    answers.bad = True
    try:
        while adversary.fed < count:
            begin = time.monotonic()
            tally["calls"] += 1
            try:
                reading = board.measure(1)
            except DeviceError:
                tally["refused"] += 1
                continue
            finally:
                tally["longest_s"] = max(tally["longest_s"], time.monotonic() - begin)
            off = abs((reading.pressure_gauge or 0.0) - _PRESSURE)
            tally["wrong" if reading.is_open or off > 0.05 * _MAX else "true"] += 1
    finally:
        answers.bad = False
        board.close(quiet=True)
        adversary.port.close()
    return tally | {"bytes": adversary.fed}
