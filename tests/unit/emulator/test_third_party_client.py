"""Tests of emulated servos with a third-party client: both layers of the SDK, used as in its
examples."""

import dynamixel_sdk as sdk
import pytest

from tests.emulated import ANGLE, servo_bench

pytestmark = pytest.mark.clock

TICKS = round(ANGLE / (2 * 3.141592653589793) * 4096)


@pytest.fixture
def bench():
    with servo_bench() as bench:
        yield bench


def test_the_sdks_sync_read_write_example(bench):
    port = sdk.PortHandler(bench.bus.path)
    packets = sdk.PacketHandler(2.0)
    # of the SDK's 34 ms: tests share their processors
    port.setPacketTimeout = lambda length: port.setPacketTimeoutMillis(1500)
    assert port.openPort()
    assert port.setBaudRate(1_000_000)
    try:
        for servo in (1, 2):
            model, result, error = packets.ping(port, servo)
            assert (model, result, error) == (1200, sdk.COMM_SUCCESS, 0)
            assert packets.write1ByteTxRx(port, servo, 64, 1) == (sdk.COMM_SUCCESS, 0)
        write = sdk.GroupSyncWrite(port, packets, 116, 4)
        for servo in (1, 2):
            assert write.addParam(servo, list((1500 + servo).to_bytes(4, "little")))
        assert write.txPacket() == sdk.COMM_SUCCESS
        read = sdk.GroupSyncRead(port, packets, 132, 4)
        assert all(read.addParam(servo) for servo in (1, 2))
        assert read.txRxPacket() == sdk.COMM_SUCCESS
        assert [read.getData(servo, 132, 4) for servo in (1, 2)] == [TICKS, TICKS]
        assert read.fastSyncRead() == sdk.COMM_SUCCESS
        assert [read.getData(servo, 132, 4) for servo in (1, 2)] == [TICKS, TICKS]
        assert [bench.servos[i].get("Goal Position") for i in (1, 2)] == [1501, 1502]
    finally:
        port.closePort()


def test_the_easy_sdk(bench, monkeypatch):
    easy = pytest.importorskip("dynamixel_easy_sdk")

    def patient(port, length):
        port.setPacketTimeoutMillis(1500)  # as above

    monkeypatch.setattr(sdk.PortHandler, "setPacketTimeout", patient)
    connector = easy.Connector(bench.bus.path, 1_000_000)
    try:
        motor = connector.createMotor(1)
        motor.disableTorque()
        motor.setOperatingMode(easy.OperatingMode.EXTENDED_POSITION)
        motor.enableTorque()
        motor.setGoalPosition(1700)
        assert motor.getPresentPosition() == TICKS
        assert bench.servos[1].get("Goal Position") == 1700
        assert bench.servos[1].get("Operating Mode") == 4
    finally:
        connector.closePort()
