"""Emulated servos and valves inside the test's own process, for tests of the drivers. MuJoCo is not
needed.

Time-outs are generous (0.2 s where a real bus needs 8 ms) since tests share their processors; none
is asserted.
"""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field

from mjtactile.core import scaled_clock
from mjtactile.devices.dynamixel.gripper import DynamixelGripper
from mjtactile.emulator.faults import Faults
from mjtactile.emulator.protocol2 import Instruction
from mjtactile.emulator.servo import EmulatedServo
from mjtactile.emulator.servo_bus import ServoBus
from mjtactile.emulator.valve import ValveFirmware, ValvePort
from mjtactile.rig.file import BusConfig, GripperConfig, LiftConfig, ServoConfig, ValveConfig

REPLY_TIMEOUT = 0.2
ANGLE = 3.0  # initial angle of the emulated servos, rad


@dataclass
class Bench:
    """Two jaw servos with their bus; `log` holds every packet that reached them."""

    servos: dict[int, EmulatedServo]
    faults: Faults
    bus: ServoBus
    log: list[Instruction] = field(default_factory=list)

    @property
    def bus_config(self) -> BusConfig:
        return BusConfig(self.bus.path, reply_timeout=REPLY_TIMEOUT, watchdog=2.0)

    def gripper(self, **changes) -> DynamixelGripper:
        config = BusConfig(
            self.bus.path, **{"reply_timeout": REPLY_TIMEOUT, "watchdog": 2.0, **changes}
        )
        return DynamixelGripper(config, GRIPPER, LiftConfig())


GRIPPER = GripperConfig(
    (0.0, 0.12),
    (
        ServoConfig(1, "XL330-M288", per_rad=0.012, zero_ticks=0),
        ServoConfig(2, "XL330-M288", per_rad=0.012, zero_ticks=0),
    ),
)


@contextlib.contextmanager
def servo_bench(model: str = "XL330-M288", count: int = 2, **kind) -> Iterator[Bench]:
    """Yield servos of a `kind` on a pty, with a short thread switch interval, so that their thread
    answers."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(5e-4)
    servos = {i: EmulatedServo(i, model, angle=ANGLE, **kind) for i in range(1, count + 1)}
    faults = Faults()
    log: list[Instruction] = []
    bus = ServoBus(servos, faults, usb_latency=0.0, on_packet=lambda _, packet: log.append(packet))
    try:
        yield Bench(servos, faults, bus, log)
    finally:
        bus.close()
        sys.setswitchinterval(before)


class Chambers:
    """Chambers without a simulated world, at the pressure of their port. Sealed chambers lose
    `leak` Pa each tick."""

    def __init__(self) -> None:
        self.pressures = {1: 0.0, 2: 0.0}
        self.leak = 0.0

    def connect(self, channel: int, supply_gauge: float) -> None:
        self.pressures[channel] = supply_gauge

    def seal(self, channel: int) -> None:
        self.pressures[channel] -= self.leak

    def pressure(self, channel: int) -> float:
        return self.pressures[channel]


@contextlib.contextmanager
def valve_bench(
    sensors: bool = True,
) -> Iterator[tuple[ValvePort, ValveFirmware, Faults, Chambers]]:
    """Yield a valve board on a pty with running pneumatics."""
    faults = Faults()
    chambers = Chambers()
    firmware = ValveFirmware(chambers, faults, sensors=sensors)
    port = ValvePort(firmware)
    stop = scaled_clock.Event()

    def live() -> None:
        while not stop.wait(0.005):
            firmware.tick(scaled_clock.monotonic(), 0.005)

    thread = threading.Thread(target=live)
    thread.start()
    try:
        yield port, firmware, faults, chambers
    finally:
        stop.set()
        thread.join()
        port.close()


def valve_configs(path: str) -> list[ValveConfig]:
    return [
        ValveConfig(finger, path, channel, heartbeat=2.0, reply_timeout=0.1, supply_gauge=1000.0)
        for channel, finger in enumerate(("left", "right"), 1)
    ]


@contextlib.contextmanager
def slowed(slow: float) -> Iterator[None]:
    """Slow down everything started inside the block to 1/`slow` of the speed."""
    before = scaled_clock.slow()
    scaled_clock.set_slow(slow)
    try:
        yield
    finally:
        scaled_clock.set_slow(before)


def wait_for(condition, timeout: float = 5.0) -> bool:
    """Wait until `condition()` is true; five seconds are far longer than any condition requires."""
    deadline = scaled_clock.monotonic() + timeout
    while scaled_clock.monotonic() < deadline:
        if condition():
            return True
        scaled_clock.sleep(0.005)
    return False
