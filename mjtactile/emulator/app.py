"""Process of the emulator: `python -m mjtactile.emulator.app`.

`mjtactile.emulator.process` starts it. It reads its options from the first line of stdin. When it
is ready, it prints one JSON line (`servo`, `valve`: pty paths; `cameras`: addresses; `pid`). Then
it processes JSON lines on stdin: `{"fault": KIND, "value": X}`, `{"ask": "truth"}`, `{"stop":
true}`. It answers each with one JSON line. It ends when its stdin closes, so that it never outlives
its parent.
"""

from __future__ import annotations

import json
import os
import sys
from typing import Any, TextIO

from mjtactile.core import platform_support, process, scaled_clock
from mjtactile.core.errors import InputError, MjtactileError
from mjtactile.emulator.faults import KINDS, Faults
from mjtactile.emulator.hardware import EmulatedHardware
from mjtactile.emulator.options import EmulatorOptions
from mjtactile.emulator.shared_memory import FROM_WORLD, SharedState

_STOP_TIME = 3.0  # time for the world's process to end in order, s


class WorldProcess:
    """The process of `mjtactile.emulator.world`. Raises InputError or DeviceError when it does not
    start."""

    def __init__(self, options: str):
        descriptor = platform_support.memory_file("mjtactile-emulator")
        self.shared = SharedState(descriptor)
        self._process = process.start(
            "mjtactile.emulator.world", descriptor, descriptors=[descriptor], talk=True
        )
        os.close(descriptor)
        try:
            answer = process.ask(self._process, options, "the emulated world")
            self.cameras: dict[str, str] = answer["cameras"]
            self.simulated: dict[str, Any] = answer["simulated"]
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        process.stop(self._process, _STOP_TIME)


class Emulator:
    """World and devices together."""

    def __init__(self, line: str):
        options = EmulatorOptions.decode(line)
        self.faults = Faults()
        for kind, value in options.faults.items():
            self.faults.set(kind, value)
        self._world = WorldProcess(line.strip())
        try:
            self._hardware = EmulatedHardware(options.rig_file, self._world.shared, self.faults)
        except BaseException:
            self._world.close()
            raise

    def endpoints(self) -> dict[str, Any]:
        valve = self._hardware.valve
        return {
            "ready": True,
            "pid": os.getpid(),
            "servo": self._hardware.bus.path,
            "valve": valve.path if valve else None,
            "cameras": self._world.cameras,
            "simulated": self._world.simulated,
        }

    def handle(self, request: dict[str, Any]) -> dict[str, Any]:
        """Answer one request."""
        if "fault" in request:
            return self._set_fault(request["fault"], float(request.get("value", 1)))
        if request.get("ask") == "truth":
            return self._truth()
        raise InputError(f"unknown request {request!r}")

    def close(self) -> None:
        self._hardware.close()
        self._world.close()

    def _set_fault(self, kind: str, value: float) -> dict[str, Any]:
        if kind not in KINDS:
            raise InputError(f"unknown fault {kind!r}", field="fault", choices=KINDS)
        self.faults.set(kind, value)
        if kind == "servo_unplug" and value:
            self._hardware.bus.close()
        if kind == "valve_unplug" and value and self._hardware.valve:
            self._hardware.valve.close()
        return {"ok": True, "time": scaled_clock.monotonic()}

    def _truth(self) -> dict[str, Any]:
        """Return the ground truth, for tests and benchmarks."""
        servos = self._hardware.servos
        firmware = self._hardware.firmware
        return {
            **{name: self._world.shared[name] for name in FROM_WORLD},
            "now": scaled_clock.monotonic(),
            "torque": {str(i): bool(s.get("Torque Enable")) for i, s in servos.items()},
            "drive": {str(i): s.drive().torque_max for i, s in servos.items()},
            "watchdog": {str(i): s.get("Bus Watchdog") for i, s in servos.items()},
            "servo_stop_time": {str(i): s.stop_time for i, s in servos.items()},
            "valve": {str(n): c.state for n, c in firmware.channels.items()},
            "valve_vent_time": firmware.vent_time,
        }


def serve(emulator: Emulator, requests: TextIO, answers: TextIO) -> None:
    """Process requests until they end or one is a stop request."""
    print(json.dumps(emulator.endpoints()), file=answers, flush=True)
    while line := requests.readline():
        try:
            request = json.loads(line)
        except ValueError:
            request = {}
        if request.get("stop"):
            return
        try:
            answer = json.dumps(emulator.handle(request))
        except InputError as error:
            answer = process.failure(error)
        print(answer, file=answers, flush=True)


def main() -> int:
    try:
        emulator = Emulator(sys.stdin.readline())
    except MjtactileError as error:
        print(process.failure(error), flush=True)
        return error.exit_code
    try:
        serve(emulator, sys.stdin, sys.stdout)
    finally:
        emulator.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
