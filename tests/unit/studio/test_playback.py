"""Tests of playback of a recording at any time."""

import numpy as np
import pytest

from mjtactile.core.scenario import Scenario
from mjtactile.recording.reader import load_recording
from mjtactile.studio.playback import RecordingPlayer
from tests.fake_run import write_fake_recording

COUNT = 12


@pytest.fixture
def tape(tmp_path):
    cycles = write_fake_recording(tmp_path, COUNT)
    tape = RecordingPlayer(Scenario(rig=f"replay:{tmp_path}"), load_recording(tmp_path))
    for cycle in cycles:
        tape.add(cycle)
    tape.playing = False
    return tape


def test_image_touch_truth_and_curves_follow_the_time(tape):
    for number in (7, 2, COUNT - 1):
        tape.at = number / 30 + 0.01  # 30 cycles a second
        snapshot = tape.snapshot()
        assert snapshot.number == number and snapshot.time == pytest.approx(number / 30)
        for estimated, image, true in zip(
            snapshot.fingers,
            tape.recording.images_of(number),
            tape.recording.column("force_normal_true")[number],
            strict=True,
        ):
            np.testing.assert_array_equal(estimated.image.pixels, image.pixels)
            assert estimated.true == pytest.approx(
                true
            ) and estimated.touch.force_normal == pytest.approx(true / 0.97, abs=0.02)
        curves = tape.history.curves()
        assert len(curves.time) == COUNT and curves.now == pytest.approx(tape.at)


def test_playback_follows_the_clock_and_restarts_at_the_end(tape, monkeypatch):
    clock = [100.0]
    monkeypatch.setattr("mjtactile.studio.playback.wall.monotonic", lambda: clock[0])
    tape.at = 0.0
    tape.playing = True
    clock[0] += 0.2
    assert tape.at == pytest.approx(0.2)
    clock[0] += 10
    assert tape.at == tape.length == pytest.approx((COUNT - 1) / 30)
    tape.playing = False
    tape.playing = True
    assert tape.at == 0.0


def test_a_playback_stores_no_images(tape):
    assert all(
        estimated.image.pixels.size == 1
        for snapshot in tape._snapshots
        for estimated in snapshot.fingers
    )
