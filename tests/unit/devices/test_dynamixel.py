"""The gripper driver against emulated servos: recipe, units, lift."""

import math
from dataclasses import replace

import pytest

from mjtactile.core.errors import DeviceError, InputError
from mjtactile.core.types import Command
from mjtactile.devices.dynamixel.gripper import DynamixelGripper, ServoFault
from mjtactile.devices.dynamixel.jaw_kinematics import JawGeometry, JawServo
from mjtactile.devices.dynamixel.servo_models import (
    MODEL_BY_NUMBER,
    MODELS,
    NO_CURRENT_CONTROL,
    load_table,
    require_model,
)
from mjtactile.emulator import protocol2 as p2
from mjtactile.emulator.servo import EmulatedServo
from mjtactile.rig.file import GripperConfig, LiftConfig, ServoConfig
from tests.emulated import ANGLE, GRIPPER, servo_bench, wait_for

TICK = 2 * math.pi / 4096


def names_written(bench, servo=1):
    """Return names of the registers written to one servo, in order."""
    table = {register.address: name for name, register in load_table("xl330_m288").items()}
    return [
        table[int.from_bytes(p.parameters[:2], "little")]
        for p in bench.log
        if p.code == p2.WRITE and p.servo == servo
    ]


# -- tables and models
# --------------------------------------------------------------------------------


def test_control_tables_of_the_sdk_are_read():
    table = load_table("xl330_m288")
    assert (table["Goal Current"].address, table["Goal Current"].size) == (102, 2)
    assert (
        table["Bus Watchdog"].address,
        table["Present Current"].address,
        table["Present Position"].size,
    ) == (98, 126, 4)


def test_every_model_has_a_complete_control_table():
    for model in MODELS.values():
        assert {"Goal Current", "Bus Watchdog", "Hardware Error Status", "Current Limit"} <= set(
            model.table
        ), model.name
    assert len(MODEL_BY_NUMBER) == len(MODELS)


@pytest.mark.parametrize("number", NO_CURRENT_CONTROL)
def test_models_without_goal_current_are_refused_by_name(number):
    with pytest.raises(DeviceError, match=NO_CURRENT_CONTROL[number]):
        require_model(number, "servo 1")


# -- connecting
# --------------------------------------------------------------------------------


@pytest.mark.clock
def test_connect_writes_settings_in_the_documented_order(bench):
    with_gripper(bench, lambda gripper: None)
    written = names_written(bench)
    first_on = [i for i, name in enumerate(written) if name == "Torque Enable"][1]
    before = ["Operating Mode", "Current Limit", "Goal Current", "Goal Position", "Bus Watchdog"]
    places = [
        max(i for i, name in enumerate(written[:first_on]) if name == item) for item in before
    ]
    assert places == sorted(places), dict(zip(before, places, strict=True))
    # and once more, should the torque have reset them
    assert set(before[2:]) <= set(written[first_on:])
    # a tripped watchdog would make goals read-only
    assert written[:2] == ["Bus Watchdog", "Torque Enable"]
    assert bench.servos[1].get("Operating Mode") == 5
    assert bench.servos[1].get("Return Delay Time") == 0


@pytest.mark.clock
def test_torque_is_enabled_after_limit_and_watchdog(bench):
    """If a host is lost while it connects, after any packet, the servo is off, or has a watchdog
    and a low current limit."""
    states = []
    bench.bus._on_packet = lambda *_: states.extend(
        [
            servo.get(name)
            for name in ("Torque Enable", "Bus Watchdog", "Goal Current", "Current Limit")
        ]
        for servo in bench.servos.values()
    )
    with_gripper(bench, lambda gripper: None)
    # virtual work: F r
    maximum = math.floor(GRIPPER.force_max * 0.012 / MODELS["XL330-M288"].torque_per_A / 1e-3)
    with_torque = [state for state in states if state[0]]
    assert with_torque
    assert all(
        watchdog and current <= maximum / 4 + 1 and limit == maximum
        for _, watchdog, current, limit in with_torque
    )


@pytest.mark.clock
@pytest.mark.parametrize(
    ("name", "value"), [("Homing Offset", 200), ("Startup Configuration", 1), ("Drive Mode", 8)]
)
def test_settings_without_host_supervision_are_refused(bench, name, value):
    bench.servos[2].set(name, value)
    with pytest.raises(DeviceError, match=rf"servo 2 .*{name} is {value} .* must be 0"):
        bench.gripper()
    assert bench.servos[2].get(name) == value  # an existing calibration is not overwritten


