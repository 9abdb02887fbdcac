"""Columns of a LeRobot data set, and their values for a cycle.

Policies use `observation.state` and `action`. `policy.observation` and `policy.action` are those of
`mjtactile.policy_data`, for `controllers/policy.py`. `next.*` has reward, end and success of an
episode. `recorded.*` is the log column by column, in doubles.
`truth.*` is the ground truth of a simulation; no policy treats this name as an observation.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core.types import Array, Image
from mjtactile.export.episode import LISTS, Perceived, RecordedEpisode, part_names
from mjtactile.recording.files import to_json
from mjtactile.recording.log_schema import TRUE
from mjtactile.recording.policy_data import ACTION_NAMES, REWARDS

IMAGES = {"video": ("video", 3), "png": ("image", 1), "none": ("", 0)}
"""Image storage: LeRobot's data type and the number of channels for a reader."""
SUCCESS = "held"
INDEX = ("timestamp", "frame_index", "episode_index", "index", "task_index")
_STATE = {
    **{"opening": "opening_m", "speed": "speed_m_s"},
    **{"effort": "effort_N", "lift_height": "lift_height_m"},
}
_ACTION = {
    "command_opening": "opening_m",
    "command_force_limit": "force_limit_N",
    "command_lift_height": "lift_height_m",
}
_WRENCH = ("fx_N", "fy_N", "fz_N", "tx_Nm", "ty_Nm", "tz_Nm")


@dataclass(frozen=True)
class Feature:
    """Column with `dtype` and `names` as in info.json, and the function that computes its value."""

    dtype: str
    names: list[str]
    value: Callable[[Perceived], Any]
    shape: tuple[int, ...] = ()

    def info(self) -> dict[str, Any]:
        return {
            "dtype": self.dtype,
            "shape": list(self.shape or (len(self.names),)),
            "names": self.names,
        }


def features_of(episode: RecordedEpisode, images: str) -> dict[str, Feature]:
    """Return the columns of an episode."""
    wrench = [f"{finger}.{name}" for finger, name in product(episode.fingers, _WRENCH)]
    found = {
        "observation.state": Feature("float32", [*_STATE.values(), *wrench], _state),
        "action": Feature("float32", list(_ACTION.values()), _action),
    }
    found |= _policy_columns(episode) | _result_columns(episode)
    found |= _image_columns(episode, images)
    if episode.re_estimate:
        found |= _marker_columns(episode)
    for key in episode.keys:
        found |= _column(episode, key)
    return found


def _state(perceived: Perceived) -> Array:
    """Return the gripper state and the wrench on each finger."""
    reported = [float(perceived.row[key]) for key in _STATE]
    wrenches = np.array(list(perceived.row["wrench"]), float)
    return np.concatenate([reported, np.ravel(wrenches)])


def _action(perceived: Perceived) -> Array:
    """Return the command."""
    return np.array([float(perceived.row[key]) for key in _ACTION])


def _policy_columns(episode: RecordedEpisode) -> dict[str, Feature]:
    """Return the columns of a policy file's inputs and outputs."""
    data = episode.policy
    return {
        "policy.observation": Feature(
            "float32", list(data.names), lambda perceived: data.observations[perceived.cycle]
        ),
        "policy.action": Feature(
            "float32", list(ACTION_NAMES), lambda perceived: data.actions[perceived.cycle]
        ),
    }


def _result_columns(episode: RecordedEpisode) -> dict[str, Feature]:
    """Return reward, end and success; they are 0 and False before the last frame."""
    last = len(episode.recording) - 1
    reward = REWARDS.get(episode.outcome, 0.0)
    success = episode.outcome == SUCCESS
    return {
        "next.reward": Feature(
            "float32", ["reward"], lambda perceived: np.array([reward * (perceived.cycle == last)])
        ),
        "next.done": Feature(
            "bool", ["done"], lambda perceived: np.array([perceived.cycle == last])
        ),
        "next.success": Feature(
            "bool", ["success"], lambda perceived: np.array([success and perceived.cycle == last])
        ),
    }


def _image_columns(episode: RecordedEpisode, images: str) -> dict[str, Feature]:
    """Return the columns of each camera's images, in the size of its first; empty without
    images."""
    kind, channels = IMAGES[images]
    if not kind:
        return {}
    first: tuple[Image, ...] = next(
        (cycle_images for cycle_images in episode.recording.images() if cycle_images), ()
    )
    names = ["height", "width", "channels"]
    found = {}
    for k, (finger, image) in enumerate(zip(episode.fingers, first, strict=False)):
        shape = (*image.pixels.shape, channels)
        value = partial(_image_file, finger=k)
        found[f"observation.images.{finger}"] = Feature(kind, names, value, shape)
    return found


def _image_file(perceived: Perceived, finger: int) -> Path:
    return perceived.files[finger]


def _marker_columns(episode: RecordedEpisode) -> dict[str, Feature]:
    """Return the columns of each finger's marker positions."""
    count = episode.design.markers.count
    names = [f"{marker}.{axis}_m" for marker, axis in product(range(count), "xyz")]
    return {
        f"observation.markers.{finger}": Feature(
            "float32", names, partial(_markers, finger=k, count=count)
        )
        for k, finger in enumerate(episode.fingers)
    }


def _column(episode: RecordedEpisode, key: str) -> dict[str, Feature]:
    """Convert a column of the log: numbers, text, or JSON for each finger."""
    name = f"{'truth' if key in TRUE else 'recorded'}.{key}"
    column = episode.recording.columns[key]
    if key not in LISTS and not np.prod(column.shape[1:]):
        return {}  # default for a rig without valves

    def numbers(perceived: Perceived) -> Array:
        return np.ravel(np.asarray(perceived.row[key], float))

    if key not in LISTS and column.dtype != object:
        return {name: Feature("float64", part_names(episode, key), numbers)}
    if not isinstance(column[0], (list, tuple, np.ndarray)):
        return {name: Feature("string", [key], lambda perceived: _text(perceived.row[key]))}
    found = {}
    for k, finger in enumerate(episode.fingers):
        found[f"{name}.{finger}"] = Feature(
            "string", [finger], lambda perceived, k=k: _text(perceived.row[key][k])
        )
    return found


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(to_json(value))


def _markers(perceived: Perceived, finger: int, count: int) -> Array:
    """Return the positions (3 count,) m in S; NaN for an undetected marker."""
    p_SM = np.full((count, 3), np.nan)
    if perceived.touch and (markers := perceived.touch[finger].markers) is not None:
        p_SM[markers.ids] = markers.p_SM
    return p_SM.ravel()
