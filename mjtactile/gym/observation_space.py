"""Observation spaces: the vector for policies, alone or with markers or images."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.policy import policy_bounds, policy_observation
from mjtactile.core.types import Array, Image, Observation, Touch

KINDS = ("wrench", "markers", "image")
_MARKER_MAX = 0.1  # bound of marker coordinates, m; larger than any sensor


def space_of(kind: str, designs: Sequence[SensorDesign]) -> gymnasium.spaces.Space[Any]:
    """Return the space of an observation. Raises InputError for an unknown kind or mixed
    fingers."""
    if kind not in KINDS:
        raise InputError(f"{kind!r}", source="Grasp-v0", field="observation", choices=KINDS)
    maximum = policy_bounds(len(designs)).astype(np.float32)
    vector = gymnasium.spaces.Box(-maximum, maximum, dtype=np.float32)
    if kind == "wrench":
        return vector
    sizes = {(d.markers.count, d.camera.height, d.camera.width) for d in designs}
    if len(sizes) > 1:
        text = "the fingers have different sensors, whose observations cannot be stacked"
        raise InputError(text, source="Grasp-v0", field="observation", choices=["wrench"])
    ((count, height, width),) = sizes
    if kind == "image":
        images = gymnasium.spaces.Box(0, 255, (len(designs), height, width), np.uint8)
        return gymnasium.spaces.Dict({"wrench": vector, "image": images})
    shape = (len(designs), count)
    markers = gymnasium.spaces.Box(-_MARKER_MAX, _MARKER_MAX, (*shape, 3), np.float32)
    observed = gymnasium.spaces.MultiBinary(shape)
    return gymnasium.spaces.Dict({"wrench": vector, "seen": observed, "markers": markers})


def show(kind: str, observation: Observation, images: Sequence[Image], count: int) -> Any:
    """Return the observation in that space. A marker that is not visible is 0, with `seen` 0."""
    vector = policy_observation(observation)
    if kind == "wrench":
        return vector
    if kind == "image":
        return {"wrench": vector, "image": np.stack([image.pixels for image in images])}
    found = [_markers(touch, count) for touch in observation.touch]
    return {
        "wrench": vector,
        "markers": np.stack([p for p, _ in found]),
        "seen": np.stack([observed for _, observed in found]),
    }


def _markers(touch: Touch, count: int) -> tuple[Array, Array]:
    """Return marker positions (count, 3) in S, m, and flags (count,) of the detected markers."""
    p_SM = np.zeros((count, 3), np.float32)
    observed = np.zeros(count, np.int8)
    if touch.markers is not None:
        p_SM[touch.markers.ids] = np.clip(touch.markers.p_SM, -_MARKER_MAX, _MARKER_MAX)
        observed[touch.markers.ids] = 1
    return p_SM, observed
