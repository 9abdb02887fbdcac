# pyright: reportMissingImports=false
"""Tests that LeRobot's commands record an episode of the simulated gripper, and replay it. They run
in a separate environment (docs/how-to/integrations.md) with LeRobot and the packages of
integrations/, else they are skipped."""

import itertools
import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import mjtactile

pytest.importorskip("lerobot")
robot_package = pytest.importorskip("lerobot_robot_mjtactile")
pytest.importorskip("lerobot_teleoperator_mjtactile")
camera_package = pytest.importorskip("lerobot_camera_mjtactile")
pytestmark = pytest.mark.filterwarnings("ignore")

SECONDS = 5  # until the egg has been held for more than a second
LOOKS = 3  # at the clock, in each turn of LeRobot's loop


def command(monkeypatch, module, *options):
    monkeypatch.setattr(sys, "argv", [module.__name__, *options])
    module.main()


def first_image(data, name):
    import av

    [file] = data.glob(f"videos/observation.images.{name}/**/*.mp4")
    with av.open(str(file)) as video:
        return next(video.decode(video=0)).to_ndarray(format="rgb24")


class NewestFrame:
    """Driver that returns a new image at every second request, each brighter by one."""

    def __init__(self, device):
        self.device = device
        self.asked = 0
        self.closed = False

    def read(self):
        self.asked += 1
        taken = self.asked // 2
        grey = np.full((self.device.height, self.device.width), taken, np.uint8)
        return mjtactile.Image(grey, taken / self.device.rate)

    def close(self):
        self.closed = True


def test_a_finger_of_a_rig_file_on_another_robot(monkeypatch):
    """LeRobot creates the camera from its options: size and rate are those of the rig file, and
    each image is returned once."""
    from lerobot.cameras import make_cameras_from_configs

    monkeypatch.setattr(camera_package.camera, "load_backend", lambda group, name: NewestFrame)
    config = camera_package.MjtactileCameraConfig(rig="two_xm430", finger="right")
    device = config.device()
    assert (config.width, config.height, config.fps) == (device.width, device.height, device.rate)
    [camera] = make_cameras_from_configs({"tip": config}).values()
    with camera:
        shown = [camera.async_read() for _ in range(4)]
        driver = camera._driver
        assert camera.is_connected and driver.device.finger == "right"
    assert shown[0].shape == (device.height, device.width, 3) and shown[0].dtype == np.uint8
    assert np.all(np.diff([int(image[0, 0, 0]) for image in shown]) == 1)
    assert driver.closed and not camera.is_connected
    with pytest.raises(ConnectionError, match="not open"):
        camera.read()
    with pytest.raises(ValueError, match="no camera of finger 'middle'"):
        camera_package.MjtactileCameraConfig(rig="two_xm430", finger="middle")


@pytest.mark.slow
def test_an_episode_is_recorded_and_replayed(tmp_path, monkeypatch):
    import pandas
    from lerobot.scripts import lerobot_record, lerobot_replay

    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    # LeRobot ends an episode by the clock: by one that is as slow as this computer
    ticks = itertools.count()
    clock = SimpleNamespace(perf_counter=lambda: next(ticks) / (30 * LOOKS))
    monkeypatch.setattr(lerobot_record, "time", clock)
    hand = ["--robot.type=mjtactile", "--robot.id=hand", f"--robot.calibration_dir={tmp_path}"]
    data = [
        "--dataset.repo_id=me/egg",
        f"--dataset.root={tmp_path / 'data'}",
        "--play_sounds=false",
    ]
    command(
        monkeypatch,
        lerobot_record,
        *hand,
        *data,
        "--robot.cameras={tip: {type: mjtactile, finger: right}}",
        "--teleop.type=mjtactile",
        "--teleop.controller=gentle",
        f"--teleop.calibration_dir={tmp_path}",
        "--dataset.single_task=grasp the egg",
        "--dataset.num_episodes=1",
        f"--dataset.episode_time_s={SECONDS}",
        "--dataset.push_to_hub=false",
        "--dataset.vcodec=h264",
    )
    info = json.loads((tmp_path / "data/meta/info.json").read_text())
    names = info["features"]["observation.state"]["names"]
    rows = pandas.read_parquet(tmp_path / "data/data/chunk-000/file-000.parquet")
    states = np.array(rows["observation.state"].tolist())
    force = states[:, names.index("finger1.force_normal_N")]
    height = states[:, names.index("lift_height_m")]
    for name in ("left", "right", "tip"):
        assert info["features"][f"observation.images.{name}"]["shape"] == [480, 640, 3]
    own, tip = (first_image(tmp_path / "data", name) for name in ("right", "tip"))
    # the same image, through the same encoder
    np.testing.assert_array_equal(own, tip)
    assert own.std() > 5  # gray values: the image is not uniform
    # `gentle` holds with 0.6 N, 40 mm above the table
    assert height.max() == pytest.approx(0.04, abs=2e-3)
    assert np.median(force[height > 0.03]) == pytest.approx(0.6, abs=0.05)

    again = []
    observe = robot_package.MjtactileRobot.get_observation

    def kept(robot):
        again.append(observe(robot))
        return again[-1]

    monkeypatch.setattr(robot_package.MjtactileRobot, "get_observation", kept)
    command(monkeypatch, lerobot_replay, *hand, *data, "--dataset.episode=0")
    replayed = np.array([observed["finger1.force_normal_N"] for observed in again])
    held = height > 0.03
    # the same world; actions were kept with 24 bits, and where the jaws close the force grows by
    # 0.1 N from image to image
    np.testing.assert_allclose(replayed[held], force[held], atol=0.01)
    np.testing.assert_allclose(replayed, force, atol=0.1)
