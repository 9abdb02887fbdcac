"""Emulator process: start, transfer of its addresses to a rig file, and communication."""

from __future__ import annotations

import json
import threading
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from mjtactile.core import process
from mjtactile.core.design import SensorDesign
from mjtactile.emulator.options import EmulatorOptions
from mjtactile.rig.file import RigFile

_STOP_TIME = 5.0  # wait for a regular shutdown, s


class EmulatorProcess:
    """The emulated hardware of `rig_file`, running. Raises InputError or DeviceError."""

    def __init__(
        self,
        rig_file: RigFile,
        design: SensorDesign,
        *,
        object_name: str,
        seed: int = 0,
        faults: Mapping[str, float] | None = None,
    ):
        options = EmulatorOptions(rig_file, design, object_name, seed, dict(faults or {}))
        self._lock = threading.Lock()
        self._process = process.start("mjtactile.emulator.app", talk=True)
        try:
            self.endpoints = self._request(options.encode())
        except BaseException:
            self.close()
            raise

    @property
    def pid(self) -> int:
        return self._process.pid

    def fault(self, kind: str, value: float = 1.0) -> None:
        """Switch a fault on (or off with 0). Raises InputError for an unknown kind."""
        self._request({"fault": kind, "value": value})

    def truth(self) -> dict[str, Any]:
        """Return the ground truth of the emulated world, for tests and benchmarks."""
        return self._request({"ask": "truth"})

    def connect(self, rig_file: RigFile) -> RigFile:
        """Return the rig file with the emulator's addresses."""
        valve = self.endpoints["valve"] or ""
        return replace(
            rig_file,
            bus=replace(rig_file.bus, port=self.endpoints["servo"]),
            cameras=tuple(
                replace(c, source=self.endpoints["cameras"][c.finger]) for c in rig_file.cameras
            ),
            valves=tuple(replace(v, port=valve) for v in rig_file.valves),
        )

    def close(self) -> None:
        """End the process, by force if it does not respond."""
        process.stop(self._process, _STOP_TIME)

    def _request(self, request: Mapping[str, Any] | str) -> dict[str, Any]:
        with self._lock:
            return process.ask(
                self._process,
                request if isinstance(request, str) else json.dumps(request),
                "the emulator",
            )
