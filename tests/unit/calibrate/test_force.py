"""Tests of `calibrate force` on images of simulated indentations. The drive is the load cell;
sensing receives only the images."""

import json

import cv2
import pytest

from mjtactile.calibrate.force import GRAVITY
from mjtactile.cli import main
from mjtactile.core.calibration import load_calibration
from mjtactile.core.design import load_sensor
from mjtactile.sim.rendering.renderer import Renderer
from mjtactile.sim.scenes.indentation import Indenter, PressWorld

DESIGN = load_sensor("dense")
DEPTHS = (1e-3, 1.6e-3, 2.2e-3, 2.8e-3)


@pytest.fixture(scope="module")
def press(tmp_path_factory):
    """Provide a folder with flat/, rest/ and loads (two images each), and the loads, N."""
    folder = tmp_path_factory.mktemp("press")
    world = PressWorld(DESIGN, Indenter("cylinder", 5e-3))
    renderer = Renderer(DESIGN, seed=2)

    def take(name, count):
        (folder / name).mkdir()
        for i in range(count):
            cv2.imwrite(
                str(folder / name / f"{i}.png"),
                renderer.render(*world.marker_poses(0), world.time).pixels,
            )

    world.inflate(0.0, seal=False)
    take("flat", 4)
    world.inflate(DESIGN.chamber.supply_gauge, seal=True)
    take("rest", 4)
    take("load0", 2)
    forces = {"load0": 0.0}
    for i, depth in enumerate(DEPTHS, 1):
        world.press(depth)
        take(f"load{i}", 2)
        forces[f"load{i}"] = -float(world.drive_force[2])
    return folder, forces


def calibrate(folder, rows, header="image,force_N"):
    table = folder / "loads.csv"
    table.write_text("\n".join([header, *(f"{name},{value}" for name, value in rows)]) + "\n")
    return main(
        [
            "calibrate",
            "force",
            str(table),
            "--flat",
            str(folder / "flat"),
            "--rest",
            str(folder / "rest"),
            "--out",
            str(folder / "force.json"),
            "--json",
        ]
    )


def test_the_force_estimated_is_the_load(press, capsys):
    folder, forces = press
    assert calibrate(folder, forces.items()) == 0
    result = json.loads(capsys.readouterr().out)
    # flat-ended cylinder, 3 mm mesh: forces are good to 5 % or 30 mN
    assert result["scale"] == pytest.approx(1.0, abs=0.1)
    assert abs(result["offset_N"]) < 0.05 and result["residual_N"] < 0.05
    assert 2e4 < result["area_constant_N_per_m2"] < 2e5  # as in tests/physics/test_paper_force.py
    assert [row["force_N"] for row in result["loads"]] == pytest.approx(list(forces.values()))
    part = load_calibration(folder / "force.json").force
    assert part.scale == result["scale"] and part.largest == max(forces.values())


def test_weights_in_grams_are_the_same_loads(press, capsys):
    folder, forces = press
    assert (
        calibrate(
            folder,
            [(name, 1e3 * force / GRAVITY) for name, force in forces.items()],
            "image,mass_g",
        )
        == 0
    )
    assert json.loads(capsys.readouterr().out)["loads"][2]["force_N"] == pytest.approx(
        forces["load2"]
    )


def test_a_membrane_of_another_stiffness_and_a_mixed_up_list_are_refused(press, capsys):
    folder, forces = press
    assert calibrate(folder, [(name, 1.6 * force) for name, force in forces.items()]) == 1
    assert "thickness, modulus" in json.loads(capsys.readouterr().out)["reasons"][0]
    assert (
        calibrate(
            folder,
            [(name, force) for name, force in zip(forces, reversed(forces.values()), strict=True)],
        )
        == 1
    )
    assert json.loads(capsys.readouterr().out)["verdict"] == "refused"
    assert calibrate(folder, [("load0", f) for f in forces.values()]) == 1
    assert (
        "check that the load acts on the membrane"
        in json.loads(capsys.readouterr().out)["reasons"][0]
    )


@pytest.mark.parametrize(
    ("rows", "header", "words"),
    [
        ([("load0", 0), ("load1", 1)], "image,force_N", ("different loads", "force_N")),
        ([("load0", "heavy")] * 4, "image,force_N", ("loads.csv", "line 2", "force_N")),
        ([("nowhere", 0.1)], "image,force_N", ("nowhere",)),
        ([("load0", 0.1)], "image,newton", ("missing column", "force_N")),
    ],
)
def test_bad_tables_name_the_field(press, capsys, rows, header, words):
    assert calibrate(press[0], rows, header) == 2
    text = json.loads(capsys.readouterr().out)["error"]
    assert all(word in text for word in words), text
