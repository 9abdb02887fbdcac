"""The firmware of firmware/valve/, compiled for this computer, behind a pty with simulated
chambers, under the real driver."""

import contextlib
import importlib.util
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from mjtactile.core.errors import DeviceError
from mjtactile.devices.valve.driver import ValveBoard, connect_valves
from mjtactile.emulator import valve as emulated
from mjtactile.rig.file import ValveConfig
from tests.emulated import valve_configs, wait_for

SOURCE = Path(__file__).resolve().parents[3] / "firmware" / "valve"
pytestmark = [
    pytest.mark.clock,
    pytest.mark.skipif(not SOURCE.is_dir(), reason="the firmware is in the repository only"),
]
STATES = ("vent", "set", "sealed")
FAULTS = ("ok", "start", "silent", "sensor", "pressure")


def compiler():
    """Return the compiler of the system, else that of pip; it needs no C++ library."""
    if found := os.environ.get("CXX") or shutil.which("c++"):
        return [found]
    if importlib.util.find_spec("ziglang"):
        return [sys.executable, "-m", "ziglang", "c++", "-nostdlib++"]
    pytest.skip("no C++ compiler")


def compile_files(folder, *arguments):
    command = [
        *compiler(),
        "-std=c++17",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-O1",
        "-fno-exceptions",
        "-fno-rtti",
        f"-I{SOURCE / 'lib/valve'}",
        *map(str, arguments),
    ]
    caches = {"ZIG_GLOBAL_CACHE_DIR": str(folder), "ZIG_LOCAL_CACHE_DIR": str(folder)}
    subprocess.run(command, check=True, env={**os.environ, **caches})


def build(folder, *flags):
    out = folder / "valve_host"
    sources = [*sorted((SOURCE / "lib/valve").glob("*.cpp")), SOURCE / "host/main.cpp"]
    compile_files(folder, "-Wconversion", *flags, "-o", out, *sources)
    return out


ARDUINO = """
#pragma once
#include <stddef.h>
#include <stdint.h>
enum { OUTPUT, LOW = 0, HIGH };
void pinMode(int, int); void digitalWrite(int, int); void analogReadResolution(int); int analogRead(int);
void delay(int); unsigned long millis(); unsigned long micros();
struct Port { void begin(long); int available(); int read(); int availableForWrite(); size_t write(const char*, size_t); };
struct Pico { void wdt_begin(uint32_t); void wdt_reset(); };
struct Bus { void setSDA(int); void setSCL(int); void begin(); void beginTransmission(int); size_t write(int);
             int endTransmission(); size_t requestFrom(int, int); int read(); };
extern Port Serial; extern Pico rp2040; extern Bus Wire;
"""


@pytest.mark.parametrize("flags", [(), ("-DVALVE_I2C_ADDRESS=0x18",)], ids=["analog", "I2C"])
def test_the_file_with_the_pins_is_at_least_cpp(tmp_path, flags):
    """The file with the pins compiles as C++ against stubs of Arduino's functions; no board
    toolchain is installed here."""
    for name in ("Arduino.h", "Wire.h"):
        (tmp_path / name).write_text(ARDUINO)
    compile_files(tmp_path, "-fsyntax-only", f"-I{tmp_path}", *flags, SOURCE / "src/main.cpp")


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    return build(tmp_path_factory.mktemp("firmware"))


