"""One suite for every rig: what control and controllers rely on holds for sim, emulated and replay alike.

The emulated rig runs in real time beside other work, so that its time-outs are set generously here; none is asserted.
"""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mjtactile import control
from mjtactile.design import load_sensor
from mjtactile.devices.replay import build_replay_rig
from mjtactile.emulator.process import EmulatorProcess
from mjtactile.emulator.rig import build_emulated_rig
from mjtactile.errors import DeviceError, InputError
from mjtactile.recording import Recorder, load_recording
from mjtactile.rig import Camera, Clock, Gripper, Valve, build_rig
from mjtactile.rigfile import load_rig_file
from mjtactile.sensing.pipeline import SensorPipeline
from mjtactile.types import Command

pytestmark = pytest.mark.realtime

DESIGN = load_sensor("paper16")
CYCLES = 12


class Nothing:
    """A controller that closes a little and then is done."""

    path = "test"

    def __init__(self):
        self.calls = 0

    def step(self, observation):
        self.calls += 1
        phase = "done" if self.calls >= CYCLES else "approach"
        return replace(observation.command, opening=observation.command.opening - 1e-4, force_limit=2.0, phase=phase)


def patient_rig_file():
    rig_file = load_rig_file("emulated")
    cameras = tuple(replace(camera, delay=0.5) for camera in rig_file.cameras)  # stale only after 0.6 s
    return replace(rig_file, bus=replace(rig_file.bus, reply_timeout=0.25, watchdog=2.5, host_timeout=5.0), cameras=cameras,
                   valves=tuple(replace(valve, heartbeat=3.0) for valve in rig_file.valves))


@pytest.fixture(scope="module")
def emulator():
    process = EmulatorProcess(patient_rig_file(), DESIGN, object_name="egg", seed=0)
    yield process
    process.close()


@pytest.fixture(scope="module")
def recording_folder(tmp_path_factory):
    """A short run of the simulated rig."""
    folder = tmp_path_factory.mktemp("recording")
    rig = build_rig("sim", DESIGN, object_name="egg", seed=0)
    try:
        record(rig, folder)
    finally:
        rig.close()
    return folder


def record(rig, folder):
    pipelines = [SensorPipeline(DESIGN) for _ in rig.cameras]
    with Recorder(folder, {"object": "egg"}) as recorder:
        control.take_references(rig, pipelines, on_reference=recorder.add_reference)
        control.run(rig, pipelines, Nothing(), time_limit=60.0, on_cycle=recorder.add)


@pytest.fixture(params=["sim", "emulated", "replay", pytest.param("hardware", marks=pytest.mark.hardware)])
def rig(request):
    """Each kind of rig; "hardware" is the one of `pytest --hardware RIG.toml`, whose sensor is DESIGN. Clear its jaws."""
    if request.param == "sim":
        rig = build_rig("sim", DESIGN, object_name="egg", seed=0)
    elif request.param == "hardware":
        rig_file = str(Path(request.config.getoption("--hardware")).resolve())
        rig = build_rig(rig_file, DESIGN, object_name="egg", seed=0)
    elif request.param == "emulated":
        emulator = request.getfixturevalue("emulator")
        rig = build_emulated_rig(patient_rig_file(), DESIGN, object_name="egg", seed=0, emulator=emulator)
    else:
        rig = build_replay_rig(str(request.getfixturevalue("recording_folder")), DESIGN)
    try:
        yield rig
    finally:
        rig.close()


def test_its_parts_are_what_the_protocols_say(rig):
    assert len(rig.cameras) == 2
    assert all(isinstance(camera, Camera) for camera in rig.cameras)
    assert all(isinstance(valve, Valve) for valve in rig.valves)
    assert isinstance(rig.gripper, Gripper)
    assert isinstance(rig.clock, Clock)
    assert rig.period == pytest.approx(1 / DESIGN.camera.rate)


def test_the_loop_runs_on_it(rig, tmp_path):
    record(rig, tmp_path)
    recording = load_recording(tmp_path)
    assert len(recording) == CYCLES
    assert recording.complete
    time, captured = recording.columns["time"], np.array([list(t) for t in recording.columns["image_time"]])
    assert (np.diff(time) > 0).all()
    assert (captured <= time[:, None]).all()  # nothing is seen before it was captured, on one clock
    assert (np.diff(captured, axis=0) >= 0).all()
    openings = recording.columns["command_opening"]
    running = np.array([state == "running" for state in recording.columns["state"]])[1:]
    assert running.any()
    assert np.diff(openings)[running] == pytest.approx(-1e-4, abs=1e-9)  # it closed, step by step
    assert (np.diff(openings)[~running] >= 0).all()  # a picture that came late on a busy computer: it waited


