"""Ctrl-C, SIGTERM and SIGKILL for a host that drives the emulated rig: torque off and valves vented, with or without its help.

The host is the command line in a process of its own; the emulator outlives it and says what became of the hardware.
"""

import json
import signal
import subprocess
import sys
import time

import pytest

from mjtactile.commands.emulate import _rig_text
from mjtactile.design import load_sensor
from mjtactile.emulator.process import EmulatorProcess
from mjtactile.rigfile import load_rig_file
from tests.emulated import wait_for

pytestmark = pytest.mark.realtime


@pytest.fixture(scope="module")
def emulator():
    process = EmulatorProcess(load_rig_file("emulated"), load_sensor("paper16"), object_name="egg", seed=0)
    yield process
    process.close()


@pytest.fixture
def host(emulator, tmp_path):
    """A host that watches the rig: torque on, chambers sealed; and its recording's folder."""
    text = _rig_text(load_rig_file("emulated").path.read_text(), emulator.endpoints)
    # Generous against a busy computer, as in test_rigs.py: no test here asserts how fast anything is.
    for name, before, after in (("delay_ms", "8.0", "400.0"), ("reply_timeout_ms", "20", "100"), ("watchdog_ms", "200", "1200"),
                                ("heartbeat_ms", "250", "1200")):
        assert f"{name} = {before}" in text
        text = text.replace(f"{name} = {before}", f"{name} = {after}")
    (tmp_path / "rig.toml").write_text(text)
    process = subprocess.Popen(
        [sys.executable, "-W", "error", "-m", "mjtactile", "record", "--rig", "rig.toml", "--sensor", "paper16",
         "--seconds", "60", "--out", "out", "--json"], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    log = tmp_path / "out" / "recording" / "log.jsonl"
    try:
        assert wait_for(lambda: log.exists() and log.read_text().count('"kind": "cycle"') >= 5, 40.0), process.poll()
        truth = emulator.truth()
        assert all(truth["torque"].values()) and set(truth["valve"].values()) == {"closed"}
        yield process, log
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_stopped_host_switches_torque_off_and_vents(emulator, host, number):
    process, log = host
    process.send_signal(number)
    output, errors = process.communicate(timeout=20)
    assert process.returncode == 3 and "interrupted" in errors
    assert json.loads(output)["exit_code"] == 3
    truth = emulator.truth()
    assert not any(truth["torque"].values())
    assert set(truth["valve"].values()) == {"vent"}
    assert json.loads(log.read_text().splitlines()[-1])["outcome"] == "fault"  # the recording is whole


def test_a_killed_host_leaves_it_to_the_watchdogs(emulator, host):
    process, _ = host
    process.send_signal(signal.SIGKILL)
    killed = time.monotonic()
    process.wait()
    assert wait_for(lambda: not any(emulator.truth()["drive"].values()))  # the jaws push no more
    assert wait_for(lambda: set(emulator.truth()["valve"].values()) == {"vent"})
    truth = emulator.truth()
    assert all(t is not None and t >= killed for t in truth["servo_stop_time"].values())  # their own bus watchdogs
    assert truth["valve_vent_time"] >= killed  # its own heartbeat
