"""Tests of `mjtactile fabricate`: a folder with a list of its files, or an error in one line and no
folder."""

import functools
import json
import re

import numpy as np
import pytest

from mjtactile.cli import main
from mjtactile.fabrication import build as room
from mjtactile.fabrication import manual
from mjtactile.fabrication.marker_positions import MembraneState


def flat(design, *_):
    """Replace the simulation, which tests/unit/fabrication tests."""
    p = design.markers.p_SM
    return [MembraneState("flat", p, np.tile([0.0, 0, 1], (len(p), 1)), 1.0, 0.0)]


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(
        room, "build", functools.partial(room.build, states_of=flat, load_states_of=flat)
    )
    monkeypatch.setattr(manual, "STEPS", manual.STEPS[:1])  # one image of parts


def test_the_folder_has_a_list_of_its_files(quick, capsys, tmp_path):
    out = tmp_path / "build"
    assert main(["fabricate", "paper16", "--out", str(out), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    written = {str(path.relative_to(out)) for path in out.rglob("*") if path.is_file()}
    assert (
        written == {*report["files"], "checks.json"}
        and json.loads((out / "checks.json").read_text())["sensor"] == "paper16"
    )
    for page in ("README.md", "assembly.md"):
        for link in re.findall(r"\]\(([^)]+)\)", (out / page).read_text()):
            assert (out / link).exists(), link
    named = " ".join(re.findall(r"[`(]([\w./*]+)[`)]", (out / "README.md").read_text()))
    assert all(
        name.split("/")[0].split(".")[0] in named
        for name in written - {"README.md"}
        if "pictures" not in name
    )
    for part in report["parts"]:
        assert {f"cad/{part}.stl", f"cad/{part}.step"} <= written
    assert (out / "pictures/exploded.png").read_bytes().startswith(b"\x89PNG")
    # the copy is a sensor file; no file is overwritten
    assert main(["fabricate", str(out / "sensor.toml"), "--out", str(out)]) == 2
    assert "nothing is overwritten" in capsys.readouterr().err


def test_an_infeasible_design_gives_one_line_and_no_folder(capsys, tmp_path):
    assert main(["new", "sensor", str(tmp_path / "mine")]) == 0
    path = tmp_path / "mine.toml"
    path.write_text(path.read_text().replace("wall_mm = 3.0", "wall_mm = 0.5"))
    capsys.readouterr()
    for arguments, words in (
        ([path], "mine.toml: frame.wall_mm: 0.5 is too thin a wall; at least 1.2"),
        (["dense", "--pixel-um", "0"], "--pixel-um: '0' is not a number from 0.5 to 50"),
        (["dense", "--press-mm", "25"], "--press-mm: 25 "),
        (["dens"], "dens: unknown sensor (valid: dense, "),
    ):
        assert main(["fabricate", *map(str, arguments), "--out", str(tmp_path / "a" / "b")]) == 2
        reported = capsys.readouterr().err
        assert reported.count("\n") == 1 and words in reported
    assert not (tmp_path / "a").exists()


def test_missing_parts_are_named(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(
        "mjtactile.fabrication.mesh.find_spec", lambda name: None if name == "manifold3d" else name
    )
    assert main(["fabricate", "dense", "--out", str(tmp_path / "a")]) == 2
    assert (
        "needs manifold3d: pip install 'mjtactile[fabrication]'"
    ) in capsys.readouterr().err and not (tmp_path / "a").exists()
