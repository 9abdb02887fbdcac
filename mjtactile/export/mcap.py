"""MCAP files with Foxglove's schemas (protobuf): an episode a file.

Written with foxglove-sdk, which brings these schemas; the plain mcap package would want them
written out by hand. What Foxglove has no schema for (a felt wrench, a touch, a line of the log) is
JSON with a schema of its own.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core.types import Array
from mjtactile.export import stream
from mjtactile.export.episode import Episode, meanings
from mjtactile.recording.files import to_json

_WRENCH = {"fx": "N", "fy": "N", "fz": "N", "tx": "N m", "ty": "N m", "tz": "N m"}


def write(
    episodes: Sequence[Episode], out: Path, *, say: Callable[[str], None] = lambda _: None
) -> dict[str, Any]:
    """Write `episode_000000.mcap` and so on into `out`; returns how many frames."""
    frames = 0
    for k, episode in enumerate(episodes):
        say(f"{k + 1} of {len(episodes)}: {episode.recording.folder}")
        _write_one(episode, out / f"episode_{k:06d}.mcap")
        frames += len(episode.recording)
    return {"episodes": len(episodes), "frames": frames}


def _write_one(episode: Episode, path: Path) -> None:
    import foxglove
    from foxglove.mcap import MCAPWriteOptions

    context = foxglove.Context()
    channels: dict[str, Any] = {}
    with foxglove.open_mcap(
        path, context=context, writer_options=MCAPWriteOptions(profile="")
    ) as writer:
        for item in stream.items(episode):
            if item.topic not in channels:
                channels[item.topic] = _channel(item, episode, context)
            channels[item.topic].log(
                _MESSAGES[item.kind](item), log_time=stream.nanoseconds(item.time)
            )
        start = stream.nanoseconds(float(episode.recording.columns["time"][0]))
        facts = {
            key: value if isinstance(value, str) else json.dumps(value)
            for key, value in episode.facts.items()
        }
        writer.write_metadata("mjtactile", facts)
        for name, text in episode.files.items():
            writer.attach(
                log_time=start,
                create_time=start,
                name=name,
                data=text.encode(),
                media_type="application/json" if name.endswith(".json") else "application/toml",
            )
        for name, image in episode.references.items():
            writer.attach(
                log_time=start,
                create_time=start,
                name=name,
                media_type="image/png",
                data=image.read_bytes(),
            )


def _channel(item: stream.Item, episode: Episode, context: Any) -> Any:
    from foxglove import Channel, channels

    typed = {
        "image": channels.CompressedImageChannel,
        "camera": channels.CameraCalibrationChannel,
        "cloud": channels.PointCloudChannel,
        "joints": channels.JointStatesChannel,
        "frames": channels.FrameTransformsChannel,
        "static": channels.FrameTransformsChannel,
    }
    if item.kind in typed:
        return typed[item.kind](item.topic, context=context)
    return Channel(item.topic, schema=_schema(item, episode), context=context)


def _schema(item: stream.Item, episode: Episode) -> dict[str, Any]:
    """JSON schema of a touch, a wrench or a line of the log, with units and meanings."""
    what = meanings()
    if item.kind == "wrench":
        fields = {
            name: {"type": ["number", "null"], "description": unit}
            for name, unit in _WRENCH.items()
        }
    else:
        fields = {
            key: {"description": f"{what[key]['unit']}: {what[key]['meaning']}"}
            for key in item.value
        }
    stamp = {
        "type": "object",
        "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
    }
    return {
        "title": f"mjtactile.{item.kind.capitalize()}",
        "type": "object",
        "properties": {"timestamp": stamp, "frame_id": {"type": "string"}, **fields},
    }


def _stamp(item: stream.Item) -> Any:
    from foxglove.messages import Timestamp

    return Timestamp(*divmod(stream.nanoseconds(item.time), 10**9))


def _image(item: stream.Item) -> Any:
    from foxglove.messages import CompressedImage

    return CompressedImage(
        timestamp=_stamp(item), frame_id=item.frame, data=item.value[1].read_bytes(), format="png"
    )


def _camera(item: stream.Item) -> Any:
    from foxglove.messages import CameraCalibration

    c = item.value
    P = np.column_stack([c.K, np.zeros(3)])
    return CameraCalibration(
        timestamp=_stamp(item),
        frame_id=item.frame,
        width=c.width,
        height=c.height,
        distortion_model="plumb_bob",
        D=list(c.distortion),
        K=c.K.ravel().tolist(),
        R=np.eye(3).ravel().tolist(),
        P=P.ravel().tolist(),
    )


def _cloud(item: stream.Item) -> Any:
    from foxglove.messages import PackedElementField, PackedElementFieldNumericType, PointCloud

    cloud: stream.Cloud = item.value
    fields = [
        PackedElementField(name=name, offset=8 * k, type=PackedElementFieldNumericType.Float64)
        for k, name in enumerate(cloud.names)
    ]
    return PointCloud(
        timestamp=_stamp(item),
        frame_id=item.frame,
        pose=_pose(np.eye(3), np.zeros(3)),
        fields=fields,
        point_stride=8 * len(fields),
        data=np.ascontiguousarray(cloud.values, "<f8").tobytes(),
    )


def _joints(item: stream.Item) -> Any:
    from foxglove.messages import JointState, JointStates

    def known(value: float) -> float | None:
        return value if np.isfinite(value) else None

    return JointStates(
        timestamp=_stamp(item),
        joints=[
            JointState(
                name=name, position=known(position), velocity=known(velocity), effort=known(effort)
            )
            for name, (position, velocity, effort) in item.value.items()
        ],
    )


def _frames(item: stream.Item) -> Any:
    from foxglove.messages import FrameTransform, FrameTransforms, Quaternion, Vector3

    return FrameTransforms(
        transforms=[
            FrameTransform(
                timestamp=_stamp(item),
                parent_frame_id=t.parent,
                child_frame_id=t.child,
                translation=Vector3(**xyz(t.p)),
                rotation=Quaternion(**dict(zip("xyzw", stream.quaternion(t.R), strict=True))),
            )
            for t in item.value
        ]
    )


def _pose(R: Array, p: Array) -> Any:
    from foxglove.messages import Pose, Quaternion, Vector3

    return Pose(
        position=Vector3(**xyz(p)),
        orientation=Quaternion(**dict(zip("xyzw", stream.quaternion(R), strict=True))),
    )


def xyz(p: Array) -> dict[str, float]:
    return {name: float(value) for name, value in zip("xyz", p, strict=True)}


def _json(item: stream.Item) -> Any:
    if item.kind == "wrench":
        values = dict(zip(_WRENCH, item.value, strict=True))
    else:
        values = dict(item.value)
    sec, nsec = divmod(stream.nanoseconds(item.time), 10**9)
    return to_json({"timestamp": {"sec": sec, "nsec": nsec}, "frame_id": item.frame, **values})


_MESSAGES: dict[str, Callable[[stream.Item], Any]] = {
    "image": _image,
    "camera": _camera,
    "cloud": _cloud,
    "joints": _joints,
    "frames": _frames,
    "static": _frames,
    "wrench": _json,
    "touch": _json,
    "cycle": _json,
}
