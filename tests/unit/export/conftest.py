"""Recordings for exporters: synthetic, of an indentation, and of a rig at rest."""

import pytest

from mjtactile.commands.record import Monitor
from mjtactile.core.design import load_sensor
from mjtactile.experiments.motion_stage import record_stage
from mjtactile.recording.stage_protocol import Move, Stage
from mjtactile.recording.writer import Recorder
from mjtactile.runtime.session import open_session
from tests.fake_run import fake_cycle, write_fake_recording


@pytest.fixture(scope="session")
def pair(tmp_path_factory):
    """Provide two synthetic grasps of two fingers; in the second a force is unknown."""
    runs = tmp_path_factory.mktemp("pair")
    write_fake_recording(runs / "a" / "recording", count=12)
    with Recorder(
        runs / "b" / "recording", {"object": "vial", "sensor": "dense", "seed": 1}
    ) as recorder:
        for i in range(9):
            cycle = fake_cycle(i, 12, force=float("nan") if i == 4 else None)
            recorder.add(cycle, force_normal_true=[0.1, 0.2])
        recorder.close(outcome="dropped")
    return runs


@pytest.fixture(scope="session")
def press(tmp_path_factory):
    """Record a whole simulated sensor under load; its images can be evaluated again."""
    folder = tmp_path_factory.mktemp("press") / "recording"
    stage = Stage("sphere:8", (0.0, 0.0), (Move(0.0, 1.5e-3, speed=0.02),))
    with Recorder(
        folder, {"object": None, "sensor": "dense", "rig": "stage", "seed": 0}
    ) as recorder:
        record_stage(load_sensor("dense"), stage, recorder, seconds=0.6)
        recorder.close(outcome="recorded")
    return folder


@pytest.fixture(scope="session")
def estimated(tmp_path_factory):
    """Record two fingers of a stationary simulated rig, with their touches."""
    folder = tmp_path_factory.mktemp("felt") / "recording"
    with (
        open_session("sim", load_sensor("dense"), workers=0) as session,
        Recorder(folder, {"sensor": "dense", "seed": 0}) as recorder,
    ):
        session.take_references(recorder)
        session.run(Monitor(0.1), time_limit=5.0, on_cycle=recorder.add)
        recorder.close(outcome="recorded")
    return folder
