"""Tests of `mjtactile setup` with emulated hardware: it queries the devices and keeps the
answers."""

import re

import numpy as np
import pytest

from mjtactile.calibrate.rig_wizard import _bus, _PortScan, _write, edited, flip_of, setup
from mjtactile.commands.emulate import client_text
from mjtactile.core.design import load_sensor
from mjtactile.core.errors import InputError
from mjtactile.devices.discovery import SerialPort
from mjtactile.devices.valve.driver import connect_valves
from mjtactile.emulator.process import EmulatorProcess
from mjtactile.rig.file import load_rig_file
from mjtactile.sim.rendering.renderer import Renderer


@pytest.fixture
def emulator():
    process = EmulatorProcess(load_rig_file("emulated"), load_sensor("paper16"), object_name="egg")
    yield process
    process.close()


@pytest.mark.slow(10)
@pytest.mark.clock
def test_a_rig_is_created_from_ports_and_streams(tmp_path, emulator, monkeypatch):
    # sooner, on a busy computer
    for name, value in (("BAUDS", (1_000_000,)), ("IDS", range(1, 4)), ("_REPLY_TIME", 0.3)):
        monkeypatch.setattr(f"mjtactile.devices.discovery.{name}", value)
    ends = emulator.endpoints
    nowhere = {
        "servo": "/dev/none",
        "valve": "/dev/none",
        "cameras": {"left": "http://127.0.0.1:9/1", "right": "http://127.0.0.1:9/2"},
    }
    like = tmp_path / "like.toml"
    like.write_text(client_text(load_rig_file("emulated").path, nowhere))
    path = tmp_path / "mine.toml"
    requested = []
    reported = []
    pressed = []

    def ask(question):
        requested.append(question)
        finger = re.search(r"of the (\w+) finger", question)
        if finger:  # filling its chamber changes its image like an indentation
            while pressed:
                pressed.pop().close(quiet=True)
            boards, valves = connect_valves(load_rig_file(path).valves)
            valves[["left", "right"].index(finger[1])].open(1000.0)
            pressed.extend(boards)
        if "which one" in question:
            return "2" if "jaw 1" in question else "1"
        return {
            "maximum force": "4",
            "maximum opening": "-5" if "maximum opening" not in " ".join(requested[:-1]) else "",
        }.get(question.split(" on ")[0].split(",")[0], "")

    streams = [ends["cameras"]["right"], ends["cameras"]["left"]]
    try:
        with pytest.raises(InputError, match="1 cameras were found, but the rig has 2 fingers"):
            setup(
                path,
                like=like,
                ports=[ends["valve"], ends["servo"]],
                cameras=streams[:1],
                ask=ask,
                notify=reported.append,
            )
        assert load_rig_file(path).bus.port == ends["servo"]  # results up to here are kept
        requested.clear()
        rig = setup(path, like=like, ports=[], cameras=streams, ask=ask, notify=reported.append)
    finally:
        for board in pressed:
            board.close(quiet=True)
    assert any("servos [2, 1, 3] answer" in line and "kept" in line for line in reported)
    assert [servo.id for servo in rig.gripper.servos] == [2, 1] and (
        rig.lift.id,
        rig.lift.model,
    ) == (3, "XM430-W350")
    assert [camera.source for camera in rig.cameras] == [
        ends["cameras"]["left"],
        ends["cameras"]["right"],
    ]
    assert {valve.port for valve in rig.valves} == {ends["valve"]}
    assert rig.gripper.force_max == 4.0 and rig.gripper.opening[1] == pytest.approx(0.12)
    # refused and requested again
    assert any("-5" in line and "opening_max_mm" in line for line in reported)
    assert "# on each finger" in path.read_text()  # comments stay


def test_values_are_replaced_in_place():
    text = '[a]\nx = 1  # one\nname = "b # c"\n\n[[b.c]]\nx = 2\n[[b.c]]\nx = 3\n'
    new = edited(
        text, {("a", 0, "x"): 5.0, ("b.c", 1, "x"): 7, ("a", 0, "name"): "d", ("b.c", 0, "y"): 1}
    )
    assert new == '[a]\nx = 5.0  # one\nname = "d"\n\n[[b.c]]\ny = 1\nx = 2\n[[b.c]]\nx = 7\n'


def test_removing_a_value_removes_its_line():
    text = "[a]\nx = 1  # one\ny = 2\n"
    assert edited(text, {("a", 0, "x"): None, ("a", 0, "z"): None}) == "[a]\ny = 2\n"


def test_another_servo_model_sets_its_torque_and_gain(tmp_path, monkeypatch):
    """The torque constant of an XM430, 1.78 N m/A, in the lines of an XL330, 0.354 N m/A, makes
    forces five times too large."""
    found = SerialPort("/dev/tty9", "/dev/tty9", "", "", 57600, {1: "XL330-M288", 2: "XM430-W350"})
    monkeypatch.setattr("mjtactile.calibrate.rig_wizard.serial_ports", lambda *_, **__: [found])
    path = tmp_path / "mine.toml"
    path.write_text(load_rig_file("two_xm430").path.read_text())
    reported = []
    changes = _bus(
        load_rig_file(path), _PortScan((), reported.append), lambda _: "1", reported.append
    )
    _write(path, changes)
    first, second = load_rig_file(path).gripper.servos
    assert (first.model, first.torque_per_A, first.position_p_gain) == ("XL330-M288", None, None)
    assert (second.model, second.torque_per_A, second.position_p_gain) == ("XM430-W350", 1.78, 800)
    assert any(
        "XL330-M288: using the torque per ampere of its data sheet" in line for line in reported
    )


@pytest.mark.parametrize(
    ("flip", "turned"),
    [
        ("no", lambda pixels: pixels),
        ("left-right", lambda pixels: pixels[:, ::-1]),
        ("top-bottom", lambda pixels: pixels[::-1]),
        ("both", lambda pixels: pixels[::-1, ::-1]),
    ],
)
def test_an_indentation_in_a_corner_determines_the_flip_of_the_image(flip, turned):
    """A rendered dent in the corner of largest x and y identifies the flip of an image."""
    design = load_sensor("dense")
    view = Renderer(design, seed=2)
    up = np.tile([0.0, 0.0, 1.0], (design.markers.count, 1))
    p = design.markers.p_SM
    dent = np.exp(-0.5 * np.square((p[:, :2] - [0.012, 0.008]) / 4e-3).sum(axis=1))
    flat = view.render(p, up).pixels.astype(float)
    pressed = view.render(p - 2e-3 * dent[:, None] * up, up).pixels.astype(float)
    assert flip_of(turned(pressed) - turned(flat)) == flip
    bulged = view.render(p + [0, 0, 2e-3], up).pixels.astype(float)
    assert flip_of(bulged - flat) is None


def test_a_flipped_camera_of_a_rig_file_is_corrected(tmp_path):
    text = load_rig_file("two_xm430").path.read_text()
    path = tmp_path / "mine.toml"
    path.write_text(edited(text, {("camera", 1, "flipped"): "both"}))
    assert [camera.flipped for camera in load_rig_file(path).cameras] == ["no", "both"]
    path.write_text(edited(text, {("camera", 0, "flipped"): "mirrored"}))
    with pytest.raises(InputError, match=r"flipped: 'mirrored'.*left-right"):
        load_rig_file(path)
