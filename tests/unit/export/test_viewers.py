"""Tests of the data sent to Rerun and Foxglove, of a recording and of a live run: they are the
touch data."""

import json
from importlib.util import find_spec
from types import SimpleNamespace

import numpy as np
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

import mjtactile
from mjtactile.commands.record import Monitor
from mjtactile.core.design import load_sensor
from mjtactile.export import live_view, mcap, viewer_entities
from mjtactile.export.episode import RecordedEpisode
from mjtactile.runtime.session import open_session
from tests.unit.export.test_export import read_mcap

needs_rerun = pytest.mark.skipif(
    find_spec("rerun") is None or find_spec("rerun.chunk") is None, reason="needs rerun-sdk"
)


def read_rrd(path):
    """Return entity to rows of (component, value), by Rerun's reader."""
    from rerun.chunk import RrdReader

    found = {}
    for chunk in RrdReader(str(path)).stream():
        for row in chunk.to_record_batch().to_pylist():
            values = {key: value for key, value in row.items() if value is not None}
            found.setdefault(chunk.entity_path, []).append(values)
    return found


def grasping(view):
    """Run some cycles of a simulated gripper at rest with the viewer `view`."""
    scenario = mjtactile.Scenario(rig="sim", object="egg")
    cycles = []

    class CycleCollector(mjtactile.Observer):
        def add(self, cycle, scene=None, **truth):
            cycles.append(cycle)

    with open_session(scenario, workers=0) as session:
        view.start(session)
        session.take_references(view)
        session.run(Monitor(0.1), time_limit=5.0, observer=CycleCollector(), on_cycle=view.add)
    view.close()
    return cycles


def test_a_membrane_is_shown_at_its_estimated_position(press, tmp_path):
    mcap.write([RecordedEpisode(press)], tmp_path)
    found, _, _ = read_mcap(tmp_path / "episode_000000.mcap")
    touch = list(RecordedEpisode(press).cycles())[-1].touch[0]
    (entity,) = found["/left/membrane/drawn"][-1][1].entities
    (surface,) = entity.triangles
    assert entity.frame_id == "left_sensor"
    sampled = np.array([[p.x, p.y, p.z] for p in surface.points])
    np.testing.assert_array_equal(sampled[:, 2], touch.surface.z.ravel())
    # triangles cover the frame once: their areas seen from above are the grid's
    corners = sampled[np.reshape(surface.indices, (-1, 3))]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    assert area.min() > 0
    assert area.sum() == pytest.approx(np.ptp(touch.surface.x) * np.ptp(touch.surface.y))
    # every marker that is followed has its curve, closed, around where it is
    (_, annotations) = found["/left/ellipses"][-1]
    assert len(annotations.points) == load_sensor("dense").markers.count


def test_an_arrow_has_the_direction_of_the_force(press):
    touch = list(RecordedEpisode(press).cycles())[-1].touch[0]
    arrow = viewer_entities.force_arrow(touch.traction, touch.surface)
    np.testing.assert_allclose(arrow.vectors[0], viewer_entities.FORCE * touch.traction.wrench[:3])
    # the load was at the center: the axis of the wrench passes through it, to the markers' noise
    np.testing.assert_allclose((arrow.tails + arrow.vectors)[0, :2], 0, atol=2e-3)
    tractions = viewer_entities.traction_arrows(touch.traction, touch.surface)
    node = np.diff(touch.traction.x)[0] * np.diff(touch.traction.y)[0]
    total = tractions.vectors.sum(axis=0)[2] * node / viewer_entities.TRACTION
    # omitted arrows are below 3 % of the largest at a node
    assert total == pytest.approx(touch.traction.wrench[2], rel=0.1)


@needs_rerun
def test_rerun_opens_a_recording(estimated, tmp_path):
    from mjtactile.export import rrd

    assert rrd.write([RecordedEpisode(estimated)], tmp_path)["episodes"] == 1
    found = read_rrd(tmp_path / "episode_000000.rrd")
    recording = RecordedEpisode(estimated).recording
    sensor = "/world/gripper_start/gripper/left_sensor"
    touch = list(RecordedEpisode(estimated).cycles())[-1].touch[0]
    points = np.array(found[f"{sensor}/membrane"][-1]["Mesh3D:vertex_positions"])
    heights = touch.surface.z.ravel().astype(np.float32)
    np.testing.assert_array_equal(points[..., 2].ravel(), heights)
    curve = found["/force/left"]
    forces = [row["Scalars:scalars"][0] for row in curve if "Scalars:scalars" in row]
    np.testing.assert_array_equal(forces, recording.column("force_normal")[:, 0])
    assert [row["frame"] for row in curve if "frame" in row] == list(range(len(recording)))
    names = [
        row["SeriesLines:names"] for row in found["/wrench/left/tz"] if "SeriesLines:names" in row
    ]
    assert names == [["tz, N m"]]
    assert any("ViewCoordinates:xyz" in row for row in found["/world"])
    (blob,) = found[f"{sensor}/left_camera/image"][-1]["EncodedImage:blob"]
    assert bytes(blob) == (recording.folder / recording.columns["images"][-1][0]).read_bytes()


