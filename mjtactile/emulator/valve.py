"""Firmware of an emulated valve board, in any of the three dialects, with a chamber behind each channel.

The supply reaches the chamber through a hose: its pressure follows the goal with a first-order lag. The board boots with
a banner when its port is opened, and vents all channels when it hears nothing for the heartbeat time.
"""

from __future__ import annotations

import math
import random
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

from mjtactile.emulator.faults import Faults
from mjtactile.emulator.pty_port import PtyPort

_BOOT_TIME = 0.15  # s from opening the port to the banner; commands before are lost
_LAG = 0.05  # s, time constant of hose and valve
_RELAY_SUPPLY = 1000.0  # Pa; what the emulated relay board's hose carries
_SENSOR_NOISE = 5.0  # Pa, sd


class Chambers(Protocol):
    """What the board moves: `connect` joins a chamber to a supply (Pa), `seal` closes it, `pressure` reads it."""

    def connect(self, channel: int, supply_gauge: float) -> None: ...
    def seal(self, channel: int) -> None: ...
    def pressure(self, channel: int) -> float: ...


@dataclass
class _Channel:
    state: str = "vent"  # open, closed, vent
    goal: float = 0.0
    supply: float = 0.0  # what the hose carries now
    limit: float = 5000.0


class ValveFirmware:
    """Understands one dialect. `tick` moves the pneumatics, `reply` answers a command line."""

    def __init__(self, dialect: str, chambers: Chambers, faults: Faults, channels: int = 2,
                 zeros: Mapping[int, float] = MappingProxyType({})):
        """`zeros` Pa: what each channel's pressure sensor shows at ambient pressure."""
        self._replies: Callable[[str], str] = {"ctrlp": self._ctrlp, "relay": self._relay, "regulator": self._regulator}[dialect]
        self._chambers, self._faults, self._zeros = chambers, faults, zeros
        self._regulates = dialect != "relay"  # by its own sensor, whose zero is then in the chamber
        self.channels = {number: _Channel() for number in range(1, channels + 1)}
        self.heartbeat = 0.0
        self.last_heard = time.monotonic()
        self.vent_time: float | None = None
        """When the heartbeat vented last (monotonic s), None if it did not."""
        self._is_silent = False
        self._rng = random.Random(1)
        self._lock = threading.RLock()

    def reset(self) -> None:
        with self._lock:
            for channel in self.channels.values():
                channel.state, channel.goal, channel.limit = "vent", 0.0, 5000.0
            self.heartbeat = 0.0

    def tick(self, now: float, period: float) -> None:
        """Advance by `period` s; vents when nothing was heard for the heartbeat time."""
        with self._lock:
            was_silent, self._is_silent = self._is_silent, 0 < self.heartbeat < now - self.last_heard
            if self._is_silent and not was_silent:  # the heartbeat stays armed: whoever speaks again is watched again
                self.vent_time = now
                for channel in self.channels.values():
                    channel.state, channel.goal = "vent", 0.0
            if self._faults.get("valve_stuck"):
                return
            for number, channel in self.channels.items():
                if channel.state == "closed":
                    self._chambers.seal(number)
                else:
                    zero = self._zeros.get(number, 0.0) if self._regulates and channel.state == "open" else 0.0
                    channel.supply += (channel.goal - zero - channel.supply) * min(1.0, period / _LAG)
                    self._chambers.connect(number, channel.supply)

    def reply(self, line: str, now: float) -> str | None:
        """The answer to one line, None for none."""
        with self._lock:
            self.last_heard = now
            if self._faults.get("valve_silent"):
                return None
            if self._faults.get("valve_garbage"):
                return "".join(chr(self._rng.randrange(33, 255)) for _ in range(12))
            try:
                return self._replies(line)
            except (KeyError, ValueError, IndexError):
                return None

    def _set(self, number: int, state: str, goal: float = 0.0) -> None:
        if not math.isfinite(goal):
            raise ValueError(goal)
        channel = self.channels[number]
        channel.state = state
        if state != "closed":
            channel.goal = goal

    def _pressure(self, number: int) -> float:
        return self._chambers.pressure(number) + self._zeros.get(number, 0.0) + self._rng.gauss(0.0, _SENSOR_NOISE)

    def _ctrlp(self, line: str) -> str:
        word, *arguments = line.split(";")
        number = int(arguments[0]) if arguments and arguments[0].isdigit() else 0
        if word == "version":
            return "version;ctrl-p;2.4"
        if word == "units":
            return line if arguments == ["kPa"] else "error;unknown unit"
        if word == "heartbeat":
            self.heartbeat = float(arguments[0]) * 1e-3
            return line
        if word == "maxp":
            self.channels[number].limit = 1e3 * float(arguments[1])
            return line
        if word == "set":
            goal = 1e3 * float(arguments[1])
            if goal > self.channels[number].limit:
                return "error;above maxp"
            self._set(number, "open", goal)
            return line
        if word in ("close", "vent"):
            self._set(number, {"close": "closed", "vent": "vent"}[word])
            return line
        if word == "read":
            return f"read;{number};{1e-3 * self._pressure(number):.3f};{self.channels[number].state}"
        return "error;unknown command"

    def _relay(self, line: str) -> str:
        if line == "V":
            return "V relay 1.2"
        if line.startswith("H "):
            self.heartbeat = float(line[2:]) * 1e-3
            return line
        number = int(line[1:].split()[0])
        if " " in line:
            state = {"S": "open", "C": "closed", "V": "vent"}[line[-1]]
            self._set(number, state, _RELAY_SUPPLY if state == "open" else 0.0)
            return line
        return f"{line} {dict(open='S', closed='C', vent='V')[self.channels[number].state]}"

    def _regulator(self, line: str) -> str:
        word, *arguments = line.split()
        if word == "ID?":
            return "ID regulator 3.1"
        if word == "UNIT":
            return line if arguments == ["mbar"] else "ERR unit"
        if word == "WD":
            self.heartbeat = float(arguments[0]) * 1e-3
            return line
        number = int(arguments[0])
        if word == "MAX":
            self.channels[number].limit = 100 * float(arguments[1])
        elif word == "SP":
            if 100 * float(arguments[1]) > self.channels[number].limit:
                return "ERR above MAX"
            self._set(number, "open", 100 * float(arguments[1]))
        elif word in ("CL", "VT"):
            self._set(number, {"CL": "closed", "VT": "vent"}[word])
        elif word == "PV":
            state = dict(open="O", closed="C", vent="V")[self.channels[number].state]
            return f"PV {number} {1e-2 * self._pressure(number):.2f} {state}"
        else:
            return "ERR unknown command"
        return line


class ValvePort:
    """The board's firmware on a pty: resets and boots when the port is opened."""

    _BANNERS = ("\r\nboot v1\r\n", "ready\r\n")

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
        self._boot_end = time.monotonic() + _BOOT_TIME
        self._timer = threading.Timer(_BOOT_TIME, lambda: self._port.write("".join(self._BANNERS).encode()))
        self._timer.daemon = True
        self._timer.start()

    def _receive(self, data: bytes) -> None:
        now = time.monotonic()
        if now < self._boot_end:
            return
        self._buffer += data
        while b"\n" in self._buffer:
            line, _, rest = self._buffer.partition(b"\n")
            self._buffer = bytearray(rest)
            reply = self.firmware.reply(line.decode("ascii", "replace").strip(), now)
            if reply is not None:
                self._port.write(reply.encode("latin-1", "replace") + b"\n")
        del self._buffer[:-200]
