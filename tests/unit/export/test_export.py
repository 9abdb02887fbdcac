"""What was exported is read back by each format's own reader, and is what the recording says."""

import json
import shutil

import av
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader

from mjtactile.commands.record import Monitor
from mjtactile.core import optics
from mjtactile.core.design import load_sensor
from mjtactile.core.errors import InputError
from mjtactile.core.optics import Camera
from mjtactile.experiments.stage import record_stage
from mjtactile.export import mcap, rosbag2
from mjtactile.export.episode import Episode, find_episodes
from mjtactile.export.lerobot import dataset as lerobot
from mjtactile.recording.files import to_json
from mjtactile.recording.reader import load_recording
from mjtactile.recording.stage import Move, Stage
from mjtactile.recording.writer import Recorder
from mjtactile.run.session import open_session
from tests.fake_run import fake_cycle, write_fake_recording


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """Two made-up grasps of two fingers; in the second a force is unknown."""
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


@pytest.fixture(scope="module")
def press(tmp_path_factory):
    """A whole sensor in simulation, pressed: its images can be felt again."""
    folder = tmp_path_factory.mktemp("press") / "recording"
    stage = Stage("sphere:8", (0.0, 0.0), (Move(0.0, 1.5e-3, speed=0.02),))
    with Recorder(
        folder, {"object": None, "sensor": "dense", "rig": "stage", "seed": 0}
    ) as recorder:
        record_stage(load_sensor("dense"), stage, recorder, seconds=0.6)
        recorder.close(outcome="recorded")
    return folder


@pytest.fixture(scope="module")
def felt(tmp_path_factory):
    """Two fingers of a simulated rig that stands still, felt while it was recorded."""
    folder = tmp_path_factory.mktemp("felt") / "recording"
    with (
        open_session("sim", load_sensor("dense"), workers=0) as session,
        Recorder(folder, {"sensor": "dense", "seed": 0}) as recorder,
    ):
        session.take_references(recorder)
        session.run(Monitor(0.1), time_limit=5.0, on_cycle=recorder.add)
        recorder.close(outcome="recorded")
    return folder


# -- LeRobot
# --------------------------------------------------------------------------------


@pytest.mark.parametrize("images", ["video", "png", "none"])
def test_a_lerobot_data_set_is_the_recordings(pair, tmp_path, images):
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
        mine = rows[rows["episode_index"] == k]
        np.testing.assert_array_equal(
            np.stack(mine["recorded.force_normal"]), recording.column("force_normal")
        )
        np.testing.assert_array_equal(
            np.stack(mine["recorded.wrench"]), recording.column("wrench").reshape(-1, 12)
        )
        np.testing.assert_array_equal(mine["recorded.time"], recording.columns["time"])
        np.testing.assert_array_equal(
            np.stack(mine["truth.force_normal_true"]), recording.column("force_normal_true")
        )
        np.testing.assert_array_equal(
            np.stack(mine["action"])[:, 0], recording.columns["command_opening"].astype(np.float32)
        )
        assert list(mine["recorded.phase"]) == list(recording.columns["phase"])
        assert [json.loads(text) for text in mine["recorded.memory"]] == to_json(
            list(recording.columns["memory"])
        )
        np.testing.assert_array_equal(
            mine["timestamp"], (np.arange(len(mine)) / 30).astype(np.float32)
        )
    assert rows["recorded.status_code.left"][12 + 4] == "ok"  # made up: only the force is NaN
    assert (
        np.isnan(rows["recorded.force_normal"][12 + 4]).all()
        and np.isfinite(rows["recorded.force_normal"][12 + 3]).all()
    )


def test_units_stand_beside_the_numbers(pair, tmp_path):
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
                assert frame.time == pytest.approx(i / 30, abs=1e-4)  # what lerobot allows


def test_images_in_the_parquet_file_are_the_recorded_files(pair, tmp_path):
    lerobot.write(find_episodes(pair), tmp_path, images="png")
    rows = pq.read_table(tmp_path / "data/chunk-000/file-000.parquet").to_pylist()
    recording = load_recording(pair / "a")
    assert (
        rows[3]["observation.images.right"]["bytes"]
        == (recording.folder / recording.columns["images"][3][1]).read_bytes()
    )


def test_statistics_are_those_of_all_frames(pair, tmp_path):
    """Joined from the episodes' own by the law of total variance; by hand from all rows. An unknown
    value does not count."""
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
    assert write([Episode(tmp_path / "run")], tmp_path / "out")["frames"] == 3


def test_what_is_felt_again_is_what_was_felt(felt, tmp_path):
    episode = Episode(felt)
    lerobot.write([episode], tmp_path, images="none")
    kept = json.loads((tmp_path / "meta/mjtactile.json").read_text())["episodes"][0]
    # the same images, the same chain: bit for bit
    assert kept["felt_again"] and kept["felt_again_difference_N"] == 0.0


