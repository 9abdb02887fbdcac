"""The emulator's own process: `python -m mjtactile.emulator.app`, started by `mjtactile.emulator.process`.

It reads its options from the first line of stdin, prints one JSON line when it is ready (`servo`, `valve`: pty paths;
`cameras`: addresses; `pid`), then obeys JSON lines on stdin, one JSON line in answer to each:
`{"fault": KIND, "value": X}`, `{"ask": "truth"}`, `{"stop": true}`. It ends when its stdin does, so that it never
outlives whoever started it.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from typing import Any, TextIO

from mjtactile.emulator.faults import KINDS, Faults
from mjtactile.emulator.hardware import Hardware
from mjtactile.emulator.options import EmulatorOptions
from mjtactile.emulator.shared import FROM_WORLD, SharedState
from mjtactile.errors import DeviceError, InputError, MjtactileError

_STOP_TIME = 3.0  # s for the world's process to end in order


class WorldProcess:
    """The process of `mjtactile.emulator.world`. Raises InputError or DeviceError when it does not start."""

    def __init__(self, options: str):
        descriptor = os.memfd_create("mjtactile-emulator")
        self.shared = SharedState(descriptor)
        command = [sys.executable, "-m", "mjtactile.emulator.world", str(descriptor)]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, pass_fds=[descriptor])
        os.close(descriptor)
        assert self._process.stdin and self._process.stdout
        self._process.stdin.write(options + "\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        ready = json.loads(line) if line else {"error": "the emulated world ended without a word", "exit_code": 3}
        if "error" in ready:
            self.close()
            raise (InputError if ready["exit_code"] == 2 else DeviceError)(ready["error"])
        self.cameras: dict[str, str] = ready["cameras"]

    def close(self) -> None:
        process = self._process
        if process.stdin:
            with contextlib.suppress(OSError):
                process.stdin.close()
        try:
            process.wait(_STOP_TIME)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if process.stdout:
            process.stdout.close()


class Emulator:
    """World and devices together."""

    def __init__(self, line: str):
        options = EmulatorOptions.decode(line)
        self.faults = Faults()
        for kind, value in options.faults.items():
            self.faults.set(kind, value)
        self._world = WorldProcess(line.strip())
        try:
            self._hardware = Hardware(options.rig_file, self._world.shared, self.faults)
        except BaseException:
            self._world.close()
            raise

    def endpoints(self) -> dict[str, Any]:
        valve = self._hardware.valve
        return {"ready": True, "pid": os.getpid(), "servo": self._hardware.bus.path, "valve": valve.path if valve else None,
                "cameras": self._world.cameras}

    def obey(self, request: dict[str, Any]) -> dict[str, Any]:
        """Answer one request."""
        if "fault" in request:
            return self._set_fault(request["fault"], float(request.get("value", 1)))
        if request.get("ask") == "truth":
            return self._truth()
        return {"error": f"unknown request {request!r}"}

    def close(self) -> None:
        self._hardware.close()
        self._world.close()

    def _set_fault(self, kind: str, value: float) -> dict[str, Any]:
        if kind not in KINDS:
            return {"error": f"unknown fault {kind!r} (valid: {', '.join(KINDS)})"}
        self.faults.set(kind, value)
        if kind == "servo_unplug" and value:
            self._hardware.bus.close()
        if kind == "valve_unplug" and value and self._hardware.valve:
            self._hardware.valve.close()
        return {"ok": True, "time": time.monotonic()}

    def _truth(self) -> dict[str, Any]:
        """What really is; for tests and benchmarks."""
        servos, firmware = self._hardware.servos, self._hardware.firmware
        return {**{name: self._world.shared[name] for name in FROM_WORLD}, "now": time.monotonic(),
                "torque": {str(i): bool(s.get("Torque Enable")) for i, s in servos.items()},
                "drive": {str(i): s.drive().torque_max for i, s in servos.items()},
                "watchdog": {str(i): s.get("Bus Watchdog") for i, s in servos.items()},
                "servo_stop_time": {str(i): s.stop_time for i, s in servos.items()},
                "valve": {str(n): c.state for n, c in firmware.channels.items()}, "valve_vent_time": firmware.vent_time}


def serve(emulator: Emulator, requests: TextIO, answers: TextIO) -> None:
    """Obey until the requests end or one says stop."""
    print(json.dumps(emulator.endpoints()), file=answers, flush=True)
    while line := requests.readline():
        try:
            request = json.loads(line)
        except ValueError:
            request = {}
        if request.get("stop"):
            return
        print(json.dumps(emulator.obey(request)), file=answers, flush=True)


def main() -> int:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the host; the emulator ends with its stdin
    try:
        emulator = Emulator(sys.stdin.readline())
    except MjtactileError as error:
        print(json.dumps({"error": str(error), "exit_code": error.exit_code}), flush=True)
        return error.exit_code
    try:
        serve(emulator, sys.stdin, sys.stdout)
    finally:
        emulator.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
