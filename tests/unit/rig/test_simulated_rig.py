"""Tests of rig files of simulated rigs: shipped files load; wrong files are refused with file,
field and valid choices."""

import copy
import math
import tomllib
from pathlib import Path

import pytest

from mjtactile.core import resources
from mjtactile.core.errors import InputError
from mjtactile.rig.file import load_rig_file, load_sim_rig
from mjtactile.rig.jaw_transmission import make_law
from mjtactile.rig.simulated import sim_rig_from_table

SIMULATED = ("sim", "sim_arm", "sim_three_finger")
PATH = resources.find("sim_three_finger", "models/rigs", ".toml").with_name("test.toml")


@pytest.fixture
def table():
    return copy.deepcopy(
        tomllib.loads(resources.find("sim_three_finger", "models/rigs", ".toml").read_text())
    )


@pytest.mark.parametrize("name", SIMULATED)
def test_shipped_files_load_with_their_units(name):
    rig = load_sim_rig(name)
    low, high = rig.gripper.opening
    assert 0 <= low < rig.gripper.start <= high < 0.2  # opening, m
    assert rig.backend == "sim" and rig.model.is_file() and rig.gripper.speed == pytest.approx(0.05)


def test_the_crank_of_three_fingers_is_read_with_its_units():
    (jaw,) = load_sim_rig("sim_three_finger").gripper.actuators
    # twice 25 mm + 60 mm sin(30 degrees)
    assert jaw.transmission.part(math.radians(30)) == pytest.approx(0.110)


def test_a_sensor_file_next_to_the_rig_file_is_found(table, tmp_path):
    (tmp_path / "mine.toml").touch()
    (tmp_path / "model.xml").touch()
    table["sim"]["model"] = "model.xml"
    table["finger"][0]["sensor"] = "mine.toml"
    table["finger"][1]["sensor"] = "paper16"
    rig = sim_rig_from_table(table, tmp_path / "rig.toml")
    assert [finger.sensor for finger in rig.fingers] == [
        str(tmp_path / "mine.toml"),
        "paper16",
        None,
    ]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.pop("finger"), r"finger: missing field"),
        (lambda t: t.update(finger=[]), r"finger: has 0 sections, expected 1 to 8"),
        (
            lambda t: t["finger"][1].update(name="first"),
            r"finger\.name: 2 fingers are named 'first'",
        ),
        (lambda t: t["finger"][1].update(name="a/b"), r"finger\[1\]\.name: 'a/b' contains a slash"),
        (lambda t: t["finger"][1].pop("site"), r"finger\[1\]\.site: missing field"),
        (lambda t: t["sim"].update(model="no.xml"), r"sim\.model: no such file: .*no\.xml"),
        (lambda t: t["sim"].update(tabel=False), r"unknown field, did you mean 'table'"),
        (
            lambda t: t["gripper"]["actuator"][0].update(transmission="rod"),
            r"'rod' is unknown \(valid: rack, slide, " r"tendon, crank, table\)",
        ),
        (
            lambda t: t["gripper"]["actuator"][0].update(mm_per_rad=0),
            r"actuator\[0\]\.mm_per_rad: 0 moves " r"nothing",
        ),
        (
            lambda t: t["gripper"]["actuator"][0].update(transmission="slide"),
            r"mm_per_mm: missing field; there is " r"'mm_per_rad'",
        ),
        (lambda t: t["gripper"].update(opening_start_mm=200), r"opening_start_mm: 200 is outside"),
        (lambda t: t["gripper"].update(opening_max_mm=20), r"20 is not above opening_min_mm = 22"),
        (
            lambda t: t["lift"].update(kind="crane"),
            r"'crane' is unknown \(valid: actuator, " r"mocap, arm, none\)",
        ),
        (lambda t: t["lift"].update(kind="arm", body=1), r"lift\.body: unknown field"),
    ],
)
def test_a_wrong_field_is_named(table, change, message):
    change(table)
    with pytest.raises(InputError, match=message) as caught:
        sim_rig_from_table(table, PATH)
    assert str(PATH) in str(caught.value)


def test_rig_files_of_devices_and_simulation_are_distinguished():
    with pytest.raises(
        InputError, match=r"sim_arm\.toml: \[sim\]: is simulated: " r"it has no devices"
    ):
        load_rig_file("sim_arm")
    with pytest.raises(InputError, match=r"emulated\.toml: \[sim\]: is not simulated"):
        load_sim_rig(Path("emulated"))


@pytest.mark.parametrize(
    "law",
    [
        make_law("linear", 0.02, -0.012),
        make_law("crank", 0.05, 0.06),
        make_law("table", 0, 0, [(-1.0, 0.09), (0.0, 0.05), (1.0, 0.02)]),
    ],
)
def test_laws_are_inverted_and_their_slope_is_the_derivative(law):
    for coordinate in (-0.9, -0.3, 0.4, 0.8):
        assert law.coordinate(law.part(coordinate)) == pytest.approx(coordinate, abs=1e-12)
        h = 1e-6
        slope = (law.part(coordinate + h) - law.part(coordinate - h)) / (2 * h)
        assert law.slope(coordinate) == pytest.approx(slope, rel=1e-6)  # of a central difference
    assert law.is_reachable(0.5)


@pytest.mark.parametrize(
    "table", [[], [(0, 1)], [(0, 1), (0, 2)], [(0, 1), (1, 2), (2, 1)], [(0, 1), (1, 1)]]
)
def test_a_table_that_cannot_be_inverted_is_refused(table):
    with pytest.raises(ValueError, match="at least two pairs"):
        make_law("table", 0, 0, table)
