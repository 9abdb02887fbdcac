"""`ValveBoard`: a board on a serial port: handshake, units, limits, read-back, heartbeat, and a vent on every way out.

A board that hears nothing for its heartbeat time vents by itself. The heartbeat is a thread of this process that reads
the pressures, but only while the control loop calls: a loop that hangs lets the board vent.
"""

from __future__ import annotations

import contextlib
import logging
import re
import termios
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import serial

from mjtactile.core.errors import DeviceError, InputError
from mjtactile.core.signals import deferred
from mjtactile.devices.valve.dialects import DIALECTS
from mjtactile.rig.file import ValveConfig

_log = logging.getLogger(__name__)
_HANDSHAKE_TIME = 4.0  # s; opening the port resets many boards, whose boot loader waits up to 2 s
_COMMAND_TIME = 0.15  # s for the answer to a command; USB adds 16 ms each way, a board's own loop up to 50 ms
_RETRY_TIME = 0.008  # s from a failed reading to the next try: longer than a burst of noise
_LATE_TIME = 0.05  # s to wait for the answer to a command that was given up
_LINE_LONGEST = 200  # bytes; a longer line is noise
_SILENCE = 5.0  # s without a call from the loop before the heartbeat is let die; references take 2 s between calls
_FAILURES_MAX = 3
_SURPRISE_SHARE = 0.05  # of the largest pressure: a change since the last reading that is asked for again
_CONFIRMATIONS_MAX = 8  # a chamber that fills in 50 ms may surprise several times in a row


@dataclass(frozen=True)
class ValveReading:
    """One answer of the board, with the monotonic time of the question, s."""

    is_open: bool
    pressure_gauge: float | None
    time: float


