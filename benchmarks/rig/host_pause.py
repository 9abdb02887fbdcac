"""A host that is paused (SIGSTOP, SIGCONT) while it holds an egg in the air.

Its devices react by the rig file's `on_host_loss`. The benchmark checks that the egg is set down
after the host resumes.
"""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.rig.session import OBJECT, SENSOR
from mjtactile.commands.emulate import client_text
from mjtactile.core import resources, scaled_clock
from mjtactile.core.design import load_sensor
from mjtactile.core.errors import DeviceError
from mjtactile.emulator.process import EmulatorProcess
from mjtactile.rig.file import load_rig_file

SECONDS = (0.3, 1.0, 2.0)
"""Durations of the pause, used in turn."""
# lift height that counts as up; drop of the object that counts as lost; tolerance of its height on
# the table, m
_UP = 0.039
_FALLEN = 0.010
_STANDS = 0.003
_PATIENCE = 240.0  # time limit of a grasp on a busy computer, s
_QUICK = {"CLOSING_SPEED": 0.045, "SETTLE_TIME": 0.1, "HOLD_TIME": 60.0}


def stopped(number: int, loss: str) -> dict[str, Any]:
    """Run once.

    Return the pause, s, the outcome of the egg, its maximum drop below its position in the gripper,
    mm, and the reason why the host ended.
    """
    seconds = SECONDS[number % len(SECONDS)]
    rig_file = load_rig_file("emulated")
    emulator = EmulatorProcess(rig_file, load_sensor(SENSOR), object_name=OBJECT, seed=number)
    try:
        with tempfile.TemporaryDirectory() as folder:
            text = client_text(rig_file.path, emulator.endpoints)
            host = _start(Path(folder), text, loss)
            try:
                return _run(host, emulator, seconds) | {"loss": loss}
            finally:
                host.kill()
                host.wait()
    finally:
        emulator.close()


def _start(folder: Path, rig_text: str, loss: str) -> subprocess.Popen[str]:
    changed = rig_text.replace('on_host_loss = "open"', f'on_host_loss = "{loss}"')
    (folder / "rig.toml").write_text(changed)
    controller = resources.find("gentle", "controllers", ".py").read_text(encoding="utf-8")
    for name, value in _QUICK.items():
        controller = re.sub(rf"^{name} = .*$", f"{name} = {value}", controller, flags=re.MULTILINE)
    (folder / "mine.py").write_text(controller)
    command = [sys.executable, "-m", "mjtactile", "grasp", "--rig", "rig.toml"]
    command += ["--sensor", SENSOR, "--controller", "mine.py", "--frames", "none", "--out", "out"]
    return subprocess.Popen(
        command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )


def _run(host: subprocess.Popen[str], emulator: EmulatorProcess, seconds: float) -> dict[str, Any]:
    start = emulator.truth()["object_height"]
    deadline = scaled_clock.monotonic() + _PATIENCE
    while emulator.truth()["lift_height"] < _UP:
        if host.poll() is not None or scaled_clock.monotonic() > deadline:
            raise DeviceError("the host that was to be stopped has not lifted the egg")
        scaled_clock.sleep(0.02)
    scaled_clock.sleep(0.5)
    host.send_signal(signal.SIGSTOP)
    fallen = _watch(host, emulator, start, scaled_clock.monotonic() + seconds)
    host.send_signal(signal.SIGCONT)
    fallen = max(fallen, _watch(host, emulator, start, deadline))
    scaled_clock.sleep(0.3)
    height = emulator.truth()["object_height"]
    lines = (host.communicate()[1] or "").splitlines() or [""]
    return {
        "seconds": seconds,
        "fallen_mm": 1e3 * fallen,
        "set_down": fallen < _FALLEN and abs(height - start) < _STANDS,
        "exit_code": host.returncode,
        "reported": lines[-1],
    }


def _watch(
    host: subprocess.Popen[str], emulator: EmulatorProcess, start: float, until: float
) -> float:
    """Return the maximum drop of the object below its position in the gripper, m.

    The observation lasts until the given time or the host's end.
    """
    fallen = 0.0
    while scaled_clock.monotonic() < until and host.poll() is None:
        truth = emulator.truth()
        if truth["lift_height"] > _STANDS:
            fallen = max(fallen, start + truth["lift_height"] - truth["object_height"])
        scaled_clock.sleep(0.02)
    return fallen


def stopped_rows(runs: list[dict[str, Any]]) -> list[tuple[str, str, str]]:
    """Return one table row for each reaction to a lost host."""
    rows = []
    for loss in dict.fromkeys(run["loss"] for run in runs):
        own = [run for run in runs if run["loss"] == loss]
        good = sum(run["set_down"] for run in own)
        worst = max(run["fallen_mm"] for run in own)
        rows.append(
            (
                f'host stopped for 0.3, 1 and 2 s while an egg is held, `on_host_loss = "{loss}"`',
                "always set down" if loss == "hold" else "",
                f"set down in {good} of {len(own)} runs; maximum drop of the egg in the gripper "
                f"{worst:.1f} mm",
            )
        )
    return rows
