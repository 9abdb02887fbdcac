"""Tests that apply to every rig: the assumptions of control and controllers hold for the shipped
gripper, an arm, three fingers, the emulated and a replayed rig.

The emulated rig runs in real time next to other work. Its time-outs are therefore generous, and no
test asserts one.
"""

# pyright: reportOptionalMemberAccess=false, reportArgumentType=false

import contextlib
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mjtactile.core import resources
from mjtactile.core.calibration import Calibration
from mjtactile.core.calibration_parts import ForceScale, LensCalibration, stamp
from mjtactile.core.errors import DeviceError, InputError
from mjtactile.core.scenario import Scenario
from mjtactile.core.types import Command
from mjtactile.core.types.command import PRESSURE_STEP
from mjtactile.emulator.process import EmulatorProcess
from mjtactile.emulator.rig import build_emulated_rig
from mjtactile.recording.reader import load_recording
from mjtactile.recording.writer import Recorder
from mjtactile.replay.rig import build_replay_rig
from mjtactile.rig.file import load_rig_file
from mjtactile.rig.protocols import CameraDevice, Clock, Gripper, Valve
from mjtactile.rig.registry import build_rig
from mjtactile.rig.scenario import resolve_scenario
from mjtactile.runtime.grasp import run_grasp
from mjtactile.runtime.references import patient_read
from mjtactile.runtime.session import Session
from mjtactile.sensing.pipeline import SensingPipeline
from mjtactile.sensing.stateful_pipeline import StatefulPipeline
from tests.patient import DESIGN, SIMULATED, SLOW_CAMERA_DESIGN, patient_rig_file

CYCLES = 12
# group for one worker, since the emulator starts slowly; slow tests on it have groups of their own
ONE_EMULATOR = pytest.mark.xdist_group("an emulated rig")


PRESSURE = 1100.0  # pressure that the controller below commands, Pa: from 1000 in three cycles


class ClosingController:
    """Controller that closes by a small amount at a higher pressure, then ends."""

    path = Path("test")

    def __init__(self):
        self.calls = 0

    def step(self, observation):
        self.calls += 1
        phase = "done" if self.calls >= CYCLES else "approach"
        return replace(
            observation.command,
            opening=observation.command.opening - 1e-4,
            force_limit=2.0,
            phase=phase,
            gauge_pressure=(PRESSURE,) * len(observation.touch) if self.calls > 2 else None,
        )


@pytest.fixture(scope="module")
def recording_folder(tmp_path_factory):
    """Provide a short run of the simulated rig."""
    folder = tmp_path_factory.mktemp("recording")
    rig = build_rig("sim", DESIGN, object_name="egg", seed=0)
    try:
        record(rig, folder)
    finally:
        rig.close()
    return folder


def record(rig, folder, notify=lambda _: None):
    session = Session(rig, notify=notify)
    with Recorder(folder, {"object": "egg"}) as recorder:
        session.take_references(recorder)
        session.run(ClosingController(), time_limit=60.0, on_cycle=recorder.add)


@pytest.fixture(
    params=[
        *SIMULATED,
        pytest.param("emulated", marks=[pytest.mark.clock, pytest.mark.slow, ONE_EMULATOR]),
        "replay",
        pytest.param("hardware", marks=pytest.mark.hardware),
    ]
)
def rig(request):
    """Provide each kind of rig. "hardware" is the rig of `pytest --hardware RIG.toml` with the
    sensor DESIGN; its jaws must be empty."""
    if request.param in SIMULATED:
        rig = build_rig(request.param, DESIGN, object_name="egg", seed=0)
    elif request.param == "hardware":
        rig_file = str(Path(request.config.getoption("--hardware")).resolve())
        rig = build_rig(rig_file, DESIGN, object_name="egg", seed=0)
    elif request.param == "emulated":
        emulator = request.getfixturevalue("emulator")
        rig = build_emulated_rig(
            patient_rig_file(), SLOW_CAMERA_DESIGN, object_name="egg", seed=0, emulator=emulator
        )
    else:
        rig = build_replay_rig(str(request.getfixturevalue("recording_folder")))
    try:
        yield rig
    finally:
        rig.close()


