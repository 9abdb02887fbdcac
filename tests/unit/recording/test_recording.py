"""Tests that a recording holds exactly its input, and that a truncated one still opens."""

import json
import math
import queue
import resource
import shutil
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mjtactile.core.errors import InputError
from mjtactile.core.types import Command, Slip, Touch
from mjtactile.recording import writer
from mjtactile.recording.files import to_json, write_json
from mjtactile.recording.reader import load_recording
from mjtactile.recording.writer import Recorder
from tests.emulated import wait_for
from tests.fake_run import fake_cycle, fake_touch, write_fake_recording


def test_a_recording_returns_its_inputs(tmp_path):
    cycles = write_fake_recording(tmp_path / "run" / "recording", count=20)
    recording = load_recording(tmp_path / "run")  # the run's folder will do
    assert recording.complete and not recording.problems and len(recording) == 20
    assert recording.header["object"] == "egg" and recording.notes["break_force_N"] == 2.5
    np.testing.assert_array_equal(recording.columns["time"], [cycle.time for cycle in cycles])
    np.testing.assert_array_equal(
        recording.column("force_normal"),
        [[t.force_normal for t in cycle.touch] for cycle in cycles],
    )
    for cycle, images in zip(cycles, recording.images(), strict=True):
        for image, read in zip(cycle.images, images, strict=True):
            np.testing.assert_array_equal(read.pixels, image.pixels)  # lossless
            assert read.time == image.time


@pytest.mark.parametrize(
    ("noted", "called"),
    [
        (("first", "second", "third"), ("first", "second", "third")),
        # no session note: an old or third-party recording
        (None, ("left", "right", "finger3")),
        # no names of files
        (("a/b", "b", "c"), ("left", "right", "finger3")),
        (("a", "a", "b"), ("left", "right", "finger3")),
    ],
)
def test_image_files_are_named_by_their_finger(tmp_path, noted, called):
    two = fake_cycle(0)
    cycle = replace(two, images=(*two.images, two.images[0]), touch=(*two.touch, two.touch[0]))
    with Recorder(tmp_path, {}) as recorder:
        if noted:
            recorder.note(fingers=noted)
        recorder.add_reference("flat", [[image] for image in cycle.images], [None] * 3)
        recorder.add(cycle)
    recording = load_recording(tmp_path)
    assert recording.columns["images"][0] == [f"frames/000000_{name}.png" for name in called]
    assert recording.references[0].names == [[f"frames/flat_00_{name}.png"] for name in called]
    for image, read in zip(cycle.images, next(recording.images()), strict=True):
        np.testing.assert_array_equal(read.pixels, image.pixels)


def test_unknown_force_is_null_in_the_file_and_nan_again_when_read(tmp_path):
    with Recorder(tmp_path, {}) as recorder:
        recorder.add(fake_cycle(0, force=math.nan))
    assert "NaN" not in (tmp_path / "log.jsonl").read_text()
    assert np.isnan(load_recording(tmp_path).column("force_normal")).all()


@pytest.mark.parametrize("keep", [0.4, 0.5, 0.9, 0.999])
def test_a_truncated_recording_can_be_read(tmp_path, keep):
    write_fake_recording(tmp_path, count=20)
    log = tmp_path / "log.jsonl"
    content = log.read_bytes()
    log.write_bytes(content[: int(keep * len(content))])
    recording = load_recording(tmp_path)
    assert not recording.complete and recording.problems
    assert 0 < len(recording) <= 20
    assert len(list(recording.images())) == len(recording)  # a line is written after its images


def test_without_ground_truth_the_column_is_nan(tmp_path):
    with Recorder(tmp_path, {}) as recorder:
        recorder.add(fake_cycle(0))
    assert np.isnan(load_recording(tmp_path).column("force_normal_true")).all()


def test_a_column_that_no_recording_has_is_an_error_with_the_names(tmp_path):
    write_fake_recording(tmp_path, count=3)
    recording = load_recording(tmp_path)
    with pytest.raises(InputError, match=r"force_norml.*valid:.*force_normal"):
        recording.column("force_norml")
    with pytest.raises(InputError, match=r"phase.*not a column of numbers"):
        recording.column("phase")


