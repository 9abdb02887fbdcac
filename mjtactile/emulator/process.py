"""Start the emulator's process, hand its addresses to a rig file, and talk to it."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from mjtactile.design import SensorDesign
from mjtactile.emulator.options import EmulatorOptions
from mjtactile.errors import DeviceError, InputError
from mjtactile.rigfile import RigFile

_STOP_TIME = 5.0  # s to end in order


class EmulatorProcess:
    """The emulated hardware of `rig_file`, running. Raises InputError for bad options, DeviceError if it does not start."""

    def __init__(self, rig_file: RigFile, design: SensorDesign, *, object_name: str, seed: int = 0,
                 faults: Mapping[str, float] | None = None):
        options = EmulatorOptions(rig_file, design, object_name, seed, dict(faults or {}))
        self._lock = threading.Lock()
        # A group of its own: Ctrl-C in the terminal is for the host, which ends the emulator when it has shut down.
        self._process = subprocess.Popen([sys.executable, "-m", "mjtactile.emulator.app"], text=True,
                                         stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True,
                                         env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"})
        try:
            ready = self._request(options.encode())
        except BaseException:
            self.close()
            raise
        if "error" in ready:
            self.close()
            raise (InputError if ready.get("exit_code") == 2 else DeviceError)(ready["error"])
        self.endpoints = ready

    @property
    def pid(self) -> int:
        return self._process.pid

    def fault(self, kind: str, value: float = 1.0) -> None:
        """Switch a fault on (or off with 0). Raises InputError for one that does not exist."""
        answer = self._request({"fault": kind, "value": value})
        if "error" in answer:
            raise InputError(answer["error"], field="fault")

    def truth(self) -> dict[str, Any]:
        """What really happens in the emulated world; for tests and benchmarks."""
        return self._request({"ask": "truth"})

    def connect(self, rig_file: RigFile) -> RigFile:
        """The rig file with the emulator's addresses in it."""
        valve = self.endpoints["valve"] or ""
        return replace(
            rig_file, bus=replace(rig_file.bus, port=self.endpoints["servo"]),
            cameras=tuple(replace(c, source=self.endpoints["cameras"][c.finger]) for c in rig_file.cameras),
            valves=tuple(replace(v, port=valve) for v in rig_file.valves))

    def close(self) -> None:
        """End the process, by force if it does not listen."""
        process = self._process
        with contextlib.suppress(OSError, ValueError):
            if process.stdin:
                process.stdin.close()
        try:
            process.wait(_STOP_TIME)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if process.stdout:
            process.stdout.close()

    def _request(self, request: Mapping[str, Any] | str) -> dict[str, Any]:
        line = request if isinstance(request, str) else json.dumps(request)
        with self._lock:
            try:
                assert self._process.stdin
                self._process.stdin.write(line + "\n")
                self._process.stdin.flush()
            except (OSError, ValueError) as error:
                raise DeviceError("the emulator has ended") from error
            return self._receive()

    def _receive(self) -> dict[str, Any]:
        assert self._process.stdout
        line = self._process.stdout.readline()
        if not line:
            raise DeviceError("the emulator ended without a word; what it printed to stderr says why")
        return json.loads(line)
