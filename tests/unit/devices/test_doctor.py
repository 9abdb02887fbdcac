"""What `mjtactile doctor` says of emulated servos."""

import contextlib

import pytest

from mjtactile.devices.doctor import _servo
from mjtactile.devices.dynamixel.bus import DynamixelBus
from tests.emulated import servo_bench

pytestmark = pytest.mark.clock


def findings(**kind):
    with servo_bench(**kind) as bench:
        bench.servos[2].set("Homing Offset", -300)
        bench.servos[2].set("Startup Configuration", 1)
        with contextlib.closing(DynamixelBus(bench.bus.path, reply_timeout=1.0)) as bus:
            return [list(_servo(bus, servo, "XL330-M288")) for servo in (1, 2)]


def test_settings_and_firmware_that_make_a_dead_host_dangerous():
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
    assert [finding.level for finding in old] == ["ok", "warn"] and "stops nothing" in old[1].text
