"""`ValveBoard`: a board on a serial port: handshake, limits, heartbeat, and a vent on every exit.

A board without a message during its heartbeat time vents by itself. The heartbeat is a thread of
this process that reads the pressures, but only while the control loop calls. If the loop hangs, the
board vents.
"""

from __future__ import annotations

import contextlib
import logging
import re
import termios
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import serial

from mjtactile.core import scaled_clock
from mjtactile.core.errors import DeviceError, InputError
from mjtactile.core.signals import deferred
from mjtactile.devices.serial_write import write
from mjtactile.devices.valve import protocol
from mjtactile.rig.file import ValveConfig

_log = logging.getLogger(__name__)
# handshake timeout, s; opening the port resets many boards, whose boot loader waits up to 2 s
_HANDSHAKE_TIME = 4.0
# minimum timeout of a command's answer, s; USB adds 16 ms in each direction, a board's own loop up
# to 50 ms
_COMMAND_TIME = 0.15
_COMMAND_FRACTION = 5  # factor on the rig file's reply time-out, where that is longer
_ATTEMPTS = 2
# time from a failed reading to the next attempt, s: longer than a burst of noise
_RETRY_TIME = 0.008
# write timeout, s: pySerial counts time in which the computer was suspended, even after a complete
# write
_WRITE_TIME = 0.5
# maximum time without a call from the loop before the heartbeat stops, s; references take 2 s
# between calls
_SILENCE = 5.0
_FAILURES_MAX = 3
_T = TypeVar("_T")


@dataclass(frozen=True)
class ValveReading:
    """Reply of the board and its request time, s; `fault`: why it vented by itself, or ""."""

    is_open: bool
    gauge_pressure: float | None
    time: float
    fault: str = ""


