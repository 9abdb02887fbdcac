"""Completed parts of `press`, `inflate` and `design` are kept after a failure or an interruption."""

import json

import pytest

from mjtactile.cli import main
from mjtactile.core.design import load_sensor
from mjtactile.design_study import design_sweep, json_output
from mjtactile.design_study.design_sweep import DesignCandidate
from mjtactile.design_study.score import Score
from mjtactile.experiments.indentation import IndentationPlan, press
from mjtactile.sim.scenes.indentation import Indenter


def test_steps_before_a_failure_are_written(tmp_path, capsys):
    """`dense` holds 1 kPa, but not 41 kPa."""
    out = tmp_path / "bulge"
    assert main(["inflate", "--pressure-kPa", "1:41:40", "--out", str(out), "--json"]) == 3
    printed = capsys.readouterr()
    result = json.loads(printed.out)
    assert [step["pressure_kPa"] for step in result["steps"]] == [1.0]
    assert "simulation failed" in result["stopped"]
    assert json.loads((out / "inflate.json").read_text()) == result
    assert "1 of 2 steps are complete" in printed.err


def test_steps_before_an_interruption_are_returned():
    """Ctrl-C at the second depth; without `keep_partial` it ends the caller, too."""
    plan = IndentationPlan(Indenter("sphere", 8e-3), [0.5e-3, 1e-3, 1.5e-3])

    def interrupt(message: str) -> None:
        if message.startswith("depth 1.00"):
            raise KeyboardInterrupt

    def pressed(*, keep_partial: bool):
        design = load_sensor("paper16")
        return press(design, plan, mesh=(9, 7), notify=interrupt, keep_partial=keep_partial)

    result = pressed(keep_partial=True)
    assert [round(step["depth_mm"], 1) for step in result["steps"]] == [0.5, 1.0]
    assert result["stopped"] == "interrupted"
    with pytest.raises(KeyboardInterrupt):
        pressed(keep_partial=False)


def test_designs_before_an_interruption_are_written(tmp_path, capsys, monkeypatch):
    """Ctrl-C after the first design of eight. Predictions, which take seconds, are replaced."""
    reached = Score(0.02, 0.01, 0.01, 0.005, 2e-4, 1e-4, 4e-3, 3.0)
    designs = iter([DesignCandidate(load_sensor("dense"), reached, ())])

    def interrupted(*given):
        try:
            return next(designs)
        except StopIteration:
            raise KeyboardInterrupt from None

    monkeypatch.setattr(design_sweep, "_evaluate_candidate", interrupted)
    monkeypatch.setattr(json_output, "score", lambda design, force: reached)
    monkeypatch.setattr(json_output, "check_by_simulation", lambda design: None)
    out = tmp_path / "designs"
    assert main(["design", "--edge-mm", "0.2", "--count", "8", "--out", str(out)]) == 3
    result = json.loads((out / "design.json").read_text())
    assert result["stopped"] == "interrupted"
    assert len(result["candidates"]) == 1
    assert (out / "best_1.toml").is_file()
    assert "interrupted; the result is that of" in capsys.readouterr().err
