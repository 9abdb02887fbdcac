"""Tests of an emulated servo with the SDK's own calls, against the e-manual of XL330 and XM430: its
table, and the instructions that it executes."""

import math

import dynamixel_sdk as sdk
import pytest

from mjtactile.devices.dynamixel.bus import DynamixelBus
from mjtactile.devices.dynamixel.servo_models import MODELS, load_table
from mjtactile.emulator import protocol2 as p2
from mjtactile.emulator.control_table import control_table
from mjtactile.emulator.servo import EmulatedServo
from tests.emulated import ANGLE
from tests.sdk_client import OK, sdk_client

TICKS = round(ANGLE / (2 * math.pi) * 4096)


@pytest.fixture
def xl():
    with sdk_client() as client:
        yield client


@pytest.fixture
def xm():
    with sdk_client("XM430-W350") as client:
        yield client


# -- the table
# --------------------------------------------------------------------------------


@pytest.mark.parametrize("model", MODELS)
def test_addresses_are_those_of_the_sdk(model):
    """Two transcriptions of the same pages. The SDK's first table of a 330 has its indirect data
    where a 430's are; the one for firmware 52 agrees with the manual."""
    computed = control_table(model).fields
    stem = model.lower().replace("-", "_")
    reference = load_table(stem + "_fw52" if "330" in model else stem)
    both = [name for name in reference if name in computed]
    assert len(both) > 45
    assert {n: (computed[n].address, computed[n].size) for n in both} == {
        n: (reference[n].address, reference[n].size) for n in both
    }


XL_VALUES = {
    "Present Input Voltage": 50,
    "Temperature Limit": 70,
    "Max Voltage Limit": 70,
    "Min Voltage Limit": 35,
    "Velocity Limit": 445,
    "Current Limit": 1750,
    "Shutdown": 53,
    "Position P Gain": 400,
    "Velocity I Gain": 1600,
    "Velocity P Gain": 180,
}
XM_VALUES = {
    "Present Input Voltage": 120,
    "Temperature Limit": 80,
    "Max Voltage Limit": 160,
    "Min Voltage Limit": 95,
    "Velocity Limit": 200,
    "Current Limit": 1193,
    "Shutdown": 52,
    "Position P Gain": 800,
    "Velocity I Gain": 1920,
    "Velocity P Gain": 100,
}
BOTH = {
    "Moving Threshold": 10,
    "Secondary(Shadow) ID": 255,
    "Return Delay Time": 250,
    "PWM Limit": 885,
    "Goal PWM": 885,
    "Status Return Level": 2,
    "Operating Mode": 3,
    "Protocol Type": 2,
    "Max Position Limit": 4095,
    "Goal Velocity": 0,
}


@pytest.mark.clock
def test_initial_values_are_the_manuals(xl, xm):
    for one, values in ((xl, XL_VALUES), (xm, XM_VALUES)):
        assert {name: one.read(name) for name in (*values, *BOTH)} == values | BOTH
        assert one.read("Goal Current") == values["Current Limit"]


@pytest.mark.parametrize(
    ("name", "good", "bad"),
    [
        ("ID", 252, 253),
        ("Baud Rate", 6, 7),
        ("Drive Mode", 5, 2),
        ("Operating Mode", 16, 2),
        ("Homing Offset", -1_044_479, 1_044_480),
        ("Moving Threshold", 1023, 1024),
        ("Temperature Limit", 100, 101),
        ("Max Voltage Limit", 31, 71),
        ("PWM Limit", 885, 886),
        ("Current Limit", 1750, 1751),
        ("Velocity Limit", 2047, 2048),
        ("Max Position Limit", 4095, 4096),
        ("Shutdown", 53, 2),
        ("Startup Configuration", 3, 4),
        ("PWM Slope", 1, 0),
        ("Position P Gain", 16383, 16384),
        ("Goal PWM", -885, 886),
        ("Goal Current", -1750, 1751),
        ("Goal Velocity", -445, 446),
        ("Profile Acceleration", 32767, 32768),
        ("Goal Position", 0, 4096),
        ("Bus Watchdog", 127, 128),
        ("Status Return Level", 2, 3),
        ("Indirect Address 1", 227, 63),
    ],
)
def test_values_outside_their_range_are_refused(name, good, bad):
    servo = EmulatedServo(1, "XL330-M288")
    field = control_table("XL330-M288").fields[name]
    data = [
        (value & ((1 << 8 * field.size) - 1)).to_bytes(field.size, "little")
        for value in (good, bad)
    ]
    assert [servo.write(field.address, item) for item in data] == [0, 4]  # "Data Range Error"
    assert servo.get(name) == int.from_bytes(data[0], "little")