class ValveBoard:
    """One board with one or more channels.

    Chambers stay sealed for `hold` s beyond the heartbeat's time, and then vent slowly. Raises
    DeviceError for a missing, different or unresponsive board.
    """

    def __init__(self, configs: Sequence[ValveConfig], hold: float = 0.0):
        first = configs[0]
        self._hold = hold
        self.name = first.port
        self.firmware = ""
        self.has_sensors = True
        self._configs = {config.channel: config for config in configs}
        self._lock = threading.RLock()
        self._closed = scaled_clock.Event()
        self._wake = (
            scaled_clock.Event()
        )  # the heartbeat's thread has something to do before its time
        self._readings: dict[int, ValveReading] = {}
        # pressure setpoints of the channels, Pa (None: sealed), and those sent to the board
        self._aims: dict[int, int | None] = {}
        self._sent: dict[int, int | None] = {}
        self._sequence = 0
        self._received = bytearray()
        self._failures = 0
        self._last_error = ""
        self._last_call = scaled_clock.monotonic()
        self._serial = open_port(first.port, first.baud)
        self._interval = min(config.heartbeat for config in configs) / 8
        self._reply_time = max(config.reply_timeout for config in configs)
        self._command_time = max(_COMMAND_TIME, _COMMAND_FRACTION * self._reply_time)
        self._thread = threading.Thread(target=self._heartbeat_loop, name="valve", daemon=True)
        try:
            self._handshake()
            self._set_up()
        except BaseException:
            self.close(quiet=True)
            raise
        self._thread.start()

    # -- interface for the valves

    def set(self, channel: int, pressure: float) -> None:
        """Regulate to `pressure`, Pa; without a sensor, open to the supply. Raises DeviceError."""
        self._clear_setpoint(channel)
        self._command(f"set {channel} {round(pressure)}", channel)

    def seal(self, channel: int) -> None:
        """Close both valves. Raises DeviceError if the board does not confirm."""
        self._clear_setpoint(channel)
        self._command(f"seal {channel}", channel)

    def vent(self, channel: int) -> None:
        """Open to the air, which also acknowledges a fault. Raises DeviceError."""
        self._clear_setpoint(channel)
        self._command(f"vent {channel}", channel)

    def aim(self, channel: int, pressure: float | None) -> None:
        """Set the pressure, Pa, that the board shall maintain in a channel; None: seal it, if it
        was maintained.

        The heartbeat's thread sends it; the call does not wait.
        """
        if pressure is not None:
            self._aims[channel] = round(pressure)
        elif channel in self._aims:
            self._aims[channel] = None
        if self._has_setpoint(channel):
            return
        self._last_call = scaled_clock.monotonic()
        self._wake.set()

    def reading(self, channel: int) -> ValveReading:
        """Return the heartbeat's newest reading without waiting. Raises DeviceError."""
        now = scaled_clock.monotonic()
        if now - self._last_call > _SILENCE:  # the heartbeat was stopped
            return self.measure(channel)
        self._last_call = now
        reading = self._readings[channel]
        if self._failures >= _FAILURES_MAX or now - reading.time > self._configs[channel].heartbeat:
            why = self._last_error or f"its last reading is {1e3 * (now - reading.time):.0f} ms old"
            raise DeviceError(f"valve board {self.name} is silent or broken: {why}")
        return reading

    def measure(self, channel: int, timeout: float | None = None) -> ValveReading:
        """Query the board within `timeout` s (None: a command's time)."""
        with self._lock:
            self._last_call = scaled_clock.monotonic()
            return self._with_retry(lambda: self._read(channel, timeout))

    def close(self, *, quiet: bool = False) -> None:
        """Vent every channel, even after a failure, and release the port."""
        if self._closed.is_set():
            return
        self._closed.set()
        self._wake.set()
        with deferred():
            self._finish(quiet)

    def _finish(self, quiet: bool) -> None:
        if self._thread.is_alive():
            self._thread.join()
        failed = [channel for channel in self._configs if not self._vented(channel)]
        with self._lock:
            self._serial.close()
        if failed:
            text = (
                f"valve board {self.name}: channel {', '.join(map(str, failed))} could not be "
                "vented; the board vents by itself when the host is silent"
            )
            _log.error(text)
            if not quiet:
                raise DeviceError(text)

    # -- connecting --------------------------------------------------------------------------------

    def _handshake(self) -> None:
        """Query the board's identity until it answers or the deadline passes. Its boot banner and
        incomplete lines are skipped."""
        deadline = scaled_clock.monotonic() + _HANDSHAKE_TIME
        heard = ""
        while scaled_clock.monotonic() < deadline:
            with contextlib.suppress(DeviceError):
                heard = self._ask("id")
            match = re.fullmatch(rf"id {protocol.NAME} (\d+\.\d+) (\d+) ([01]) (\d+)", heard)
            if match:
                self._check(match[1], int(match[2]), float(match[4]))
                self.has_sensors = match[3] == "1"
                return
            scaled_clock.sleep(0.02)
        answer = f"it answered {heard!r}" if heard else "its answer was not readable"
        raise DeviceError(
            f"valve board {self.name} does not answer as {protocol.NAME} within "
            f"{_HANDSHAKE_TIME:g} s: {answer}; "
            "are port and baud rate right, is firmware/valve on it?"
        )

    def _check(self, version: str, channels: int, maximum: float) -> None:
        self.firmware = version
        needed = protocol.HOLD_VERSION if self._hold else protocol.VERSION_MIN
        if self._version < needed:
            oldest = ".".join(map(str, needed))
            purpose = " to keep the chambers sealed when the host is lost" if self._hold else ""
            raise DeviceError(
                f"valve board {self.name} has firmware {version}, needs {oldest} or newer{purpose}"
            )
        for channel, config in self._configs.items():
            if channel > channels:
                raise InputError(
                    f"{channel} does not exist: the board has {channels} channels",
                    field="valve.channel",
                )
            if config.pressure_max > maximum:
                raise InputError(
                    f"{config.pressure_max / 1e3:g} exceeds the board's limit of {maximum / 1e3:g}",
                    field="valve.pressure_max_kPa",
                )

    def _set_up(self) -> None:
        """Vent, and set the maximum pressure of each channel and the heartbeat.

        The board repeats each setting; otherwise it is refused.
        """
        for channel, config in self._configs.items():
            if not self.has_sensors and config.supply_gauge is None:
                raise InputError(
                    "missing: this board has no sensors, so the file must give its supply pressure",
                    field="valve.supply_kPa",
                )
            self._command_echoed(f"vent {channel}")  # also acknowledges an earlier fault
            self._command_echoed(f"limit {channel} {round(config.pressure_max)}")
        self._command_echoed(
            f"beat {round(1e3 * min(config.heartbeat for config in self._configs.values()))}"
        )
        if self._version >= protocol.HOLD_VERSION:
            self._command_echoed(f"hold {round(1e3 * self._hold)}")
        for channel in self._configs:
            self._read(channel)

    @property
    def _version(self) -> tuple[int, ...]:
        return tuple(int(part) for part in self.firmware.split("."))

    # -- talking --------------------------------------------------------------------------------

    def _command(self, text: str, channel: int) -> None:
        with self._lock:
            self._last_call = scaled_clock.monotonic()
            self._command_echoed(text)
            self._read(channel)

    def _command_echoed(self, text: str) -> None:
        """Send a command and check that the board repeats it. Raises DeviceError."""
        reply = self._with_retry(lambda: self._ask(text))
        if reply != text:
            raise DeviceError(f"valve board {self.name}: {text!r} was answered with {reply!r}")

    @staticmethod
    def _with_retry(act: Callable[[], _T]) -> _T:
        """Repeat a command if no reply arrives. A command received twice has the same effect."""
        for _ in range(_ATTEMPTS - 1):
            with contextlib.suppress(_NoReply):
                return act()
        return act()

    def _ask(self, text: str, timeout: float | None = None) -> str:
        """Send a command and return the text of the answer. Raises DeviceError.

        It waits for `timeout` s (None: a command's time).
        """
        with self._lock:
            self._sequence = (self._sequence + 1) % protocol.SEQUENCES
            try:
                write(self._serial, protocol.encode(self._sequence, text))
                reply = self._answer(self._command_time if timeout is None else timeout)
            except (serial.SerialException, OSError, termios.error, TypeError) as error:
                # TypeError: a closed port
                raise DeviceError(f"valve port {self.name} is lost: {error}") from error
        if reply.startswith("error "):
            raise DeviceError(
                f"valve board {self.name} refuses {text!r}: {reply.removeprefix('error ')}"
            )
        return reply

    def _answer(self, timeout: float) -> str:
        """Return the line with the number of the last command.

        Damaged lines and late replies to other commands are skipped.
        """
        requested = scaled_clock.monotonic()
        damaged = 0
        while True:
            while (end := self._received.find(b"\n")) >= 0:
                line = bytes(self._received[:end]).rstrip(b"\r")
                del self._received[: end + 1]
                found = protocol.decode(line)
                if found is not None and found[0] == self._sequence:
                    return found[1]
                damaged += found is None and bool(line)
            del self._received[: -2 * protocol.LONGEST]  # noise without an end
            # the port's time-out is short
            waiting = self._serial.in_waiting  # pyright: ignore[reportAttributeAccessIssue]
            data = self._serial.read(max(1, waiting))
            self._received += data
            waited = scaled_clock.monotonic() - requested
            # received data is read first: this thread may be late
            if waited > timeout and (not data or waited > 2 * timeout):
                raise _NoReply(
                    f"valve board {self.name}: "
                    f"{'only noise' if damaged or self._received else 'no reply'}"
                )

    def _read(self, channel: int, timeout: float | None = None) -> ValveReading:
        # the board measures after this, so that the reported age is an upper bound
        requested = scaled_clock.monotonic()
        reply = self._ask(f"state {channel}", timeout)
        match = re.fullmatch(
            rf"state {channel} ({'|'.join(protocol.STATES)}) (-?\d+|-) "
            rf"({'|'.join(protocol.FAULTS)})",
            reply,
        )
        if match is None:
            raise DeviceError(f"valve board {self.name}: unreadable answer {reply[:60]!r}")
        gauge = None if match[2] == "-" or not self.has_sensors else float(match[2])
        reading = ValveReading(
            protocol.STATES[match[1]], gauge, requested, protocol.FAULTS[match[3]]
        )
        self._readings[channel] = reading
        self._failures = 0
        return reading

    def _heartbeat_loop(self) -> None:
        """Read all channels repeatedly while the control loop calls."""
        while not self._closed.is_set():
            self._wake.wait(_RETRY_TIME if 0 < self._failures < _FAILURES_MAX else self._interval)
            self._wake.clear()
            if self._closed.is_set():
                return
            if scaled_clock.monotonic() - self._last_call > _SILENCE:
                continue
            for channel in self._configs:
                try:
                    with self._lock:
                        self._send_aim(channel)
                        self._read(channel, self._reply_time)
                except DeviceError as error:
                    self._failures = self._failures + 1
                    self._last_error = str(error)

    def _send_aim(self, channel: int) -> None:
        """Send the pressure setpoint of a channel, unless the board has it already."""
        if self._has_setpoint(channel):
            return
        pressure = self._aims[channel]
        self._command_echoed(f"seal {channel}" if pressure is None else f"set {channel} {pressure}")
        self._sent[channel] = pressure

    def _has_setpoint(self, channel: int) -> bool:
        return channel not in self._aims or self._sent.get(channel, ...) == self._aims[channel]

    def _clear_setpoint(self, channel: int) -> None:
        """Delete the pressure setpoint of a channel, since a direct command replaces it."""
        with self._lock:
            self._aims.pop(channel, None)
            self._sent.pop(channel, None)

    def _vented(self, channel: int) -> bool:
        for _ in range(_ATTEMPTS):
            try:
                self._command_echoed(f"vent {channel}")
                return True
            except Exception:  # noqa: BLE001
                # after any error, the next channel must still be vented
                _log.debug("vent failed", exc_info=True)
        return False


class _NoReply(DeviceError):
    """Missing reply: the command may or may not have been received."""


def open_port(port: str, baud: int) -> serial.SerialBase:
    """Open a device or a pyserial URL (`socket://`, `rfc2217://`), exclusively if possible."""
    options: dict[str, Any] = {} if "://" in port else {"exclusive": True}
    try:
        return serial.serial_for_url(
            port,
            baudrate=baud,
            timeout=0.01,
            write_timeout=scaled_clock.wall(_WRITE_TIME),
            **options,
        )
    except (serial.SerialException, OSError, ValueError) as error:
        raise DeviceError(
            f"valve port {port} cannot be opened: {' '.join(str(error).split())}"
        ) from error
