"""Every outcome has its exit code: 0 held, 1 dropped or crushed, 3 fault; a wrong run is never reported as a result."""

import json

import pytest

from mjtactile import resources

DENSE = resources.find("paper16", "models/sensors", ".toml").read_text()

# Closes to `OPENING` m at 60 mm/s, pushes with up to `FORCE` N, lifts, holds, and ends; it feels nothing.
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
    (tmp_path / "blind.py").write_text(BLIND.replace("OPENING", str(opening)).replace("FORCE", str(force)))
    process = mjtactile("grasp", "--controller", "blind.py", "--sensor", "paper16", "--out", "result", "--json", *args)
    assert "Traceback" not in process.stderr
    assert json.loads((tmp_path / "result" / "summary.json").read_text())["outcome"]
    return process, json.loads(process.stdout)


def test_a_grip_harder_than_the_egg_stands_crushes_it(mjtactile, tmp_path):
    process, report = run(mjtactile, tmp_path, 0.02, 4.0)
    assert (process.returncode, report["outcome"]) == (1, "crushed")
    assert report["peak_force_true_N"] > 2.5  # the egg's break_force_N


def test_an_object_that_is_not_gripped_is_dropped(mjtactile, tmp_path):
    process, report = run(mjtactile, tmp_path, 0.045, 4.0)  # the fingers stay clear of the egg, 32 mm across
    assert (process.returncode, report["outcome"]) == (1, "dropped")
    assert report["peak_force_true_N"] == pytest.approx(0.0, abs=1e-9) and report["hold_force_true_N"] == 0.0


def test_a_membrane_pushed_to_the_glass_is_a_fault_with_step_and_reason(mjtactile, tmp_path):
    shallow = DENSE.replace("depth_mm = 20.0", "depth_mm = 2.0")
    (tmp_path / "shallow.toml").write_text(shallow)
    process, report = run(mjtactile, tmp_path, 0.01, 8.0, "--sensor", "shallow.toml")
    assert (process.returncode, report["outcome"]) == (3, "fault")
    line = process.stderr.strip().splitlines()[-1]
    assert "step" in line and "t =" in line and "glass" in line
    assert report["hold_force_N"] is None and report["frames"] > 0  # recorded so far, and no made-up result