def test_markers_are_those_that_the_chain_sees(press, tmp_path):
    lerobot.write([Episode(press)], tmp_path, images="none")
    rows = pq.read_table(tmp_path / "data/chunk-000/file-000.parquet").to_pylist()
    last = list(Episode(press).cycles())[-1].touch[0]
    np.testing.assert_array_equal(
        np.reshape(rows[-1]["observation.markers.left"], (-1, 3))[last.markers.ids],
        last.markers.p_SM.astype(np.float32),
    )


def test_episodes_that_do_not_fit_are_named(pair, press, tmp_path):
    with pytest.raises(InputError, match="other columns"):
        lerobot.write([Episode(pair / "a"), Episode(press)], tmp_path, images="none")
    with pytest.raises(InputError, match="no recording here or below"):
        find_episodes(tmp_path)
    shutil.copytree(pair / "a", tmp_path / "few")
    log = tmp_path / "few/recording/log.jsonl"
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    lines[5]["images"] = []
    log.write_text("".join(json.dumps(line) + "\n" for line in lines))
    with pytest.raises(InputError, match=r"11 of 12 cycles have their images.*valid: none"):
        lerobot.write([Episode(tmp_path / "few")], tmp_path / "out")


# -- MCAP
# --------------------------------------------------------------------------------


def read_mcap(path):
    """Topic to (time s, message) by mcap's reader; protobuf by the schema in the file."""
    found = {}
    types = {}
    with path.open("rb") as file:
        reader = make_reader(file)
        for schema, channel, message in reader.iter_messages():
            if schema.encoding == "jsonschema":
                value = json.loads(message.data)
            else:
                if schema.name not in types:
                    pool = descriptor_pool.DescriptorPool()
                    for part in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
                        pool.Add(part)
                    types[schema.name] = message_factory.GetMessageClass(
                        pool.FindMessageTypeByName(schema.name)
                    )
                value = types[schema.name].FromString(message.data)
            found.setdefault(channel.topic, []).append((message.log_time / 1e9, value))
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        attachments = {record.name: record.data for record in reader.iter_attachments()}
    return found, metadata, attachments


def test_an_mcap_file_is_the_recording(pair, tmp_path):
    assert mcap.write(find_episodes(pair), tmp_path) == {"episodes": 2, "frames": 21}
    found, metadata, attachments = read_mcap(tmp_path / "episode_000001.mcap")
    recording = load_recording(pair / "b")
    assert [row["phase"] for _, row in found["/cycle"]] == list(recording.columns["phase"])
    lines = [json.loads(line) for line in (recording.folder / "log.jsonl").read_text().splitlines()]
    for (time, row), line in zip(
        found["/cycle"], [x for x in lines if x["kind"] == "cycle"], strict=True
    ):
        # nothing is lost, null is null
        assert {k: v for k, v in row.items() if k not in ("timestamp", "frame_id")} == {
            k: v for k, v in line.items() if k not in ("kind", "images")
        }
        assert time == pytest.approx(line["time"], abs=1e-9)
    assert (
        found["/left/touch"][4][1]["force_normal"] is None
        and found["/left/touch"][4][1]["status"] == "ok"
    )
    for (_, image), name in zip(found["/right/image"], recording.columns["images"], strict=True):
        assert (
            image.data == (recording.folder / name[1]).read_bytes()
            and image.frame_id == "right_camera"
        )
    camera = load_sensor("dense").camera
    assert list(found["/left/camera_info"][0][1].K) == camera.K.ravel().tolist()
    assert list(found["/left/camera_info"][0][1].D) == list(camera.distortion)
    joint = found["/joint_states"][3][1].joints[0]
    assert (joint.name, joint.position) == ("opening", recording.columns["opening"][3])
    assert (
        json.loads(metadata["mjtactile"]["header"])["seed"] == 1
        and metadata["mjtactile"]["fingers"] == '["left", "right"]'
    )
    assert attachments["sensor.toml"].startswith(b"# The paper's sensor")


def test_the_membrane_is_a_cloud_in_the_sensors_frame(press, tmp_path):
    mcap.write([Episode(press)], tmp_path)
    found, metadata, attachments = read_mcap(tmp_path / "episode_000000.mcap")
    _, cloud = found["/left/membrane"][-1]
    touch = list(Episode(press).cycles())[-1].touch[0]
    points = np.frombuffer(cloud.data, "<f8").reshape(-1, 3)
    np.testing.assert_array_equal(points[:, 2], touch.surface.z.ravel())
    assert [field.name for field in cloud.fields] == [
        "x",
        "y",
        "z",
    ] and cloud.frame_id == "left_sensor"
    traction = np.frombuffer(found["/left/traction"][-1][1].data, "<f8").reshape(-1, 6)
    # N: it is pressed
    assert traction[:, 5].sum() == pytest.approx(-touch.force_normal) and touch.force_normal > 0.1
    assert metadata["mjtactile"]["felt_again"] == "true"
    assert {"flat_00_left.png", "rest_09_left.png", "sensor.toml"} <= set(attachments)


