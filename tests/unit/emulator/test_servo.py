"""An emulated servo as the SDK's own calls find it, against what the e-manual says of XL330 and XM430.

The shaft is turned by hand (`turn`), so that nothing here depends on the computer's pace.
"""

import math

import dynamixel_sdk as sdk
import pytest

from mjtactile.core import pace
from mjtactile.devices.dynamixel.bus import DynamixelBus
from mjtactile.devices.dynamixel.tables import MODELS, load_table
from mjtactile.emulator import protocol2 as p2
from mjtactile.emulator.control_table import control_table
from mjtactile.emulator.servo import EmulatedServo
from tests.emulated import ANGLE, servo_bench

pytestmark = pytest.mark.clock

TICKS = round(ANGLE / (2 * math.pi) * 4096)
PATIENCE, SILENCE = 1500.0, 60.0  # ms for a reply, where the SDK has 34 (tests share their processors), and for none
OK = sdk.COMM_SUCCESS
RPM = 0.229 * 2 * math.pi / 60  # rad/s of a velocity unit


class Client:
    """The SDK's port and packets on a bench, with its register names."""

    def __init__(self, bench, model):
        self.bench, self.table = bench, control_table(model).fields
        self.port, self.packets = sdk.PortHandler(bench.bus.path), sdk.PacketHandler(2.0)
        self.patience = PATIENCE
        self.port.setPacketTimeout = lambda length: self.port.setPacketTimeoutMillis(self.patience)
        assert self.port.openPort() and self.port.setBaudRate(1_000_000)

    def read(self, name, servo=1):
        field = self.table[name]
        data, result, error = self.packets.readTxRx(self.port, servo, field.address, field.size)
        assert (result, error) == (OK, 0), (name, result, error)
        return int.from_bytes(bytes(data), "little")

    def write(self, name, value, servo=1):
        """The error of the status packet."""
        field = self.table[name]
        data = list((value & ((1 << 8 * field.size) - 1)).to_bytes(field.size, "little"))
        result, error = self.packets.writeTxRx(self.port, servo, field.address, field.size, data)
        assert result == OK, (name, self.packets.getTxRxResult(result))
        return error

    def ping(self, servo=1):
        return self.packets.ping(self.port, servo)[1] == OK

    def is_silent(self, ask, *arguments):
        """Whether nothing comes back from a call of the SDK."""
        self.patience = SILENCE
        result = [part for part in ask(self.port, *arguments) if part == sdk.COMM_RX_TIMEOUT]
        self.patience = PATIENCE
        return bool(result)

    def is_absent(self, servo):
        return self.is_silent(self.packets.ping, servo)


def client(model="XL330-M288"):
    with servo_bench(model) as bench:
        client = Client(bench, model)
        try:
            yield client
        finally:
            client.port.closePort()


@pytest.fixture
def xl():
    yield from client()


@pytest.fixture
def xm():
    yield from client("XM430-W350")


def turn(servo, seconds):
    for _ in range(round(seconds / 0.01)):
        servo.turn(0.01)


# -- the table ---------------------------------------------------------------------------------------------------------

@pytest.mark.parametrize("model", MODELS)
def test_addresses_are_those_of_the_sdk(model):
    """Two transcriptions of the same pages. The SDK's first table of a 330 has its indirect data where a 430's are; the one for
    firmware 52 agrees with the manual."""
    ours, stem = control_table(model).fields, model.lower().replace("-", "_")
    theirs = load_table(stem + "_fw52" if "330" in model else stem)
    both = [name for name in theirs if name in ours]
    assert len(both) > 45
    assert {n: (ours[n].address, ours[n].size) for n in both} == {n: (theirs[n].address, theirs[n].size) for n in both}


XL_VALUES = {"Present Input Voltage": 50, "Temperature Limit": 70, "Max Voltage Limit": 70, "Min Voltage Limit": 35,
             "Velocity Limit": 445, "Current Limit": 1750, "Shutdown": 53, "Position P Gain": 400, "Velocity I Gain": 1600,
             "Velocity P Gain": 180}