@pytest.mark.clock
def test_firmware_without_the_startup_register_is_accepted(bench, monkeypatch):
    from mjtactile.emulator.registers import Registers

    monkeypatch.setattr(
        EmulatedServo,
        "read",
        lambda self, address, size: (
            (7, b"") if address == 60 else Registers.read(self, address, size)
        ),
    )
    with_gripper(bench, lambda gripper: gripper.state())


def with_gripper(bench, act):
    gripper = bench.gripper()
    try:
        return act(gripper)
    finally:
        gripper.close()


@pytest.mark.clock
def test_a_setting_that_the_servo_rejects_is_an_error(bench, monkeypatch):
    monkeypatch.setattr(
        EmulatedServo,
        "_apply",
        lambda self, name, value: self.set(name, value if name != "Goal Current" else value + 100),
    )
    with pytest.raises(DeviceError, match=r"Goal Current was set to .* but reads"):
        bench.gripper()
    assert not bench.servos[1].get("Torque Enable")


@pytest.mark.clock
def test_another_model_than_the_files_is_refused(bench):
    for servo in bench.servos.values():
        servo.set("Model Number", 1190)
    with pytest.raises(DeviceError, match="is a XL330-M077, but the rig file specifies XL330-M288"):
        bench.gripper()


@pytest.mark.clock
def test_a_servo_without_goal_current_is_refused_at_connect(bench):
    bench.servos[2].set("Model Number", 1060)
    with pytest.raises(DeviceError, match="XL430-W250"):
        bench.gripper()


@pytest.mark.clock
def test_a_latched_error_is_reported_without_a_reboot(bench):
    bench.servos[2].raise_error(0x20)
    with pytest.raises(ServoFault, match=r"servo 2 .* overload"):
        bench.gripper()
    assert bench.servos[2].get("Hardware Error Status") == 0x20
    assert p2.REBOOT not in [packet.code for packet in bench.log]


@pytest.mark.clock
def test_a_missing_servo_is_named(bench):
    bench.faults.set("servo_silent", 2)
    with pytest.raises(DeviceError, match=r"servo 2 on /dev/pts/.* does not answer"):
        bench.gripper(reply_timeout=0.05)


@pytest.mark.clock
def test_a_tripped_watchdog_is_cleared_at_connect(bench):
    bench.servos[1].set("Bus Watchdog", 0xFF)
    with_gripper(bench, lambda gripper: gripper.command(Command(0.06, 2.0)))
    assert bench.servos[1].get("Bus Watchdog") != 0xFF


def test_the_number_of_turns_is_found_after_power_up():
    """One turn away the jaw would be at 36 + 75 mm; only one number of turns gives a position
    between the stops."""
    config = GripperConfig(
        (0.0, 0.12), (ServoConfig(1, "XL330-M288", per_rad=0.012, zero_ticks=-1000),)
    )
    geometry = JawGeometry(config, "test")
    jaw = geometry.servos[0]
    true_ticks = jaw.ticks(0.05)
    for read in (true_ticks, true_ticks - 4096, true_ticks + 4096):
        jaw.set_revolution_offset(read, 0.0, 0.07)
        assert jaw.part(read) == pytest.approx(0.05, abs=0.012 * TICK)
    with pytest.raises(ValueError, match="no"):
        jaw.set_revolution_offset(jaw.ticks(0.0) - 300 - jaw.revolution_offset_ticks, 0.02, 0.05)
    with pytest.raises(ValueError, match="more than one"):
        jaw.set_revolution_offset(true_ticks, -0.1, 0.2)


# -- units
# --------------------------------------------------------------------------------


@pytest.mark.clock
def test_state_is_in_si(bench):
    for servo in bench.servos.values():
        servo.follow_load(ANGLE, -1.0, -0.06, 0.01)  # closing with 0.06 N m
    state = with_gripper(bench, lambda gripper: gripper.state())
    assert state.opening == pytest.approx(2 * 0.012 * ANGLE, abs=2 * 0.012 * TICK)
    # the unit is 0.229 rpm = 2.4 %/2 of 1 rad/s
    assert state.speed == pytest.approx(-2 * 0.012, rel=0.02)
    # virtual work: tau / r on each finger; 1 mA of 169
    assert state.effort == pytest.approx(0.06 / 0.012, rel=0.01)


@pytest.mark.clock
def test_command_returns_the_sent_values_and_the_servos_have_them(bench):
    def act(gripper):
        sent = gripper.command(Command(0.066234, 4.0, 0.0, "close", {"a": 1.0}))
        assert wait_for(
            lambda: bench.servos[1].get("Goal Position") == round(0.066234 / 2 / 0.012 / TICK)
        )
        return sent

    sent = with_gripper(bench, act)
    assert sent.opening == 0.066234
    assert (sent.phase, dict(sent.memory)) == ("close", {"a": 1.0})
    assert bench.servos[1].get("Goal Current") == math.floor(
        4.0 * 0.012 / MODELS["XL330-M288"].torque_per_A / 1e-3
    )


