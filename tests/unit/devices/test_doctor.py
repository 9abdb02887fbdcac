"""Tests of the findings of `mjtactile doctor` about emulated servos."""

import contextlib
from dataclasses import replace
from types import SimpleNamespace

import pytest

from mjtactile.devices.discovery import serial_ports
from mjtactile.devices.doctor import _check_host_loss, _check_torques, _plugged_in
from mjtactile.devices.doctor.servos import check_servo
from mjtactile.devices.dynamixel.bus import DynamixelBus
from mjtactile.rig.file import load_rig_file
from tests.emulated import servo_bench


def findings(**kind):
    with servo_bench(**kind) as bench:
        bench.servos[2].set("Homing Offset", -300)
        bench.servos[2].set("Startup Configuration", 1)
        with contextlib.closing(DynamixelBus(bench.bus.path, reply_timeout=1.0)) as bus:
            return [list(check_servo(bus, servo, "XL330-M288")) for servo in (1, 2)]


@pytest.mark.clock
def test_settings_and_firmware_without_host_supervision_are_reported():
    sound, moving = findings()
    assert [finding.level for finding in sound] == ["ok"]
    bad = [finding.text for finding in moving if finding.level == "bad"]
    assert (
        len(bad) == 2
        and "Homing Offset is -300, must be 0" in bad[0]
        and "Startup Configuration is 1" in bad[1]
    )
    assert all(
        finding.remedy == "set it with Dynamixel Wizard"
        for finding in moving
        if finding.level == "bad"
    )
    old = findings(firmware=51)[0]
    assert [finding.level for finding in old] == [
        "ok",
        "warn",
    ] and "does not stop the servo" in old[1].text
    assert "without a host it holds its place" in sound[0].text
    assert "without a host it goes on to its last goal" in old[0].text


def test_the_state_after_a_lost_host_is_reported_with_the_idle_servos():
    rig = load_rig_file("emulated")
    [opens] = _check_host_loss(rig)
    assert opens.level == "ok" and "vent 250 ms after" in opens.text
    holds = replace(rig, on_host_loss="hold", hold_time=5.0)
    [found] = _check_host_loss(holds)
    assert 'on_host_loss = "hold": chambers stay sealed for 5 s' in found.text
    limp = replace(holds, emulator=replace(rig.emulator, watchdog="limp"))
    [found] = _check_host_loss(limp)
    assert found.level == "warn" and "switch their torque off" in found.text


def test_a_torque_constant_of_another_model_is_bad():
    """The torque constant of an XM430 (1.78 N m/A) on an XL330 (0.354) is bad: forces are five
    times off."""
    rig = load_rig_file("two_xm430")
    assert list(_check_torques(rig)) == []
    servos = tuple(replace(servo, model="XL330-M288") for servo in rig.gripper.servos)
    found = list(_check_torques(replace(rig, gripper=replace(rig.gripper, servos=servos))))
    assert [finding.level for finding in found] == ["bad", "bad"]
    assert "1.78" in found[0].text and "0.354" in found[0].text and "5 times" in found[0].text


def test_devices_and_doctor_list_the_same_ports(monkeypatch):
    """Both list a built-in port, and neither opens it, since it may be a console."""
    built_in = SimpleNamespace(device="/dev/ttyS0", description="n/a", serial_number=None, vid=None)
    adapter = SimpleNamespace(device="/dev/ttyU0", description="USB", serial_number="7", vid=1027)
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: [adapter, built_in])
    observed = [f.text.split()[0] for f in _plugged_in() if f.subject == "serial port"]
    requested = []
    listed = serial_ports(notify=requested.append)
    assert [port.path for port in listed] == observed == ["/dev/ttyS0", "/dev/ttyU0"]
    assert listed[0].problem == "built in: queried only with --port /dev/ttyS0"
    assert [text.split(":")[0] for text in requested] == ["/dev/ttyU0"]
