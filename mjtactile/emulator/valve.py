"""Emulated valve board with a chamber behind each channel.

It implements the language and the rules of firmware/valve/README.md. Its code, including the CRC,
is independent of that firmware and of the driver. Tests therefore detect a mistake in one of them.
The supply reaches the chamber through a hose. The chamber pressure follows the goal with a
first-order lag. The board prints a banner when its port is opened, like many real boards.
"""

from __future__ import annotations

import random
import re
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

from mjtactile.core import scaled_clock
from mjtactile.emulator.faults import Faults
from mjtactile.emulator.pty_port import PtyPort

_BOOT_TIME = 0.15  # time from opening the port to the banner, s; earlier commands are lost
_LAG = 0.05  # time constant of hose and valve, s
_SLOW_LAG = 2.0  # time constant of a slightly opened outlet, s
_SUPPLY = 1000.0  # hose pressure of a board without sensors, Pa
_SENSOR_NOISE = 5.0  # standard deviation, Pa
_MAX = 6000  # pressure limit of the board, Pa
_BEAT = (20, 60000)  # ms
_HOLD = (0, 600000)  # ms
_READINGS_TO_TRIP = 3  # consecutive samples that make a fault
_SAMPLE = 0.005  # sample period, s
_LONGEST = 80  # bytes of a line


def _divide(crc: int) -> int:
    for _ in range(8):
        crc = crc >> 1 ^ (0xEDB88320 if crc & 1 else 0)
    return crc


_TABLE = [_divide(byte) for byte in range(256)]


def crc32(data: bytes) -> int:
    """Compute the CRC-32 of IEEE 802.3: reflected, start value and final complement 0xFFFFFFFF.

    The polynomial is 0x04C11DB7.
    """
    crc = 0xFFFFFFFF
    for byte in data:
        crc = crc >> 8 ^ _TABLE[(crc ^ byte) & 0xFF]
    return crc ^ 0xFFFFFFFF


def framed(body: str) -> bytes:
    """Return a line with its checksum and its end, as sent."""
    data = body.encode("ascii")
    return data + f"*{crc32(data):08X}\n".encode("ascii")


def unframed(line: bytes) -> str | None:
    """Return the content of a line without its end; None for a damaged line."""
    body, star, crc = line.rpartition(b"*")
    if (
        not star
        or len(line) > _LONGEST
        or re.fullmatch(rb"[0-9A-F]{8}", crc) is None
        or crc32(body) != int(crc, 16)
    ):
        return None
    return body.decode("ascii") if all(0x20 <= byte <= 0x7E for byte in body) else None


class Chambers(Protocol):
    """Chambers driven by the board: connected to a supply (Pa), sealed, measured."""

    def connect(self, channel: int, supply_gauge: float) -> None: ...
    def seal(self, channel: int) -> None: ...
    def pressure(self, channel: int) -> float: ...


@dataclass
class _Channel:
    state: str = "vent"  # vent, set, sealed
    fault: str = "start"  # ok, start, silent, sensor, pressure
    goal: float = 0.0
    supply: float = 0.0  # current hose pressure
    limit: int = 0
    sensor_failures: int = 0
    pressure_excesses: int = 0
    slow: bool = False  # it vents slowly

    def trip(self, fault: str) -> None:
        """Vent, and refuse pressure until the host has vented the channel as well."""
        self.state = "vent"
        self.slow = False
        self.goal = 0.0
        self.fault = fault

    def vent(self) -> None:
        self.trip("ok")
        self.sensor_failures = self.pressure_excesses = 0


