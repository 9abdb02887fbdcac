"""Tests of exit codes: 0 held, 1 dropped or crushed, 3 fault; a failed run is not reported as a
result."""

import json

import numpy as np
import pytest

from mjtactile.core import resources
from mjtactile.recording.reader import load_recording
from tests.emulated_host import controller_text

DENSE = resources.find("dense", "models/sensors", ".toml").read_text()

SAMPLED = "--effects=-mesh,-pipeline"  # the fastest level: outcomes follow from ground truth

# Close to `OPENING` m at 60 mm/s, push with up to `FORCE` N, lift, hold, and end, without touch.
BLIND = """
from dataclasses import replace

def step(observation):
    c = observation.command
    t = c.memory.get("t", 0.0) + observation.period
    phase = "close" if t < 1.6 else "lift" if t < 2.2 else "hold" if t < 2.6 else "done"
    height = 0.02 if t > 1.6 else 0.0
    opening = max(OPENING, c.opening - 0.06 * observation.period)
    return replace(c, opening=opening, force_limit=FORCE, lift_height=height, phase=phase, memory={"t": t})
"""


def run(mjtactile, tmp_path, opening, force, *args):
    (tmp_path / "blind.py").write_text(
        BLIND.replace("OPENING", str(opening)).replace("FORCE", str(force))
    )
    process = mjtactile(
        "grasp", "--controller", "blind.py", SAMPLED, "--out", "result", "--json", *args
    )
    assert "Traceback" not in process.stderr
    assert json.loads((tmp_path / "result" / "summary.json").read_text())["outcome"]
    return process, json.loads(process.stdout)


def test_a_grip_above_the_breaking_force_crushes_the_egg(command, tmp_path):
    process, report = run(command, tmp_path, 0.02, 4.0)
    assert (process.returncode, report["outcome"]) == (1, "crushed")
    assert report["peak_force_true_N"] > 2.5  # the egg's break_force_N


@pytest.mark.slow
def test_an_object_that_is_not_gripped_is_dropped(command, tmp_path):
    # the fingers stay clear of the egg, 32 mm across
    process, report = run(command, tmp_path, 0.045, 4.0)
    assert (process.returncode, report["outcome"]) == (1, "dropped")
    assert (
        report["peak_force_true_N"] == pytest.approx(0.0, abs=1e-9)
        and report["hold_force_true_N"] == 0.0
    )
    assert "controller aborted" not in report.get("reason", "")  # the run was completed


@pytest.mark.slow
def test_a_controller_that_aborts_reports_when(command, tmp_path):
    (tmp_path / "shy.py").write_text(
        BLIND.replace("OPENING", "0.045")
        .replace("FORCE", "4.0")
        .replace(
            'phase = "close" if t < 1.6 else "lift"', 'phase = "close" if t < 1.6 else "abort"'
        )
        .replace('memory={"t": t}', 'memory={"t": t}, reason="" if t < 1.6 else "shy"')
    )
    process = command("grasp", "--controller", "shy.py", SAMPLED, "--out", "result", "--json")
    report = json.loads(process.stdout)
    # the egg was not touched
    assert (process.returncode, report["outcome"]) == (1, "not held: set down")
    assert report["reason"] == "the controller aborted in phase 'close', 1.6 s after its start: shy"
    log = load_recording(tmp_path / "result" / "recording")
    assert log.columns["command_reason"][-1] == "shy"


@pytest.mark.slow
def test_a_membrane_pushed_to_the_glass_is_a_fault_with_step_and_reason(command, tmp_path):
    shallow = DENSE.replace("depth_mm = 20.0", "depth_mm = 2.0")
    (tmp_path / "shallow.toml").write_text(shallow)
    process, report = run(
        command, tmp_path, 0.01, 8.0, "--sensor", "shallow.toml", "--effects=-images"
    )
    assert (process.returncode, report["outcome"]) == (3, "fault")
    line = process.stderr.strip().splitlines()[-1]
    assert "step" in line and "t =" in line and "glass" in line
    # recorded until then, without a result
    assert report["hold_force_N"] is None and report["frames"] > 0


HEAVY = """<mujoco model="heavy">
  <custom><numeric name="break_force_N" data="9"/><text name="material" data="solid"/></custom>
  <worldbody>
    <body name="object" pos="0 0 0.03"><freejoint/><geom type="cylinder" size="0.02 0.03" mass="1"/></body>
  </worldbody>
</mujoco>"""


@pytest.mark.slow
def test_an_object_too_heavy_for_the_grip_is_dropped_with_the_reason(command, tmp_path):
    (tmp_path / "heavy.xml").write_text(HEAVY)
    (tmp_path / "quick.py").write_text(controller_text())
    process = command(
        "grasp",
        "--object",
        "./heavy.xml",
        "--controller",
        "quick.py",
        "--sensor",
        "paper16",
        "--effects=-mesh,-images",
        "--frames",
        "none",
        "--out",
        "result",
        "--json",
    )
    report = json.loads(process.stdout)
    assert (process.returncode, report["outcome"]) == (1, "dropped"), process.stderr
    assert "too heavy" in report["reason"] and "9.8 N" in report["reason"]
    recording = load_recording(tmp_path / "result")
    assert recording.columns["phase"][-1] == "abort" and not list(
        (tmp_path / "result/recording/frames").iterdir()
    )
    # ground truth of every cycle: force on the membranes and position of the box, upright on the
    # table
    wrench = recording.column("wrench_true")
    assert wrench.shape == (len(recording), 2, 6)
    np.testing.assert_allclose(-wrench[..., 2], recording.column("force_normal_true"), atol=1e-12)
    position = recording.column("object_position_true")
    # scatter of the seed, m
    assert position.shape == (len(recording), 3) and np.abs(position[0] - [0, 0, 0.03]).max() < 3e-3
    np.testing.assert_allclose(
        np.linalg.norm(recording.column("object_quaternion_true"), axis=1), 1.0, atol=1e-9
    )
    options = ("--controller", "quick.py", "--sensor", "paper16", "--out", "again")
    replay = command("grasp", "--rig", "replay:result", *options)
    assert replay.returncode == 2 and "0 of" in replay.stderr and "--frames all" in replay.stderr
