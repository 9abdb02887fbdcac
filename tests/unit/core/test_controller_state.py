"""Tests of the written part of a controller's memory: its JSON matches the kept values."""

import json
import math
from enum import Enum, IntEnum, StrEnum

import numpy as np
import pytest

from mjtactile.core.controller_state import DEEPEST, ENTRIES_MAX, plain


class Number(IntEnum):
    ONE = 1


class Word(StrEnum):
    UP = "up"


def nested(depth: int) -> list:
    found: list = []
    for _ in range(depth):
        found = [found]
    return found


def cyclic() -> dict:
    found: dict = {}
    found["again"] = [found, found]
    return found


@pytest.mark.parametrize(
    ("value", "kept"),
    [
        (1.5, 1.5),
        (None, None),
        (True, True),
        ("text", "text"),
        (np.float32(0.5), 0.5),
        (np.arange(3), [0, 1, 2]),
        ((1, [2.0, "b"]), [1, [2.0, "b"]]),
        ({"a": {"b": 1}}, {"a": {"b": 1}}),
        (Number.ONE, 1),
        (Word.UP, "up"),
    ],
)
def test_numbers_texts_lists_and_tables_are_kept(value, kept):
    found, left_out = plain({"name": value})
    assert json.loads(json.dumps(found)) == {"name": kept} and not left_out
    assert type(found["name"]) is type(kept)  # no Enum: its class is unknown in other programs


@pytest.mark.parametrize(
    "value",
    [
        object(),
        lambda: None,
        Enum("Colour", ["RED"]).RED,  # type: ignore[attr-defined]
        2**70,
        10**5000,
        "x" * (ENTRIES_MAX + 1),
        [0.0] * (ENTRIES_MAX + 1),
        [[0.0] * (ENTRIES_MAX // 2)] * 3,
        np.zeros(ENTRIES_MAX + 1),
        np.array([object()]),
        nested(DEEPEST + 2),
        nested(100_000),
        cyclic(),
        {(1, 2): 3},
    ],
    ids=lambda value: type(value).__name__,
)
def test_unsupported_values_are_omitted_by_name(value):
    found, left_out = plain({"before": 1.0, "odd": value, "after": math.inf})
    assert found == {"before": 1.0, "after": math.inf}
    assert left_out == (f"odd ({type(value).__name__})",)


def test_a_memory_of_very_many_entries_is_truncated():
    found, left_out = plain(dict.fromkeys(range(1_000_000), 0.0))
    assert 1_000 < len(found) < ENTRIES_MAX and len(left_out) < 100
