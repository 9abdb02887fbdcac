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
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    write_fake_recording(folder, count=6)
    return folder


def changed(lines, seed):
    """One to three values anywhere in the lines' JSON replaced or taken out."""
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
def test_damage_never_gets_beyond_the_reader(tmp_path, whole, damage):
    lines = (whole / "log.jsonl").read_bytes().splitlines(keepends=True)
    sound = load_recording(whole)
    reported = 0
    for seed in range(300):
        (tmp_path / "log.jsonl").write_bytes(damage(lines, seed))
        try:
            found = load_recording(tmp_path)
        except InputError:
            continue
        reported += bool(found.problems)
        for key in found.columns if len(found) else ():
            want = sound.columns.get(key)
            got = found.columns[key]
            if want is not None and want.dtype == float:
                assert got.dtype == float and got.shape[1:] == want.shape[1:], (seed, key)
        assert not len(found) or np.isfinite(found.columns["time"]).all()
        for names in found.columns["images"] if len(found) else ():
            assert all(
                (tmp_path / name).resolve().is_relative_to(tmp_path.resolve()) for name in names
            )
    assert reported > 100  # most changes are to checked content


def test_the_line_and_the_column_are_named(tmp_path, whole):
    lines = (whole / "log.jsonl").read_text().splitlines()
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
def test_a_damaged_image_costs_its_cycle_only(tmp_path, damage):
    """A power cut leaves the last files empty; a bit may flip anywhere."""
    write_fake_recording(tmp_path, count=6)
    path = next(one for one in images_of(tmp_path) if one.name.startswith("000003"))
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
def test_what_pages_show_of_a_header_is_checked(row, wrong):
    assert wrong_note(row) == wrong
