"""Tests of the commands `mjtactile inflate` and `mjtactile press`."""

import json

import pytest

from mjtactile.cli import main
from mjtactile.commands.press import _shape_line


def run_json(capsys, *args):
    assert main([*args, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_inflate_reports_height_and_theory(capsys, tmp_path):
    result = run_json(
        capsys,
        "inflate",
        "--sensor",
        "paper16",
        "--pressure-kPa",
        "0:1:0.5",
        "--out",
        str(tmp_path / "o"),
    )
    steps = result["steps"]
    assert [s["pressure_kPa"] for s in steps] == [0.0, 0.5, 1.0]
    # 40 x 30 x 20 mm; the membrane sags under gravity by 7 um
    assert steps[0]["volume_mL"] == pytest.approx(24.0, rel=1e-3)
    for step in steps[1:]:
        # 1.5 % of the default mesh and 2 % of the closed form, whose two terms assume one shape
        assert step["centre_height_mm"] == pytest.approx(step["theory_height_mm"], rel=0.015)
        assert step["max_stretch"] > 1.05  # the sensor's pre-stretch
    assert {p.name for p in (tmp_path / "o").iterdir()} == {"inflate.json", "inflate.png"}


def test_press_estimates_equal_the_load_cell(capsys):
    result = run_json(capsys, "press", "--indenter", "sphere:16", "--depth-mm", "1:2:1")
    for step in result["steps"]:
        assert step["converged"] and step["status"] == "ok"
        # contact and drive carry the same force; 1 % covers the last of the settling
        assert step["force_true_N"][2] == pytest.approx(step["drive_force_N"][2], rel=0.01)
        # 0.04 N is the paper's error; half of it is the discretization error of 13 x 11 vertices
        assert step["force_estimated_N"][2] == pytest.approx(step["force_true_N"][2], abs=0.04)
    shallow, deep = result["steps"]
    assert deep["force_true_N"][2] < 2 * shallow["force_true_N"][2] < 0  # stiffens with depth
    assert (
        deep["pressure_kPa"] > shallow["pressure_kPa"] > 1.0
        and deep["volume_mL"] < shallow["volume_mL"]
    )
    shape = result["shape"]
    assert shape["kind"] == "smooth"
    assert 13 < shape["radius_mm"] < 19
    low, high = shape["area_interval_mm2"]
    assert 0 < low < shape["area_mm2"] < high
    assert "shape" not in result["flags"]


@pytest.mark.slow  # test_press_estimates_equal_the_load_cell is another `press`
def test_press_simulates_a_mesh_that_has_the_shape_it_reports(capsys):
    press = ("press", "--indenter", "sphere:5.3")
    fine = run_json(capsys, *press)
    assert fine["mesh"] == [25, 21] and not fine["flags"]
    # 10 % is one standard deviation of the radius; a mesh of 13 x 11 is 15 % off
    assert fine["shape"]["radius_mm"] == pytest.approx(5.3, rel=0.1)
    area = fine["steps"][-1]["contact_area_true_mm2"]
    assert fine["shape"]["area_mm2"] == pytest.approx(area, rel=0.1)
    # an explicit mesh is kept, and the advice of its flag is the mesh without a flag
    coarse = run_json(capsys, *press, "--mesh", "13x11", "--depth-mm", "1")
    assert coarse["mesh"] == [13, 11]
    assert "--mesh 25x21" in coarse["flags"]["shape"]["reason"]


def test_the_printed_probability_is_that_of_the_printed_kind():
    shape = {
        "kind": "edge",
        "family": "cylinder",
        "probabilities": {"smooth": 0.04, "edge": 0.96},
        "radius_mm": None,
        "direction_deg": None,
        "area_mm2": 20.0,
        "area_interval_mm2": (18.0, 22.0),
    }
    assert _shape_line(shape).startswith("shape: edge (96 %), best model cylinder")


def test_open_valve_keeps_the_pressure(capsys):
    result = run_json(
        capsys,
        "press",
        "--indenter",
        "cylinder:6",
        "--depth-mm",
        "2",
        "--valve",
        "open",
        "--sensor",
        "paper16",
    )
    # exactly the supply pressure
    assert result["steps"][0]["pressure_kPa"] == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (("press", "--indenter", "sphere"), ("--indenter", "sphere:R_mm", "FILE.stl")),
        (("press", "--indenter", "sphere:8", "--mesh", "3x11"), ("--mesh", "5 to 101")),
        (("press", "--indenter", "sphere:8", "--mesh", "25"), ("--mesh", "NXxNY")),
        (("press", "--indenter", "cone:3"), ("cone:3", "box:A_mm")),
        (("press", "--indenter", "missing.stl"), ("missing.stl", "no such file")),
        (("press", "--indenter", "sphere:8", "--position-mm", "30,0"), ("--position-mm", "20 mm")),
        (("press", "--indenter", "sphere:8", "--depth-mm", "25"), ("--depth-mm", "20 mm")),
        (
            ("press", "--indenter", "sphere:8", "--depth-mm", "4:0:1"),
            ("--depth-mm", "does not lead"),
        ),
        (("inflate", "--pressure-kPa", "nan"), ("--pressure-kPa", "nan")),
        (("inflate", "--pressure-kPa=-200"), ("--pressure-kPa", "vacuum")),
        (("inflate", "--pressure-kPa", "1", "--sensor", "nope"), ("nope", "dense", "paper16")),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(capsys, args, words):
    assert main(list(args)) == 2
    captured = capsys.readouterr()
    lines = captured.err.strip().splitlines()
    assert len(lines) == 1 and captured.out == ""
    for word in words:
        assert word in lines[0]
