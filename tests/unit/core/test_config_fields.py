"""Tests of dataclass fields that define their form in a file: written values are read back, and
errors are named."""

from dataclasses import dataclass

import numpy as np
import pytest

from mjtactile.core.config_fields import (
    DEGREE,
    MM,
    entry,
    file_path,
    flag,
    from_table,
    integer,
    number,
    numbers,
    part,
    parts,
    read,
    text,
    write,
)
from mjtactile.core.errors import InputError
from mjtactile.core.field_types import NumberArray, Pairs, Span, Texts
from mjtactile.core.toml import Section


@dataclass(frozen=True)
class Wheel:
    teeth: int = integer("teeth", 3, 1000)
    radius: float = number("radius_mm", 0.1, 100, MM, default=0.01)


@dataclass(frozen=True, eq=False, kw_only=True)
class Machine:
    kind: str = text("kind", ("geared", "free"))
    first: Wheel = part("first", Wheel)
    others: tuple[Wheel, ...] = parts("other", Wheel, low=0)
    ratio: float = number("ratio", 1, 9, default=2.0, required=True, only_if=("kind", ("geared",)))
    reach: tuple[float, float] = entry(
        Span(key="reach_max_mm", low_key="reach_min_mm", low=0, high=50, unit=MM)
    )
    turns: tuple[float, ...] = numbers("rotation_deg", "xy", -90, 90, DEGREE, default=(0.0, 0.0))
    law: tuple = entry(Pairs(key="law_deg_mm", units=(DEGREE, MM)))
    names: tuple[str, ...] = entry(Texts(key="names"), ())
    places: np.ndarray = entry(NumberArray(key="positions_mm", shape=(None, 2), unit=MM))
    manual: object = file_path("manual")
    is_on: bool = flag("is_on", default=False)


TABLE = {
    "kind": "geared",
    "first": {"teeth": 10, "radius_mm": 2.0},
    "other": [{"teeth": 20, "radius_mm": 4.0}],
    "ratio": 3.0,
    "reach_min_mm": 1.0,
    "reach_max_mm": 8.0,
    "rotation_deg": [90.0, -45.0],
    "law_deg_mm": [[0.0, 1.0], [90.0, 2.0]],
    "names": ["a", "b"],
    "positions_mm": [[1.0, 2.0], [4.0, 8.0]],
    "manual": None,
    "is_on": True,
}


def test_values_are_si_and_written_unchanged():
    machine = from_table(Machine, TABLE, "a/b.toml")
    assert machine.first == Wheel(10, 0.002) and machine.others == (Wheel(20, 0.004),)
    assert machine.reach == (0.001, 0.008) and machine.turns[0] == pytest.approx(np.pi / 2)
    assert machine.law[1] == pytest.approx((np.pi / 2, 0.002)) and machine.names == ("a", "b")
    assert machine.places[1, 1] == 0.008 and not machine.places.flags.writeable
    assert write(machine) == TABLE


def test_a_file_is_searched_next_to_the_file_that_names_it():
    assert str(from_table(Machine, {**TABLE, "manual": "x.pdf"}, "a/b.toml").manual) == "a/x.pdf"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "free"}, "ratio: unknown field"),
        ({"ratio": None}, "ratio: missing field"),
        ({"first": {"teeth": 2}}, "first.teeth: 2 is outside 3 to 1000"),
        ({"other": [{"teeth": 3}] * 3}, "other: has 3 sections, expected 0 to 2"),
        ({"other": [{"teeth": 3, "size": 1}]}, r"other\[0\].size: unknown field"),
        ({"reach_max_mm": 1.0}, "reach_max_mm: 1 is not above reach_min_mm = 1"),
        ({"rotation_deg": [91, 0]}, r"rotation_deg\[0\]: 91 is outside -90 to 90"),
        ({"is_on": 1}, "is_on: 1 is not true or false"),
    ],
)
def test_an_error_is_named_with_its_file(change, message):
    with pytest.raises(InputError, match=f"^b.toml: {message}"):
        from_table(Machine, {**TABLE, **change}, "b.toml")


def test_a_given_field_is_not_read():
    assert read(Wheel, Section({"radius_mm": 1}, "", "f"), teeth=1) == Wheel(1, 0.001)
