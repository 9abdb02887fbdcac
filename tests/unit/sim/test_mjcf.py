"""Tests of MJCF from any source: a file that would expand too much is rejected immediately."""

import os
import resource

import pytest

from mjtactile.core import resources
from mjtactile.core.errors import InputError
from mjtactile.sim.scenes import mjcf_trial
from mjtactile.sim.scenes.mjcf import COPIES_MAX, read_mjcf

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
def test_too_many_copies_are_refused(tmp_path, inside, field):
    (tmp_path / "many.xml").write_text(scene(inside))
    with pytest.raises(
        InputError, match=rf"many.xml: {field}: makes \d+ copies; at most {COPIES_MAX} are allowed"
    ):
        read_mjcf(tmp_path / "many.xml")


def test_usual_numbers_of_copies_are_accepted(tmp_path):
    (tmp_path / "some.xml").write_text(
        scene(f'<replicate count="30" offset="0.1 0 0">{GEOM}</replicate>' * 2)
    )
    assert len(read_mjcf(tmp_path / "some.xml").geoms) == 60


@pytest.mark.parametrize(
    "text", ["", "<mujoco>", "\0", "<a/>", scene('<replicate count="x">' + GEOM + "</replicate>")]
)
def test_a_file_that_is_not_mjcf_is_one_line(tmp_path, text):
    (tmp_path / "bad.xml").write_text(text)
    with pytest.raises(InputError, match=r"bad\.xml: not valid MJCF: ") as caught:
        read_mjcf(tmp_path / "bad.xml")
    assert "\n" not in str(caught.value)


def texture(inside):
    return f'<mujoco><asset><texture name="t" type="2d" {inside}/></asset><worldbody/></mujoco>'


HFIELD = '<hfield name="h" nrow="20000" ncol="20000" size="1 1 1 1"/>'
UNBOUNDED = {
    "texture": texture('builtin="checker" width="30000" height="30000"'),
    "cube texture": texture('builtin="flat" width="12000" height="72000"').replace("2d", "cube"),
    "height field": f"<mujoco><asset>{HFIELD}</asset><worldbody/></mujoco>",
    "many textures": "<mujoco><asset>"
    + "".join(
        f'<texture name="t{k}" type="2d" builtin="flat" width="9000" height="9000"/>'
        for k in range(20)
    )
    + "</asset><worldbody/></mujoco>",
    "user data": scene(GEOM).replace("<world", '<size nuserdata="2000000000"/><world', 1),
    "user data of geoms": scene(GEOM).replace("<world", '<size nuser_geom="500000000"/><world', 1),
}
"""Small files that need more than 1 GiB."""


@pytest.mark.parametrize("kind", UNBOUNDED)
def test_a_small_file_that_needs_much_memory_is_refused(tmp_path, monkeypatch, kind):
    """MuJoCo reads it in a child process with a limit: this process never has the memory."""
    if kind == "many textures":  # it takes 5 s to fill 1 GiB
        monkeypatch.setattr(mjcf_trial, "MEMORY", 1 << 28)
    (tmp_path / "big.xml").write_text(UNBOUNDED[kind])
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError, match=r"big\.xml: needs more than 1 GiB of memory or 10 s"):
        read_mjcf(tmp_path / "big.xml")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100 << 10  # KiB


def test_the_limits_count_included_and_attached_files(tmp_path):
    (tmp_path / "part.xml").write_text(
        texture('builtin="checker" width="30000" height="30000"').replace(
            "mujoco>", "mujocoinclude>"
        )
    )
    (tmp_path / "a.xml").write_text('<mujoco><include file="part.xml"/></mujoco>')
    with pytest.raises(InputError, match="needs more than 1 GiB"):
        read_mjcf(tmp_path / "a.xml")
    (tmp_path / "model.xml").write_text(
        scene(f'<body name="b">{GEOM}</body>').replace(
            "<world", f"<asset>{HFIELD}</asset><world", 1
        )
    )
    (tmp_path / "b.xml").write_text(
        '<mujoco><asset><model name="m" file="model.xml"/></asset><worldbody>'
        '<attach model="m" body="b" prefix="p"/></worldbody></mujoco>'
    )
    with pytest.raises(InputError, match="needs more than 1 GiB"):
        read_mjcf(tmp_path / "b.xml")


def test_a_small_file_that_needs_much_time_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(mjcf_trial, "TIME", 1)
    (tmp_path / "part.xml").write_text(
        f'<mujocoinclude><replicate count="19000"><replicate count="190">{GEOM}</replicate>'
        "</replicate></mujocoinclude>"
    )
    (tmp_path / "slow.xml").write_text(scene('<include file="part.xml"/>'))
    with pytest.raises(InputError, match="needs more than 1 GiB of memory or 10 s"):
        read_mjcf(tmp_path / "slow.xml")


@pytest.mark.parametrize(
    ("text", "folder"),
    [
        ('<mujoco><include file="pipe"/></mujoco>', "."),
        (texture('file="pipe"'), "."),
        (texture('file="pipe"').replace("<asset", '<compiler texturedir="in"/><asset'), "in"),
        ('<mujoco><include file="again.xml"/></mujoco>', "."),
        (texture('file="/dev/zero"'), "."),
    ],
    ids=["include", "texture", "folder", "included twice", "device"],
)
def test_a_pipe_or_device_in_a_file_is_refused(tmp_path, text, folder):
    (tmp_path / folder).mkdir(exist_ok=True)
    os.mkfifo(tmp_path / folder / "pipe")
    (tmp_path / "again.xml").write_text('<mujocoinclude><include file="pipe"/></mujocoinclude>')
    (tmp_path / "a.xml").write_text(text)
    with pytest.raises(InputError, match=r"a\.xml: names '.*', which is not a regular file"):
        read_mjcf(tmp_path / "a.xml")


def test_a_trial_does_not_change_a_good_file(tmp_path, monkeypatch):
    """A file with a texture is tried once; a plain file, and a shipped one, never."""
    (tmp_path / "good.xml").write_text(texture('builtin="checker" width="300" height="300"'))
    assert len(read_mjcf(tmp_path / "good.xml").textures) == 1
    monkeypatch.setattr(mjcf_trial.process, "start", lambda *_, **__: pytest.fail("a trial"))
    assert len(read_mjcf(tmp_path / "good.xml").textures) == 1
    (tmp_path / "plain.xml").write_text(scene(GEOM))
    assert len(read_mjcf(tmp_path / "plain.xml").geoms) == 1
    for path in resources.folder("models").glob("*/*.xml"):
        read_mjcf(path)