# -- ROS
# --------------------------------------------------------------------------------


def read_bag(path):
    store = rosbag2.typestore()
    found = {}
    with Reader(path) as bag:
        for connection, stamp, raw in bag.messages():
            found.setdefault(connection.topic, []).append(
                (stamp / 1e9, store.deserialize_cdr(raw, connection.msgtype))
            )
        return found, {c.topic: c.msgtype for c in bag.connections}


def test_a_bag_is_the_recording(pair, tmp_path):
    assert rosbag2.write(find_episodes(pair), tmp_path) == {"episodes": 2, "frames": 21}
    found, types = read_bag(tmp_path / "episode_000001")
    recording = load_recording(pair / "b")
    assert (
        types["/left/image"] == "sensor_msgs/msg/Image"
        and types["/tf_static"] == "tf2_msgs/msg/TFMessage"
    )
    for (_, image), images in zip(found["/left/image"], recording.images(), strict=True):
        np.testing.assert_array_equal(
            image.data.reshape(image.height, image.width), images[0].pixels
        )
        assert image.header.stamp.sec + 1e-9 * image.header.stamp.nanosec == pytest.approx(
            images[0].time, abs=1e-9
        )
    wrench = np.array([[m.wrench.force.z, m.wrench.torque.x] for _, m in found["/right/wrench"]])
    np.testing.assert_array_equal(wrench, recording.column("wrench")[:, 1, [2, 3]])
    touches = [touch for _, touch in found["/left/touch"]]
    np.testing.assert_array_equal(
        [t.force_normal for t in touches], recording.column("force_normal")[:, 0]
    )
    assert np.isnan(touches[4].force_normal) and [t.slip_state for t in touches] == ["unknown"] * 9
    np.testing.assert_array_equal(
        [t.wrench_sd for t in touches], recording.column("wrench_sd")[:, 0]
    )
    np.testing.assert_array_equal(
        [j.position[0] for _, j in found["/joint_states"]], recording.columns["opening"]
    )
    np.testing.assert_array_equal(
        [c.opening for _, c in found["/command"]], recording.columns["command_opening"]
    )
    info = found["/left/camera_info"][0][1]
    np.testing.assert_array_equal(info.k, load_sensor("dense").camera.K.ravel())
    assert info.distortion_model == "plumb_bob" and json.loads(found["/cycle"][2][1].data)[
        "patches"
    ] == [[], []]
    assert (tmp_path / "mjtactile_msgs/msg/Touch.msg").is_file()
    assert (
        "break_force_N" not in recording.notes
        and "seed" in (tmp_path / "episode_000001/metadata.yaml").read_text()
    )


def test_frames_of_a_bag_put_a_point_of_the_membrane_into_the_image(press, tmp_path):
    """A marker's point through tf_static and camera_info lands on the pixel at which a marker is
    dark."""
    rosbag2.write([Episode(press)], tmp_path)
    found, _ = read_bag(tmp_path / "episode_000000")
    transform = found["/tf_static"][0][1].transforms[0]
    assert (transform.header.frame_id, transform.child_frame_id) == ("left_sensor", "left_camera")
    _, image = found["/left/image"][-1]
    _, cloud = found["/left/markers"][-1]
    points = cloud.data.view("<f4").reshape(-1, 10)
    t = transform.transform.translation
    q = transform.transform.rotation
    assert q.w == pytest.approx(1.0, abs=1e-6)  # parallel axes, as the design says
    p_CM = points[:, :3] - [t.x, t.y, t.z]
    design = load_sensor("dense")
    uv = optics.project(Camera.from_design(design.camera, design.glass), p_CM).round().astype(int)
    pixels = image.data.reshape(image.height, image.width)
    assert len(points) == 81 and pixels[uv[:, 1], uv[:, 0]].max() < 90 < np.median(pixels)


def test_in_the_gripper_the_sensors_face_each_other(pair, tmp_path):
    rosbag2.write(find_episodes(pair / "a"), tmp_path)
    found, _ = read_bag(tmp_path / "episode_000000")
    both = [t for t in found["/tf"][0][1].transforms if t.header.frame_id == "gripper"]
    ends = []
    for t in both:
        x, y, z, w = (getattr(t.transform.rotation, name) for name in "xyzw")
        # R e_z
        outward = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
        ends.append((t.transform.translation.x, outward))
    (left, out_left), (right, out_right) = ends
    assert right - left == pytest.approx(0.05)  # m, the opening of the made-up run
    np.testing.assert_allclose(out_left, [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(out_right, [-1, 0, 0], atol=1e-12)
