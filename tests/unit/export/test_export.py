"""Tests of exports: each format's own reader reads them back, and the values equal the
recording's."""

import json
import re
import shutil

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader

from mjtactile.cli import main
from mjtactile.core.design import load_sensor
from mjtactile.export import foxglove_sink, mcap, messages, rosbag2
from mjtactile.export.effective_camera import effective_camera
from mjtactile.export.episode import RecordedEpisode, find_episodes
from mjtactile.recording.reader import load_recording
from tests.lenses import CAMERAS

# -- LeRobot
# --------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["mcap", "lerobot", "rosbag2"])
def test_damaged_recordings_do_not_affect_the_others(pair, tmp_path, kind, capsys):
    """After a power cut, the log ends inside a line and the last images are empty: its whole cycles
    are exported. A recording without cycles is left out."""
    source = tmp_path / "runs"
    shutil.copytree(pair, source)
    log = source / "a" / "recording" / "log.jsonl"
    lines = log.read_text().splitlines(keepends=True)
    cycles = [k for k, line in enumerate(lines) if '"kind": "cycle"' in line]
    log.write_text("".join(lines[: cycles[10]]) + lines[cycles[10]][:50])
    for name in json.loads(lines[cycles[9]])["images"]:
        (log.parent / name).write_bytes(b"")
    (source / "c" / "recording").mkdir(parents=True)
    (source / "c" / "recording" / "log.jsonl").write_text(lines[0])
    out = tmp_path / "out"
    arguments = ["export", str(source), "--format", kind, "--out", str(out), "--json"]
    assert main(arguments) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["episodes"], result["frames"]) == (2, 9 + 9)
    (reason,) = result["left_out"]
    assert "has no cycles to export" in reason and str(source / "c") in reason
    (problems,) = result["problems"].values()
    assert "1 cycles left out" in " ".join(problems) and "1 lines left out" in " ".join(problems)
    assert not list(out.glob(".*"))


def test_a_failed_export_leaves_no_file(pair, tmp_path, capsys, monkeypatch):
    """So that the same command can be given again."""
    arguments = ["export", str(pair), "--format", "mcap", "--out", str(tmp_path / "out")]
    monkeypatch.setattr(mcap, "_attach", lambda *_: (_ for _ in ()).throw(OSError(28, "full")))
    assert main(arguments) == 3
    assert not (tmp_path / "out").exists()
    monkeypatch.undo()
    assert main(arguments) == 0 and len(list((tmp_path / "out").glob("*.mcap"))) == 2


# -- MCAP
# --------------------------------------------------------------------------------


def read_mcap(path):
    """Return topic to (time s, message) by mcap's reader; protobuf by the schema in the file."""
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


def test_an_mcap_file_contains_the_recording(pair, tmp_path):
    assert mcap.write(find_episodes(pair), tmp_path) == {"episodes": 2, "frames": 21}
    found, metadata, attachments = read_mcap(tmp_path / "episode_000001.mcap")
    recording = load_recording(pair / "b")
    assert [row["phase"] for _, row in found["/cycle"]] == list(recording.columns["phase"])
    lines = [json.loads(line) for line in (recording.folder / "log.jsonl").read_text().splitlines()]
    for (time, row), line in zip(
        found["/cycle"], [x for x in lines if x["kind"] == "cycle"], strict=True
    ):
        # all values are kept, null is null
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
    camera = effective_camera(load_sensor("dense")).camera
    assert list(found["/left/camera_info"][0][1].K) == camera.K.ravel().tolist()
    assert list(found["/left/camera_info"][0][1].D) == list(camera.distortion)
    joint = found["/joint_states"][3][1].joints[0]
    assert (joint.name, joint.position) == ("opening", recording.columns["opening"][3])
    assert (
        json.loads(metadata["mjtactile"]["header"])["seed"] == 1
        and metadata["mjtactile"]["fingers"] == '["left", "right"]'
    )
    assert attachments["sensor.toml"].startswith(b"# The paper's sensor")


def test_the_layout_shows_topics_of_the_file(press, tmp_path):
    mcap.write([RecordedEpisode(press)], tmp_path)
    found, _, _ = read_mcap(tmp_path / "episode_000000.mcap")
    layout = json.loads((tmp_path / "layout.json").read_text())
    named = set(re.findall(r"/left/[a-z_]+(?:/drawn)?", json.dumps(layout)))
    assert named <= set(found) and "/left/force/drawn" in named

    def leaves(node):
        is_panel = isinstance(node, str)
        return {node} if is_panel else leaves(node["first"]) | leaves(node["second"])

    assert leaves(layout["layout"]) == set(layout["configById"])


def test_the_membrane_is_a_cloud_in_the_sensors_frame(press, tmp_path):
    mcap.write([RecordedEpisode(press)], tmp_path)
    found, metadata, attachments = read_mcap(tmp_path / "episode_000000.mcap")
    _, cloud = found["/left/membrane"][-1]
    touch = list(RecordedEpisode(press).cycles())[-1].touch[0]
    points = np.frombuffer(cloud.data, "<f8").reshape(-1, 3)
    np.testing.assert_array_equal(points[:, 2], touch.surface.z.ravel())
    assert [field.name for field in cloud.fields] == [
        "x",
        "y",
        "z",
    ] and cloud.frame_id == "left_sensor"
    traction = np.frombuffer(found["/left/traction"][-1][1].data, "<f8").reshape(-1, 6)
    # force in N: the sensor is loaded
    assert traction[:, 5].sum() == pytest.approx(-touch.force_normal) and touch.force_normal > 0.1
    assert metadata["mjtactile"]["re_estimate"] == "true"
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


def test_a_bag_contains_the_recording(pair, tmp_path):
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


@pytest.mark.parametrize(
    ("model", "foxglove"),
    [
        ("plumb_bob", "plumb_bob"),
        ("rational_polynomial", "rational_polynomial"),
        ("equidistant", "kannala_brandt"),
    ],
)
def test_camera_messages_name_the_lens_model(press, model, foxglove):
    """The names are those of sensor_msgs and of Foxglove's schema."""
    camera = CAMERAS[model]
    item = messages.Message("/left/camera_info", "camera", 0.5, "left_camera", camera)
    info = rosbag2._Bag(RecordedEpisode(press))._camera(item)
    assert info.distortion_model == model and tuple(info.d) == camera.distortion
    assert repr(foxglove) in repr(foxglove_sink._camera(item)).replace('"', "'")
