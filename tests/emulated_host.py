"""Command line in its own process with emulated hardware, and the final state of hardware and
object.

The emulator outlives its hosts and reports the ground truth. Time-outs are generous for a busy
computer; none is asserted.
"""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from mjtactile.commands.emulate import client_text
from mjtactile.core import resources, scaled_clock
from mjtactile.emulator.process import EmulatorProcess
from mjtactile.recording.reader import load_recording
from mjtactile.rig.file import load_rig_file
from tests.patient import RATE, SLOW_CAMERA_DESIGN

WAIT = 300.0  # time-out in s; an idle computer needs a few seconds
# largest drop, m, of a lift of 40 mm; the two heights are not read at exactly the same time
FALLEN = 0.010
_CHECK_TIME = 0.03  # period of the check on the hardware's clock, s; a fall of 40 mm takes 0.09 s
_TAIL = 40_000  # bytes at the end of the log, more than one line
_GENEROUS = (
    ("rate_Hz", "30.0", str(RATE)),
    ("delay_ms", "8.0", "400.0"),
    ("reply_timeout_ms", "20", "100"),
    ("watchdog_ms", "200", "1200"),
    ("heartbeat_ms", "250", "1200\nreply_timeout_ms = 100"),  # of the valve board
    ("host_timeout_ms", "1000", "2000"),
)


def emulated_rig(object_name: str = "egg") -> EmulatorProcess:
    """Return emulated hardware whose cameras have the rate of `rig_text`."""
    rig_file = load_rig_file("emulated")
    cameras = tuple(replace(camera, rate=RATE) for camera in rig_file.cameras)
    return EmulatorProcess(
        replace(rig_file, cameras=cameras), SLOW_CAMERA_DESIGN, object_name=object_name
    )


def write_slower_sensor(folder: Path) -> str:
    """Write the sensor `paper16` with that rate to a folder; return the file's name."""
    text = resources.find("paper16", "models/sensors", ".toml").read_text(encoding="utf-8")
    assert "rate_Hz = 30.0" in text
    (folder / "slower.toml").write_text(text.replace("rate_Hz = 30.0", f"rate_Hz = {RATE}"))
    return "slower.toml"


def rig_text(emulator: EmulatorProcess) -> str:
    """Return a rig file for the emulated hardware."""
    text = client_text(load_rig_file("emulated").path, emulator.endpoints)
    for name, before, after in _GENEROUS:
        assert f"{name} = {before}" in text
        text = text.replace(f"{name} = {before}", f"{name} = {after}")
    return text


def shipped_with(controller: str, **constants: float) -> str:
    """Return the text of a shipped controller with other values of its constants."""
    text = resources.find(controller, "controllers", ".py").read_text(encoding="utf-8")
    for name, value in constants.items():
        text, found = re.subn(rf"^{name} = .*$", f"{name} = {value}", text, flags=re.MULTILINE)
        assert found == 1, f"{controller} has no {name}"
    return text


def controller_text(hold: float = 60.0) -> str:
    """Return the text of a faster `gentle` that holds for `hold` s."""
    text = shipped_with(
        "gentle", CLOSING_SPEED=0.045, SETTLE_TIME=0.1, LIFT_SPEED=0.08, OPENING_SPEED=0.08
    )
    before = "return phases.hold(observation, "
    brief = f"goal = replace(observation.goal, hold_time={hold})\n    observation = replace(observation, goal=goal)"
    assert text.count(before) == 1
    return text.replace(before, f"{brief}\n    {before}")


class Host:
    """Grasp in a process, with a thread that monitors the object."""

    def __init__(
        self,
        emulator: EmulatorProcess,
        folder: Path,
        controller: str,
        *,
        stdout: int = subprocess.PIPE,
        stderr: int = subprocess.PIPE,
        loss: str = "open",
    ):
        self.emulator = emulator
        self.log = folder / "out" / "recording" / "log.jsonl"
        text = rig_text(emulator).replace('on_host_loss = "open"', f'on_host_loss = "{loss}"')
        (folder / "rig.toml").write_text(text)
        (folder / "mine.py").write_text(controller)
        self.process = subprocess.Popen(
            [
                sys.executable,
                "-W",
                "error",
                "-m",
                "mjtactile",
                "grasp",
                "--rig",
                "rig.toml",
                "--sensor",
                write_slower_sensor(folder),
                "--controller",
                "mine.py",
                "--frames",
                "every:5",
                "--out",
                "out",
                "--json",
            ],
            cwd=folder,
            stdout=stdout,
            stderr=stderr,
            text=True,
        )
        self.fallen = 0.0  # drop of the object below its lifted height, m
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._follow)
        self._thread.start()

    def close(self) -> None:
        self.process.kill()
        self.process.communicate()
        self._over.set()
        self._thread.join()

    def wait_for_phase(self, *phases: str) -> None:
        """Wait until the recording's last cycle is in one of `phases`."""
        deadline = time.monotonic() + WAIT
        while self.phase() not in phases:
            assert self.process.poll() is None, self.process.communicate()
            assert time.monotonic() < deadline, self.phase()
            scaled_clock.sleep(_CHECK_TIME)

    def phase(self) -> str | None:
        with contextlib.suppress(OSError), self.log.open("rb") as log:
            log.seek(max(0, os.fstat(log.fileno()).st_size - _TAIL))
            found = re.findall(rb'"phase": "(\w+)"', log.read())
            return found[-1].decode() if found else None
        return None

    def signal(self, number: int) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.process.pid, number)

    def ends(self) -> tuple[str, str]:
        """Wait for the end of the process and return stdout and stderr. Check that torque is off,
        the chambers are vented, and no object has fallen."""
        output = self.process.communicate(timeout=WAIT)
        self._over.set()
        self._thread.join()
        truth = self.emulator.truth()
        assert not any(truth["torque"].values()), output
        assert set(truth["valve"].values()) == {"vent"}, output
        return output

    def has_set_down(self) -> None:
        """Check that the object was lowered with the gripper to its initial position."""
        assert self.fallen < FALLEN
        # height of the object's center, m; less means that it has toppled
        assert self.emulator.truth()["object_height"] == pytest.approx(0.031, abs=0.003)

    def recording(self):
        """Return the recording; check that it is complete and contains the phases of the
        retreat."""
        recording = load_recording(self.log.parent)
        assert recording.complete and not recording.problems
        return recording

    def _follow(self) -> None:
        start = self.emulator.truth()
        while not self._over.wait(scaled_clock.wall(_CHECK_TIME)):
            now = self.emulator.truth()
            below = start["object_height"] + now["lift_height"] - now["object_height"]
            self.fallen = max(self.fallen, below if now["lift_height"] > 0 else 0.0)


@contextlib.contextmanager
def host(
    emulator: EmulatorProcess, folder: Path, controller: str | None = None, **options: Any
) -> Iterator[Host]:
    running = Host(emulator, folder, controller or controller_text(), **options)
    try:
        yield running
    finally:
        running.close()
