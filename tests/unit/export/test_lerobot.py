"""Tests of `mjtactile export lerobot`: the data set equals the recordings in numbers, units and
pixels."""

import json
import shutil

import av
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

import mjtactile
from mjtactile.core.errors import InputError
from mjtactile.export import mcap, rosbag2
from mjtactile.export.episode import RecordedEpisode, find_episodes
from mjtactile.export.lerobot import dataset as lerobot
from mjtactile.recording.files import to_json
from mjtactile.recording.reader import load_recording
from mjtactile.recording.writer import Recorder
from tests.fake_run import fake_cycle


@pytest.mark.parametrize("images", ["video", "png", "none"])
def test_a_lerobot_data_set_contains_the_recordings(pair, tmp_path, images):
    result = lerobot.write(find_episodes(pair), tmp_path, images=images)
    assert result == {
        "episodes": 2,
        "frames": 21,
        "fps": 30,
        "tasks": ["grasp the egg", "grasp the vial"],
    }
    info = json.loads((tmp_path / "meta/info.json").read_text())
    assert (
        info["codebase_version"] == "v3.0"
        and info["total_frames"] == 21
        and info["splits"] == {"train": "0:2"}
    )
    rows = pq.read_table(tmp_path / "data/chunk-000/file-000.parquet").to_pandas()
    assert set(rows.columns) == {
        name for name, f in info["features"].items() if f["dtype"] != "video"
    }
    np.testing.assert_array_equal(rows["index"], range(21))
    # as lerobot reads it
    assert pd.read_parquet(tmp_path / "meta/tasks.parquet").loc["grasp the vial", "task_index"] == 1
    for k, name in enumerate("ab"):
        recording = load_recording(pair / name)
        selected = rows[rows["episode_index"] == k]
        np.testing.assert_array_equal(
            np.stack(selected["recorded.force_normal"]), recording.column("force_normal")
        )
        np.testing.assert_array_equal(
            np.stack(selected["recorded.wrench"]), recording.column("wrench").reshape(-1, 12)
        )
        np.testing.assert_array_equal(selected["recorded.time"], recording.columns["time"])
        np.testing.assert_array_equal(
            np.stack(selected["truth.force_normal_true"]), recording.column("force_normal_true")
        )
        np.testing.assert_array_equal(
            np.stack(selected["action"])[:, 0],
            recording.columns["command_opening"].astype(np.float32),
        )
        assert list(selected["recorded.phase"]) == list(recording.columns["phase"])
        assert [json.loads(text) for text in selected["recorded.memory"]] == to_json(
            list(recording.columns["memory"])
        )
        np.testing.assert_array_equal(
            selected["timestamp"], (np.arange(len(selected)) / 30).astype(np.float32)
        )
    assert rows["recorded.status_code.left"][12 + 4] == "ok"  # synthetic: only the force is NaN
    assert (
        np.isnan(rows["recorded.force_normal"][12 + 4]).all()
        and np.isfinite(rows["recorded.force_normal"][12 + 3]).all()
    )


def test_units_are_next_to_their_values(pair, tmp_path):
    lerobot.write(find_episodes(pair), tmp_path, images="none")
    features = json.loads((tmp_path / "meta/info.json").read_text())["features"]
    assert features["recorded.force_normal"]["names"] == ["left.N", "right.N"]
    assert features["observation.state"]["names"][:5] == [
        "opening_m",
        "speed_m_s",
        "effort_N",
        "lift_height_m",
        "left.fx_N",
    ]
    kept = json.loads((tmp_path / "meta/mjtactile.json").read_text())
    assert (
        kept["columns"]["wrench"]["unit"] == "N, N m"
        and kept["episodes"][0]["notes"]["break_force_N"] == 2.5
    )
    assert (
        (tmp_path / "references/episode-000000/sensor.toml")
        .read_text()
        .startswith("# The paper's sensor")
    )
    assert kept["episodes"][1]["notes"]["outcome"] == "dropped"


