"""Seconds that last longer."""

import os
import subprocess
import sys
import time
from dataclasses import replace

import pytest

from mjtactile.cli import main
from mjtactile.core import scaled_clock
from mjtactile.core.design import load_sensor
from mjtactile.core.errors import InputError
from mjtactile.devices.rig import build_device_rig
from mjtactile.rig.file import load_rig_file
from tests.emulated import slowed


@pytest.fixture
def five():
    with slowed(5.0):
        yield


@pytest.mark.parametrize(
    "wait",
    [scaled_clock.sleep, lambda seconds: scaled_clock.Event().wait(seconds)],
    ids=["sleep", "Event"],
)
def test_clock_at_one_fifth_of_real_time(five, wait):
    wall = time.monotonic()
    slow = scaled_clock.monotonic()
    wait(0.02)
    wall = time.monotonic() - wall
    slow = scaled_clock.monotonic() - slow
    assert wall > 0.0999  # time in s; 5 x 0.02 less a clock's resolution
    # tolerance in s: the delay between the two clock readings on a busy computer
    assert slow == pytest.approx(wall / 5, abs=2e-3)
    assert scaled_clock.wall(0.02) == pytest.approx(0.1)


def test_child_processes_inherit_the_time_scale(five):
    code = "from mjtactile.core import scaled_clock as pace; print(pace.slow())"
    assert (
        subprocess.run(
            [sys.executable, "-c", code], check=True, capture_output=True, text=True
        ).stdout.strip()
        == "5.0"
    )


@pytest.mark.parametrize("text", ["fast", "0.5", "nan", "inf", ""])
def test_invalid_time_scales_are_refused(monkeypatch, text):
    monkeypatch.setenv("MJTACTILE_TIME_SCALE", text)
    with pytest.raises(InputError, match="MJTACTILE_TIME_SCALE"):
        scaled_clock._from_environment()


def test_an_invalid_time_scale_is_one_line():
    done = subprocess.run(
        [sys.executable, "-m", "mjtactile", "emulate", "--faults", "meteorite"],
        check=False,
        text=True,
        capture_output=True,
        env={**os.environ, "MJTACTILE_TIME_SCALE": "fast"},
    )
    assert (
        done.returncode == 2
        and "MJTACTILE_TIME_SCALE" in done.stderr
        and len(done.stderr.splitlines()) == 1
    )


@pytest.mark.parametrize(
    "arguments",
    [("--rig", "sim"), ("--rig", "replay:somewhere"), ("--rig", "emulated", "--time-scale", "0.1")],
)
def test_only_the_emulated_rig_is_slow(capsys, arguments):
    assert main(["grasp", "--time-scale", "3", *arguments]) == 2
    assert "--time-scale" in capsys.readouterr().err


def test_real_servos_ignore_the_time_scale(five):
    rig_file = load_rig_file("emulated")
    real = replace(rig_file, bus=replace(rig_file.bus, port="/dev/ttyACM0"), cameras=(), valves=())
    with pytest.raises(InputError, match="ttyACM0: only emulated devices can run slower"):
        build_device_rig(real, load_sensor("dense"))