class Host:
    """The board's program, its pty, and its chambers."""

    def __init__(self, program):
        self.process = subprocess.Popen(
            [program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.path = self.process.stdout.readline().strip()

    def send(self, command="ask"):
        """Send a command of host/main.cpp, and return the state."""
        self.process.stdin.write(command + "\n")
        self.process.stdin.flush()
        return json.loads(self.process.stdout.readline())

    def channel(self, number=1):
        reported = self.send()
        return (
            STATES[reported[f"state_{number}"]],
            FAULTS[reported[f"fault_{number}"]],
            reported[f"pa_{number}"],
        )

    def close(self):
        self.process.stdin.close()
        self.process.wait(5)
        self.process.stdout.close()


@pytest.fixture
def host(program):
    with contextlib.closing(Host(program)) as host:
        yield host


@pytest.fixture
def rig(host):
    boards, valves = connect_valves(valve_configs(host.path))
    try:
        yield host, boards[0], valves
    finally:
        boards[0].close(quiet=True)


def is_near(host, pressure, number=1):
    return wait_for(lambda: abs(host.channel(number)[2] - pressure) < 30)


def test_firmware_regulates_seals_and_vents_both_chambers(rig):
    host, board, valves = rig
    assert board.firmware == "1.1" and board.has_sensors
    for number, (valve, pressure) in enumerate(zip(valves, (1000.0, 2500.0), strict=True), 1):
        valve.open(pressure)
        assert is_near(host, pressure, number)
        valve.close()
        assert host.channel(number)[0] == "sealed" and is_near(host, pressure, number)
        assert board.measure(number).gauge_pressure == pytest.approx(pressure, abs=40)
        valve.open(0.0)
        assert is_near(host, 0.0, number)
        assert host.channel(number)[:2] == ("vent", "ok")


def test_a_second_host_takes_over_from_a_lost_host(host):
    """The board vents without a host; a second host that connects and is lost is monitored, too."""
    for _ in range(2):
        board = ValveBoard([ValveConfig("left", host.path, heartbeat=0.2)])
        board.set(1, 1000.0)
        assert is_near(host, 1000.0)
        board._closed.set()  # the heartbeat thread ends without a command to vent
        board._thread.join()
        board._serial.close()
        assert wait_for(lambda: host.channel()[:2] == ("vent", "silent"))
        assert is_near(host, 0.0)


@pytest.mark.clock(13)
def test_the_chamber_is_sealed_for_a_late_host_and_vented_for_a_lost_host(host):
    board = ValveBoard([ValveConfig("left", host.path, heartbeat=0.2)], hold=1.5)
    board.set(1, 1000.0)
    assert is_near(host, 1000.0)
    board._closed.set()
    board._wake.set()
    board._thread.join()
    assert wait_for(lambda: host.channel()[:2] == ("sealed", "ok"))
    assert is_near(host, 1000.0)
    assert board.measure(1).gauge_pressure == pytest.approx(1000.0, abs=40)  # it is back
    assert wait_for(lambda: host.channel()[:2] == ("vent", "silent"))
    # 5 % of an outlet that takes 0.1 s: 2 s
    assert host.channel()[2] > 300.0
    assert wait_for(lambda: host.channel()[2] < 300.0)
    board._serial.close()


@pytest.mark.parametrize(
    ("command", "fault", "why"),
    [
        ("sensor 1 1", "sensor", "its pressure sensor failed"),
        ("push 1 4000", "pressure", "its pressure was too high"),
        ("reset", "start", "has restarted"),
    ],
)
def test_firmware_vents_on_a_fault_and_the_driver_reports_the_reason(rig, command, fault, why):
    host, board, valves = rig
    valves[0].open(1000.0)
    assert is_near(host, 1000.0)
    valves[0].close()
    host.send(command)
    assert wait_for(lambda: host.channel()[:2] == ("vent", fault))
    assert wait_for(lambda: board._readings[1].fault)
    with pytest.raises(DeviceError, match=why):
        valves[0].state()
    assert is_near(host, 0.0)


def test_an_inlet_that_does_not_close_is_detected(rig):
    host, _, valves = rig
    valves[0].open(1000.0)
    valves[0].close()
    host.send("over 1 1")
    assert wait_for(lambda: host.channel()[1] == "pressure")


def test_a_stuck_valve_and_a_puncture_are_detected(rig):
    host, board, valves = rig
    valves[0].open(1000.0)
    assert is_near(host, 1000.0)
    valves[0].close()
    host.send("leak 1 1")
    assert wait_for(lambda: board.measure(1).gauge_pressure < 200)
    host.send("stuck 1")
    valves[1].open(1000.0)
    valves[1]._goal_time -= 10.0
    with pytest.raises(DeviceError, match="stuck"):
        valves[1].state()


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda host: host.send("hang 1"), "is silent or broken"),
        (lambda host: host.process.kill(), "lost"),
    ],
)
def test_a_board_that_hangs_or_is_unplugged_is_an_error(rig, act, message):
    host, board, valves = rig
    act(host)
    with pytest.raises(DeviceError, match=message):
        for _ in range(500):
            valves[0].state()
            board._closed.wait(0.01)
    if host.process.poll() is None:
        host.send("hang 0")
    else:
        host.close = lambda: None
        host.process.communicate()


def test_firmware_answers_equal_those_of_the_emulated_board(host):
    """The firmware answers every request of a host word for word as the emulated board.

    The two programs implement the same page.
    """
    import serial

    board = emulated.ValveFirmware(
        type("None", (), {"pressure": lambda *_: 0.0})(), emulated.Faults()
    )
    board._rng.gauss = lambda *_: 0.0
    lines = [
        "id",
        "state 1",
        "set 1 100",
        "beat 5",
        "beat 60000",
        "set 1 100",
        "vent 1",
        "vent 2",
        "set 1 100",
        "limit 1 6001",
        "limit 1 3000",
        "limit 3 5",
        "set 1 3001",
        "set 1 3000",
        "vent 1",
        "seal 2",
        "state 2",
        "set 1 -5",
        "set 1",
        "seal",
        "x 1",
        "set 1 1 1",
        "id 1",
        "beat",
        "limit 1 1e3",
        "seal 1234567",
        "",
    ]
    with serial.Serial(host.path, timeout=5.0) as port:
        answer = b"-"
        while b"-" in answer:  # until it has read its sensors
            port.write(emulated.framed("0 state 2"))
            answer = port.readline()
        for number, text in enumerate(lines):
            body = f"{number} {text}"
            reply = board.reply(emulated.framed(body).rstrip(b"\n"), 0.0)
            port.write(emulated.framed(body))
            if reply is not None:
                assert port.readline() == reply, text
        port.write(
            b"id\n9 id*00000000\n\xff\xfe\n" + b"x" * 500 + b"\n" + emulated.framed("65535 id")
        )
        # and no answer to damaged lines
        assert port.readline() == emulated.framed("65535 id mjvalve 1.1 2 1 6000")


def test_ten_million_damaged_bytes_cause_no_action(program):
    reported = json.loads(
        subprocess.run(
            [program, "fuzz", "10000000", "1"], check=True, capture_output=True, text=True
        ).stdout
    )
    assert reported["bytes"] >= 10_000_000 and reported["lines"] > 300_000
    assert reported["accepted"] == 0  # a CRC-32 passes 1 in 4 10^9


def test_without_sensors_firmware_opens_the_supply_valve(tmp_path):
    with contextlib.closing(Host(build(tmp_path, "-DVALVE_SENSORS=0"))) as host:
        boards, valves = connect_valves(valve_configs(host.path))
        try:
            assert not boards[0].has_sensors
            valves[0].open(1000.0)
            assert valves[0].state().gauge_pressure is None
            assert wait_for(lambda: host.channel()[2] > 2000)  # the simulated supply is 10 kPa
            valves[0].close()
            assert host.channel()[0] == "sealed"
        finally:
            boards[0].close()
