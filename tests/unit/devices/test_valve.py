"""The valve driver against emulated boards in all three dialects."""

import time

import pytest

from mjtactile.bench.rig.fuzz import fuzz_valve
from mjtactile.core.errors import DeviceError, InputError
from mjtactile.devices.valve.driver import ValveBoard, connect_valves
from mjtactile.emulator.valve import ValveFirmware
from mjtactile.rig.file import ValveConfig
from tests.emulated import valve_bench, valve_configs, wait_for

DIALECTS = ["ctrlp", "relay", "regulator"]


@pytest.fixture(params=DIALECTS)
def rig(request):
    with valve_bench(request.param) as (port, firmware, faults, chambers):
        boards, valves = connect_valves(valve_configs(port, request.param))
        try:
            yield boards[0], valves, firmware, faults, chambers
        finally:
            for board in boards:
                board.close(quiet=True)


def test_handshake_waits_for_the_boot_and_sets_the_heartbeat(rig):
    board, _, firmware, _, _ = rig
    assert board.firmware
    assert firmware.heartbeat == pytest.approx(2.0)


def test_open_close_and_vent_reach_each_chamber(rig):
    _, valves, firmware, _, chambers = rig
    for channel, valve in enumerate(valves, 1):
        valve.open(1000.0)
        assert firmware.channels[channel].state == "open"
        assert wait_for(lambda channel=channel: abs(chambers.pressures[channel] - 1000.0) < 20)
        state = valve.state()
        assert state.is_open
        valve.close()
        assert not valve.state().is_open
        valve.open(0.0)
        assert firmware.channels[channel].state == "vent"


def test_pressure_is_in_pascal_or_unknown(rig):
    board, valves, _, _, chambers = rig
    valves[0].open(1000.0)
    assert wait_for(lambda: abs(chambers.pressures[1] - 1000.0) < 1)
    board.obey(board.dialect.close, 1)
    pressure = valves[0].state().pressure_gauge
    if board.dialect.name == "relay":
        assert pressure is None  # a board without a sensor says nothing, not zero
    else:
        assert pressure == pytest.approx(1000.0, abs=30)  # the emulated sensor has 5 Pa of noise


def test_the_largest_pressure_is_kept_by_host_and_board(rig):
    board, valves, firmware, _, _ = rig
    with pytest.raises(DeviceError, match="outside 0 to 3000 Pa"):
        valves[0].open(3001.0)
    if board.dialect.limit:
        assert firmware.channels[1].limit == pytest.approx(3000.0)
        with pytest.raises(DeviceError, match="refuses"):
            board.obey(board.dialect.open, 1, 4000.0)


def test_closing_vents_every_channel(rig):
    board, valves, firmware, _, _ = rig
    for valve in valves:
        valve.open(1000.0)
    board.close()
    assert [channel.state for channel in firmware.channels.values()] == ["vent", "vent"]


def test_the_board_vents_by_itself_when_the_host_is_gone(rig):
    _, valves, firmware, _, _ = rig
    valves[0].open(1000.0)
    firmware.tick(time.monotonic() + 10.0, 0.005)
    assert firmware.vent_time is not None
    assert firmware.channels[1].state == "vent"


@pytest.mark.parametrize("fault", ["valve_silent", "valve_garbage"])
def test_a_silent_or_babbling_board_is_an_error(rig, fault):
    board, valves, _, faults, _ = rig
    valves[0].state()
    faults.set(fault, 1)
    with pytest.raises(DeviceError, match=f"{board.name} is silent or broken"):
        for _ in range(300):  # 3 s, far more than three answers may take on a busy computer
            valves[0].state()
            time.sleep(0.01)
    with pytest.raises(DeviceError):
        valves[0].open(1000.0)