def test_estimates_are_read_back_with_their_shape(tmp_path):
    """Wrench, slip and contact of every finger are read back in their shape; unknown values are NaN
    in that shape."""
    estimated = fake_touch(0.5, 0.0)
    patch = replace(
        estimated.contact,
        force=np.array([0.1, 0.0, -0.5]),
        semi_axes=np.array([2e-3, 1e-3]),
        angle=0.3,
    )
    estimated = replace(
        estimated,
        slip=Slip("incipient", np.array([1e-3, -2e-3]), 3e-4, 0.4),
        patches=(patch, patch),
    )
    blind = Touch(0.0, 0.3, math.nan, math.nan, False, status="dark")
    with Recorder(tmp_path, {}) as recorder:
        recorder.add(replace(fake_cycle(0), touch=(estimated, blind)))
        recorder.add(replace(fake_cycle(1), touch=(estimated, estimated)))
    recording = load_recording(tmp_path)
    wrench = recording.column("wrench")
    assert wrench.shape == (2, 2, 6) and np.isnan(wrench[0, 1]).all()
    np.testing.assert_array_equal(wrench[1, 1], estimated.traction.wrench)
    np.testing.assert_allclose(recording.column("wrench_sd")[0, 0], 0.02)  # value of fake_touch
    np.testing.assert_array_equal(
        recording.column("slip_velocity")[0], [[1e-3, -2e-3], [np.nan, np.nan]]
    )
    assert (
        recording.column("contact_centroid").shape == (2, 2, 2)
        and recording.column("touch_age")[0, 1] == 0.3
    )
    assert recording.columns["slip_state"].tolist() == [
        ["incipient", "unknown"],
        ["incipient", "incipient"],
    ]
    one, other = recording.columns["patches"][0]
    assert (
        len(one) == 2
        and other == []
        and one[0]["force"] == [0.1, 0.0, -0.5]
        and one[0]["semi_axes"] == [2e-3, 1e-3]
    )
    assert recording.column("force_normal").shape == (2, 2) and recording.column("time").shape == (
        2,
        1,
    )


@pytest.mark.parametrize(("frames", "kept"), [(0, 0), (1, 10), (4, 3)])
def test_images_may_be_omitted_and_the_log_is_complete(tmp_path, frames, kept):
    with Recorder(tmp_path, {}, frames=frames) as recorder:
        for i in range(10):
            recorder.add(fake_cycle(i))
    recording = load_recording(tmp_path)
    assert (
        len(list((tmp_path / "frames").glob("*.png"))) == 2 * kept
        and recording.header["frames"] == frames
    )
    assert (
        len(recording) == 10
        and recording.width == 2
        and np.isfinite(recording.column("force_normal")).all()
    )
    assert [len(images) for images in recording.images()] == [
        2 if frames and i % frames == 0 else 0 for i in range(10)
    ]
    if frames == 1:
        recording.require_images()
    else:
        with pytest.raises(InputError, match=f"only {kept} of 10 cycles have images.*--frames all"):
            recording.require_images()


def test_an_old_recording_without_these_columns_can_be_read(tmp_path):
    write_fake_recording(tmp_path, count=3)
    log = tmp_path / "log.jsonl"
    rows = [json.loads(line) for line in log.read_text().splitlines()]
    new = {
        "wrench",
        "wrench_sd",
        "force_shear",
        "patches",
        "slip_state",
        "slip_velocity",
        "touch_age",
        "contact_area",
    }
    log.write_text(
        "".join(
            json.dumps({k: v for k, v in row.items() if k not in new | {"frames"}}) + "\n"
            for row in rows
        )
    )
    recording = load_recording(tmp_path)
    assert (
        recording.complete
        and len(recording) == 3
        and np.isfinite(recording.column("force_normal")).all()
    )
    assert np.isnan(recording.column("force_shear")).all()
    recording.require_images()


def test_phases_are_read_in_order(tmp_path):
    write_fake_recording(tmp_path, count=60)
    phases = load_recording(tmp_path).phases()
    assert [name for name, _, _ in phases] == [
        "approach",
        "close",
        "regulate",
        "lift",
        "hold",
        "lower",
        "release",
    ]
    assert all(end == start for (_, _, end), (_, start, _) in zip(phases, phases[1:], strict=False))


def test_the_cycle_shown_is_of_the_hold_phase(tmp_path):
    with Recorder(tmp_path, {}) as recorder:
        for i in range(60):
            recorder.add(fake_cycle(i, count=60))
    assert recorder.snapshot is not None and recorder.snapshot.sent.phase == "hold"


def test_missing_recordings_and_other_files_are_named(tmp_path):
    with pytest.raises(InputError, match=r"log\.jsonl"):
        load_recording(tmp_path)
    (tmp_path / "log.jsonl").write_text('{"format": "other"}\n')
    with pytest.raises(InputError, match="line 1"):
        load_recording(tmp_path)