class ValveBoard:
    """One board with one or more channels. Raises DeviceError when it is not there, another one, or does not obey."""

    def __init__(self, configs: Sequence[ValveConfig]):
        first = configs[0]
        if first.dialect not in DIALECTS:
            raise InputError(f"{first.dialect!r} is unknown", field="valve.dialect", choices=DIALECTS)
        self.name, self.dialect = first.port, DIALECTS[first.dialect]
        self.firmware = ""
        self._configs = {config.channel: config for config in configs}
        self._lock = threading.RLock()
        self._closed = threading.Event()
        self._readings: dict[int, ValveReading] = {}
        self._failures, self._last_error = 0, ""
        self._unanswered = False  # the last command: its answer may still come
        self._last_call = time.monotonic()
        self._serial = _open_port(first.port, first.baud)
        self._interval = min(config.heartbeat for config in configs) / 8
        self._reply_time = max(config.reply_timeout for config in configs)
        self._thread = threading.Thread(target=self._beat, name="valve", daemon=True)
        try:
            self._handshake()
            self._set_up()
        except BaseException:
            self.close(quiet=True)
            raise
        self._thread.start()

    # -- what the valves use -------------------------------------------------------------------------------------

    def obey(self, template: str | None, channel: int, pressure: float | None = None) -> None:
        """Send a command and check that the board repeats it. Raises DeviceError when it does not."""
        assert template is not None
        text = self._fill(template, channel, pressure)
        with self._lock:
            self._last_call = time.monotonic()
            reply = self._ask(text)
            if reply != text:
                raise DeviceError(f"valve board {self.name}: {text!r} was answered with {reply!r}")
            self._read(channel)

    def reading(self, channel: int) -> ValveReading:
        """The heartbeat's newest reading, without waiting for the board. Raises DeviceError when it has been silent."""
        now, before = time.monotonic(), self._last_call
        if now - before > _SILENCE:  # the heartbeat had been let die
            return self.measure(channel)
        self._last_call, reading = now, self._readings[channel]
        if self._failures >= _FAILURES_MAX or now - reading.time > self._configs[channel].heartbeat:
            why = self._last_error or f"its last reading is {1e3 * (now - reading.time):.0f} ms old"
            raise DeviceError(f"valve board {self.name} is silent or broken: {why}")
        return reading

    def measure(self, channel: int) -> ValveReading:
        """Ask the board now. Raises DeviceError."""
        with self._lock:
            self._last_call = time.monotonic()
            return self._read(channel)

    def close(self, *, quiet: bool = False) -> None:
        """Vent every channel, also after one failed, then let go of the port. Raises DeviceError for what did not vent."""
        if self._closed.is_set():
            return
        self._closed.set()
        with deferred():
            self._finish(quiet)

    def _finish(self, quiet: bool) -> None:
        if self._thread.is_alive():
            self._thread.join()
        failed = [channel for channel in self._configs if not self._vent(channel)]
        with self._lock:
            self._serial.close()
        if failed:
            text = (f"valve board {self.name}: channel {', '.join(map(str, failed))} could not be vented; the board vents by "
                    "itself when it hears nothing")
            _log.error(text)
            if not quiet:
                raise DeviceError(text)

    # -- connecting ----------------------------------------------------------------------------------------------

    def _handshake(self) -> None:
        """Ask who it is until it says so or the deadline passes; its boot banner and a cut line are skipped."""
        deadline, heard = time.monotonic() + _HANDSHAKE_TIME, ""
        while time.monotonic() < deadline:
            with contextlib.suppress(DeviceError):
                heard = self._ask(self.dialect.identify)
            match = re.fullmatch(self.dialect.identity, heard)
            if match:
                self._check_version(match["version"])
                return
            time.sleep(0.02)
        what = f"it said {heard!r}" if heard else "it said nothing"
        raise DeviceError(f"valve board {self.name} does not answer as a {self.dialect.name} board within "
                          f"{_HANDSHAKE_TIME:g} s: {what}; are port, baud rate and dialect right?")

    def _check_version(self, version: str) -> None:
        self.firmware = version
        if tuple(int(part) for part in version.split(".")) < self.dialect.version_min:
            oldest = ".".join(map(str, self.dialect.version_min))
            raise DeviceError(f"valve board {self.name} has firmware {version}, needs {oldest} or newer")

    def _set_up(self) -> None:
        """Units, largest pressure of each channel, heartbeat; each is repeated by the board, or it is refused."""
        dialect = self.dialect
        if dialect.units:
            self._demand(dialect.units)
        for channel, config in self._configs.items():
            if dialect.limit:
                self._demand(self._fill(dialect.limit, channel, config.pressure_max))
            elif config.supply_gauge is None:
                raise InputError("missing: this board cannot regulate, so the file must say what its supply gives",
                                 field="valve.supply_kPa")
        heartbeat = min(config.heartbeat for config in self._configs.values())
        self._demand(dialect.heartbeat.format(ms=round(1e3 * heartbeat)))
        for channel in self._configs:
            self._read(channel)

    def _demand(self, text: str) -> None:
        reply = self._ask(text)
        if reply != text:
            raise DeviceError(f"valve board {self.name} did not take {text!r}: it answered {reply!r}")

    def _fill(self, template: str, channel: int, pressure: float | None) -> str:
        value = "" if pressure is None else f"{pressure / self.dialect.unit:.{self.dialect.decimals}f}"
        return template.format(channel=channel, pressure=value)

    # -- talking -------------------------------------------------------------------------------------------------

    def _ask(self, text: str, patience: float = _COMMAND_TIME) -> str:
        """One command, one reply line within `patience` s. Raises DeviceError."""
        with self._lock:
            try:
                if self._unanswered:  # a late answer would pass for the one to this
                    with contextlib.suppress(DeviceError):
                        self._line(_LATE_TIME)
                self._serial.reset_input_buffer()
                self._unanswered = True
                self._serial.write(text.encode("ascii") + b"\n")
                line = self._line(patience)
                self._unanswered = False
            except (serial.SerialException, OSError, termios.error, TypeError) as error:  # TypeError: a closed port
                raise DeviceError(f"valve port {self.name} is lost: {error}") from error
        reason = re.fullmatch(self.dialect.error, line)
        if reason:
            raise DeviceError(f"valve board {self.name} refuses {text!r}: {reason['reason']}")
        return line

    def _line(self, patience: float) -> str:
        data, asked = bytearray(), time.monotonic()
        while not data.endswith(b"\n"):
            byte = self._serial.read(1)  # the port's time-out is short; a line has 20 bytes
            data += byte
            waited = time.monotonic() - asked
            if waited > patience and (not byte or waited > 2 * patience):  # what has come is read: this thread may be late
                raise DeviceError(f"valve board {self.name}: no reply" if not data else f"valve board {self.name}: reply cut off")
            if len(data) > _LINE_LONGEST:
                raise DeviceError(f"valve board {self.name}: noise instead of a reply")
        try:
            return data.decode("ascii").strip()
        except UnicodeDecodeError as error:
            raise DeviceError(f"valve board {self.name}: noise instead of a reply") from error

    def _read(self, channel: int, patience: float = _COMMAND_TIME) -> ValveReading:
        """One reading. These lines have no checksum: what surprises must be said twice. Raises DeviceError."""
        before, reading = self._readings.get(channel), self._ask_reading(channel, patience)
        for _ in range(_CONFIRMATIONS_MAX):
            if before is not None and self._agree(channel, before, reading):
                break
            before, reading = reading, self._ask_reading(channel, patience)
        else:
            raise DeviceError(f"valve board {self.name}: answers that contradict each other")
        self._readings[channel] = reading
        self._failures = 0
        return reading

    def _agree(self, channel: int, before: ValveReading, reading: ValveReading) -> bool:
        if reading.is_open != before.is_open:
            return False
        if reading.pressure_gauge is None or before.pressure_gauge is None:
            return reading.pressure_gauge == before.pressure_gauge
        most = _SURPRISE_SHARE * self._configs[channel].pressure_max
        return abs(reading.pressure_gauge - before.pressure_gauge) <= most

    def _ask_reading(self, channel: int, patience: float) -> ValveReading:
        asked = time.monotonic()  # the board measures after this, so that a reading is never thought younger than it is
        line = self._ask(self.dialect.read.format(channel=channel), patience)
        match = re.fullmatch(self.dialect.reading.replace("{channel}", str(channel)), line)
        if match is None:
            raise DeviceError(f"valve board {self.name}: unreadable answer {line[:60]!r}")
        pressure = match.groupdict().get("pressure")
        gauge = None if pressure is None else float(pressure) * self.dialect.unit
        return ValveReading(self.dialect.states[match["state"]], gauge, asked)

    def _beat(self) -> None:
        """The heartbeat: read all channels while the loop lives."""
        while not self._closed.wait(_RETRY_TIME if 0 < self._failures < _FAILURES_MAX else self._interval):
            if time.monotonic() - self._last_call > _SILENCE:
                continue
            for channel in self._configs:
                try:
                    with self._lock:
                        self._read(channel, self._reply_time)
                except DeviceError as error:
                    self._failures, self._last_error = self._failures + 1, str(error)

    def _vent(self, channel: int) -> bool:
        text = self.dialect.vent.format(channel=channel)
        for _ in range(3):
            try:
                if self._ask(text) == text:
                    return True
            except Exception:  # noqa: BLE001  # whatever it is, the next channel must still be vented
                _log.debug("vent failed", exc_info=True)
        return False


def _open_port(port: str, baud: int) -> serial.SerialBase:
    """Open a device or a pyserial URL (`socket://`, `rfc2217://`, `spy://`), alone where that can be had."""
    options: dict[str, Any] = {} if "://" in port else {"exclusive": True}
    try:
        return serial.serial_for_url(port, baudrate=baud, timeout=0.01, write_timeout=0.2, **options)
    except (serial.SerialException, OSError, ValueError) as error:
        raise DeviceError(f"valve port {port} cannot be opened: {' '.join(str(error).split())}") from error
