"""Tests that cases of `bench references` are read strictly, and that a deviating number is
reported."""

import pytest

from benchmarks.reference_cases import run
from benchmarks.reference_cases.cases import MOTIONS, load_case, load_cases
from benchmarks.reference_cases.measure import measure
from mjtactile.core.errors import InputError

BULGE = """about = "a bulge"
sensor = "dense"

[bulge]
height = [[1.0, 2.45]]

[reference]
source = "a test"
percent = 2.0
tolerance_min = 0.0
"""


def write(tmp_path, text, name="mine.toml"):
    (tmp_path / name).write_text(text)
    return tmp_path / name


def test_shipped_references_can_be_read_and_use_every_motion():
    cases = load_cases()
    assert {case.motion for case in cases} >= set(MOTIONS) - {"bulge"}
    assert all(case.about and case.source and case.percent + case.minimum > 0 for case in cases)


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("[bulge]", "[blow]", ["expected one", "press, bulge"]),
        ("2.45]]", "2.45]]\n[spin]\naxis = [0, 0, 1]", ["2 motions"]),
        ('source = "a test"', "", ["source"]),
        ("height", "hight", ["height", "hight"]),
        ('"dense"', '"dens"', ["dens"]),
        ("percent = 2.0", "percent = -1", ["percent"]),
    ],
)
def test_a_case_that_is_wrong_is_one_line(tmp_path, before, after, words):
    with pytest.raises(InputError) as error:
        load_case(write(tmp_path, BULGE.replace(before, after)))
    assert all(word in str(error.value) for word in words) and "\n" not in str(error.value)


def test_a_folder_without_cases(tmp_path):
    with pytest.raises(InputError, match="--cases"):
        load_cases(tmp_path)


def test_an_indenter_of_several_geoms_presses_with_all(tmp_path):
    """The force of two balls is larger than that of one at the same depth, and less than twice as
    large, since their indentations overlap."""
    press = BULGE.replace("[bulge]", "[press]").replace(
        "height = [[1.0, 2.45]]", 'indenter = "balls.xml"\nforce = [[1.0, 0.1]]\nestimate = false'
    )
    forces = []
    for places in ((0.0,), (-0.004, 0.004)):
        geoms = "".join(f'<geom type="sphere" size="0.003" pos="{x} 0 0"/>' for x in places)
        write(tmp_path, f"<mujoco><worldbody>{geoms}</worldbody></mujoco>", "balls.xml")
        forces += [number.measured for number in measure(load_case(write(tmp_path, press)))]
    assert 1.2 * forces[0] < forces[1] < 2 * forces[0]


def test_a_missed_reference_is_reported(tmp_path):
    write(tmp_path, BULGE.replace("2.45", "2.9"))
    result = run.run(tmp_path, notify=lambda _: None, cases=tmp_path)
    assert (result["met"], result["numbers"]) == (0, 1) and (tmp_path / "references.png").exists()
    rows = [line.split("|") for line in run.table(result).splitlines() if "0 of 1" in line]
    assert [row[1].strip() for row in rows] == ["a bulge", "all"]
    # every row has as many cells as the head
    assert {line.count("|") for line in run.table(result).splitlines()[2:]} == {10}
