"""Tests of MJCF from any source: a file that would expand too much is rejected immediately."""

import pytest

from mjtactile.core.errors import InputError
from mjtactile.sim.scenes.mjcf import MOST, read_mjcf

GEOM = '<geom size="0.01"/>'


def scene(inside):
    return f"<mujoco><worldbody>{inside}</worldbody></mujoco>"


@pytest.mark.parametrize(
    ("inside", "field"),
    [
        (f'<replicate count="10000000">{GEOM}</replicate>', "replicate"),
        (
            '<replicate count="1000"><body><replicate '
            f'count="1000">{GEOM}</replicate></body></replicate>',
            "replicate",
        ),
        ('<flexcomp type="grid" name="a" count="300 300 300"/>', "flexcomp"),
    ],
)
def test_too_many_copies(tmp_path, inside, field):
    (tmp_path / "many.xml").write_text(scene(inside))
    with pytest.raises(
        InputError, match=rf"many.xml: {field}: makes \d+ copies; at most {MOST} are allowed"
    ):
        read_mjcf(tmp_path / "many.xml")


def test_as_many_as_people_want(tmp_path):
    (tmp_path / "some.xml").write_text(
        scene(f'<replicate count="30" offset="0.1 0 0">{GEOM}</replicate>' * 2)
    )
    assert len(read_mjcf(tmp_path / "some.xml").geoms) == 60


@pytest.mark.parametrize(
    "text", ["", "<mujoco>", "\0", "<a/>", scene('<replicate count="x">' + GEOM + "</replicate>")]
)
def test_what_is_no_mjcf_is_one_line(tmp_path, text):
    (tmp_path / "bad.xml").write_text(text)
    with pytest.raises(InputError, match=r"bad\.xml: not valid MJCF: ") as caught:
        read_mjcf(tmp_path / "bad.xml")
    assert "\n" not in str(caught.value)