def test_its_parts_satisfy_the_protocols(rig):
    assert len(rig.cameras) == len(rig.fingers) == (3 if rig.name == "sim_three_finger" else 2)
    assert len({finger.name for finger in rig.fingers}) == len(rig.fingers)
    assert all(isinstance(camera, CameraDevice) for camera in rig.cameras)
    assert all(isinstance(valve, Valve) for valve in rig.valves)
    assert isinstance(rig.gripper, Gripper)
    assert isinstance(rig.clock, Clock)
    assert rig.period == pytest.approx(1 / rig.fingers[0].design.camera.rate)


def test_the_loop_runs_on_it(rig, tmp_path):
    record(rig, tmp_path)
    recording = load_recording(tmp_path)
    assert len(recording) == CYCLES
    assert recording.complete
    time = recording.columns["time"]
    captured = np.array([list(t) for t in recording.columns["image_time"]])
    assert (np.diff(time) > 0).all()
    assert (captured <= time[:, None]).all()  # capture precedes its use, on one clock
    assert (np.diff(captured, axis=0) >= 0).all()
    openings = recording.columns["command_opening"]
    running = np.array([state == "running" for state in recording.columns["state"]])[1:]
    assert running.any()
    assert np.diff(openings)[running] == pytest.approx(
        -1e-4, abs=1e-9
    )  # the gripper closed in steps
    # a late image on a busy computer: the controller held still
    assert (np.diff(openings)[~running] >= 0).all()
    pressures = recording.column("command_pressure")
    assert np.isnan(pressures[:2]).all() and np.isfinite(pressures[2:]).all()
    # from the measured pressure, with noise and zero error, one step per cycle
    assert pressures[2] == pytest.approx(1000 + PRESSURE_STEP, abs=60)
    assert (np.abs(np.diff(pressures[2:], axis=0)) <= PRESSURE_STEP + 1e-9).all()
    if running.all():
        assert pressures[-1] == pytest.approx(PRESSURE)
        # noise of the pressure sensor; a board lags by 0.1 s, on a busy computer by more
        behind = 25 if math.isinf(rig.host_timeout) else 60
        assert recording.column("gauge_pressure")[-1] == pytest.approx(PRESSURE, abs=behind)


def test_images_have_the_size_of_the_design_and_show_the_markers(rig):
    for camera in rig.cameras:
        image = patient_read(camera, rig.clock, rig.period)
        assert image.pixels.shape == (DESIGN.camera.height, DESIGN.camera.width)
        sensing_pipeline = SensingPipeline(DESIGN)
        assert (
            len(sensing_pipeline.detect_markers(sensing_pipeline.initial_state(), image)[0])
            == DESIGN.markers.count
        )


def test_state_is_finite_and_within_the_limits(rig):
    for camera in rig.cameras:
        patient_read(camera, rig.clock, rig.period)
    state = rig.gripper.state()
    assert all(
        math.isfinite(value)
        for value in (state.opening, state.speed, state.effort, state.lift_height)
    )
    low, high = rig.limits.opening
    assert low <= state.opening <= high
    assert abs(state.lift_height) < 1e-3  # the initial height


def test_every_reading_has_its_time(rig):
    images = [patient_read(camera, rig.clock, rig.period) for camera in rig.cameras]
    # a replay's first cycle starts with its first image after those of the references
    for _ in range(2):
        for camera in rig.cameras:
            images.append(patient_read(camera, rig.clock, rig.period))
    before = rig.clock.now()
    readings = [rig.gripper.state(), *(valve.state() for valve in rig.valves)]
    after = rig.clock.now()
    assert all(image.time <= after for image in images)
    if rig.name == "replay":
        # before its first cycle only images were recorded; another test compares their times bit
        # for bit
        return
    for reading in readings:
        # age in s; a valve's heartbeat may be 0.25 s old, an image 0.5 s on a busy computer
        assert 0 <= reading.age <= 1.0
        assert before - 1.0 <= reading.time <= after
        # one clock for all of them; rounding of the sum
        assert reading.time + reading.age <= after + 1e-9


