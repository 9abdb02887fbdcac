"""Tests of rig files: shipped files load; wrong files are refused with file, field and valid
choices."""

import copy
import tomllib
from pathlib import Path

import pytest

from mjtactile.core import resources
from mjtactile.core.design import load_sensor
from mjtactile.core.errors import InputError
from mjtactile.devices.dynamixel.jaw_kinematics import JawGeometry
from mjtactile.rig.file import RigFile, load_rig_file, read_rig_file, rig_from_table
from mjtactile.rig.registry import build_rig

PATH = Path("test.toml")


@pytest.fixture
def table():
    return copy.deepcopy(
        tomllib.loads(resources.find("two_xm430", "models/rigs", ".toml").read_text())
    )


SHIPPED = resources.names("models/rigs", ".toml")


@pytest.mark.parametrize(
    "name", [name for name in SHIPPED if isinstance(read_rig_file(name), RigFile)]
)
def test_shipped_rigs_load_and_their_units_are_right(name):
    rig = load_rig_file(name)
    geometry = JawGeometry(rig.gripper, name)
    low, high = rig.gripper.opening
    for opening in (0.1 * high, 0.5 * high, 0.9 * high):
        goals = geometry.goals(opening)
        # a tick is 1.5 mrad; 60 mm per rad make 0.05 mm of half a tick
        assert geometry.opening(goals) == pytest.approx(opening, abs=1e-4)
    assert 0 <= low < high < 0.5


@pytest.mark.parametrize(
    ("section", "key", "value", "message"),
    [
        ("bus", "watchdog_ms", 10, "10 is outside 20 to 2540"),
        ("bus", "baud", "fast", "'fast' is not a whole number"),
        ("bus", "watchdog_s", 0.1, "wrong unit"),
        ("bus", "reply_timeout_ms", float("nan"), "outside"),
        ("gripper", "opening_max_mm", -5.0, "outside"),
        ("gripper", "force_max_n", 5.0, "write it as 'force_max_N'"),
        ("gripper", "spede_max_mm_s", 5.0, "did you mean 'speed_max_mm_s'"),
        ("lift", "kind", "crane", r"valid: servo, none"),
    ],
)
def test_a_wrong_field_is_named(table, section, key, value, message):
    table[section][key] = value
    with pytest.raises(InputError, match=message) as caught:
        rig_from_table(table, PATH)
    assert f"test.toml: {section}.{key}" in str(caught.value)


def test_a_missing_field_is_named(table):
    del table["camera"][1]["source"]
    with pytest.raises(InputError, match=r"camera\[1\]\.source: missing field"):
        rig_from_table(table, PATH)


def test_a_field_in_another_unit_is_pointed_out(table):
    table["gripper"]["opening_max_cm"] = table["gripper"].pop("opening_max_mm") / 10
    with pytest.raises(
        InputError,
        match=r"gripper\.opening_max_mm: missing field; there " r"is 'opening_max_cm': wrong unit",
    ):
        rig_from_table(table, PATH)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t["gripper"]["servo"][1].update(id=1), "not all different"),
        (lambda t: t["camera"][1].update(finger="left"), "in this order"),
        (lambda t: t["valve"].pop(), "1 valves for 2 cameras"),
        (lambda t: t["valve"][1].update(channel=1), "valve: two fingers have the same valve"),
        (
            lambda t: t["camera"][1].update(source=t["camera"][0]["source"]),
            "camera: two fingers have the same camera",
        ),
        (lambda t: t["camera"][1].update(fourcc="MJPEG"), "'MJPEG' is not a code of four"),
        (
            lambda t: t["valve"][0].update(port="spy:///dev/null?file=/tmp/x"),
            "neither a device nor socket:// or rfc2217://",
        ),
        (lambda t: t["gripper"]["servo"].clear(), "has 0 sections"),
        (lambda t: t.update(bos={}), "bos: unknown section, did you mean .bus."),
    ],
)
def test_sections_that_do_not_fit_are_refused(table, change, message):
    change(table)
    with pytest.raises(InputError, match=message):
        rig_from_table(table, PATH)


def test_an_unknown_rig_lists_the_choices():
    with pytest.raises(
        InputError,
        match=r"unknown rig 'simm'.*valid: emulated, .*sim, " r".*FILE\.toml, replay:FOLDER",
    ):
        build_rig("simm", load_sensor("paper16"), object_name="egg", seed=0)


def test_a_missing_device_is_named_and_not_replaced():
    from mjtactile.core.errors import DeviceError

    with pytest.raises(DeviceError, match="left camera /dev/v4l/by-id/usb-Arducam_Left"):
        build_rig("two_xm430", load_sensor("paper16"), object_name="egg", seed=0)
