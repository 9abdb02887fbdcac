"""Discovery of connected devices, for `mjtactile devices`. It only sends queries: no setting
changes and no device moves."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import serial
from serial.tools import list_ports

from mjtactile.core import scaled_clock
from mjtactile.core.errors import DeviceError
from mjtactile.devices.dynamixel.bus import BusError, DynamixelBus
from mjtactile.devices.dynamixel.servo_models import MODEL_BY_NUMBER, NO_CURRENT_CONTROL
from mjtactile.devices.valve import protocol
from mjtactile.devices.valve.board import open_port

BAUDS = (57600, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 115200)
"""Baud rates of Dynamixel servos: the factory setting first, then those that users choose."""
VALVE_BAUD = 115200
IDS = range(21)
_BOOT_TIME = 2.5  # time for the board to boot, s; opening the port resets many boards
_REPLY_TIME = 0.02  # reply timeout of a servo, s, for an adapter with the default latency timer


@dataclass(frozen=True)
class SerialPort:
    """Serial port with its most stable `path` for opening it, and the computer's description of it.

    `servos` are the models of the responding servos by id, at `baud`; `board` is the responding
    valve board. `problem` is the reason why the port could not be queried.
    """

    path: str
    device: str
    description: str
    serial: str
    baud: int = 0
    servos: Mapping[int, str] = field(default_factory=dict)
    board: str = ""
    problem: str = ""

    @property
    def answers(self) -> tuple[str, ...]:
        """Description of the responding devices."""
        servos = (
            f"servo {servo_id}: {model}, {self.baud} baud"
            for servo_id, model in self.servos.items()
        )
        return (*servos, *([f"valve board: {self.board}"] if self.board else []))


def serial_ports(
    more: Iterable[str] = (), *, ask: bool = True, notify: Callable[[str], None] = lambda _: None
) -> list[SerialPort]:
    """Return all serial ports of this computer.

    Args:
        more: Additional ports to check.
        ask: True to query the devices on them, which takes some seconds each. A built-in port,
            which may be a console, is queried only if `more` names it.
        notify: Called with a message before each query.

    Returns:
        The computer's own by name, then the other ports of `more`.
    """
    named = list(more)
    found = []
    for port in sorted(list_ports.comports(), key=lambda port: port.device):
        path = _stable_path(port.device)
        known = SerialPort(path, port.device, port.description or "", port.serial_number or "")
        if not ask:
            found.append(known)
        elif port.vid is None and port.device not in named:
            found.append(replace(known, problem=f"built in: queried only with --port {path}"))
        else:
            found.append(_identify(known, notify))
    present = {port.device for port in found}
    others = [SerialPort(path, path, "named", "") for path in named if path not in present]
    return found + [_identify(port, notify) if ask else port for port in others]


def servos_at(
    port: str, bauds: Iterable[int] | None = None, *, reply_time: float | None = None
) -> tuple[int, Mapping[int, str]]:
    """Return the first baud rate at which servos answer, and their models by id, or (0, {})."""
    for baud in bauds or BAUDS:
        bus = DynamixelBus(port, baud, reply_timeout=reply_time or _REPLY_TIME)
        try:
            found = {servo: model for servo in IDS if (model := _model_name(bus, servo))}
            if found:  # a reply may be lost
                found |= {
                    servo: model
                    for servo in IDS
                    if servo not in found and (model := _model_name(bus, servo))
                }
                return baud, dict(sorted(found.items()))
        finally:
            bus.close()
    return 0, {}


def valve_board_at(port: str) -> str:
    """Return the self-description of the valve board at a port; "" without an answer."""
    line = open_port(port, VALVE_BAUD)
    received = bytearray()
    try:
        deadline = scaled_clock.monotonic() + _BOOT_TIME
        while scaled_clock.monotonic() < deadline:
            line.write(protocol.encode(0, "id"))
            received += line.read(64)
            *lines, rest = received.split(b"\n")
            received = bytearray(rest[-protocol.LONGEST :])
            for answer in (protocol.decode(bytes(each).rstrip(b"\r")) for each in lines):
                words = answer[1].split() if answer else []
                if words[:2] == ["id", protocol.NAME] and len(words) == 6:
                    sensors = "with" if words[4] == "1" else "without"
                    return f"{words[1]} {words[2]}, {words[3]} channels, {sensors} pressure sensors"
            scaled_clock.sleep(0.02)
        return ""
    except (serial.SerialException, OSError) as error:
        raise DeviceError(f"{port} went away: {' '.join(str(error).split())}") from error
    finally:
        line.close()


def _identify(port: SerialPort, notify: Callable[[str], None]) -> SerialPort:
    notify(f"{port.path}: searching for servos and a valve board")
    try:
        baud, servos = servos_at(port.path) if "://" not in port.path else (0, {})
        return replace(
            port, baud=baud, servos=servos, board="" if servos else valve_board_at(port.path)
        )
    except DeviceError as error:
        return replace(port, problem=str(error))


def _model_name(bus: DynamixelBus, servo: int) -> str:
    """Return the model's name; "" without an answer."""
    try:
        model_number, _ = bus.ping(servo)
    except BusError as error:
        if error.reason == "lost":
            raise
        return ""
    known = MODEL_BY_NUMBER.get(model_number)
    return known.name if known else NO_CURRENT_CONTROL.get(model_number, f"model {model_number}")


def _stable_path(device: str) -> str:
    with contextlib.suppress(OSError):
        for link in sorted(Path("/dev/serial/by-id").glob("*")):
            if link.resolve() == Path(device).resolve():
                return str(link)
    return device
