"""Tests of the contract of `Command`, stated in its docstring, for every gripper: simulated,
emulated, replayed, in the Gymnasium environment, and the stub of the tests."""

import json
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pytest

import mjtactile.gym  # noqa: F401  # registers the environment
from mjtactile.core.errors import InputError
from mjtactile.core.types import COMMAND_FIELDS, Command
from mjtactile.core.types.command import PRESSURE_STEP, command_table
from mjtactile.emulator.rig import build_emulated_rig
from mjtactile.recording.files import LOG
from mjtactile.recording.log_schema import SENSED
from mjtactile.recording.reader import Recording, load_recording
from mjtactile.replay.rig import ReplayGripper, build_replay_rig
from mjtactile.rig.command_limits import CommandLimits
from mjtactile.rig.registry import build_rig
from tests.contract.test_rigs import record
from tests.patient import DESIGN, SIMULATED, SLOW_CAMERA_DESIGN, patient_rig_file
from tests.stub_rig import World

# group for one worker, since the emulator starts slowly
ONE_EMULATOR = pytest.mark.xdist_group("commands of an emulated rig")
EMULATED = pytest.param("emulated", marks=[pytest.mark.clock, pytest.mark.slow(8), ONE_EMULATOR])
PERIOD = 1 / 30


def make(name, request):
    """Return the rig of a name; the caller closes it."""
    if name in SIMULATED:
        return build_rig(name, DESIGN, object_name="egg", seed=0)
    if name == "emulated":
        emulator = request.getfixturevalue("emulator")
        return build_emulated_rig(
            patient_rig_file(), SLOW_CAMERA_DESIGN, object_name="egg", seed=0, emulator=emulator
        )
    if name == "gym":
        env = gymnasium.make("mjtactile/Grasp-v0", object="egg", effects="-mesh,-pipeline")
        env.reset(seed=0)
        return env.unwrapped._rig
    return World().rig()


@pytest.fixture(params=[*SIMULATED, EMULATED, "gym", "stub"])
def rig(request):
    rig = make(request.param, request)
    try:
        yield rig
    finally:
        rig.close()


def go(rig, command, time):
    """Send `command` through the limits each period for `time` s; return the last command sent."""
    last = replace(command, opening=rig.gripper.state().opening, lift_height=0.0)
    for _ in range(round(time / PERIOD)):
        last = rig.gripper.command(rig.limits.apply(command, last, PERIOD))
        rig.clock.wait_until(rig.clock.now() + PERIOD)
        rig.gripper.state()  # as the loop does: the driver's goals start from where the jaws are
    return last


# -- every gripper
# --------------------------------------------------------------------------------


def test_none_keeps_the_limit_and_the_returned_command_has_it(rig):
    opening = rig.gripper.state().opening
    first = rig.gripper.command(Command(opening, None)).force_limit
    assert first is not None and first > 0
    for limit in (2.0, 0.0, 0.5):
        assert rig.gripper.command(Command(opening, limit)).force_limit == limit
        assert rig.gripper.command(Command(opening, None)).force_limit == limit


def test_the_returned_command_is_within_the_limits_of_the_rig(rig):
    far = Command(9.0, 1e6, 9.0)
    near = Command(-9.0, -1.0, -9.0)
    start = Command(rig.gripper.state().opening, 1.0)
    for requested, force in ((far, rig.limits.force), (near, 0.0)):
        sent = rig.gripper.command(rig.limits.apply(requested, start, PERIOD))
        assert sent.force_limit == force
        assert rig.limits.opening[0] <= sent.opening <= rig.limits.opening[1]
        assert abs(sent.opening - start.opening) <= rig.limits.speed * PERIOD + 1e-9
        assert rig.limits.lift[0] <= sent.lift_height <= rig.limits.lift[1]


def test_the_returned_command_has_phase_memory_and_reason(rig):
    requested = Command(rig.gripper.state().opening, 1.0, 0.0, "close", {"a": 1.0}, "because")
    sent = rig.gripper.command(requested)
    assert (sent.phase, dict(sent.memory), sent.reason) == ("close", {"a": 1.0}, "because")


def test_with_zero_force_the_jaws_stay_open(rig):
    """A force limit of 0 closes the jaws without force. Version 1 kept the previous limit
    instead."""
    before = rig.gripper.state().opening
    go(rig, Command(rig.limits.opening[0], 0.0), 1.0)
    after = rig.gripper.state()
    assert after.opening == pytest.approx(before, abs=5e-4)  # an unpowered gripper may sag
    if rig.name != "stub":
        assert abs(after.effort) < 0.02  # effort in N; the servo current is rounded to 1 mA


@pytest.mark.parametrize("name", [pytest.param("sim", marks=pytest.mark.slow), EMULATED])
def test_grip_force_equals_the_force_limit(name, request):
    rig = make(name, request)
    try:
        efforts = []
        for limit, time in ((1.0, 2.0), (0.5, 1.0), (0.0, 1.0), (2.0, 1.0)):
            go(rig, Command(0.0, limit), time)
            efforts.append(rig.gripper.state().effort)
    finally:
        rig.close()
    assert efforts == pytest.approx([1.0, 0.5, 0.0, 2.0], abs=0.1)


# -- the environment
# --------------------------------------------------------------------------------


