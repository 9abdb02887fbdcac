"""Tests of files of any origin: limits, pipes, devices and impossible names give one-line
errors."""

import os
from pathlib import Path

import pytest

from mjtactile.core import foreign_file
from mjtactile.core.camera_file import read as read_camera_file
from mjtactile.core.errors import InputError
from mjtactile.core.policy_file import load_policy
from mjtactile.core.toml import read_json, read_toml
from mjtactile.recording.stage_protocol import read_moves
from mjtactile.sensing.pose.circles_from_images import load_image

READERS = {
    "bytes": (lambda path: foreign_file.read_bytes(path, 10, "a file"), "a"),
    "TOML": (read_toml, "a.toml"),
    "JSON": (read_json, "a.json"),
    "image": (load_image, "a.png"),
    "camera": (read_camera_file, "a.yaml"),
    "policy": (load_policy, "a.npz"),
    "protocol": (read_moves, "./a.csv"),
}


@pytest.mark.parametrize("kind", READERS)
def test_a_pipe_never_blocks(tmp_path, monkeypatch, kind):
    """A pipe without a writer would wait forever."""
    read, name = READERS[kind]
    monkeypatch.chdir(tmp_path)
    os.mkfifo(name)
    with pytest.raises(InputError, match=r"is not a regular file|no such file") as caught:
        read(tmp_path / name)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", READERS)
@pytest.mark.parametrize("how", ["missing", "folder", "long", "deep"])
def test_a_path_that_is_not_a_file_is_one_line(tmp_path, monkeypatch, kind, how):
    read, name = READERS[kind]
    monkeypatch.chdir(tmp_path)
    path = tmp_path / name
    if how == "folder":
        path.mkdir()
    if how == "long":
        path = path.with_name("x" * 300 + path.suffix)
    if how == "deep":
        path = path.parent / ("x/" * 3000) / path.name
    with pytest.raises(InputError) as caught:
        read(path)
    assert "\n" not in str(caught.value)


def test_files_above_the_size_limit_are_refused(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"x" * 10)
    assert foreign_file.read_bytes(path, 10, "a file") == b"x" * 10
    path.write_bytes(b"x" * 11)
    with pytest.raises(InputError, match="a: is larger than 10 bytes, the limit for a file"):
        foreign_file.read_bytes(path, 10, "a file")
    with pytest.raises(InputError, match="/dev/zero: is not a regular file"):
        foreign_file.read_bytes(Path("/dev/zero"), 10, "a file")