def test_a_stuck_valve_is_an_error_where_a_sensor_can_tell(rig):
    board, valves, _, faults, _ = rig
    faults.set("valve_stuck", 1)
    valves[0].open(1000.0)
    valves[0]._goal_time -= 10.0  # the settling time has passed
    if board.dialect.name == "relay":
        assert valves[0].state().is_open
    else:
        with pytest.raises(DeviceError, match="stuck"):
            valves[0].state()


def test_a_valve_that_never_reached_its_pressure_is_not_sealed(rig):
    board, valves, _, faults, _ = rig
    faults.set("valve_stuck", 1)
    valves[0].open(1000.0)
    valves[0]._goal_time -= 10.0
    if board.dialect.name == "relay":
        valves[0].close()
    else:
        with pytest.raises(DeviceError, match="stuck"):
            valves[0].close()


def test_a_relays_supply_cannot_be_changed():
    with valve_bench("relay") as (port, *_):
        boards, valves = connect_valves(valve_configs(port, "relay"))
        try:
            with pytest.raises(DeviceError, match="its supply gives 1000 Pa"):
                valves[0].open(500.0)
        finally:
            boards[0].close()


def test_a_relay_needs_its_supply_in_the_file():
    with valve_bench("relay") as (port, *_), pytest.raises(InputError, match=r"valve\.supply_kPa"):
        ValveBoard([ValveConfig("left", port.path, "relay")])


def test_another_dialect_and_old_firmware_are_refused(monkeypatch):
    monkeypatch.setattr("mjtactile.devices.valve.board._HANDSHAKE_TIME", 0.5)
    with valve_bench("relay") as (port, *_), pytest.raises(DeviceError, match="does not answer as a ctrlp board"):
        ValveBoard([ValveConfig("left", port.path, "ctrlp")])
    monkeypatch.setattr(ValveFirmware, "_ctrlp", lambda *_: "version;ctrl-p;1.9")
    with valve_bench("ctrlp") as (port, *_), pytest.raises(DeviceError, match=r"firmware 1\.9, needs 2\.0"):
        ValveBoard([ValveConfig("left", port.path, "ctrlp")])


def test_a_missing_port_is_named():
    with pytest.raises(DeviceError, match="/dev/no-such-port"):
        ValveBoard([ValveConfig("left", "/dev/no-such-port")])


def test_an_unplugged_board_is_an_error():
    with valve_bench("ctrlp") as (port, *_):
        boards, valves = connect_valves(valve_configs(port, "ctrlp"))
        port.close()
        with pytest.raises(DeviceError, match="lost"):
            for _ in range(300):  # 3 s, as above
                valves[0].state()
                time.sleep(0.01)
        with pytest.raises(DeviceError, match="could not be vented"):
            boards[0].close()


def test_a_surprising_reading_must_be_said_twice():
    """A line without a checksum: one damaged digit is no pressure."""
    with valve_bench("ctrlp") as (port, *_):
        board = ValveBoard(valve_configs(port, "ctrlp"))
        ask = board._ask
        try:
            before = board.measure(1)
            with board._lock:  # the heartbeat's questions must not take the lines
                lines = iter(["read;1;9.003;vent", "read;1;0.001;vent", "read;1;0.002;vent"])
                board._ask = lambda text, patience: next(lines)
                assert board.measure(1).pressure_gauge == pytest.approx(before.pressure_gauge, abs=40)  # 5 Pa of noise; not 9 kPa
                lines = iter([f"read;1;{i}.500;vent" for i in range(20)])
                with pytest.raises(DeviceError, match="contradict"):
                    board.measure(1)
                board._ask = ask
        finally:
            board._ask = ask
            board.close()


def test_bad_lines_are_no_readings():
    """A seeded 40 kB here; `mjtactile bench rig` feeds 10^6 bytes."""
    result = fuzz_valve(40_000)
    assert result["wrong"] == 0 and result["refused"] > 30
    assert result["true"] > 0  # the true answers among them were taken
    assert result["longest_s"] < 10 * 0.15 + 1.0  # each question waits 0.15 s at most; nothing hangs
