"""Tests of signals and failures while an object is held in the air, on the emulated rig.

In each case the object is set down, torque is off, the chambers are vented, the recording is
readable, and the process has ended.

The default runs a subset of all combinations. All of them take half an hour: `MJTACTILE_SIGNALS=all
pytest tests/contract/test_signals.py`.
"""

import itertools
import json
import os
import pty
import resource
import shutil
import signal
import subprocess
import sys
import termios

import pytest

from mjtactile.core import scaled_clock
from tests.emulated import wait_for
from tests.emulated_host import (
    WAIT,
    controller_text,
    emulated_rig,
    host,
    rig_text,
    write_slower_sensor,
)

pytestmark = pytest.mark.clock

INT = signal.SIGINT
TERM = signal.SIGTERM
HUP = signal.SIGHUP
QUIT = signal.SIGQUIT
XCPU = signal.SIGXCPU
TIMES = {
    "once": (),
    "twice, 1 ms": (0.001,),
    "twice, 30 ms": (0.03,),
    "twice, 50 ms": (0.05,),
    "six": (0.001, 0.05, 0.01, 0.1, 0.03),
}
EACH_SECOND = (1.02, 1.02)
PHASES = ("connecting", "references", "approach", "regulate", "lift", "hold", "lower", "release")
SOME = [(HUP, "six", "lift"), (XCPU, "each second", "hold"), (INT, "twice, 50 ms", "connecting")]
ALL = os.environ.get("MJTACTILE_SIGNALS") == "all"
# a repetition of these signals does not request a faster stop
REPEATED = itertools.product((XCPU, signal.SIGALRM, signal.SIGUSR1), ("each second",), PHASES)
CASES = [*itertools.product((INT, TERM, HUP, QUIT), TIMES, PHASES), *REPEATED] if ALL else SOME
# the others also in tests/unit/runtime/test_failures.py
FAULTS = ["while True: pass", "import sys; sys.exit(0)", "raise KeyboardInterrupt"]


@pytest.fixture
def emulator():
    """Provide a new emulator for each test: the egg stands and the jaws are open."""
    process = emulated_rig()
    yield process
    process.close()


def wait_until(running, phase):
    if phase == "connecting":
        assert wait_for(running.log.exists, WAIT)
    elif phase == "references":
        assert wait_for(
            lambda: "sealed" in emulator_valves(running) or "set" in emulator_valves(running), WAIT
        )
    else:
        running.wait_for_phase(phase)


def emulator_valves(running):
    return running.emulator.truth()["valve"].values()


@pytest.mark.slow(45)
@pytest.mark.parametrize(
    ("number", "times", "phase"), CASES, ids=[f"{n.name}-{t}-{p}" for n, t, p in CASES]
)
def test_signals(emulator, tmp_path, number, times, phase):
    with host(
        emulator, tmp_path, controller_text(hold=60.0 if phase not in PHASES[6:] else 0.1)
    ) as running:
        wait_until(running, phase)
        running.signal(number)
        for pause in TIMES.get(times, EACH_SECOND):
            scaled_clock.sleep(pause)
            running.signal(number)
        output, errors = running.ends()
        assert running.process.returncode == 3 and "Traceback" not in errors
        assert (
            errors.splitlines()[-1] == "mjtactile: interrupted"
            and json.loads(output)["exit_code"] == 3
        )
        running.has_set_down()
        if phase not in PHASES[:2]:
            recording = running.recording()
            assert (
                recording.notes["outcome"] == "fault" and recording.notes["error"] == "interrupted"
            )
            assert (
                recording.columns["state"][-1] == "latched"
                and recording.columns["command_lift_height"][-1] < 1e-3
            )


@pytest.mark.slow(40)
def test_a_second_signal_a_second_later_releases_at_once(emulator, tmp_path):
    with host(emulator, tmp_path) as running:
        running.wait_for_phase("hold")
        running.signal(INT)
        scaled_clock.sleep(1.05)
        running.signal(INT)
        _, errors = running.ends()
        assert (
            running.process.returncode == 3 and errors.splitlines()[-1] == "mjtactile: interrupted"
        )
        assert running.recording().columns["state"][-1] == "safe"  # the gripper was still raised