XM_VALUES = {"Present Input Voltage": 120, "Temperature Limit": 80, "Max Voltage Limit": 160, "Min Voltage Limit": 95,
             "Velocity Limit": 200, "Current Limit": 1193, "Shutdown": 52, "Position P Gain": 800, "Velocity I Gain": 1920,
             "Velocity P Gain": 100}
BOTH = {"Moving Threshold": 10, "Secondary(Shadow) ID": 255, "Return Delay Time": 250, "PWM Limit": 885, "Goal PWM": 885,
        "Status Return Level": 2, "Operating Mode": 3, "Protocol Type": 2, "Max Position Limit": 4095, "Goal Velocity": 0}


def test_initial_values_are_the_manuals(xl, xm):
    for one, values in ((xl, XL_VALUES), (xm, XM_VALUES)):
        assert {name: one.read(name) for name in (*values, *BOTH)} == values | BOTH
        assert one.read("Goal Current") == values["Current Limit"]


@pytest.mark.parametrize(("name", "good", "bad"), [
    ("ID", 252, 253), ("Baud Rate", 6, 7), ("Drive Mode", 5, 2), ("Operating Mode", 16, 2),
    ("Homing Offset", -1_044_479, 1_044_480),
    ("Moving Threshold", 1023, 1024), ("Temperature Limit", 100, 101), ("Max Voltage Limit", 31, 71), ("PWM Limit", 885, 886),
    ("Current Limit", 1750, 1751), ("Velocity Limit", 2047, 2048), ("Max Position Limit", 4095, 4096), ("Shutdown", 53, 2),
    ("Startup Configuration", 3, 4), ("PWM Slope", 1, 0), ("Position P Gain", 16383, 16384), ("Goal PWM", -885, 886),
    ("Goal Current", -1750, 1751), ("Goal Velocity", -445, 446), ("Profile Acceleration", 32767, 32768),
    ("Goal Position", 0, 4096), ("Bus Watchdog", 127, 128), ("Status Return Level", 2, 3), ("Indirect Address 1", 227, 63)])
def test_values_outside_their_range_are_refused(name, good, bad):
    servo = EmulatedServo(1, "XL330-M288")
    field = control_table("XL330-M288").fields[name]
    data = [(value & ((1 << 8 * field.size) - 1)).to_bytes(field.size, "little") for value in (good, bad)]
    assert [servo.write(field.address, one) for one in data] == [0, 4]  # "Data Range Error"
    assert servo.get(name) == int.from_bytes(data[0], "little")


def test_limits_bound_the_goals(xl):
    assert xl.write("Current Limit", 300) == 0
    assert xl.write("Goal Current", 301) == 4
    assert xl.write("Operating Mode", 5) == 0
    assert xl.read("Goal Current") == 300  # "Reset to … Current Limit(38)"
    assert xl.write("Goal Position", -1_048_575) == 0
    assert xl.write("Goal Position", 1_048_576) == 4


def test_what_is_not_defined_can_be_neither_read_nor_written(xl):
    assert xl.packets.readTxRx(xl.port, 1, 66, 2)[2] == 7
    assert xl.packets.readTxRx(xl.port, 1, 64, 4)[2] == 7  # 66 and 67 are within
    assert xl.packets.write1ByteTxRx(xl.port, 1, 66, 0) == (OK, 7)
    assert xl.write("Present Position", 0) == 7
    assert xl.packets.write2ByteTxRx(xl.port, 1, 116, 0) == (OK, 5)  # half of a register


# -- instructions ------------------------------------------------------------------------------------------------------

def test_bulk_read_answers_for_every_servo(xl):
    for fast in (False, True):
        read = sdk.GroupBulkRead(xl.port, xl.packets)
        assert read.addParam(1, 132, 4) and read.addParam(2, 144, 2)
        assert (read.fastBulkRead if fast else read.txRxPacket)() == OK
        assert (read.getData(1, 132, 4), read.getData(2, 144, 2)) == (TICKS, 50)