@pytest.mark.clock
def test_steps_below_a_tick_accumulate(bench):
    """1 um a cycle, where a tick is 18 um: after 100 cycles the goal is 0.1 mm further."""

    def act(gripper):
        command = Command(0.07, 2.0)
        start = gripper.geometry.goals(0.07)[1]
        for _ in range(100):
            command = gripper.command(replace(command, opening=command.opening - 1e-6))
        assert wait_for(
            lambda: bench.servos[1].get("Goal Position") == round(0.0699 / 2 / 0.012 / TICK)
        )
        return start

    assert bench.servos[1].get("Goal Position") != with_gripper(bench, act)


@pytest.mark.clock
def test_a_closing_goal_is_not_far_ahead_of_its_jaw(bench):
    """0.1 s at 0.1 m/s: 10 mm of opening, 5 mm for each jaw at 36 mm; opening, it may be
    anywhere."""

    def act(gripper):
        assert gripper.command(Command(0.0, 2.0)).opening == 0.0
        assert wait_for(lambda: bench.servos[1].get("Goal Position") == round(0.031 / 0.012 / TICK))
        gripper.command(Command(0.12, 2.0))
        assert wait_for(lambda: bench.servos[1].get("Goal Position") == round(0.060 / 0.012 / TICK))

    with_gripper(bench, act)


@pytest.mark.clock
def test_commands_are_limited_to_the_rig_file(bench):
    sent = with_gripper(bench, lambda gripper: gripper.command(Command(0.5, 1e6)))
    assert sent.opening == pytest.approx(0.12, abs=2 * 0.012 * TICK)
    assert sent.force_limit == GRIPPER.force_max


@pytest.mark.parametrize(
    "config",
    [
        ServoConfig(1, "XM430-W350", "rack", -0.02, 0.01, 700),
        ServoConfig(1, "XM430-W350", "crank", 0.05, 0.03, 2048),
        ServoConfig(
            1, "XM430-W350", "table", 0.0, 0.0, 2048, table=((-0.5, 0.05), (0.1, 0.02), (0.7, 0.0))
        ),
    ],
)
def test_laws_invert_and_their_slope_is_their_derivative(config):
    jaw = JawServo(config, "test")
    for part in (0.011, 0.024, 0.041):
        ticks = jaw.ticks(part)
        # one tick of rounding
        assert jaw.part(ticks) == pytest.approx(part, abs=abs(jaw.slope(ticks)) * TICK)
        numeric = (jaw.part(ticks + 5) - jaw.part(ticks - 5)) / (10 * TICK)
        # 5 ticks of a crank's curvature
        assert jaw.slope(ticks) == pytest.approx(numeric, rel=1e-3)


def test_a_table_that_cannot_be_inverted_is_refused():
    config = ServoConfig(1, "XM430-W350", "table", table=((0.0, 0.01), (0.1, 0.02), (0.2, 0.015)))
    with pytest.raises(InputError, match="table_deg_mm"):
        JawServo(config, "test")


@pytest.mark.clock
def test_lift_moves_from_its_initial_position():
    with servo_bench("XM430-W350", 1) as bench:
        gripper = GripperConfig(
            (0.0, 0.12), (ServoConfig(1, "XM430-W350", per_rad=0.024, zero_ticks=0),)
        )
        bench.servos[3] = EmulatedServo(3, "XM430-W350", angle=1.0)
        driver = DynamixelGripper(
            bench.bus_config, gripper, LiftConfig("servo", id=3, model="XM430-W350", per_rad=0.02)
        )
        try:
            assert driver.state().lift_height == 0.0
            driver.command(Command(0.07, 2.0, lift_height=0.04))
            assert wait_for(
                lambda: bench.servos[3].get("Goal Position") == round((1.0 + 0.04 / 0.02) / TICK)
            )
            bench.servos[3].follow_load(3.0, 0.0, 0.0, 0.01)
            assert driver.state().lift_height == pytest.approx(0.04, abs=0.02 * TICK)
        finally:
            driver.close()


@pytest.mark.clock
def test_wrong_lift_model_is_refused():
    with servo_bench() as bench, pytest.raises(InputError, match=r"lift\.model"):
        DynamixelGripper(
            bench.bus_config, GRIPPER, replace(LiftConfig("servo"), model="XL430-W250")
        )