@pytest.mark.clock
def test_goals_are_limited(xl):
    assert xl.write("Current Limit", 300) == 0
    assert xl.write("Goal Current", 301) == 4
    assert xl.write("Operating Mode", 5) == 0
    assert xl.read("Goal Current") == 300  # "Reset to … Current Limit(38)"
    assert xl.write("Goal Position", -1_048_575) == 0
    assert xl.write("Goal Position", 1_048_576) == 4


@pytest.mark.clock
def test_undefined_registers_can_be_neither_read_nor_written(xl):
    assert xl.packets.readTxRx(xl.port, 1, 66, 2)[2] == 7
    assert xl.packets.readTxRx(xl.port, 1, 64, 4)[2] == 7  # 66 and 67 are within
    assert xl.packets.write1ByteTxRx(xl.port, 1, 66, 0) == (OK, 7)
    assert xl.write("Present Position", 0) == 7
    assert xl.packets.write2ByteTxRx(xl.port, 1, 116, 0) == (OK, 5)  # half of a register


# -- instructions
# --------------------------------------------------------------------------------


@pytest.mark.clock
def test_bulk_read_answers_for_every_servo(xl):
    for fast in (False, True):
        read = sdk.GroupBulkRead(xl.port, xl.packets)
        assert read.addParam(1, 132, 4) and read.addParam(2, 144, 2)
        assert (read.fastBulkRead if fast else read.txRxPacket)() == OK
        assert (read.getData(1, 132, 4), read.getData(2, 144, 2)) == (TICKS, 50)


def test_fast_bulk_read_is_the_packet_in_the_manual():
    """ids 3, 7, 4 with 166, 421 and 31: the example of "Fast Bulk Read"."""
    parts = [
        (3, 0, bytes.fromhex("a6000000")),
        (7, 0, bytes.fromhex("a501")),
        (4, 0, bytes.fromhex("1f")),
    ]
    assert p2.fast_status(parts) == bytes.fromhex(
        "fffffd00fe14005500 03a600000067a4 0007a5012474 00041fd9c1"
    )


@pytest.mark.clock
def test_bulk_write(xl):
    write = sdk.GroupBulkWrite(xl.port, xl.packets)
    assert write.addParam(1, 65, 1, [1]) and write.addParam(2, 24, 4, [7, 0, 0, 0])
    assert write.txPacket() == OK
    assert (xl.read("LED", 1), xl.read("Moving Threshold", 2)) == (1, 7)


@pytest.mark.clock
def test_an_absent_id_does_not_block_the_others(xl):
    xl.port.closePort()
    bus = DynamixelBus(xl.bench.bus.path, reply_timeout=0.3)
    try:
        replies, failures = bus.read_many([1, 9, 2], 132, 4)
        assert set(replies) == {1, 2} and failures[9].reason == "no reply"
    finally:
        bus.close()
        xl.port.openPort()


@pytest.mark.clock
def test_a_group_packet_with_a_bad_crc_is_not_answered(xl):
    packet = bytearray(p2.encode(p2.BROADCAST, p2.SYNC_READ, bytes((132, 0, 4, 0, 1, 2))))
    packet[-1] ^= 1
    xl.port.writePort(bytes(packet))
    assert xl.ping()  # an answer would arrive first
    assert xl.port.getBytesAvailable() == 0
    assert not xl.bench.log[0].intact


@pytest.mark.clock
def test_only_the_new_id_answers(xl):
    assert xl.write("ID", 9) == 0
    assert xl.ping(9) and xl.is_absent(1) and xl.ping(2)
    assert xl.read("ID", 9) == 9


@pytest.mark.clock
def test_a_new_baud_rate_applies_at_once(xl):
    assert xl.write("Baud Rate", 1) == 0
    assert xl.is_absent(1) and xl.ping(2)
    assert xl.port.setBaudRate(57600)
    assert xl.ping(1) and xl.is_absent(2)


