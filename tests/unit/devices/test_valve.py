"""The valve driver against emulated boards, with and without pressure sensors. The real firmware:
test_valve_firmware.py."""

import pytest

from mjtactile.core import scaled_clock
from mjtactile.core.errors import DeviceError, InputError
from mjtactile.devices.valve import protocol
from mjtactile.devices.valve.driver import ValveBoard, connect_valves
from mjtactile.emulator import valve as emulated
from mjtactile.rig.file import ValveConfig
from tests.emulated import valve_bench, valve_configs, wait_for


@pytest.fixture(params=[True, False], ids=["sensors", "no sensors"])
def rig(request, monkeypatch):
    """Provide a board that has booted, since earlier requests wait for half a second."""
    monkeypatch.setattr(emulated, "_BOOT_TIME", 0.0)
    with valve_bench(request.param) as (port, firmware, faults, chambers):
        boards, valves = connect_valves(valve_configs(port.path))
        try:
            yield boards[0], valves, firmware, faults, chambers
        finally:
            for board in boards:
                board.close(quiet=True)


# -- lines
# --------------------------------------------------------------------------------


# -- behavior of a board -------------------------------------------------------------------


@pytest.mark.clock
@pytest.mark.parametrize("sensors", [True, False])
def test_handshake_waits_for_the_boot_and_sets_the_heartbeat(sensors):
    with valve_bench(sensors) as (port, firmware, _, _):
        (board,), _ = connect_valves(valve_configs(port.path))
        board.close(quiet=True)
    assert board.firmware == "1.1"
    assert firmware.heartbeat == pytest.approx(2.0)


@pytest.mark.clock
def test_open_close_and_vent_reach_each_chamber(rig):
    _, valves, firmware, _, chambers = rig
    for channel, valve in enumerate(valves, 1):
        valve.open(1000.0)
        assert firmware.channels[channel].state == "set"
        assert wait_for(lambda channel=channel: abs(chambers.pressures[channel] - 1000.0) < 20)
        assert valve.state().is_open
        valve.close()
        assert not valve.state().is_open
        valve.open(0.0)
        assert firmware.channels[channel].state == "vent"


@pytest.mark.clock
def test_pressure_is_in_pascal_or_unknown(rig):
    board, valves, _, _, chambers = rig
    valves[0].open(1000.0)
    assert wait_for(lambda: abs(chambers.pressures[1] - 1000.0) < 1)
    board.seal(1)
    pressure = valves[0].state().gauge_pressure
    if board.has_sensors:
        assert pressure == pytest.approx(1000.0, abs=30)  # the emulated sensor has 5 Pa of noise
    else:
        assert pressure is None  # a board without a sensor reports None, not zero


@pytest.mark.clock
def test_the_largest_pressure_is_kept_by_host_and_board(rig):
    board, valves, firmware, _, _ = rig
    with pytest.raises(DeviceError, match="outside 0 to 3000 Pa"):
        valves[0].open(3001.0)
    assert firmware.channels[1].limit == 3000
    with pytest.raises(DeviceError, match="refuses 'set 1 4000': limit"):
        board.set(1, 4000.0)


@pytest.mark.clock
def test_closing_vents_every_channel(rig):
    board, valves, firmware, _, _ = rig
    for valve in valves:
        valve.open(1000.0)
    board.close()
    assert [channel.state for channel in firmware.channels.values()] == ["vent", "vent"]


@pytest.mark.clock
def test_the_board_vents_each_time_the_host_is_lost(rig):
    _, valves, firmware, _, _ = rig
    for _ in range(2):
        valves[0].open(1000.0)
        firmware.tick(scaled_clock.monotonic() + 10.0, 0.005)
        assert firmware.vent_time is not None
        assert (firmware.channels[1].state, firmware.channels[1].fault) == ("vent", "silent")
        with pytest.raises(DeviceError, match="refuses 'set 1 1000': fault"):
            valves[0].open(1000.0)
        assert wait_for(lambda: valves[0].board._readings[1].fault)
        with pytest.raises(DeviceError, match="valve left vented by itself: the host was silent"):
            valves[0].state()
        valves[0].open(0.0)  # the host has read the fault


@pytest.mark.clock
@pytest.mark.parametrize(
    ("fault", "why"),
    [("valve_sensor", "its pressure sensor failed"), ("valve_restart", "has restarted")],
)
def test_a_board_with_an_internal_fault_vents_and_reports_its_reason(fault, why):
    with valve_bench() as (port, firmware, faults, _):
        boards, valves = connect_valves(valve_configs(port.path))
        try:
            valves[0].open(1000.0)
            faults.set(fault, 1)
            assert wait_for(lambda: boards[0]._readings[1].fault)
            assert firmware.channels[1].state == "vent"
            with pytest.raises(DeviceError, match=why):
                valves[0].state()
        finally:
            boards[0].close()