def test_fast_bulk_read_is_the_packet_in_the_manual():
    """ids 3, 7, 4 with 166, 421 and 31: the example of "Fast Bulk Read"."""
    parts = [(3, 0, bytes.fromhex("a6000000")), (7, 0, bytes.fromhex("a501")), (4, 0, bytes.fromhex("1f"))]
    assert p2.fast_status(parts) == bytes.fromhex("fffffd00fe14005500 03a600000067a4 0007a5012474 00041fd9c1")


def test_bulk_write(xl):
    write = sdk.GroupBulkWrite(xl.port, xl.packets)
    assert write.addParam(1, 65, 1, [1]) and write.addParam(2, 24, 4, [7, 0, 0, 0])
    assert write.txPacket() == OK
    assert (xl.read("LED", 1), xl.read("Moving Threshold", 2)) == (1, 7)


def test_an_absent_id_does_not_silence_the_others(xl):
    xl.port.closePort()
    bus = DynamixelBus(xl.bench.bus.path, reply_timeout=0.3)
    try:
        replies, failures = bus.read_many([1, 9, 2], 132, 4)
        assert set(replies) == {1, 2} and failures[9].reason == "no reply"
    finally:
        bus.close()
        xl.port.openPort()


def test_a_group_packet_with_a_bad_crc_is_not_answered(xl):
    packet = bytearray(p2.encode(p2.BROADCAST, p2.SYNC_READ, bytes((132, 0, 4, 0, 1, 2))))
    packet[-1] ^= 1
    xl.port.writePort(bytes(packet))
    assert xl.ping()  # whatever had been answered would come first
    assert xl.port.getBytesAvailable() == 0
    assert not xl.bench.log[0].intact


def test_a_new_id_answers_and_the_old_one_does_not(xl):
    assert xl.write("ID", 9) == 0
    assert xl.ping(9) and xl.is_absent(1) and xl.ping(2)
    assert xl.read("ID", 9) == 9


def test_a_new_baud_rate_counts_at_once(xl):
    assert xl.write("Baud Rate", 1) == 0
    assert xl.is_absent(1) and xl.ping(2)
    assert xl.port.setBaudRate(57600)
    assert xl.ping(1) and xl.is_absent(2)


@pytest.mark.parametrize(("option", "servo_id", "baud"), [(0xFF, 1, 57600), (0x01, 2, 57600), (0x02, 2, 1_000_000)])
def test_factory_reset_keeps_what_its_option_says(xl, option, servo_id, baud):
    assert xl.write("Moving Threshold", 99, 2) == 0
    assert xl.write("ID", 3, 1) == 0  # out of the way
    assert xl.packets.factoryReset(xl.port, 2, option) == (OK, 0)
    xl.bench.servos[2]._silent_until = 0.0  # it has restarted
    assert xl.port.setBaudRate(baud)
    assert xl.ping(servo_id)
    assert xl.read("Moving Threshold", servo_id) == 10


def test_not_all_servos_are_reset_at_once(xl):
    xl.port.writePort(p2.encode(p2.BROADCAST, p2.FACTORY_RESET, b"\xff"))
    assert xl.ping(1) and xl.ping(2)


def test_reboot_is_silent_for_a_while_and_forgets_ram(xl):
    assert xl.write("Torque Enable", 1) == 0
    xl.bench.servos[1].raise_error(0x20)
    assert xl.packets.reboot(xl.port, 1)[0] == OK
    assert xl.is_absent(1) and xl.ping(2)
    xl.bench.servos[1]._silent_until = 0.0
    assert (xl.read("Torque Enable"), xl.read("Hardware Error Status")) == (0, 0)


def test_status_return_level(xl):
    assert xl.write("Status Return Level", 1) == 0
    assert xl.is_silent(xl.packets.write1ByteTxRx, 1, 65, 1)
    assert xl.read("LED") == 1
    assert xl.is_silent(xl.packets.write1ByteTxRx, 1, 68, 0)
    assert xl.is_silent(xl.packets.read1ByteTxRx, 1, 65)
    assert xl.ping()


