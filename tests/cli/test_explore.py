"""`mjtactile explore`: an egg on the stage, going on, fusing, and what is refused in one line."""

from __future__ import annotations

import json

import pytest

from mjtactile.cli import main


def refused(capsys, *arguments):
    assert main(["explore", *arguments]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    return lines[0]


def test_what_is_refused(capsys, tmp_path):
    assert "--touches" in refused(capsys, "--touches", "0")
    assert "half of the 2.5 N" in refused(capsys, "--object", "egg", "--force-N", "1.6")
    assert "no holder holds" in refused(capsys, "--object", "tofu", "--force-N", "0.1")
    assert "--resume" in refused(capsys, "--resume", "--out", str(tmp_path / "none"))
    assert "cannot turn" in refused(capsys, "--on", "gripper", "--rig", "emulated")
    assert "--from" in refused(capsys, "--from", str(tmp_path), "--resume", "--out", str(tmp_path))


@pytest.mark.slow
def test_an_egg_is_touched_and_gone_on_with(capsys, tmp_path):
    out = tmp_path / "egg"
    arguments = ["explore", "--object", "egg", "--seed", "3", "--out", str(out), "--json"]
    assert main([*arguments, "--touches", "2"]) == 0
    two = json.loads(capsys.readouterr().out)
    assert two["patches"] == 2 and (out / "surface.ply").stat().st_size > 1e4
    assert main([*arguments, "--touches", "4", "--resume"]) == 0
    four = json.loads(capsys.readouterr().out)
    assert four["patches"] == 4 and len((out / "touched.jsonl").read_text().splitlines()) == 4
    assert four["touched"][0]["place_mm"] == pytest.approx(two["touched"][0]["place_mm"])
    # four touches of an egg of 32 x 32 x 40 mm: what is asked of twelve
    assert four["surface_error_mm_true"] < 0.7
    assert max(one["force_N"] for one in four["touched"]) < 0.6
    assert main(["explore", "--from", str(out), "--json"]) == 0
    fused = json.loads(capsys.readouterr().out)
    assert fused["patches"] == 4
    assert fused["size_mm"] == pytest.approx(four["size_mm"], rel=0.01)
    assert main([*arguments, "--touches", "4"]) == 2  # nothing is overwritten
