"""Tests of loading protocols of a sensor, and of their note in a recording."""

import json
import math

import pytest

from mjtactile.core import resources
from mjtactile.core.errors import InputError
from mjtactile.recording.files import to_json
from mjtactile.recording.stage_protocol import (
    PROTOCOLS,
    Move,
    Stage,
    describe,
    read_moves,
    stage_from_note,
)


@pytest.mark.parametrize("name", resources.names(PROTOCOLS, ".csv"))
def test_shipped_protocols_load(name):
    assert read_moves(name)[-1].time > 0


def test_a_note_is_read_back(tmp_path):
    moves = (Move(1.0, 2e-3, 0.0, 5e-3), Move(2.0), Move(3.0, 1e-3, -5e-4, 2e-3, 0.25))
    stage = Stage("sphere:8", (1e-3, 0.0), moves)
    back = stage_from_note(json.loads(json.dumps(to_json(stage.note()))), "log.jsonl")
    assert back.indenter == stage.indenter and back.at == stage.at
    assert [m.time for m in back.moves] == [1, 2, 3] and math.isnan(back.moves[1].depth)
    assert back.moves[2].force == pytest.approx(0.25) and back.moves[2].shear == pytest.approx(
        -5e-4
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s,depth\n1,2\n", "column 'depth'"),
        ("depth_mm\n2\n", "column time_s is missing"),
        ("time_s,depth_mm\n", "has no moves"),
        ("time_s,depth_mm\n2,1\n1,1\n", "not later"),
        ("time_s,depth_mm\n1,deep\n", "'deep' is not a number"),
        ("time_s,depth_mm\n,1\n", "missing"),
    ],
)
def test_each_error_is_named(tmp_path, text, message):
    (tmp_path / "p.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        read_moves(tmp_path / "p.csv")


def test_a_person_receives_instructions():
    assert describe(Move(1.0, 2e-3, 1e-3, 5e-3)) == (
        "1 s: move to 2 mm below the first contact, 1 mm along x, at 5 mm/s"
    )
    assert describe(Move(9.0)) == "9 s: lift off"