def test_close_can_be_called_twice(rig):
    rig.close()
    rig.close()


# -- features of some rigs only ------------------------------------------------------------


def test_a_replay_gives_the_same_numbers_bit_for_bit(recording_folder, tmp_path):
    record(build_replay_rig(str(recording_folder)), tmp_path)
    first = load_recording(recording_folder)
    second = load_recording(tmp_path)
    for key in (
        "time",
        "force_normal",
        "force_normal_sd",
        "opening",
        "speed",
        "effort",
        "command_opening",
        "command_pressure",
        "gauge_pressure",
        "image_time",
        "gripper_time",
        "gripper_age",
        "valve_time",
        "valve_age",
    ):
        assert np.array_equal(first.column(key), second.column(key), equal_nan=True), key
    for a, b in zip(first.images(), second.images(), strict=True):
        assert all(np.array_equal(x.pixels, y.pixels) for x, y in zip(a, b, strict=True))


@pytest.mark.slow
def test_a_replay_does_not_depend_on_the_sensors_file(tmp_path):
    """The replay is bit-identical if the file is edited or missing, since the recording contains
    the sensor. The default sensor would have another pressure."""
    path = tmp_path / "mine.toml"
    text = resources.find("dense", "models/sensors", ".toml").read_text()
    path.write_text(text.replace("\nthickness_mm = 0.3 ", "\nthickness_mm = 0.33 "))
    scenario = Scenario(sensor=str(path))
    rig = build_rig(scenario)
    session = Session(rig)
    with contextlib.closing(rig), Recorder(tmp_path / "first", scenario.header()) as recorder:
        session.take_references(recorder)
        session.run(ClosingController(), time_limit=60.0, on_cycle=recorder.add)
    forces = load_recording(tmp_path / "first").column("force_normal")
    for change in (lambda: path.write_text(text), path.unlink):
        change()
        with Recorder(tmp_path / change.__name__, {"sensor": "dense"}) as recorder:
            session = Session(build_replay_rig(str(tmp_path / "first")))
            session.take_references(recorder)
            session.run(ClosingController(), time_limit=60.0, on_cycle=recorder.add)
        again = load_recording(tmp_path / change.__name__)
        assert np.array_equal(forces, again.column("force_normal"), equal_nan=True)
        assert "0.33" in again.notes["sensors"]["left"]["text"]
    with pytest.raises(InputError, match=r"--sensor: finger 'left' was recorded with 'mine', not"):
        build_replay_rig(str(tmp_path / "first"), "paper16")


def test_a_replay_reports_the_recorded_names_and_outcome(tmp_path):
    """Names and outcome are not the defaults (egg, seed 0), and not evaluated from the replay."""
    names = {"object": "random:12", "controller": "adaptive", "seed": 12}
    scenario = Scenario(**names, task="shake")
    rig = build_rig(Scenario())
    session = Session(rig)
    with contextlib.closing(rig), Recorder(tmp_path, scenario.header()) as recorder:
        session.take_references(recorder)
        session.run(ClosingController(), time_limit=60.0, on_cycle=recorder.add)
        recorder.close(outcome="crushed")
    summary = run_grasp(resolve_scenario(Scenario(rig=f"replay:{tmp_path}"))).summary()
    assert (summary["outcome"], summary["outcome_from"]) == ("crushed", "recording")
    assert names.items() <= summary.items() and summary["scenario"]["task"] == "shake"
    recorded = {**names, "sensor": "dense", "task": "shake", "outcome": "crushed", "rig": "sim"}
    assert recorded.items() <= summary["recorded"].items()
    other = resolve_scenario(Scenario(rig=f"replay:{tmp_path}", controller="slip_aware"))
    summary = run_grasp(other).summary()
    assert summary["controller"] == "slip_aware" and summary["outcome"] == "crushed"
    assert summary["recorded"]["controller"] == "adaptive"


