"""Tests of the command `mjtactile experiments`."""

import json

import pytest

from mjtactile.cli import main


@pytest.mark.slow(6)
def test_quick_figures_and_table(capsys, tmp_path):
    assert (
        main(["experiments", "--only", "fig5b,fig6", "--quick", "--out", str(tmp_path), "--json"])
        == 0
    )
    result = json.loads(capsys.readouterr().out)
    assert {p.name for p in tmp_path.iterdir()} == {
        "experiments.json",
        "experiments.md",
        "fig5b.png",
        "fig6.png",
    }
    assert result["fig6"]["summary"]["mean_mm"] < 0.39  # the paper's
    solid = result["fig5b"]["solid"]
    sponge = result["fig5b"]["sponge"]
    # before a contact is detected, both are unknown
    kept = [abs(d) for d in solid["own_deformation_mm"] if d is not None]
    given = [d for d in sponge["own_deformation_mm"] if d is not None]
    # a solid keeps its shape to 0.2 mm (bending of the reconstruction at sharp edges), the sponge
    # yields by millimetres
    assert max(kept) < 0.3 < 0.8 < max(given)
    assert sponge["force_N"][-1] < solid["force_N"][-1]
    table = (tmp_path / "experiments.md").read_text()
    assert "0.39 mm" in table and "5b: sponge" in table


def test_an_unknown_experiment_lists_the_choices(capsys):
    assert main(["experiments", "--only", "fig9"]) == 2
    error = capsys.readouterr().err
    assert "fig9" in error and "fig5a" in error and len(error.strip().splitlines()) == 1
