"""Loading a user's controller file."""

import os
import sys

import pytest

from mjtactile.core.errors import ControllerError
from mjtactile.runtime.controller import load_controller

DATACLASS = """
from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(kw_only=True)
class Plan:
    force: float
    kind: str = "NAME"


def step(observation):
    return replace(observation, phase=Plan(force=1.0).kind)
"""


def test_dataclasses_with_deferred_annotations_in_files_of_equal_name(tmp_path):
    """A dataclass resolves the types of its fields in the names of its module."""
    loaded = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        path = tmp_path / name / "mine.py"
        path.write_text(DATACLASS.replace("NAME", name))
        loaded.append(load_controller(path))
    names = [item.function.__globals__["Plan"](force=1.0).kind for item in loaded]
    assert names == ["a", "b"]
    assert loaded[0].function.__module__ != loaded[1].function.__module__


@pytest.mark.parametrize("raised", ["GeneratorExit", "SystemExit(3)", "BaseException('x')"])
def test_every_import_error_is_one_line(tmp_path, raised):
    path = tmp_path / "mine.py"
    path.write_text(f"raise {raised}\n")
    with pytest.raises(ControllerError, match=r"mine\.py: cannot be imported: "):
        load_controller(path)


def test_an_edit_of_equal_length_is_reloaded_without_cache_files(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    path = tmp_path / "mine.py"
    for answer in ("1", "2"):
        path.write_text(f"def step(observation):\n    return {answer}\n")
        os.utime(path, (1.0, 1.0))
        assert load_controller(path).function(None) == int(answer)
    assert list(tmp_path.iterdir()) == [path]
