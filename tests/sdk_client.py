"""Calls of the SDK on a bench of emulated servos, and external rotation of their shafts."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import dynamixel_sdk as sdk

from mjtactile.emulator.control_table import control_table
from tests.emulated import servo_bench

# ms for a reply, where the SDK has 34 (tests share their processors), and for none
REPLY_TIMEOUT_MS = 1500.0
NO_REPLY_TIMEOUT_MS = 60.0
OK = sdk.COMM_SUCCESS


class SdkClient:
    """The SDK's port and packets on a bench, with its register names."""

    def __init__(self, bench, model):
        self.bench = bench
        self.table = control_table(model).fields
        self.port = sdk.PortHandler(bench.bus.path)
        self.packets = sdk.PacketHandler(2.0)
        self.timeout = REPLY_TIMEOUT_MS
        self.port.setPacketTimeout = lambda length: self.port.setPacketTimeoutMillis(self.timeout)
        assert self.port.openPort() and self.port.setBaudRate(1_000_000)

    def read(self, name, servo=1):
        field = self.table[name]
        data, result, error = self.packets.readTxRx(self.port, servo, field.address, field.size)
        assert (result, error) == (OK, 0), (name, result, error)
        return int.from_bytes(bytes(data), "little")

    def write(self, name, value, servo=1):
        """Write a register and return the error of the status packet."""
        field = self.table[name]
        data = list((value & ((1 << 8 * field.size) - 1)).to_bytes(field.size, "little"))
        result, error = self.packets.writeTxRx(self.port, servo, field.address, field.size, data)
        assert result == OK, (name, self.packets.getTxRxResult(result))
        return error

    def ping(self, servo=1):
        return self.packets.ping(self.port, servo)[1] == OK

    def is_silent(self, ask, *arguments):
        """Return True if a call of the SDK gets no reply."""
        self.timeout = NO_REPLY_TIMEOUT_MS
        result = [part for part in ask(self.port, *arguments) if part == sdk.COMM_RX_TIMEOUT]
        self.timeout = REPLY_TIMEOUT_MS
        return bool(result)

    def is_absent(self, servo):
        return self.is_silent(self.packets.ping, servo)


@contextlib.contextmanager
def sdk_client(model: str = "XL330-M288") -> Iterator[SdkClient]:
    with servo_bench(model) as bench:
        client = SdkClient(bench, model)
        try:
            yield client
        finally:
            client.port.closePort()


def turn(servo, seconds):
    for _ in range(round(seconds / 0.01)):
        servo.turn(0.01)