def test_register_and_action(xl):
    assert xl.packets.regWriteTxRx(xl.port, 1, 65, 1, [1]) == (OK, 0)
    assert (xl.read("Registered Instruction"), xl.read("LED")) == (1, 0)
    assert xl.packets.action(xl.port, p2.BROADCAST) == OK  # to one servo, the SDK leaves its status unread
    assert (xl.read("Registered Instruction"), xl.read("LED")) == (0, 1)
    assert xl.bench.servos[1].act() == 2  # "Action has been used without Reg Write"


def test_indirect_addresses_stand_for_others(xl):
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


def test_a_secondary_id_obeys_in_silence(xl):
    for servo in (1, 2):
        assert xl.write("Secondary(Shadow) ID", 100, servo) == 0
    assert xl.packets.write1ByteTxOnly(xl.port, 100, 65, 1) == OK
    assert (xl.read("LED", 1), xl.read("LED", 2)) == (1, 1)


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


# -- motion ------------------------------------------------------------------------------------------------------------

def on(one, mode, **registers):
    assert one.write("Operating Mode", mode) == 0
    for name, value in registers.items():
        assert one.write(name.replace("_", " "), value) == 0
    assert one.write("Torque Enable", 1) == 0


@pytest.mark.parametrize(("mode", "goal", "value"), [
    (0, "Goal Current", -100), (1, "Goal Velocity", -50), (16, "Goal PWM", -200)])
def test_modes_without_a_position_move(xl, mode, goal, value):
    on(xl, mode)
    assert xl.write(goal, value) == 0
    turn(xl.bench.servos[1], 0.5)
    assert xl.bench.servos[1].angle < ANGLE - 0.4
    if mode == 1:
        assert xl.bench.servos[1].angle == pytest.approx(ANGLE - 0.5 * 50 * RPM, abs=50 * RPM * 0.011)  # a tick
        assert xl.read("Present Velocity") == (1 << 32) - 50
    assert xl.read("Moving") == 1


def test_the_profile_takes_its_time_and_says_so(xl):
    on(xl, 4)
    assert xl.write("Profile Velocity", 20) == 0  # 0.48 rad/s
    assert xl.write("Goal Position", TICKS + 1000) == 0  # 1.534 rad: 3.2 s
    turn(xl.bench.servos[1], 1.0)
    assert xl.bench.servos[1].angle == pytest.approx(ANGLE + 20 * RPM, abs=20 * RPM * 0.011)  # a tick behind its path
    assert (xl.read("Moving"), xl.read("Velocity Trajectory"), xl.read("Moving Status")) == (1, 20, 0x12)
    assert xl.read("Position Trajectory") == pytest.approx(TICKS + 20 * RPM * 4096 / (2 * math.pi), abs=1)
    turn(xl.bench.servos[1], 3.0)
    assert xl.read("Present Position") == TICKS + 1000
    assert (xl.read("Moving"), xl.read("Velocity Trajectory"), xl.read("Moving Status")) == (0, 0, 0x11)


def test_a_trapezoid_reaches_its_goal_without_overshoot():
    servo = EmulatedServo(1, "XL330-M288")
    for address, size, value in ((11, 1, 4), (64, 1, 1), (108, 4, 5), (112, 4, 50), (116, 4, 800)):
        assert servo.write(address, value.to_bytes(size, "little")) == 0
    speeds = []
    for _ in range(300):
        servo.turn(0.01)
        speeds.append(servo.speed)
        assert servo.angle <= 800 * 2 * math.pi / 4096 + 1e-9
    assert servo.angle == pytest.approx(800 * 2 * math.pi / 4096)
    assert max(speeds) == pytest.approx(50 * RPM, rel=1e-6)
    assert max(b - a for a, b in zip(speeds, speeds[1:], strict=False)) <= 5 * 214.577 * 2 * math.pi / 3600 * 0.01 + 1e-9