@pytest.mark.clock
def test_excess_pressure_is_vented():
    with valve_bench() as (port, firmware, _, chambers):
        boards, valves = connect_valves(valve_configs(port.path))
        try:
            valves[0].open(3000.0)
            boards[0].seal(1)
            chambers.pressures[1] = 4000.0  # 25 % and 200 Pa above the limit is 3950
            assert wait_for(lambda: firmware.channels[1].fault == "pressure")
        finally:
            boards[0].close()


@pytest.mark.clock(5)
@pytest.mark.parametrize("fault", ["valve_silent", "valve_garbage"])
def test_a_silent_board_or_a_flooding_board_is_an_error(rig, fault):
    board, valves, _, faults, _ = rig
    valves[0].state()
    faults.set(fault, 1)
    with pytest.raises(DeviceError, match=f"{board.name} is silent or broken"):
        for _ in range(300):  # 3 s, far more than three answers may take on a busy computer
            valves[0].state()
            scaled_clock.sleep(0.01)
    with pytest.raises(DeviceError):
        valves[0].open(1000.0)
    faults.set(fault, 0)


@pytest.mark.clock
def test_a_stuck_valve_is_an_error_unless_sealed_or_without_a_sensor(rig):
    board, valves, _, faults, _ = rig
    faults.set("valve_stuck", 1)
    valves[0].open(1000.0)
    valves[0]._goal_time -= 10.0  # the settling time has passed
    if not board.has_sensors:
        assert valves[0].state().is_open
        valves[0].close()
        return
    for act in (valves[0].state, valves[0].close):
        with pytest.raises(DeviceError, match="stuck"):
            act()


@pytest.mark.clock
def test_a_chamber_follows_its_command_and_is_sealed_without_a_command(rig):
    """A chamber follows the commanded pressure, and without a command it is sealed at its pressure.

    The heartbeat's thread sends the commands: the loop does not wait for a board.
    """
    board, valves, firmware, faults, chambers = rig
    if not board.has_sensors:
        return  # such a rig refuses it: `Rig.limits.pressure` is None
    valves[0].regulate_pressure(None)
    valves[0].open(1000.0)
    valves[0].close()
    for pressure in (960.0, 920.0, 1500.0):
        valves[0].regulate_pressure(pressure)
        assert wait_for(lambda goal=pressure: abs(chambers.pressures[1] - goal) < 5)
        assert valves[0].state().is_open
    valves[0].regulate_pressure(9000.0)
    assert wait_for(lambda: firmware.channels[1].goal == 3000.0)  # the rig file's largest
    valves[0].regulate_pressure(None)
    assert wait_for(lambda: firmware.channels[1].state == "sealed")
    assert firmware.channels[2].state == "vent"
    valves[0].regulate_pressure(1500.0)
    faults.set("valve_stuck", 1)
    valves[0].regulate_pressure(500.0)
    valves[0]._goal_time -= 10.0  # the settling time has passed
    with pytest.raises(DeviceError, match="stuck"):
        valves[0].state()


@pytest.mark.clock
def test_without_a_sensor_the_supply_pressure_is_that_of_the_file():
    with valve_bench(sensors=False) as (port, *_):
        boards, valves = connect_valves(valve_configs(port.path))
        try:
            with pytest.raises(DeviceError, match="its supply has 1000 Pa"):
                valves[0].open(500.0)
        finally:
            boards[0].close()
    with (
        valve_bench(sensors=False) as (port, *_),
        pytest.raises(InputError, match=r"valve\.supply_kPa"),
    ):
        ValveBoard([ValveConfig("left", port.path)])


@pytest.mark.clock
@pytest.mark.parametrize(
    ("answer", "error", "message"),
    [
        ("id mjvalve 0.9 2 1 6000", DeviceError, r"firmware 0\.9, needs 1\.0"),
        ("id mjvalve 1.0 0 1 6000", InputError, "the board has 0 channels"),
        (
            "id mjvalve 1.0 2 1 2000",
            InputError,
            r"pressure_max_kPa: 3 exceeds the board's limit of 2",
        ),
        ("id regulator 3.1", DeviceError, "does not answer as mjvalve"),
        ("error unknown", DeviceError, "its answer was not readable"),
    ],
)
def test_another_board_is_refused(monkeypatch, answer, error, message):
    monkeypatch.setattr("mjtactile.devices.valve.board._HANDSHAKE_TIME", 1.0)
    monkeypatch.setattr(emulated.ValveFirmware, "_execute", lambda *_: answer)
    with valve_bench() as (port, *_), pytest.raises(error, match=message):
        ValveBoard([ValveConfig("left", port.path)])


def test_a_missing_port_is_named():
    with pytest.raises(DeviceError, match="/dev/no-such-port"):
        ValveBoard([ValveConfig("left", "/dev/no-such-port")])