def test_images_have_the_designs_size_and_see_the_markers(rig):
    for camera in rig.cameras:
        image = camera.read()
        assert image.pixels.shape == (DESIGN.camera.height, DESIGN.camera.width)
        assert len(SensorPipeline(DESIGN).markers(image)) == DESIGN.markers.count


def test_state_is_finite_and_within_the_limits(rig):
    for camera in rig.cameras:
        camera.read()
    state = rig.gripper.state()
    assert all(math.isfinite(value) for value in (state.opening, state.speed, state.effort, state.lift_height))
    low, high = rig.limits.opening
    assert low <= state.opening <= high
    assert abs(state.lift_height) < 1e-3  # where it started


def test_every_reading_says_when_it_was_taken(rig):
    images = [camera.read() for camera in rig.cameras]
    for _ in range(2):  # a replay's first image begins its first cycle only after the references' images
        for camera in rig.cameras:
            images.append(camera.read())
    before = rig.clock.now()
    readings = [rig.gripper.state(), *(valve.state() for valve in rig.valves)]
    after = rig.clock.now()
    assert all(image.time <= after for image in images)
    if rig.name == "replay":
        return  # before its first cycle nothing was recorded but images: their own test compares the times bit for bit
    for reading in readings:
        assert 0 <= reading.age <= 1.0  # s; a valve's heartbeat may be 0.25 s old, an image 0.5 s on a busy computer
        assert before - 1.0 <= reading.time <= after
        assert reading.time + reading.age <= after + 1e-9  # one clock for all of them; rounding of the sum


def test_closing_twice_does_no_harm(rig):
    rig.close()
    rig.close()


# -- what only some rigs have ---------------------------------------------------------------------------------------------

def test_a_replay_gives_the_same_numbers_bit_for_bit(recording_folder, tmp_path):
    record(build_replay_rig(str(recording_folder), DESIGN), tmp_path)
    first, second = load_recording(recording_folder), load_recording(tmp_path)
    for key in ("time", "force_normal", "force_normal_sd", "opening", "speed", "effort", "command_opening", "image_time",
                "gripper_time", "gripper_age", "valve_time", "valve_age"):
        assert np.array_equal(first.column(key), second.column(key), equal_nan=True), key
    for a, b in zip(first.images(), second.images(), strict=True):
        assert all(np.array_equal(x.pixels, y.pixels) for x, y in zip(a, b, strict=True))


def test_a_replay_ends_where_the_recording_does(recording_folder):
    class Endless(Nothing):
        def step(self, observation):
            return observation.command

    rig = build_replay_rig(str(recording_folder), DESIGN)
    pipelines = [SensorPipeline(DESIGN) for _ in rig.cameras]
    control.take_references(rig, pipelines)
    with pytest.raises(DeviceError, match=f"ends after {CYCLES} cycles"):
        control.run(rig, pipelines, Endless(), time_limit=60.0, on_cycle=lambda cycle: None)


def test_what_cannot_be_replayed_is_refused(tmp_path):
    with Recorder(tmp_path, {"object": "egg"}):
        pass
    with pytest.raises(InputError, match="cannot be replayed"):
        build_replay_rig(str(tmp_path), DESIGN)
    with pytest.raises(InputError, match="no recording here"):
        build_rig("replay:/nonexistent", DESIGN, object_name="egg", seed=0)


def test_torque_is_off_and_valves_are_vented_after_close(emulator):
    rig = build_emulated_rig(patient_rig_file(), DESIGN, object_name="egg", seed=0, emulator=emulator)
    try:
        rig.valves[0].open(1000.0)
        rig.gripper.command(Command(0.07, 2.0))
        truth = emulator.truth()
        assert all(truth["torque"].values())
        assert truth["valve"]["1"] == "open"
    finally:
        rig.close()
    truth = emulator.truth()
    assert not any(truth["torque"].values())
    assert set(truth["valve"].values()) == {"vent"}


def test_the_emulator_refuses_an_unknown_fault(emulator):
    with pytest.raises(InputError, match="valid: servo_drop"):
        emulator.fault("meteorite")


def test_an_emulator_with_a_bad_object_is_bad_input():
    with pytest.raises(InputError, match="unknown object"):
        EmulatorProcess(load_rig_file("emulated"), DESIGN, object_name="no-such-thing")
