"""Layout of Foxglove for an exported recording: scene, images with ellipses, forces over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any


def layout(fingers: Sequence[str]) -> dict[str, Any]:
    """Return a layout that Foxglove imports (Layouts, Import from file).

    Args:
        fingers: Names of the fingers.

    Returns:
        Panels and their arrangement.
    """
    images = [f"Image!{finger}" for finger in fingers]
    topics = [f"/{finger}/{name}" for finger in fingers for name in _SAMPLED]
    scene = {"followTf": "world", "topics": {topic: {"visible": True} for topic in topics}}
    panels: dict[str, Any] = {"3D!scene": scene, "Plot!force": _forces(fingers)}
    panels |= {
        panel: {"imageMode": _image(finger)} for panel, finger in zip(images, fingers, strict=True)
    }
    left = _stack(["3D!scene", "Plot!force"], "column")
    arrangement = {"direction": "row", "first": left, "splitPercentage": 65}
    arrangement["second"] = _stack(images, "column")
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": arrangement if images else left,
    }


_SAMPLED = ("membrane/drawn", "traction/drawn", "force/drawn")


def _image(finger: str) -> dict[str, Any]:
    return {
        "imageTopic": f"/{finger}/image",
        "calibrationTopic": f"/{finger}/camera_info",
        "annotations": {f"/{finger}/ellipses": {"visible": True}},
    }


def _forces(fingers: Sequence[str]) -> dict[str, Any]:
    paths = [
        {"value": f"/{finger}/touch.force_normal", "label": f"{finger}, N", "enabled": True}
        for finger in fingers
    ]
    return {"title": "force_normal, N", "paths": paths, "xAxisVal": "timestamp"}


def _stack(panels: Sequence[str], direction: str) -> Any:
    """Return the panels one after another, nested as Foxglove expects."""
    if not panels:
        return None
    first, *others = panels
    if not others:
        return first
    return {"direction": direction, "first": first, "second": _stack(others, direction)}
