"""`mjtactile explore`: an egg on the stage, resumed runs, fusion, and one-line errors."""

from __future__ import annotations

import json

import numpy as np
import pytest

from mjtactile.cli import main
from mjtactile.explore import surface_fusion
from mjtactile.explore.exploration import PatchStore
from mjtactile.explore.shape_models import FAMILIES


def refused(capsys, *arguments):
    assert main(["explore", *arguments]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    return lines[0]


def test_invalid_requests_are_refused(capsys, tmp_path):
    assert "--touches" in refused(capsys, "--touches", "0")
    assert "half of the breaking force of 'egg', 2.5 N" in refused(
        capsys, "--object", "egg", "--force-N", "1.6"
    )
    assert "a holder cannot hold" in refused(capsys, "--object", "tofu", "--force-N", "0.1")
    assert "--resume" in refused(capsys, "--resume", "--out", str(tmp_path / "none"))
    assert "valid: --setup gripper" in refused(capsys, "--setup", "stage", "--rig", "emulated")
    assert "a simulation turns the object itself" in refused(capsys, "--rotation-deg", "90")
    three = refused(capsys, "--rig", "sim_three_finger")
    assert "3 fingers: only two that face each other" in three
    assert "--input" in refused(
        capsys, "--input", str(tmp_path), "--resume", "--out", str(tmp_path)
    )


def test_a_recorded_press_has_the_position_of_the_indenter(capsys, tmp_path):
    moves = tmp_path / "twice.csv"
    moves.write_text("time_s,depth_mm,speed_mm_s\n0,1,40\n0.2,2,40\n")
    run = str(tmp_path / "press")
    record = ["record", "--rig", "stage", "--protocol", str(moves), "--indenter", "sphere:8"]
    assert main([*record, "--position-mm", "3,-2", "--seconds", "0.5", "--out", run]) == 0
    capsys.readouterr()
    assert main(["explore", "--input", run, "--out", str(tmp_path / "ball"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["patches"] == 1
    patch = PatchStore(tmp_path / "ball" / "touched.jsonl").read()[0]
    off = np.linalg.norm(patch.points - [0, 0, 0.008], axis=1) - 0.008
    # the frame begins at the ball's lowest point. A mesh of 13 x 11 vertices is 0.1 to 0.2 mm away
    # from a ball between its vertices
    assert np.abs(off).max() < 3e-4


@pytest.mark.slow(40)
@pytest.mark.clock
def test_exploration_by_an_emulated_gripper_equals_that_of_its_recording(capsys, tmp_path):
    out = tmp_path / "egg"
    arguments = ["explore", "--rig", "emulated", "--object", "egg", "--time-scale", "4"]
    assert main([*arguments, "--touches", "2", "--out", str(out), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["patches"] == 4 and "surface_error_mm_true" not in found
    assert max(item["force_N"] for item in found["touched"]) < 0.6
    places = np.array([item["place_mm"] for item in found["touched"]])
    # an egg of 32 mm, touched at its maximum width, with the offset of the seed
    widths = np.abs(places[::2, 0] - places[1::2, 0])
    assert widths == pytest.approx([32, 32], abs=1.0)
    # a grip 6 mm higher touches the egg less than 6 mm higher
    assert (places[2:, 2] - places[:2, 2] > 0.5).all() and (places[2:, 2] - places[:2, 2] < 6).all()
    assert main(["explore", "--rig", f"replay:{out}", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["touched"] == found["touched"]


@pytest.mark.slow(20)
def test_exploration_of_an_egg_can_be_resumed(capsys, tmp_path, monkeypatch):
    # fits of two of the six families; tests/unit/explore/ compares all of them
    families = [family for family in FAMILIES if family.name in ("ellipsoid", "box")]
    assert len(families) == 2
    monkeypatch.setattr(surface_fusion, "FAMILIES", families)
    out = tmp_path / "egg"
    arguments = ["explore", "--object", "egg", "--seed", "3", "--out", str(out), "--json"]
    assert main([*arguments, "--touches", "1"]) == 0
    one = json.loads(capsys.readouterr().out)
    assert one["patches"] == 1 and (out / "surface.ply").stat().st_size > 1e4
    assert main([*arguments, "--touches", "3", "--resume"]) == 0
    three = json.loads(capsys.readouterr().out)
    assert three["patches"] == 3 and len((out / "touched.jsonl").read_text().splitlines()) == 3
    assert three["touched"][0]["place_mm"] == pytest.approx(one["touched"][0]["place_mm"])
    # three touches of an egg of 32 x 32 x 40 mm meet the requirement for twelve
    assert three["surface_error_mm_true"] < 0.7
    assert max(touch["force_N"] for touch in three["touched"]) < 0.6
    assert main(["explore", "--input", str(out), "--json"]) == 0
    fused = json.loads(capsys.readouterr().out)
    assert fused["patches"] == 3
    assert fused["size_mm"] == pytest.approx(three["size_mm"], rel=0.01)
    assert main([*arguments, "--touches", "3"]) == 2  # no file is overwritten