@needs_rerun
def test_rerun_displays_a_run(tmp_path):
    view = mjtactile.LiveView(f"rerun:{tmp_path / 'run.rrd'}")
    cycles = grasping(view)
    assert not view.problem and not view.left_out and "run.rrd" in view.where
    found = read_rrd(tmp_path / "run.rrd")
    forces = [
        row["Scalars:scalars"][0] for row in found["/force/right"] if "Scalars:scalars" in row
    ]
    np.testing.assert_array_equal(forces, [cycle.touch[1].force_normal for cycle in cycles])


def test_foxglove_displays_a_run(tmp_path):
    view = mjtactile.LiveView(f"foxglove:{tmp_path / 'run.mcap'}")
    cycles = grasping(view)
    assert not view.problem and not view.left_out
    found, _, _ = read_mcap(tmp_path / "run.mcap")
    forces = [touch["force_normal"] for _, touch in found["/right/touch"]]
    assert forces == [cycle.touch[1].force_normal for cycle in cycles]
    assert len(found["/left/image"]) == len(found["/left/membrane/drawn"]) == len(cycles)
    assert found["/left/image"][0][1].data.startswith(b"\x89PNG")


def test_a_viewer_that_connects_later_sees_the_scene():
    """A viewer that connects later gets the scene: a server keeps no history, and static parts are
    sent repeatedly."""
    view = mjtactile.LiveView("foxglove:0")
    view.start(
        SimpleNamespace(
            disk_wait_time=1.0, perceptions=(), rig=SimpleNamespace(fingers=(), scene=None)
        )
    )
    url = f"ws://127.0.0.1:{view.where.rsplit(':', 1)[-1]}"
    with connect(url, subprotocols=["foxglove.sdk.v1"]) as client:
        reported = json.loads(client.recv(timeout=5))
        assert reported["op"] == "serverInfo" and reported["name"] == "mjtactile"
    for origin in ("https://evil.example", "null", "http://localhost:1"):
        with pytest.raises(InvalidStatus, match="403"):
            connect(url, subprotocols=["foxglove.sdk.v1"], origin=origin)
    with connect(url, subprotocols=["foxglove.sdk.v1"], origin="https://app.foxglove.dev"):
        pass
    view.close()
    solid = SimpleNamespace(
        name="egg",
        points=np.eye(3),
        faces=np.array([[0, 1, 2]]),
        rgba=np.ones(4),
        R_WG=np.eye(3),
        p_WG=np.zeros(3),
    )
    scene = SimpleNamespace(solids=lambda: [solid], soft_bodies=lambda: [])
    observed = SimpleNamespace(view=scene, time=0.0, ellipses=(), touch=())
    sampled = viewer_entities.EntityStream(SimpleNamespace(fingers=()))
    assert [i.topic for i in sampled.of(observed)] == ["/scene/egg", "/tf_scene"]
    assert not list(sampled.of(observed))  # it has not moved
    sampled.again()
    assert len(list(sampled.of(observed))) == 2


def test_a_failed_viewer_is_disconnected(tmp_path, caplog):
    view = mjtactile.LiveView(f"foxglove:{tmp_path / 'run.mcap'}")

    class BrokenViewer:
        where, forgets = "", False

        def log(self, item):
            raise OSError("the disk is full")

        def close(self):
            pass

    view._open = lambda *_, **__: BrokenViewer()
    assert len(grasping(view)) >= 3  # the run continued
    assert "the disk is full" in view.problem and "the disk is full" in caplog.text


@pytest.mark.parametrize(
    "target, reported",
    [
        ("rviz", "valid: rerun, rerun:FILE.rrd"),
        ("foxglove:run.bag", "does not end in .mcap"),
        ("foxglove:65536", "port 65536 is not from 0 to 65535"),
        ("foxglove:/nowhere/run.mcap", "no such folder"),
    ],
)
def test_an_unknown_target_is_named(target, reported):
    with pytest.raises(mjtactile.InputError, match=reported):
        live_view.LiveView(target)


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setattr(live_view, "find_spec", lambda _: None)
    with pytest.raises(mjtactile.InputError, match=r"pip install 'mjtactile\[live\]'"):
        live_view.LiveView("rerun")


@needs_rerun
def test_without_a_display_a_file_is_suggested(monkeypatch):
    from mjtactile.export import rerun_sink

    monkeypatch.setattr(rerun_sink, "_has_screen", lambda: False)
    monkeypatch.setattr(rerun_sink, "_is_open", lambda: False)
    with pytest.raises(mjtactile.InputError, match=r"rerun:FILE\.rrd writes a file"):
        rerun_sink.to_viewer(rerun_sink.RerunSink(()))