@pytest.mark.slow(55)
def test_output_that_is_not_read_and_a_folder_that_is_removed(emulator, tmp_path):
    """With `mjtactile grasp … 2>&1 | head -6` the grasp continues to its end."""
    reader, writer = os.pipe()
    with host(
        emulator, tmp_path, controller_text(hold=0.5), stdout=writer, stderr=writer
    ) as running:
        os.close(writer)
        os.read(reader, 20)
        os.close(reader)
        running.wait_for_phase("lift", "hold")
        shutil.rmtree(tmp_path / "out")
        running.ends()
        assert running.process.returncode == 0
        running.has_set_down()


@pytest.mark.slow(55)
def test_a_stopped_terminal_a_full_disk_and_no_descriptors(emulator, tmp_path):
    reader, writer = pty.openpty()
    with host(emulator, tmp_path, controller_text(hold=0.5), stderr=writer) as running:
        running.wait_for_phase("regulate", "lift", "hold")
        termios.tcflow(writer, termios.TCOOFF)  # Ctrl-S
        resource.prlimit(running.process.pid, resource.RLIMIT_FSIZE, (1, 1))
        resource.prlimit(running.process.pid, resource.RLIMIT_NOFILE, (3, 3))
        assert wait_for(lambda: not any(emulator.truth()["torque"].values()), WAIT)
        termios.tcflow(writer, termios.TCOON)  # Ctrl-Q: resume the output
        output, _ = running.ends()
        assert running.process.returncode == 0, output
        running.has_set_down()
        result = json.loads(output)
        assert result["outcome"] == "held" and result["recording_problem"]
    os.close(reader)
    os.close(writer)


@pytest.mark.slow(60)
@pytest.mark.parametrize("fault", FAULTS if ALL else FAULTS[:1])
def test_a_controller_that_fails(emulator, tmp_path, fault):
    text = controller_text().replace("def _hold(", f"def _hold(*_):\n    {fault}\n\n\ndef _unused(")
    with host(emulator, tmp_path, text) as running:
        _, errors = running.ends()
        assert running.process.returncode == 2 and "Traceback" not in errors, errors
        line = errors.splitlines()[-1]
        assert line.startswith("mjtactile: mine.py: line ") and "step()" in line
        running.has_set_down()
        assert running.recording().columns["state"][-1] == "latched"


@pytest.mark.slow(25)
def test_a_resumed_host_sets_the_held_object_down(emulator, tmp_path):
    """With `on_host_loss = "hold"`, the servos' watchdogs have tripped and the chambers are
    sealed."""
    with host(emulator, tmp_path, loss="hold") as running:
        running.wait_for_phase("hold")
        running.signal(signal.SIGSTOP)
        assert wait_for(lambda: set(emulator.truth()["watchdog"].values()) == {0xFF})
        scaled_clock.sleep(
            0.5
        )  # longer than the board's heartbeat, which started with the watchdogs
        assert set(emulator.truth()["valve"].values()) == {"sealed"}
        running.signal(signal.SIGCONT)
        _, errors = running.ends()
        assert running.process.returncode == 3, errors
        # the first late device is named; its watchdog is cleared, and the opening is measured again
        assert "stopped safely: " in errors.splitlines()[-1]
        running.has_set_down()
        columns = running.recording().columns
        assert columns["state"][-1] == "latched"
        held = columns["opening"][columns["phase"] == "hold"][0]
        # RETREAT_OPENING, less the tolerance of the measured opening
        assert columns["opening"][-1] > held + 0.013


@pytest.mark.clock(15)
def test_after_a_killed_host_the_watchdogs_act(emulator, tmp_path):
    (tmp_path / "rig.toml").write_text(rig_text(emulator))
    sensor = write_slower_sensor(tmp_path)
    process = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "mjtactile",
            "record",
            "--rig",
            "rig.toml",
            "--sensor",
            sensor,
            "--seconds",
            "60",
            "--out",
            "out",
        ],
        cwd=tmp_path,
        stderr=subprocess.DEVNULL,
    )
    log = tmp_path / "out" / "recording" / "log.jsonl"
    assert wait_for(lambda: log.exists() and log.read_text().count('"kind": "cycle"') >= 5, WAIT), (
        process.poll()
    )
    process.send_signal(signal.SIGKILL)
    killed = scaled_clock.monotonic()
    process.wait()
    # the jaws do not move
    assert wait_for(lambda: set(emulator.truth()["watchdog"].values()) == {0xFF})
    assert wait_for(lambda: set(emulator.truth()["valve"].values()) == {"vent"})
    truth = emulator.truth()
    # their own bus watchdogs
    assert all(t is not None and t >= killed for t in truth["servo_stop_time"].values())
    assert truth["valve_vent_time"] >= killed  # its own heartbeat
