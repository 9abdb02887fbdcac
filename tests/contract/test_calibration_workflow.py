"""Test of the complete calibration of two fingers that differ from their sensor file: measure,
calibrate, measure again.

It runs on the as-built sensors of `models/rigs/emulated_as_built.toml`, over ptys and streams. The
user has a printed board, a load cell, a caliper and a pressure of zero. The test simulates the user
who reads the instruments, in the emulated world.
"""

# pyright: reportOptionalMemberAccess=false, reportArgumentType=false

import contextlib
import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.commissioning.simulated_operator import Person, photograph_board
from mjtactile.calibrate import interactive
from mjtactile.cli import main
from mjtactile.commands.emulate import client_text
from mjtactile.core import resources
from mjtactile.core.calibration import load_calibration
from mjtactile.core.design import load_sensor
from mjtactile.core.types import FINGERS
from mjtactile.emulator.process import EmulatorProcess
from mjtactile.emulator.rig import build_emulated_rig
from mjtactile.rig.as_built_sensor import true_design
from mjtactile.rig.file import load_rig_file
from mjtactile.runtime.controller import load_controller
from mjtactile.runtime.session import Session
from tests.emulated import slowed

pytestmark = pytest.mark.clock

# image rate, Hz; half of the emulated cameras' rate: two processors render and evaluate the images
RATE = 15.0
# maximum force error on each finger after calibration, N: three times the standard deviation of the
# calibration at 0.6 N (slope 0.013 x 0.6 N, offset about 5 mN)
ERROR_MAX = 0.03


def write_rig(folder):
    """Write the rig file of the as-built sensors with a calibration file for each finger and the
    gripper, and long time-outs."""
    text = resources.find("emulated_as_built", "models/rigs", ".toml").read_text()
    text = text.replace("[gripper]\n", '[gripper]\ncalibration = "gripper.json"\n')
    for finger in FINGERS:
        text = text.replace(
            f'[[camera]]\nfinger = "{finger}"',
            f'[[camera]]\ncalibration = "{finger}.json"\nfinger = "{finger}"',
        )
    for name, value in (
        ("reply_timeout_ms", 100),
        ("watchdog_ms", 2500),
        ("host_timeout_ms", 5000),
        ("heartbeat_ms", 3000),
        ("delay_ms", 1000.0),
        ("rate_Hz", RATE),
    ):
        lines = [
            f"{name} = {value}" if line.startswith(f"{name} =") else line
            for line in text.splitlines()
        ]
        text = "\n".join(lines) + "\n"
    path = folder / "rig.toml"
    path.write_text(text)
    sensor = resources.find("dense", "models/sensors", ".toml").read_text()
    assert "rate_Hz = 30.0" in sensor
    (folder / "slower.toml").write_text(sensor.replace("rate_Hz = 30.0", f"rate_Hz = {RATE}"))
    return path


# -- force estimates and ground truth -------------------------------------------------------------


class BriefHold:
    """Controller `gentle`, ended after a short hold."""

    path = "gentle"

    def __init__(self, cycles):
        self._gentle = load_controller("gentle")
        self._left = cycles

    def step(self, observation):
        command = self._gentle.step(observation)
        self._left -= command.phase == "hold"
        return replace(command, phase="done") if self._left < 0 else command


@contextlib.contextmanager
def emulated_session(path):
    """Yield a session with references on a new emulated rig, its emulator, and its messages."""
    rig_file = load_rig_file(path)
    reported = []
    design = load_sensor(path.parent / "slower.toml")
    emulator = EmulatorProcess(rig_file, design, object_name="egg", seed=1)
    try:
        rig = build_emulated_rig(rig_file, design, object_name="egg", seed=1, emulator=emulator)
        try:
            session = Session(rig, notify=reported.append)
            session.take_references()
            yield session, emulator, reported
        finally:
            rig.close()
    finally:
        emulator.close()


