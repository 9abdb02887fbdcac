"""A recording holds exactly what went in, and one that was cut off anywhere still opens."""

import json
import math

import numpy as np
import pytest

from mjtactile.errors import DeviceError, InputError
from mjtactile.recording import Recorder, load_recording, to_json, write_json
from tests.fake_run import fake_cycle, write_fake_recording


def test_what_goes_in_comes_out(tmp_path):
    cycles = write_fake_recording(tmp_path / "run" / "recording", count=20)
    recording = load_recording(tmp_path / "run")  # the run's folder will do
    assert recording.complete and not recording.problems and len(recording) == 20
    assert recording.header["object"] == "egg" and recording.notes["break_force_N"] == 2.5
    np.testing.assert_array_equal(recording.columns["time"], [cycle.time for cycle in cycles])
    np.testing.assert_array_equal(recording.column("force_normal"),
                                  [[t.force_normal for t in cycle.touch] for cycle in cycles])
    for cycle, images in zip(cycles, recording.images(), strict=True):
        for image, read in zip(cycle.images, images, strict=True):
            np.testing.assert_array_equal(read.pixels, image.pixels)  # lossless
            assert read.time == image.time


def test_unknown_force_is_null_in_the_file_and_nan_again_when_read(tmp_path):
    with Recorder(tmp_path, {}) as recorder:
        recorder.add(fake_cycle(0, force=math.nan))
    assert "NaN" not in (tmp_path / "log.jsonl").read_text()
    assert np.isnan(load_recording(tmp_path).column("force_normal")).all()


@pytest.mark.parametrize("keep", [0.2, 0.5, 0.9, 0.999])
def test_a_recording_cut_off_anywhere_still_loads(tmp_path, keep):
    write_fake_recording(tmp_path, count=20)
    log = tmp_path / "log.jsonl"
    whole = log.read_bytes()
    log.write_bytes(whole[: int(keep * len(whole))])
    recording = load_recording(tmp_path)
    assert not recording.complete and recording.problems
    assert 0 < len(recording) <= 20
    assert len(list(recording.images())) == len(recording)  # a line is written after its images


def test_without_truth_the_column_is_unknown_not_zero(tmp_path):
    with Recorder(tmp_path, {}) as recorder:
        recorder.add(fake_cycle(0))
    assert np.isnan(load_recording(tmp_path).column("force_normal_true")).all()


def test_phases_are_read_in_order(tmp_path):
    write_fake_recording(tmp_path, count=60)
    phases = load_recording(tmp_path).phases()
    assert [name for name, _, _ in phases] == ["approach", "close", "regulate", "lift", "hold", "lower", "release"]
    assert all(end == start for (_, _, end), (_, start, _) in zip(phases, phases[1:], strict=False))


def test_the_cycle_shown_is_of_the_hold_phase(tmp_path):
    with Recorder(tmp_path, {}) as recorder:
        for i in range(60):
            recorder.add(fake_cycle(i, count=60))
    assert recorder.snapshot is not None and recorder.snapshot.sent.phase == "hold"


def test_no_recording_and_a_foreign_file_are_named(tmp_path):
    with pytest.raises(InputError, match=r"log\.jsonl"):
        load_recording(tmp_path)
    (tmp_path / "log.jsonl").write_text('{"format": "other"}\n')
    with pytest.raises(InputError, match="line 1"):
        load_recording(tmp_path)


def test_a_disk_that_fails_is_reported_and_never_hangs_the_loop(tmp_path):
    recorder = Recorder(tmp_path, {})
    recorder._log.close()  # as good as a disk that vanished: the next write fails
    with pytest.raises(DeviceError, match="cannot be written"):
        for i in range(100):
            recorder.add(fake_cycle(i))
            recorder._thread.join(0.01)
    with pytest.raises(DeviceError):
        recorder.close()


def test_json_is_always_valid(tmp_path):
    write_json(tmp_path / "a.json", {"x": [math.inf, np.float64(1.5), np.int64(2)], "p": tmp_path, "n": None})
    assert json.loads((tmp_path / "a.json").read_text()) == {"x": [None, 1.5, 2], "p": str(tmp_path), "n": None}
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]
    assert to_json(True) is True