# -- a failed recording never endangers the held object: it stops with one message, and the run
# continues

CYCLES = [fake_cycle(i) for i in range(50)]


def aborted(recorder, caplog):
    """Record until the recorder stops; return its messages."""
    for cycle in CYCLES:
        recorder.add(cycle)
        recorder._thread.join(0.01)
    recorder.close(outcome="held")
    assert recorder.problem
    return [message for message in caplog.messages if "the recording was stopped" in message]


def test_a_folder_that_is_removed(tmp_path, caplog):
    recorder = Recorder(tmp_path / "run", {})
    shutil.rmtree(tmp_path / "run")
    (reported,) = aborted(recorder, caplog)
    assert "No such file" in reported


def test_a_disk_that_is_full(tmp_path, caplog):
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    recorder = Recorder(tmp_path, {})
    for cycle in CYCLES[:3]:
        recorder.add(cycle)
    assert wait_for(recorder._queue.empty)
    # equivalent to a full disk: every write that extends a file fails
    resource.setrlimit(resource.RLIMIT_FSIZE, (1, limit[1]))
    try:
        (reported,) = aborted(recorder, caplog)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    assert "too large" in reported
    assert len(load_recording(tmp_path)) >= 2  # earlier data can be read


def test_a_process_without_descriptors(tmp_path, caplog):
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)
    recorder = Recorder(tmp_path, {})
    resource.setrlimit(resource.RLIMIT_NOFILE, (3, limit[1]))
    try:
        (reported,) = aborted(recorder, caplog)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limit)
    assert "Too many open files" in reported


def test_a_memory_that_contains_itself(tmp_path, caplog):
    memory = {}
    memory["me"] = memory
    recorder = Recorder(tmp_path, {})
    recorder.add(replace(fake_cycle(0), sent=Command(0.05, 4.0, memory=memory)))
    (reported,) = aborted(recorder, caplog)
    assert "RecursionError" in reported


@pytest.mark.parametrize("disk_wait_time", [0.0, 0.05])
def test_a_blocked_disk_does_not_block_the_run(tmp_path, caplog, monkeypatch, disk_wait_time):
    """The first image takes forever, or as long as this test; the loop is held up for
    `disk_wait_time` at most, once."""
    over = threading.Event()
    monkeypatch.setattr(Path, "write_bytes", lambda *_: over.wait(60))
    monkeypatch.setattr(writer, "_FLUSH_TIME", 0.05)
    recorder = Recorder(tmp_path, {})
    recorder.disk_wait_time = disk_wait_time
    put = recorder._queue.put
    in_vain = []

    def counted(*args, **kwargs):
        try:
            put(*args, **kwargs)
        except queue.Full:
            in_vain.append(kwargs)
            raise

    monkeypatch.setattr(recorder._queue, "put", counted)
    for cycle in 4 * CYCLES:
        recorder.add(cycle)
    assert in_vain == [{"block": disk_wait_time > 0, "timeout": disk_wait_time}]
    recorder.close(outcome="held")
    assert (
        "cycles behind" in recorder.problem
        and sum("the recording was stopped" in message for message in caplog.messages) == 1
    )
    over.set()
    recorder._thread.join()


def test_a_recording_is_never_overwritten(tmp_path):
    write_fake_recording(tmp_path, count=5)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    with pytest.raises(InputError, match="already contains a recording"):
        Recorder(tmp_path, {})
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_json_is_always_valid(tmp_path):
    write_json(
        tmp_path / "a.json",
        {"x": [math.inf, np.float64(1.5), np.int64(2)], "p": tmp_path, "n": None},
    )
    assert json.loads((tmp_path / "a.json").read_text()) == {
        "x": [None, 1.5, 2],
        "p": str(tmp_path),
        "n": None,
    }
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]
    assert to_json(True) is True


def test_commanded_pressures_are_read_back_and_older_recordings_have_none(tmp_path):
    cycles = [fake_cycle(0), fake_cycle(1)]
    commanded = replace(cycles[1].sent, gauge_pressure=(600.0, 700.0))
    with Recorder(tmp_path, {}) as recorder:
        recorder.add(cycles[0])
        recorder.add(replace(cycles[1], sent=commanded))
    recording = load_recording(tmp_path)
    assert [recording.command(k).gauge_pressure for k in range(2)] == [None, (600.0, 700.0)]
    log = tmp_path / "log.jsonl"
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    for line in lines:
        line.pop("command_pressure", None)
    log.write_text("".join(json.dumps(line) + "\n" for line in lines))
    assert load_recording(tmp_path).command(1).gauge_pressure is None