def test_homing_offset_is_added_to_the_position(xl):
    """What lerobot's calibration writes."""
    assert xl.write("Homing Offset", 500) == 0
    assert xl.read("Present Position") == TICKS + 500
    on(xl, 4)
    assert xl.write("Goal Position", TICKS + 600) == 0
    turn(xl.bench.servos[1], 1.0)
    assert xl.bench.servos[1].angle == pytest.approx(ANGLE + 100 * 2 * math.pi / 4096, abs=2 * math.pi / 4096)
    assert xl.write("Torque Enable", 0) == 0
    assert xl.write("Homing Offset", 2000) == 0
    assert xl.write("Operating Mode", 3) == 0
    assert xl.read("Present Position") == TICKS + 100  # beyond 1024 it is ignored in mode 3


def test_clear_forgets_whole_turns_of_a_shaft_at_rest(xl):
    servo = xl.bench.servos[1]
    on(xl, 4)
    assert xl.write("Goal Position", TICKS + 8192) == 0
    servo.turn(0.01)
    assert xl.packets.clearMultiTurn(xl.port, 1) == (OK, 1)  # it moves
    turn(servo, 4.0)
    assert xl.packets.clearMultiTurn(xl.port, 1) == (OK, 0)
    assert xl.read("Present Position") == TICKS


# -- the bus watchdog --------------------------------------------------------------------------------------------------

def tripped(mode=5, **how):
    """A servo on its way, whose host has died: from 1 rad to 2 rad, or with 0.1 A or 1 rad/s."""
    servo = EmulatedServo(1, "XL330-M288", angle=1.0, **how)
    goal = {0: (102, 2, 100), 1: (104, 4, 42), 16: (100, 2, 200)}.get(mode, (116, 4, 1304))
    for address, size, value in ((11, 1, mode), (98, 1, 5), (64, 1, 1), goal):
        assert servo.write(address, value.to_bytes(size, "little")) == 0
    turn(servo, 0.05)
    servo.look_at_watchdog(pace.monotonic() + 1)
    return servo, servo.angle


@pytest.mark.parametrize("mode", [0, 1, 3, 4, 5, 16])
def test_a_trip_stops_the_servo_and_makes_its_goals_read_only(mode):
    servo, at = tripped(mode)
    turn(servo, 0.5)
    assert servo.angle == pytest.approx(at, abs=2 * math.pi / 4096)
    assert servo.get("Bus Watchdog") == 0xFF
    assert (servo.drive().torque_max > 0) == (mode not in (0, 16))  # held where it is, or free
    assert servo.write(116, (1).to_bytes(4, "little")) == 4
    assert servo.write(98, b"\0") == 0
    assert servo.write(116, (1000).to_bytes(4, "little")) == 0


def test_a_limp_servo_lets_go():
    assert tripped(trip="limp")[0].drive().torque_max == 0


def test_firmware_51_of_a_330_notes_the_trip_and_goes_on():
    servo, at = tripped(firmware=51)
    turn(servo, 0.5)
    assert servo.get("Bus Watchdog") == 0xFF
    assert servo.angle == pytest.approx(1304 * 2 * math.pi / 4096) and servo.angle > at + 0.5
    assert EmulatedServo(1, "XM430-W350", firmware=51)._goes_on is False


def test_with_a_homing_offset_a_trip_moves_the_motor():
    servo = EmulatedServo(1, "XL330-M288", angle=1.0)
    for address, size, value in ((20, 4, 300), (11, 1, 4), (98, 1, 5), (64, 1, 1)):
        assert servo.write(address, value.to_bytes(size, "little")) == 0
    for i in range(100):
        servo.look_at_watchdog(pace.monotonic() + 1 + i)
        servo.turn(0.01)
    assert servo.angle < -1.0  # and on


def test_without_torque_it_does_not_trip():
    servo = EmulatedServo(1, "XL330-M288")
    assert servo.write(98, b"\x05") == 0
    servo.look_at_watchdog(pace.monotonic() + 10)
    assert servo.get("Bus Watchdog") == 5