def test_a_replay_uses_the_recorded_calibration(tmp_path):
    mark = stamp(DESIGN, {}, {})
    camera = DESIGN.camera
    lens = LensCalibration(
        camera.width,
        camera.height,
        1.01 * camera.fx,
        1.01 * camera.fy,
        camera.cx,
        camera.cy,
        camera.distortion,
        stamp=mark,
    )
    rig = build_rig("sim", DESIGN, object_name="egg", seed=0)
    known = {
        f.name: Calibration(f.name, DESIGN.name)
        .with_part(lens)
        .with_part(ForceScale(0.9, 0.01, 1.0, mark))
        for f in rig.fingers
    }
    reported = []
    fingers = tuple(replace(f, calibration=known[f.name]) for f in rig.fingers)
    try:
        record(replace(rig, fingers=fingers), tmp_path / "first", reported.append)
    finally:
        rig.close()
    assert "calibration of left: never measured: frame, valve" in reported
    replay = build_replay_rig(str(tmp_path / "first"))
    recalled = [(f.name, f.calibration) for f in replay.fingers]
    assert {name: c and c.table() for name, c in recalled} == {
        name: c.table() for name, c in known.items()
    }
    record(replay, tmp_path / "second")
    first, second = (
        load_recording(tmp_path / name).column("force_normal") for name in ("first", "second")
    )
    assert np.array_equal(first, second, equal_nan=True)


def test_a_replay_ends_where_the_recording_does(recording_folder):
    class EndlessController(ClosingController):
        def step(self, observation):
            return observation.command

    rig = build_replay_rig(str(recording_folder))
    session = Session(rig)
    session.take_references()
    with pytest.raises(DeviceError, match=f"ends after {CYCLES} cycles"):
        session.run(EndlessController(), time_limit=60.0, on_cycle=lambda cycle: None)


def test_unsupported_replays_are_refused(tmp_path):
    with Recorder(tmp_path, {"object": "egg"}):
        pass
    with pytest.raises(InputError, match="cannot be replayed"):
        build_replay_rig(str(tmp_path))
    with pytest.raises(InputError, match="contains no recording"):
        build_rig("replay:/nonexistent", DESIGN, object_name="egg", seed=0)


@pytest.mark.clock
@ONE_EMULATOR
def test_torque_is_off_and_valves_are_vented_after_close(emulator):
    rig = build_emulated_rig(
        patient_rig_file(), SLOW_CAMERA_DESIGN, object_name="egg", seed=0, emulator=emulator
    )
    try:
        rig.valves[0].open(1000.0)
        rig.gripper.command(Command(0.07, 2.0))
        truth = emulator.truth()
        assert all(truth["torque"].values())
        assert truth["valve"]["1"] == "set"
    finally:
        rig.close()
    truth = emulator.truth()
    assert not any(truth["torque"].values())
    assert set(truth["valve"].values()) == {"vent"}


@pytest.mark.clock
@ONE_EMULATOR
def test_an_emulated_membrane_is_reported_as_a_mesh(emulator):
    """The errors of its contact shapes are those of a simulated mesh, not of rubber: on 13 x 11
    vertices an egg was classified as flat with a probability of 100 %."""
    rig = build_emulated_rig(
        patient_rig_file(), SLOW_CAMERA_DESIGN, object_name="egg", seed=0, emulator=emulator
    )
    try:
        session = Session(rig)
        ratios = [
            perception.pipeline.settings.contact_shape.mesh_ratio
            for perception in session.perceptions
            if isinstance(perception, StatefulPipeline)
        ]
    finally:
        rig.close()
    # 40 x 30 mm in 12 x 10 cells; intervals are calibrated at a spacing of 1.25 mm
    assert ratios == pytest.approx([math.sqrt(40 / 12 * 30 / 10) / 1.25] * 2)


@pytest.mark.clock
@ONE_EMULATOR
def test_the_emulator_refuses_an_unknown_fault(emulator):
    with pytest.raises(InputError, match="valid: servo_drop"):
        emulator.fault("meteorite")


def test_an_emulator_with_a_bad_object_is_bad_input():
    with pytest.raises(InputError, match="unknown object"):
        EmulatorProcess(load_rig_file("emulated"), DESIGN, object_name="no-such-thing")