def grasp_error(path):
    """Return the mean force error on each finger, N, while an egg is held, and the session's
    messages."""
    errors = []
    with emulated_session(path) as (session, emulator, reported):

        def on_cycle(cycle):
            if cycle.sent.phase == "hold":
                truth = emulator.truth()
                errors.append(
                    [
                        touch.force_normal - truth[f"contact_{i}"]
                        for i, touch in enumerate(cycle.touch, 1)
                    ]
                )

        session.run(BriefHold(30), time_limit=60.0, on_cycle=on_cycle)
    return np.nanmean(errors, axis=0), reported


# -- instruments of the user
# --------------------------------------------------------------------------------


@contextlib.contextmanager
def client(path):
    """Provide an emulator and the rig file of its client."""
    design = load_sensor(path.parent / "slower.toml")
    emulator = EmulatorProcess(load_rig_file(path), design, object_name="egg", seed=2)
    try:
        file = path.parent / "client.toml"
        file.write_text(client_text(path, emulator.endpoints))
        yield emulator, file
    finally:
        emulator.close()


def calibrate(file, emulator, monkeypatch, *options):
    """Run `mjtactile calibrate` with the answers of a user at the terminal."""
    person = Person(emulator)
    # the emulated jaws have no backlash, and the chambers have short hoses
    monkeypatch.setattr(interactive, "_SPEED", 0.1)
    monkeypatch.setattr(interactive, "_REST_TIME", 0.3)
    monkeypatch.setattr(interactive, "_VALVE_STAGES", (1.0, 1.0, 0.5))
    with person.at_the_terminal():
        code = main(["calibrate", *options, "--rig", str(file)])
    assert code == 0, "".join(person.read)


def calibrate_cameras(path, file):
    design = load_sensor(path.parent / "slower.toml")
    as_built = load_rig_file(path).emulator
    for finger in FINGERS:
        photos = path.parent / f"photos_{finger}"
        photograph_board(photos, true_design(design, as_built.as_built_sensor(finger)).camera)
        arguments = ["calibrate", "camera", str(photos), "--rig", str(file), "--finger", finger]
        assert main([*arguments, "--sensor", str(path.parent / "slower.toml")]) == 0


@pytest.mark.slow(100)
def test_calibration_of_two_fingers_that_differ_from_their_sensor_file(tmp_path, monkeypatch):
    path = write_rig(tmp_path)
    sensor = ("--sensor", str(tmp_path / "slower.toml"))
    # most of the time is a minute of motion of the jaws and of pressure settling
    with slowed(2.0), client(path) as (emulator, file):
        calibrate_cameras(path, file)
        for arguments in (["valve", "--seal", "2"], ["frame"], ["force", "--load-cell"]):
            calibrate(file, emulator, monkeypatch, *arguments, *sensor)
    left, right = (load_calibration(tmp_path / f"{finger}.json") for finger in FINGERS)
    # each against the as-built sensor: focal length 3 % of 600 px by the camera's own 0.5 %, zero
    # by 5 Pa of noise over 0.7 s
    assert left.lens.fx == pytest.approx(618, rel=0.005) and right.lens.fx == pytest.approx(
        582, rel=0.005
    )
    assert left.valve.offset == pytest.approx(30, abs=3) and right.valve.offset == pytest.approx(
        -30, abs=3
    )
    # the board separates a shift from the lens center
    assert left.frame.p_SC[0] == pytest.approx(4e-4, abs=1.5e-4)
    assert left.frame.scale.mean() == pytest.approx(
        1.02, abs=2e-3
    ) and left.frame.stiffness == pytest.approx(1.15, abs=0.05)
    # with lens and zero calibrated, only the model error remains
    assert left.force.scale == pytest.approx(1.0, abs=0.05)
    after, reported = grasp_error(path)
    assert not [text for text in reported if text.startswith("calibration of")]
    assert np.abs(after).max() < ERROR_MAX


@pytest.mark.slow(25)
def test_calibration_of_servos_whose_torque_differs_from_the_data_sheet(tmp_path, monkeypatch):
    with slowed(2.0), client(write_rig(tmp_path)) as (emulator, file):
        calibrate(file, emulator, monkeypatch, "gripper")
    servos = json.loads((tmp_path / "gripper.json").read_text())["servo"]
    # data sheet of the XL330-M288
    assert servos[0]["torque_Nm_per_A"] / 0.354 == pytest.approx(1.08, abs=0.03)