def test_every_pixel_of_a_video_is_the_cameras(pair, tmp_path):
    lerobot.write(find_episodes(pair), tmp_path, images="video")
    for k, name in enumerate("ab"):
        shots = list(load_recording(pair / name).images())
        for finger, side in enumerate(("left", "right")):
            with av.open(
                str(tmp_path / f"videos/observation.images.{side}/chunk-000/file-{k:03d}.mp4")
            ) as file:
                frames = list(file.decode(video=0))
            assert len(frames) == len(shots)
            for i, (frame, images) in enumerate(zip(frames, shots, strict=True)):
                np.testing.assert_array_equal(
                    frame.to_ndarray(format="rgb24")[..., 1], images[finger].pixels
                )
                assert frame.time == pytest.approx(i / 30, abs=1e-4)  # tolerance of lerobot


def test_images_in_the_parquet_file_are_the_recorded_files(pair, tmp_path):
    lerobot.write(find_episodes(pair), tmp_path, images="png")
    rows = pq.read_table(tmp_path / "data/chunk-000/file-000.parquet").to_pylist()
    recording = load_recording(pair / "a")
    assert (
        rows[3]["observation.images.right"]["bytes"]
        == (recording.folder / recording.columns["images"][3][1]).read_bytes()
    )


def test_statistics_are_those_of_all_frames(pair, tmp_path):
    """Statistics joined by the law of total variance equal those of all rows. An unknown value does
    not count."""
    lerobot.write(find_episodes(pair), tmp_path, images="none")
    stats = json.loads((tmp_path / "meta/stats.json").read_text())["recorded.opening"]
    rows = pq.read_table(tmp_path / "data/chunk-000/file-000.parquet").to_pandas()
    for name, value in (
        ("mean", rows["recorded.opening"].mean()),
        ("std", rows["recorded.opening"].std(ddof=0)),
        ("max", rows["recorded.opening"].max()),
    ):
        assert stats[name] == pytest.approx([value], abs=1e-12)
    episodes = pq.read_table(tmp_path / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [(row["dataset_from_index"], row["dataset_to_index"]) for row in episodes] == [
        (0, 12),
        (12, 21),
    ]
    assert (
        episodes[1]["stats/recorded.force_normal/count"] == [9]
        and episodes[1]["outcome"] == "dropped"
    )


@pytest.mark.parametrize(
    "write", [lambda e, out: lerobot.write(e, out, images="none"), mcap.write, rosbag2.write]
)
def test_a_recording_without_images_is_exported_without_them(tmp_path, write):
    with Recorder(tmp_path / "run", {"sensor": "dense"}, frames=0) as recorder:
        for i in range(3):
            recorder.add(fake_cycle(i))
    (tmp_path / "out").mkdir()
    assert write([RecordedEpisode(tmp_path / "run")], tmp_path / "out")["frames"] == 3


def test_repeated_estimates_equal_the_recorded_estimates(estimated, tmp_path):
    episode = RecordedEpisode(estimated)
    lerobot.write([episode], tmp_path, images="none")
    kept = json.loads((tmp_path / "meta/mjtactile.json").read_text())["episodes"][0]
    # the same images, the same chain: bit for bit
    assert kept["re_estimate"] and kept["recomputed_difference_N"] == 0.0


def test_markers_are_those_that_the_pipeline_detects(press, tmp_path):
    lerobot.write([RecordedEpisode(press)], tmp_path, images="none")
    rows = pq.read_table(tmp_path / "data/chunk-000/file-000.parquet").to_pylist()
    last = list(RecordedEpisode(press).cycles())[-1].touch[0]
    np.testing.assert_array_equal(
        np.reshape(rows[-1]["observation.markers.left"], (-1, 3))[last.markers.ids],
        last.markers.p_SM.astype(np.float32),
    )


def test_episodes_that_do_not_fit_are_named(pair, press, tmp_path):
    reasons = []
    episodes = [RecordedEpisode(pair / "a"), RecordedEpisode(press), RecordedEpisode(pair / "b")]
    result = lerobot.write(episodes, tmp_path / "some", images="none", leave_out=reasons.append)
    assert (result["episodes"], result["frames"]) == (2, 21)
    assert len(reasons) == 1 and "different columns" in reasons[0] and str(press) in reasons[0]
    with pytest.raises(InputError, match="contains no recording"):
        find_episodes(tmp_path)
    shutil.copytree(pair / "a", tmp_path / "few")
    log = tmp_path / "few/recording/log.jsonl"
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    lines[5]["images"] = []
    log.write_text("".join(json.dumps(line) + "\n" for line in lines))
    with pytest.raises(InputError, match=r"11 of 12 cycles have their images.*valid: none"):
        lerobot.write([RecordedEpisode(tmp_path / "few")], tmp_path / "out")


def graded(folder, outcome, **header):
    """Record a short synthetic grasp with an outcome."""
    with Recorder(folder, {"object": "egg", "sensor": "dense"} | header) as recorder:
        for i in range(4):
            recorder.add(fake_cycle(i, 4))
        recorder.close(outcome=outcome)


def test_reward_end_and_success_are_those_of_the_last_frame(tmp_path):
    for name in ("held", "crushed", "fault"):
        graded(tmp_path / "runs" / name, name)
    episodes = find_episodes(tmp_path / "runs")  # crushed, fault, held
    lerobot.write(episodes, tmp_path / "out", images="none")
    info = json.loads((tmp_path / "out/meta/info.json").read_text())["features"]
    assert (info["next.done"]["dtype"], info["next.success"]["dtype"]) == ("bool", "bool")
    rows = pq.read_table(tmp_path / "out/data/chunk-000/file-000.parquet").to_pandas()
    assert list(rows["next.reward"]) == [0, 0, 0, -1, 0, 0, 0, 0, 0, 0, 0, 1]
    assert list(rows["next.done"]) == [False, False, False, True] * 3
    assert list(rows["next.success"]) == [False] * 11 + [True]
    meta = pq.read_table(tmp_path / "out/meta/episodes/chunk-000/file-000.parquet").to_pandas()
    assert list(meta["success"]) == [False, False, True]


def test_policy_columns_are_the_training_data(pair, tmp_path):
    lerobot.write(find_episodes(pair), tmp_path, images="none")
    info = json.loads((tmp_path / "meta/info.json").read_text())["features"]
    assert info["policy.observation"]["names"] == mjtactile.policy_observation_names()
    rows = pq.read_table(tmp_path / "data/chunk-000/file-000.parquet").to_pandas()
    for k, name in enumerate("ab"):
        data = mjtactile.policy_data(pair / name)
        selected = rows[rows["episode_index"] == k]
        np.testing.assert_array_equal(np.stack(selected["policy.observation"]), data.observations)
        np.testing.assert_array_equal(
            np.stack(selected["policy.action"]), data.actions.astype(np.float32)
        )


@pytest.mark.parametrize(
    ("header", "text"),
    [
        ({"object": "silicone_ball"}, "grasp the silicone ball"),
        ({"object": "random:11"}, "grasp an unknown object"),
        ({"object": "my/cup.xml"}, "grasp the cup"),
        ({"object": None}, "record"),
        ({"scenario": {"task": "lift"}}, "grasp the egg"),
        ({"scenario": {"task": "bump"}}, "grasp the egg: hold it while something bumps against it"),
        ({"scenario": {"task": "gone/mine.toml"}}, "grasp the egg: mine"),
    ],
)
def test_tasks_are_readable(tmp_path, header, text):
    graded(tmp_path / "run", "held", **header)
    assert RecordedEpisode(tmp_path / "run").task == text


def test_recordings_are_selected_by_their_outcome(tmp_path):
    for name in ("held", "dropped"):
        graded(tmp_path / name, name)
    (chosen,) = find_episodes(tmp_path, outcome="held")
    assert chosen.recording.folder.name == "held"
    with pytest.raises(InputError, match=r"'crushed' .valid: dropped, held"):
        find_episodes(tmp_path, outcome="crushed")
