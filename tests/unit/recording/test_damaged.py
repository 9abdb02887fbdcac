"""Tests of recordings with damage or changes: all undamaged parts are read, the rest is named, and
the reader does not fail.

Readers of a recording rely on these checks: kinds, shapes, and files inside the folder.
"""

import copy
import json
import random

import numpy as np
import pytest

from mjtactile.core.errors import InputError
from mjtactile.recording.log_validation import wrong_note
from mjtactile.recording.reader import load_recording
from tests.fake_run import write_fake_recording

VALUES = [
    None,
    True,
    -1,
    1e300,
    "x",
    "",
    [],
    {},
    [[]],
    [None],
    [1, 2, 3],
    {"a": 1},
    "../../etc/passwd",
    [["a"]],
    10**400,
]


@pytest.fixture(scope="module")
def complete(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    write_fake_recording(folder, count=6)
    return folder


def changed(lines, seed):
    """Replace or remove one to three values at random positions in the lines' JSON."""
    rng = random.Random(seed)
    rows = [json.loads(line) for line in lines]
    for _ in range(rng.choice([1, 1, 3])):
        node = rng.choice(rows)
        place = None
        while isinstance(node, (dict, list)) and node and (place is None or rng.random() < 0.7):
            key = rng.choice(list(node)) if isinstance(node, dict) else rng.randrange(len(node))
            place = (node, key)
            node = node[key]
        if place is not None:
            owner, key = place
            if isinstance(owner, dict) and rng.random() < 0.2:
                del owner[key]
            else:
                owner[key] = copy.deepcopy(rng.choice(VALUES))
    return b"".join(json.dumps(row).encode() + b"\n" for row in rows)


def flipped(lines, seed):
    rng = random.Random(seed)
    data = bytearray(b"".join(lines))
    for _ in range(rng.choice([1, 3, 30])):
        data[rng.randrange(len(data))] = rng.randrange(256)
    return bytes(data)


@pytest.mark.parametrize("damage", [changed, flipped])
def test_damaged_values_are_rejected_by_the_reader(tmp_path, complete, damage):
    lines = (complete / "log.jsonl").read_bytes().splitlines(keepends=True)
    sound = load_recording(complete)
    reported = 0
    for seed in range(300):
        (tmp_path / "log.jsonl").write_bytes(damage(lines, seed))
        try:
            found = load_recording(tmp_path)
        except InputError:
            continue
        reported += bool(found.problems)
        for key in found.columns if len(found) else ():
            expected = sound.columns.get(key)
            column = found.columns[key]
            if expected is not None and expected.dtype == float:
                assert column.dtype == float and column.shape[1:] == expected.shape[1:], (seed, key)
        assert not len(found) or np.isfinite(found.columns["time"]).all()
        for names in found.columns["images"] if len(found) else ():
            assert all(
                (tmp_path / name).resolve().is_relative_to(tmp_path.resolve()) for name in names
            )
    assert reported > 100  # most changes are to checked content


def test_the_line_and_the_column_are_named(tmp_path, complete):
    lines = (complete / "log.jsonl").read_text().splitlines()
    number = next(n for n, line in enumerate(lines) if '"kind": "cycle"' in line) + 3
    row = json.loads(lines[number])
    row["force_normal"] = [1.0, "2.0"]
    lines[number] = json.dumps(row)
    (tmp_path / "log.jsonl").write_text("\n".join(lines) + "\n")
    found = load_recording(tmp_path)
    assert len(found) == 5  # of 6
    assert found.problems[0] == f"1 lines left out: line {number + 1} is corrupt: force_normal"


def images_of(folder):
    return sorted((folder / "frames").glob("0*.png"))


@pytest.mark.parametrize("damage", ["empty", "cut", "flipped", "missing"])
def test_a_damaged_image_loses_only_its_cycle(tmp_path, damage):
    """A power cut leaves the last files empty; a bit may flip anywhere."""
    write_fake_recording(tmp_path, count=6)
    path = next(item for item in images_of(tmp_path) if item.name.startswith("000003"))
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    content = {"empty": b"", "cut": bytes(data[:-20]), "flipped": bytes(data)}
    if damage == "missing":
        path.unlink()
    else:
        path.write_bytes(content[damage])
    found = load_recording(tmp_path)
    assert len(found) == 5 and all(len(images) == 2 for images in found.images())
    assert not [name for names in found.columns["images"] for name in names if "000003" in name]
    assert found.problems == (f"1 cycles left out: image frames/{path.name} is missing or damaged",)


def test_without_any_image_the_log_is_read(tmp_path):
    write_fake_recording(tmp_path, count=6)
    for path in images_of(tmp_path):
        path.unlink()
    found = load_recording(tmp_path)
    assert len(found) == 6 and "6 cycles have no images" in found.problems[0]


@pytest.mark.parametrize(
    ("row", "wrong"),
    [
        ({"kind": "note", "simulated": {"mesh": ["<script>", 1], "timestep_ms": 4}}, "simulated"),
        ({"kind": "note", "simulated": {"mesh": [13, 11], "timestep_ms": "4"}}, "simulated"),
        (
            {"kind": "note", "simulated": {"timestep_ms": 4, "effects": [{"effect": 1}]}},
            "simulated",
        ),
        ({"kind": "start", "versions": {"numpy": 2}}, "versions"),
        ({"kind": "start", "command": ["grasp"]}, "command"),
        ({"kind": "note", "simulated": {"mesh": [13, 11], "timestep_ms": 4}}, None),
    ],
)
def test_header_values_shown_on_pages_are_checked(row, wrong):
    assert wrong_note(row) == wrong


def rewritten(source, folder, change):
    """Return a copy of a recording with `change(row)` applied to its lines."""
    rows = [json.loads(line) for line in (source / "log.jsonl").read_text().splitlines()]
    for row in rows:
        change(row)
    folder.mkdir(exist_ok=True)
    (folder / "log.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    return folder


def of_kind(kind, **values):
    """Return a change of all lines of a kind; None removes a key."""

    def change(row):
        if row["kind"] == kind:
            for key, value in values.items():
                row.pop(key, None)
                if value is not None:
                    row[key] = value

    return change


@pytest.mark.parametrize(
    "key",
    ["time", "phase", "images", "image_time", "status", "touching", "force_normal", "opening"]
    + ["speed", "effort", "lift_height", "valve_open"],
)
def test_a_cycle_without_a_required_column_is_left_out(tmp_path, complete, key):
    """Readers use these columns without a check of their own, in every version."""
    found = load_recording(rewritten(complete, tmp_path / "a", of_kind("cycle", **{key: None})))
    assert not len(found)
    assert f"corrupt: {key}" in found.problems[0]


@pytest.mark.parametrize(
    ("values", "wrong"),
    [
        ({"object_position_true": [1.0, 2.0, 3.0]}, "object_quaternion_true is missing"),
        (
            {"object_position_true": [1.0], "object_quaternion_true": [1.0, 0.0, 0.0, 0.0]},
            "object_position_true",
        ),
        ({"time": -1.0}, "time"),
    ],
)
def test_contradicting_columns_are_left_out(tmp_path, complete, values, wrong):
    found = load_recording(rewritten(complete, tmp_path / "a", of_kind("cycle", **values)))
    assert not len(found) and f"corrupt: {wrong}" in found.problems[0]


def test_lines_of_another_recording_are_left_out(tmp_path, complete):
    lines = (complete / "log.jsonl").read_text().splitlines()
    (tmp_path / "log.jsonl").write_text("\n".join([lines[0], *lines]) + "\n")
    assert len(load_recording(tmp_path)) == 6
    assert "line 2 is corrupt: it starts another recording" in load_recording(tmp_path).problems[0]


def test_time_that_runs_backwards_is_left_out(tmp_path, complete):
    lines = (complete / "log.jsonl").read_text().splitlines()
    cycles = [n for n, line in enumerate(lines) if '"kind": "cycle"' in line]
    first, last = cycles[0], cycles[-1]
    lines[first], lines[last] = lines[last], lines[first]
    (tmp_path / "log.jsonl").write_text("\n".join(lines) + "\n")
    found = load_recording(tmp_path)
    assert len(found) == 1  # the last cycle, which now is the first
    assert "its time is before that of an earlier cycle" in found.problems[0]


@pytest.mark.parametrize(
    "scenario",
    [
        *({"task": []}, {"task": {}}, {"controller": 3}, {"sensors": {"left": 3}}, {"seed": "x"}),
        *([], "egg", {"contact_shapes": "yes"}),
    ],
)
def test_a_header_with_a_wrong_scenario_is_refused_with_its_field(tmp_path, complete, scenario):
    with pytest.raises(InputError, match="line 1 is corrupt: scenario"):
        load_recording(rewritten(complete, tmp_path / "a", of_kind("start", scenario=scenario)))


def test_names_of_another_number_of_fingers_are_left_out(tmp_path, complete):
    def change(row):
        if row["kind"] == "end":
            row["fingers"] = ["one", "two", "three"]

    found = load_recording(rewritten(complete, tmp_path / "a", change))
    assert found.fingers == ("left", "right") and len(found) == 6
    assert "3 names of fingers for 2 cameras: left out" in found.problems
    for names in (["x", "x"], ["", "x"]):
        found = load_recording(rewritten(complete, tmp_path / "b", of_kind("end", fingers=names)))
        assert any("corrupt: fingers" in problem for problem in found.problems)


def test_a_reference_of_another_number_of_fingers_is_left_out(tmp_path, complete):
    row = {"kind": "reference", "stage": "flat", "images": [[]], "image_time": [[0.0]]}
    lines = (
        (complete / "log.jsonl").read_text() + json.dumps(row | {"gauge_pressure": [0.0]}) + "\n"
    )
    (tmp_path / "log.jsonl").write_text(lines)
    found = load_recording(tmp_path)
    assert found.references == ()
    assert any("has 1 fingers, the cycles 2" in problem for problem in found.problems)
    times = '"images": [], "image_time": [[0.0], [0.0]]'
    without = lines.replace('"images": [[]], "image_time": [[0.0]]', times)
    without = without.replace('"gauge_pressure": [0.0]}', '"gauge_pressure": [0.0, 0.0]}')
    (tmp_path / "log.jsonl").write_text(without)
    found = load_recording(tmp_path)  # recorded without images: its references have none
    assert [reference.stage for reference in found.references] == ["flat"]
    assert not any("fingers, the cycles" in problem for problem in found.problems)
