"""Each trap of the SDK's packet layer (docs/how-to/hardware.md), through the bus and emulated servos on a
pty."""

import threading

import pytest
from dynamixel_sdk import PortHandler, Protocol2PacketHandler

from benchmarks.rig.fuzz import fuzz_servos
from mjtactile.core import scaled_clock
from mjtactile.core.errors import DeviceError
from mjtactile.devices.dynamixel.bus import BusError, DynamixelBus
from mjtactile.emulator import protocol2
from tests.emulated import REPLY_TIMEOUT

POSITION = 132


@pytest.fixture
def bus(bench):
    bus = DynamixelBus(bench.bus.path, reply_timeout=REPLY_TIMEOUT)
    yield bus
    bus.close()


@pytest.mark.clock
@pytest.mark.parametrize("fast", [False, True])
def test_group_read_keeps_the_alert_byte(bench, bus, fast):
    bench.servos[2].raise_error(0x20)
    replies, failures = bus.read_many([1, 2], POSITION, 4, fast=fast)
    assert not failures
    assert (replies[1].alert, replies[2].alert) == (False, True)
    assert replies[1].value(0, 4) == bench.servos[1].get("Present Position")


@pytest.mark.clock
@pytest.mark.parametrize("fast", [False, True])
def test_group_read_names_servos_without_an_answer(bench, bus, fast):
    bench.faults.set("servo_silent", 2)
    replies, failures = bus.read_many([1, 2], POSITION, 4, fast=fast)
    # the first servo's part of the packet has arrived
    assert failures[2].reason == ("corrupt" if fast else "no reply")
    assert set(replies) == (set() if fast else {1})  # the fast reply is one packet for all


@pytest.mark.clock
def test_a_short_reply_is_an_error(bench, bus):
    bench.faults.set("servo_short", 1)
    with pytest.raises(BusError, match="3 bytes instead of 4") as caught:
        bus.read(1, POSITION, 4)
    assert caught.value.reason == "short"
    _, failures = bus.read_many([1, 2], POSITION, 4)
    assert {error.reason for error in failures.values()} == {"short"}


@pytest.mark.clock
def test_a_corrupt_reply_is_an_error_and_the_next_read_is_right(bench, bus):
    for _ in range(8):  # another byte is hit each time: header, id, length, data, CRC
        bench.faults.set("servo_corrupt", 1)
        bus._port._reply_timeout_ms = 20  # a broken length is waited for
        with pytest.raises(BusError):
            bus.read(1, POSITION, 4)
        bench.faults.set("servo_corrupt", 0)
        bus._port._reply_timeout_ms = 1e3 * REPLY_TIMEOUT
        assert bus.read(1, POSITION, 4).value(0, 4) == bench.servos[1].get("Present Position")