@pytest.mark.clock
@pytest.mark.parametrize(
    ("option", "servo_id", "baud"), [(0xFF, 1, 57600), (0x01, 2, 57600), (0x02, 2, 1_000_000)]
)
def test_factory_reset_keeps_the_values_of_its_option(xl, option, servo_id, baud):
    assert xl.write("Moving Threshold", 99, 2) == 0
    assert xl.write("ID", 3, 1) == 0  # out of the way
    assert xl.packets.factoryReset(xl.port, 2, option) == (OK, 0)
    xl.bench.servos[2]._silent_until = 0.0  # it has restarted
    assert xl.port.setBaudRate(baud)
    assert xl.ping(servo_id)
    assert xl.read("Moving Threshold", servo_id) == 10


@pytest.mark.clock
def test_not_all_servos_are_reset_at_once(xl):
    xl.port.writePort(p2.encode(p2.BROADCAST, p2.FACTORY_RESET, b"\xff"))
    assert xl.ping(1) and xl.ping(2)


@pytest.mark.clock
def test_reboot_delays_answers_and_resets_ram(xl):
    assert xl.write("Torque Enable", 1) == 0
    xl.bench.servos[1].raise_error(0x20)
    assert xl.packets.reboot(xl.port, 1)[0] == OK
    assert xl.is_absent(1) and xl.ping(2)
    xl.bench.servos[1]._silent_until = 0.0
    assert (xl.read("Torque Enable"), xl.read("Hardware Error Status")) == (0, 0)


@pytest.mark.clock
def test_status_return_level(xl):
    assert xl.write("Status Return Level", 1) == 0
    assert xl.is_silent(xl.packets.write1ByteTxRx, 1, 65, 1)
    assert xl.read("LED") == 1
    assert xl.is_silent(xl.packets.write1ByteTxRx, 1, 68, 0)
    assert xl.is_silent(xl.packets.read1ByteTxRx, 1, 65)
    assert xl.ping()


@pytest.mark.clock
def test_register_and_action(xl):
    assert xl.packets.regWriteTxRx(xl.port, 1, 65, 1, [1]) == (OK, 0)
    assert (xl.read("Registered Instruction"), xl.read("LED")) == (1, 0)
    # to one servo, the SDK leaves its status unread
    assert xl.packets.action(xl.port, p2.BROADCAST) == OK
    assert (xl.read("Registered Instruction"), xl.read("LED")) == (0, 1)
    assert xl.bench.servos[1].act() == 2  # "Action has been used without Reg Write"


@pytest.mark.clock
def test_indirect_addresses_map_to_other_addresses(xl):
    """Example 2 of "Indirect Address": Goal Position's four bytes as indirect data 2 to 5."""
    assert xl.write("Operating Mode", 4) == 0
    for i in range(4):
        assert xl.write(f"Indirect Address {i + 2}", 116 + i) == 0
    data = xl.table["Indirect Data 2"].address
    assert xl.packets.write4ByteTxRx(xl.port, 1, data, 1024) == (OK, 0)
    assert xl.read("Goal Position") == 1024
    assert xl.packets.read4ByteTxRx(xl.port, 1, data) == (1024, OK, 0)
    assert xl.packets.write2ByteTxRx(xl.port, 1, data, 7) == (OK, 5)  # half of it
    assert xl.write("Indirect Address 2", 7) == 4  # EEPROM cannot be assigned


@pytest.mark.clock
def test_a_secondary_id_obeys_without_an_answer(xl):
    for servo in (1, 2):
        assert xl.write("Secondary(Shadow) ID", 100, servo) == 0
    assert xl.packets.write1ByteTxOnly(xl.port, 100, 65, 1) == OK
    assert (xl.read("LED", 1), xl.read("LED", 2)) == (1, 1)


@pytest.mark.clock
def test_backup_and_restore(xl):
    servo = xl.bench.servos[1]
    assert xl.write("Moving Threshold", 77) == 0
    assert xl.write("Torque Enable", 1) == 0
    assert servo.back_up(1, 0.0) == 1  # "works properly only if Torque Enable … is set as '0'"
    assert xl.write("Torque Enable", 0) == 0
    xl.port.writePort(p2.encode(1, p2.BACKUP, bytes.fromhex("014354524c")))
    assert xl.packets.readRx(xl.port, 1, 0)[1:] == (OK, 0)
    assert xl.read("Backup Ready") == 1
    assert xl.write("Moving Threshold", 5) == 0
    assert servo.back_up(2, -1.0) == 0  # the time is long ago: it has restarted
    assert xl.read("Moving Threshold") == 77
