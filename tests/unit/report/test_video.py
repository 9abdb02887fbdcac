"""Tests of videos of runs: their length, the time in each image, and the text in place of missing
data."""

import av
import cv2
import numpy as np
import pytest

from mjtactile.cli import main
from mjtactile.core.errors import InputError
from mjtactile.recording.reader import load_recording
from mjtactile.report.video import write_video
from tests.fake_run import write_fake_recording
from tests.unit.report.test_report import FakeScene


def decoded(path):
    with av.open(str(path)) as file:
        return [frame.to_ndarray(format="gray") for frame in file.decode(video=0)]


class DarkScene(FakeScene):
    """The same triangle, black."""

    def triangles(self):
        return 0.02 * np.eye(3)[None], np.array([[0.0, 0.0, 0.0, 1.0]])


@pytest.fixture
def recording(tmp_path):
    """Provide 60 cycles at 30 Hz with uniform images whose gray level rises with time."""
    write_fake_recording(tmp_path, count=60)
    for k, path in enumerate(sorted((tmp_path / "frames").glob("*_left.png"))):
        cv2.imwrite(str(path), np.full((480, 640), 40 + 3 * k, np.uint8))
    return load_recording(tmp_path)


def test_every_image_shows_its_time(tmp_path, recording):
    result = write_video(tmp_path / "film.mp4", recording)
    frames = decoded(tmp_path / "film.mp4")
    assert len(frames) == result["frames"] == 60
    greys = [frame[60:300, 60:400].mean() for frame in frames]
    # less than half of an image's step: H.264's loss
    np.testing.assert_allclose(greys, 40 + 3 * np.arange(60), atol=1.4)


def test_a_part_can_be_rendered_at_twice_the_speed(tmp_path, recording):
    write_video(tmp_path / "film.mp4", recording, speed=2.0, start=0.5, seconds=1.0)
    greys = [frame[60:300, 60:400].mean() for frame in decoded(tmp_path / "film.mp4")]
    np.testing.assert_allclose(greys, 40 + 3 * np.arange(15, 46, 2), atol=1.4)


@pytest.mark.slow
def test_the_scene_is_rendered_next_to_the_images(tmp_path, recording):
    write_video(tmp_path / "film.mp4", recording)
    write_video(tmp_path / "scene.mp4", recording, [(0.0, FakeScene(2)), (1.0, DarkScene(2))])
    alone = decoded(tmp_path / "film.mp4")
    beside = decoded(tmp_path / "scene.mp4")
    assert beside[0].shape[1] == alone[0].shape[1] + 320
    scenes = [frame[:480, :320].astype(float) for frame in beside]
    # it changes after 1 s
    assert np.abs(scenes[40] - scenes[2]).max() > 60 and np.abs(scenes[20] - scenes[2]).max() < 30


@pytest.mark.parametrize("suffix", [".gif", ".webp"])
def test_small_videos_can_be_written(tmp_path, recording, suffix):
    result = write_video(tmp_path / f"film{suffix}", recording)
    assert (tmp_path / f"film{suffix}").stat().st_size > 1000 and result["frames"] > 15
    if suffix == ".gif":  # PyAV does not read an animated WebP
        frames = decoded(tmp_path / "film.gif")
        assert len(frames) == result["frames"] and frames[0].shape[:2] == (
            result["height_px"],
            result["width_px"],
        )


def test_only_an_own_video_is_overwritten(tmp_path, recording, capsys):
    quasistatic = tmp_path / "film.mp4"
    arguments = ["video", str(recording.folder), "--seconds", "0.1", "--out"]
    assert main([*arguments, str(quasistatic)]) == 0
    assert main([*arguments, str(quasistatic)]) == 0  # its own
    with av.open(str(tmp_path / "theirs.mp4"), "w") as file:
        stream = file.add_stream("libx264", rate=30)
        stream.width = stream.height = 64
        frame = av.VideoFrame.from_ndarray(np.zeros((64, 64, 3), np.uint8), format="rgb24")
        file.mux([*stream.encode(frame), *stream.encode()])
    (tmp_path / "notes.mp4").write_text("no film")
    (tmp_path / "theirs.gif").write_text("no film")
    for name in ("theirs.mp4", "notes.mp4", "theirs.gif"):
        before = (tmp_path / name).read_bytes()
        capsys.readouterr()
        assert main([*arguments, str(tmp_path / name)]) == 2
        assert f"{name}: --out: the path exists already" in capsys.readouterr().err
        assert main(["grasp", "--video", str(tmp_path / name)]) == 2  # before anything runs
        assert f"{name}: --video: the path exists already" in capsys.readouterr().err
        assert (tmp_path / name).read_bytes() == before


def test_bad_input_is_reported(tmp_path, recording):
    with pytest.raises(InputError, match="is not a supported video format"):
        write_video(tmp_path / "film.avi", recording)
    # an endless video: 2 s of a run in 60 million images
    with pytest.raises(InputError, match=r"at most 100000, so at least 0\.00059"):
        write_video(tmp_path / "film.mp4", recording, speed=1e-6)
    with pytest.raises(InputError, match="ends after"):
        write_video(tmp_path / "film.mp4", recording, start=100.0)
    assert not list(tmp_path.glob("*.part"))