@pytest.mark.clock
def test_an_unplugged_board_is_an_error():
    with valve_bench() as (port, *_):
        boards, valves = connect_valves(valve_configs(port.path))
        port.close()
        with pytest.raises(DeviceError, match="lost"):
            for _ in range(300):  # 3 s, as above
                valves[0].state()
                scaled_clock.sleep(0.01)
        with pytest.raises(DeviceError, match="could not be vented"):
            boards[0].close()


@pytest.mark.clock
def test_a_late_answer_is_not_returned_for_the_next_request():
    """A late answer to an earlier request is recognized by its number alone, since it is intact."""
    with valve_bench() as (port, *_):
        boards, _ = connect_valves(valve_configs(port.path))
        try:
            with boards[0]._lock:
                boards[0]._received += protocol.encode(boards[0]._sequence, "state 1 set 2000 ok")
                assert boards[0].measure(1).gauge_pressure == pytest.approx(0.0, abs=40)
        finally:
            boards[0].close()


@pytest.mark.parametrize(
    "line",
    [
        "set 1 nan",
        "set 1 -5",
        "set 1 1e3",
        "seal",
        "set 1",
        "seal 3",
        "limit 1 0",
        "beat 5",
        "close 1",
    ],
)
def test_an_unknown_request_is_an_error_and_the_board_continues(line):
    firmware = emulated.ValveFirmware({}, emulated.Faults())
    for text in ("vent 1", "beat 1000"):
        firmware.reply(emulated.framed(f"1 {text}").rstrip(), 0.0)
    assert b"error" in firmware.reply(emulated.framed(f"2 {line}").rstrip(), 0.0)
    assert firmware.reply(b"close;1;\xff", 0.0) is None


class ConstantChambers:
    """Chambers that keep their given pressure."""

    def __init__(self):
        self.pressures = {1: 0.0, 2: 0.0}

    def connect(self, channel, supply_gauge):
        self.pressures[channel] = supply_gauge

    def seal(self, channel):
        pass

    def pressure(self, channel):
        return self.pressures[channel]


@pytest.mark.parametrize("hold", [0, 2000])
def test_the_state_for_a_late_host_depends_on_its_hold_time(hold):
    """The state for a late host depends on its hold time, for a sealed and a regulated chamber.

    The test supplies the clock; the heartbeat is 0.5 s.
    """
    chambers = ConstantChambers()
    firmware = emulated.ValveFirmware(chambers, emulated.Faults())
    for text in ("beat 500", f"hold {hold}"):
        firmware.reply(emulated.framed(f"1 {text}").rstrip(), 0.0)
    for channel, act in ((1, "seal"), (2, "set")):
        for text in (f"vent {channel}", f"limit {channel} 2000", f"set {channel} 1000"):
            firmware.reply(emulated.framed(f"1 {text}").rstrip(), 0.0)
        chambers.pressures[channel] = firmware.channels[channel].supply = 1000.0
        if act == "seal":
            firmware.reply(emulated.framed(f"1 seal {channel}").rstrip(), 0.0)

    def after(seconds):
        firmware.tick(seconds, 0.01)
        return [channel.state for channel in firmware.channels.values()]

    assert after(0.4) == ["sealed", "set"]
    assert after(0.6) == (["sealed", "sealed"] if hold else ["vent", "vent"])
    if hold:
        assert after(2.4) == ["sealed", "sealed"]
        assert [channel.fault for channel in firmware.channels.values()] == ["ok", "ok"]
        assert after(2.6) == ["vent", "vent"]
        # 10 ms of 2 s
        assert chambers.pressures == pytest.approx({1: 995.0, 2: 995.0}, abs=0.1)
    else:
        assert chambers.pressures == pytest.approx({1: 800.0, 2: 800.0})  # 10 ms of 50
    assert {channel.fault for channel in firmware.channels.values()} == {"silent"}


@pytest.mark.clock
def test_an_older_board_cannot_hold(monkeypatch):
    monkeypatch.setattr("mjtactile.devices.valve.board._HANDSHAKE_TIME", 1.0)
    monkeypatch.setattr(emulated.ValveFirmware, "_execute", lambda *_: "id mjvalve 1.0 2 1 6000")
    with (
        valve_bench() as (port, *_),
        pytest.raises(DeviceError, match=r"firmware 1\.0, needs 1\.1 or newer to keep"),
    ):
        ValveBoard([ValveConfig("left", port.path)], hold=1.0)


def test_a_host_without_heartbeat_or_with_an_unread_fault_cannot_inflate():
    firmware = emulated.ValveFirmware({}, emulated.Faults())

    def ask(text):
        return emulated.unframed(
            firmware.reply(emulated.framed(f"1 {text}").rstrip(), 0.0).rstrip()
        )

    assert ask("set 1 100") == "1 error beat"
    ask("beat 1000")
    assert ask("set 1 100") == "1 error fault"  # it has just started
    ask("vent 1")
    assert ask("set 1 100") == "1 error limit"
    ask("limit 1 100")
    assert ask("set 1 100") == "1 set 1 100"