@pytest.mark.clock
def test_an_exception_in_a_transaction_leaves_the_bus_usable(bus, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(Protocol2PacketHandler, "rxPacket", lambda *_: [].pop())
        with pytest.raises(BusError, match="unreadable"):
            bus.read(1, POSITION, 4)
    assert bus.ping(1)[0] == 1200


@pytest.mark.clock
def test_many_threads_share_one_bus(bus):
    wrong: list[object] = []

    def ask(servo: int) -> None:
        try:
            for _ in range(30):
                if bus.ping(servo)[0] != 1200:
                    wrong.append(servo)
        except DeviceError as error:
            wrong.append(error)

    threads = [threading.Thread(target=ask, args=(servo,)) for servo in (1, 2, 1, 2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


@pytest.mark.clock
def test_time_outs_are_those_of_the_file(bench):
    """The port uses the time-out of the file, on the monotonic clock.

    LATENCY_TIMER = 16 makes the SDK wait 34 ms.
    """
    bus = DynamixelBus(bench.bus.path, reply_timeout=0.005)
    sdk = PortHandler("none")
    try:
        bus._port.setPacketTimeout(21)
        # ms; 10 bits a byte at 1 Mbaud
        assert bus._port.packet_timeout == pytest.approx(5 + 21 * 0.01)
        sdk.setPacketTimeout(21)
        assert sdk.packet_timeout > 30
        # not the wall clock's 1.7e12
        assert abs(bus._port.getCurrentTime() - 1e3 * scaled_clock.monotonic()) < 1e3
    finally:
        bus.close()


@pytest.mark.clock
def test_a_late_reply_is_not_returned_for_the_next_request(bench):
    """The reply arrives 20 ms after the time-out, is intact, from the same servo, and has the
    length of the next reply."""
    bus = DynamixelBus(bench.bus.path, reply_timeout=0.05)
    try:
        bench.faults.set("servo_late", 0.07)
        with pytest.raises(BusError, match="no reply"):
            bus.read(1, 0, 4)  # model number and information
        bench.faults.set("servo_late", 0)
        bus._port._reply_timeout_ms = 1e3 * REPLY_TIMEOUT
        assert bus.read(1, POSITION, 4).value(0, 4) == bench.servos[1].get("Present Position")
    finally:
        bus.close()


@pytest.mark.clock
def test_byte_stuffing_is_written_and_removed(bench, bus, monkeypatch):
    """The SDK computes the stuffed packet and discards it. The bytes are compared with the
    emulator's own encoder."""
    sent = []
    write = bus._port.writePort
    monkeypatch.setattr(
        bus._port, "writePort", lambda packet: sent.append(bytes(packet)) or write(packet)
    )
    value = -131_073  # little-endian FF FF FD FF, a goal beyond 32 turns
    for servo in bench.servos.values():
        servo.set("Operating Mode", 5)
    bus.write(1, 116, 4, value)
    assert sent == [protocol2.encode(1, protocol2.WRITE, bytes.fromhex("7400fffffdff"))]
    assert b"\xff\xff\xfd\xfd" in sent[0]
    assert bench.servos[1].get_signed("Goal Position") == value
    block = bytes.fromhex("fffffdff")  # two places in one packet
    bus.write_many(116, {1: block, 2: block})
    assert sent[-1].count(b"\xff\xff\xfd\xfd") == 2
    assert bus.read(2, 116, 4).data == block


@pytest.mark.clock
def test_a_refused_write_reports_its_reason(bench, bus):
    bench.servos[1].set("Torque Enable", 1)
    with pytest.raises(BusError, match="denies access") as caught:
        bus.write(1, 11, 1, 5)  # EEPROM is locked while torque is on
    assert caught.value.reason == "refused"


@pytest.mark.clock
def test_the_port_is_opened_exclusively_and_a_missing_port_is_named(bench, bus):
    with pytest.raises(DeviceError, match=bench.bus.path):
        DynamixelBus(bench.bus.path)
    with pytest.raises(DeviceError, match="/dev/no-such-port"):
        DynamixelBus("/dev/no-such-port")


@pytest.mark.clock
def test_an_unplugged_adapter_is_a_lost_port(bench, bus):
    assert bus.ping(1)[0] == 1200
    bench.bus.close()
    for _ in range(2):  # and remains an error
        with pytest.raises(BusError) as caught:
            bus.read(1, POSITION, 4)
        assert caught.value.reason == "lost"


@pytest.mark.clock
def test_another_baud_rate_receives_no_reply(bench):
    bus = DynamixelBus(bench.bus.path, 57600, reply_timeout=0.02)
    with pytest.raises(BusError, match="no reply"):
        bus.ping(1)
    bus.close()


def test_invalid_bytes_give_no_reply():
    """A seeded 20 kB of noise and damaged packets; `mjtactile bench rig` feeds 10^6 bytes."""
    result = fuzz_servos(20_000)
    assert result["wrong"] == 0 and result["refused"] > 50
    assert result["true"] > 0  # the correct answers among them were accepted
    # a babbler gets five times the time-out of 2 ms, on a busy computer more; a hang has no end
    assert result["longest_s"] < 30.0