class ValveFirmware:
    """Firmware of the board: `tick` advances the pneumatics, `reply` answers a line.

    `zeros` are the sensor readings at ambient pressure, Pa. `sensors` False is a board of relays on
    a supply of 1 kPa.
    """

    def __init__(
        self,
        chambers: Chambers,
        faults: Faults,
        channels: int = 2,
        *,
        zeros: Mapping[int, float] = MappingProxyType({}),
        sensors: bool = True,
    ):
        self._chambers = chambers
        self._faults = faults
        self._zeros = zeros
        self._sensors = sensors
        self.channels = {number: _Channel() for number in range(1, channels + 1)}
        self.heartbeat = 0.0
        self.hold = 0.0
        self.last_heard = scaled_clock.monotonic()
        self.vent_time: float | None = None
        """Time of the last vent by the heartbeat (monotonic), s; None without one."""
        self._since_sample = 0.0
        self._rng = random.Random(1)
        self._lock = threading.RLock()

    def reset(self) -> None:
        """Restart the firmware: all channels are vented and all state is lost."""
        with self._lock:
            for number, channel in self.channels.items():
                self.channels[number] = _Channel(supply=channel.supply)
            self.heartbeat = 0.0
            self.hold = 0.0

    def tick(self, now: float, period: float) -> None:
        """Advance by `period` s; vent on a missing heartbeat, failed sensor or high pressure."""
        with self._lock:
            if self._faults.get("valve_restart"):
                self._faults.set("valve_restart", 0)
                self.reset()
            # the heartbeat stays armed: it also monitors a host that returns
            if 0 < self.heartbeat < now - self.last_heard:
                self._handle_missing_host(now)
            self._since_sample += period
            if self._since_sample >= _SAMPLE:
                self._since_sample = 0.0
                self._check_limits()
            if not self._faults.get("valve_stuck"):
                self._move_pressures(period)

    def _handle_missing_host(self, now: float) -> None:
        """Seal the chambers while the host is late; vent them once the host is lost."""
        for number, channel in self.channels.items():
            if channel.state == "vent":
                continue
            if now - self.last_heard <= self.heartbeat + self.hold:
                channel.state = "sealed"
                continue
            if channel.state == "sealed" and self.hold:
                channel.supply = self._chambers.pressure(number)
            channel.trip("silent")
            channel.slow = self.hold > 0
            self.vent_time = now

    def _check_limits(self) -> None:
        """Trip channels with a failed sensor or an excessive pressure."""
        for number, channel in self.channels.items() if self._sensors else ():
            failed = bool(self._faults.get("valve_sensor"))
            high = channel.state != "vent" and self._pressure(number) > channel.limit * 1.25 + 200
            channel.sensor_failures = channel.sensor_failures + 1 if failed else 0
            channel.pressure_excesses = channel.pressure_excesses + 1 if high and not failed else 0
            if channel.sensor_failures >= _READINGS_TO_TRIP:
                channel.trip("sensor")
            elif channel.pressure_excesses >= _READINGS_TO_TRIP:
                channel.trip("pressure")

    def _move_pressures(self, period: float) -> None:
        for number, channel in self.channels.items():
            if channel.state == "sealed":
                self._chambers.seal(number)
                continue
            goal = channel.goal
            # it regulates by its own sensor, whose zero is then in the chamber
            if channel.state == "set":
                goal = goal - self._zeros.get(number, 0.0) if self._sensors else _SUPPLY
            lag = _SLOW_LAG if channel.slow else _LAG
            channel.supply += (goal - channel.supply) * min(1.0, period / lag)
            self._chambers.connect(number, channel.supply)

    def reply(self, line: bytes, now: float) -> bytes | None:
        """Return the answer to one line without its end; None: no answer."""
        with self._lock:
            body = unframed(line)
            if body is None or self._faults.get("valve_silent"):
                return None
            sequence, _, command = body.partition(" ")
            if re.fullmatch(r"\d{1,6}", sequence) is None or not command:
                return None
            self.last_heard = now
            if self._faults.get("valve_garbage"):
                return self._rng.randbytes(12).replace(b"\n", b"?") + b"\n"
            return framed(f"{sequence} {self._execute(command)}")

    def _execute(self, command: str) -> str:
        """Execute a command; return it as the confirmation, or an error."""
        word, *arguments = command.split()
        if any(re.fullmatch(r"\d{1,6}", argument) is None for argument in arguments):
            return "error number"
        parsed = [int(argument) for argument in arguments]
        if word == "id" and not parsed:
            return f"id mjvalve 1.1 {len(self.channels)} {int(self._sensors)} {_MAX}"
        if word == "beat" and len(parsed) == 1:
            if not _BEAT[0] <= parsed[0] <= _BEAT[1]:
                return "error range"
            self.heartbeat = 1e-3 * parsed[0]
            return f"beat {parsed[0]}"
        if word == "hold" and len(parsed) == 1:
            if not _HOLD[0] <= parsed[0] <= _HOLD[1]:
                return "error range"
            self.hold = 1e-3 * parsed[0]
            return f"hold {parsed[0]}"
        requested = {"limit": 2, "set": 2, "seal": 1, "vent": 1, "state": 1}.get(word)
        if not parsed or requested != len(parsed):
            return "error unknown"
        if parsed[0] not in self.channels:
            return "error channel"
        return (
            self._execute_for_channel(word, self.channels[parsed[0]], *parsed)
            or f"{word} {' '.join(map(str, parsed))}"
        )

    def _execute_for_channel(
        self, word: str, channel: _Channel, channel_number: int, value: int = 0
    ) -> str | None:
        """Execute a command of a channel; return its answer, or None for a repetition of the
        command."""
        if word == "state":
            is_finite_value = self._sensors and not self._faults.get("valve_sensor")
            pressure = str(round(self._pressure(channel_number))) if is_finite_value else "-"
            return f"state {channel_number} {channel.state} {pressure} {channel.fault}"
        if word == "vent":
            channel.vent()
            return None
        if word == "limit":
            if not 1 <= value <= _MAX:
                return "error limit"
            channel.limit = value
            return None
        if not self.heartbeat:
            return "error beat"
        if channel.fault != "ok":
            return "error fault"
        if word == "set" and value > channel.limit:
            return "error limit"
        if word == "set" and channel.state == "sealed":
            channel.supply = self._chambers.pressure(
                channel_number
            )  # the hose between the two valves
        channel.state = "set" if word == "set" else "sealed"
        channel.goal = float(value) if word == "set" else channel.goal
        return None

    def _pressure(self, number: int) -> float:
        return (
            self._chambers.pressure(number)
            + self._zeros.get(number, 0.0)
            + self._rng.gauss(0.0, _SENSOR_NOISE)
        )


class ValvePort:
    """The board's firmware on a pty: resets and boots when the port is opened."""

    _BANNER = b"\r\nboot v1\r\nready\r\n"

    def __init__(self, firmware: ValveFirmware):
        self.firmware = firmware
        self._buffer = bytearray()
        self._boot_end = 0.0
        self._timer: threading.Timer | None = None
        self._port = PtyPort(self._receive, "valve", on_open=self._reset)
        self.path = self._port.path

    def close(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer.join()
        self._port.close()

    def _reset(self) -> None:
        self.firmware.reset()
        self._buffer.clear()
        self._boot_end = scaled_clock.monotonic() + _BOOT_TIME
        self._timer = threading.Timer(
            scaled_clock.wall(_BOOT_TIME), lambda: self._port.write(self._BANNER)
        )
        self._timer.daemon = True
        self._timer.start()

    def _receive(self, data: bytes) -> None:
        now = scaled_clock.monotonic()
        if now < self._boot_end:
            return
        self._buffer += data
        while b"\n" in self._buffer:
            line, _, rest = self._buffer.partition(b"\n")
            self._buffer = bytearray(rest)
            reply = self.firmware.reply(bytes(line), now)
            if reply is not None:
                self._port.write(reply)
        del self._buffer[:-200]