def test_the_range_of_the_force_action_is_monotonic():
    """Peak forces on an egg increase with the action; -1 makes no contact."""
    peaks = []
    for action in (-1.0, -0.95, -0.85, -0.7):
        env = gymnasium.make("mjtactile/Grasp-v0", object="egg", effects="-mesh,-pipeline")
        _, info = env.reset(seed=1)
        for _ in range(75):
            _, _, over, _, info = env.step(np.array([-1.0, action, 0.0], np.float32))
            assert not over
        peaks.append(info["peak_force_true_N"])
        env.close()
    assert peaks[0] == 0.0
    assert (np.diff(peaks) > 0.1).all()


# -- recordings
# --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recording")
    rig = build_rig("sim", DESIGN, object_name="egg", seed=0)
    try:
        record(rig, folder)
    finally:
        rig.close()
    return folder


def test_a_replay_returns_the_recorded_commands(folder):
    rig = build_replay_rig(str(folder))
    limits = load_recording(folder).columns["command_force_limit"]
    for _ in range(200):
        if rig.gripper._tape.cycle == 3:
            break
        for camera in rig.cameras:
            camera.read()
    assert rig.gripper.command(Command(0.05, None)).force_limit == limits[3] == 2.0


def test_zero_in_an_old_recording_keeps_the_previous_limit(folder, tmp_path):
    """Version 1 wrote 0 where the limit stayed as it was, and before the first one."""
    lines = [json.loads(line) for line in (folder / LOG).read_text().splitlines()]
    cycles = [line for line in lines if line["kind"] == "cycle"]
    for line, limit in zip(cycles, (0.0, 2.0, 0.0, 3.0), strict=False):
        line["command_force_limit"] = limit
    for version, requested in ((1, [math.nan, 2.0, 2.0, 3.0]), (2, [0.0, 2.0, 0.0, 3.0])):
        lines[0]["version"] = version
        log = tmp_path / str(version) / LOG
        log.parent.mkdir()
        log.write_text("".join(json.dumps(line) + "\n" for line in lines))
        found = load_recording(log.parent).columns["command_force_limit"][:4]
        assert np.array_equal(found, requested, equal_nan=True)


def test_a_replay_does_not_invent_a_limit():
    columns = {
        "time": np.zeros(1),
        "command_opening": np.array([0.05]),
        "command_force_limit": np.array([math.nan]),
    }
    recording = Recording(Path(), {}, {}, columns, True, ())
    tape: Any = SimpleNamespace(cycle=0, recording=recording)
    assert ReplayGripper(tape).command(Command(0.05, 1.0)).force_limit is None


# -- rejected commands, and clamping by the limits ----------------------------------------


@pytest.mark.parametrize("value", [math.nan, math.inf, "4", True])
@pytest.mark.parametrize(
    "field", [name for name, one in COMMAND_FIELDS.items() if one.kind == "number"]
)
def test_non_finite_numbers_are_refused(field, value):
    with pytest.raises(InputError, match=field):
        replace(Command(0.05, 1.0), **{field: value})


def test_only_documented_fields_can_be_none():
    kept = Command(0.05, None)
    assert kept.force_limit is None and kept.gauge_pressure is None
    assert {name for name, one in COMMAND_FIELDS.items() if one.none} == {
        "force_limit",
        "gauge_pressure",
    }
    for field in ("opening", "lift_height", "reason"):
        with pytest.raises(InputError, match=field):
            replace(kept, **{field: None})


def test_limits_leave_none_alone():
    sent = CommandLimits().apply(Command(0.05, None), Command(0.05, 3.0), PERIOD)
    assert sent.force_limit is None


def test_limits_and_columns_of_every_field_come_from_its_contract():
    """A goal far beyond the limits moves by its rate, or to its range. Fields without a limit are
    unchanged."""
    limits = CommandLimits(pressure=(0.0, 3000.0), pressure_rate=6000.0)  # 200 Pa per cycle
    last = Command(0.05, 1.0, 0.02, gauge_pressure=(600.0,))
    far = Command(9.0, 99.0, 9.0, "hold", {"a": 1.0}, "why", (9e3,))
    sent = limits.apply(far, last, PERIOD)
    step = 0.1 * PERIOD
    assert (sent.opening, sent.force_limit, sent.lift_height) == (0.05 + step, 10.0, 0.02 + step)
    assert sent.gauge_pressure == (600.0 + PRESSURE_STEP,)
    assert (sent.phase, dict(sent.memory), sent.reason) == ("hold", {"a": 1.0}, "why")
    clipped = limits.clip(far)
    assert (clipped.opening, clipped.lift_height, clipped.gauge_pressure) == (0.12, 0.15, (3000.0,))
    for name, entry in COMMAND_FIELDS.items():
        assert entry.column in SENSED
        assert entry.read(entry.write(getattr(far, name), 1)) == getattr(far, name)
        if entry.none:
            assert entry.read(entry.write(None, 2)) is None


def test_the_page_of_controllers_has_the_contract():
    page = (Path(__file__).resolve().parents[2] / "docs/how-to/controllers.md").read_text()
    written = page.partition("<!-- bench:command-page -->\n")[2].partition("<!-- /bench -->")[0]
    # else: mjtactile bench command-page --readme
    assert written == command_table()
