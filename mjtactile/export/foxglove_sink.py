"""Foxglove messages by foxglove-sdk, which has their schemas; to a file or an open viewer.

A wrench, a touch and a line of the log have no Foxglove schema: they are JSON with their own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core import loopback
from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.export import messages
from mjtactile.export.episode import meanings
from mjtactile.export.viewer_entities import FLAGGED, TRUSTED, Arrows, ImageCurves, RenderedMesh
from mjtactile.recording.files import to_json

PORT = 8765
VIEWERS = ("https://app.foxglove.dev", "https://studio.foxglove.dev")
"""Origins of Foxglove in the browser."""
_ARROW_WIDTH = 8e-4  # width of arrows, m
_WRENCH = {"fx": "N", "fy": "N", "fz": "N", "tx": "N m", "ty": "N m", "tz": "N m"}


class FoxgloveSink:
    """Sender of items to the listeners of a foxglove-sdk `context`; one channel per topic."""

    def __init__(self) -> None:
        import foxglove

        self.context = foxglove.Context()
        self._channels: dict[str, Any] = {}

    def log(self, item: messages.Message) -> None:
        """Send one item."""
        if item.topic not in self._channels:
            self._channels[item.topic] = _channel(item, self.context)
        message = _MESSAGES[item.kind](item)
        self._channels[item.topic].log(message, log_time=messages.nanoseconds(item.time))


class FoxgloveFile(FoxgloveSink):
    """An MCAP file."""

    forgets = False

    def __init__(self, path: Path):
        super().__init__()
        import foxglove
        from foxglove.mcap import MCAPWriteOptions

        self.where = f"written to {path}: open it in Foxglove"
        options = MCAPWriteOptions(profile="")
        self.writer = foxglove.open_mcap(path, context=self.context, writer_options=options)

    def close(self) -> None:
        """Finish the file."""
        self.writer.close()


class FoxgloveServer(FoxgloveSink):
    """A server to which Foxglove connects.

    foxglove-sdk accepts connections of any page; a gate in front of it refuses other pages than
    Foxglove's. Raises InputError for a port that is taken.
    """

    forgets = True

    def __init__(self, port: int = PORT):
        super().__init__()
        import foxglove

        host = loopback.hidden_address()
        try:
            self._server = foxglove.start_server(
                name="mjtactile", host=host, port=0, context=self.context
            )
        except Exception as error:  # the SDK's own kinds of error change from version to version
            text = " ".join(str(error).split())
            raise InputError(f"the server does not start: {text}", field="--live") from error
        try:
            self._gate = loopback.LoopbackGate(port, (host, self._server.port), VIEWERS)
        except OSError as error:
            self._server.stop()
            raise InputError(f"port {port}: {error.strerror}", field="--live") from error
        self.port = self._gate.port
        self.where = f"Foxglove: open connection ws://localhost:{self.port}"

    def close(self) -> None:
        """End the server."""
        self._gate.close()
        self._server.stop()


def _channel(item: messages.Message, context: Any) -> Any:
    from foxglove import Channel, channels

    typed = {
        "image": channels.CompressedImageChannel,
        "curves": channels.ImageAnnotationsChannel,
        "mesh": channels.SceneUpdateChannel,
        "arrows": channels.SceneUpdateChannel,
        "camera": channels.CameraCalibrationChannel,
        "cloud": channels.PointCloudChannel,
        "joints": channels.JointStatesChannel,
        "frames": channels.FrameTransformsChannel,
        "static": channels.FrameTransformsChannel,
    }
    if item.kind in typed:
        return typed[item.kind](item.topic, context=context)
    return Channel(item.topic, schema=_schema(item), context=context)


def _schema(item: messages.Message) -> dict[str, Any]:
    """Return the JSON schema of a touch, a wrench or a line of the log.

    It includes units and meanings.
    """
    columns = meanings()
    if item.kind == "wrench":
        kind = {"type": ["number", "null"]}
        fields = {name: {**kind, "description": unit} for name, unit in _WRENCH.items()}
    else:
        texts = {key: f"{columns[key]['unit']}: {columns[key]['meaning']}" for key in item.value}
        fields = {key: {"description": text} for key, text in texts.items()}
    integer = {"type": "integer"}
    stamp = {"type": "object", "properties": {"sec": integer, "nsec": integer}}
    return {
        "title": f"mjtactile.{item.kind.capitalize()}",
        "type": "object",
        "properties": {"timestamp": stamp, "frame_id": {"type": "string"}, **fields},
    }


def _stamp(item: messages.Message) -> Any:
    from foxglove.messages import Timestamp

    return Timestamp(*divmod(messages.nanoseconds(item.time), 10**9))


def _header(item: messages.Message) -> dict[str, Any]:
    return {"timestamp": _stamp(item), "frame_id": item.frame}


def _image(item: messages.Message) -> Any:
    from foxglove.messages import CompressedImage

    return CompressedImage(**_header(item), data=messages.png_of(item), format="png")


def _curves(item: messages.Message) -> Any:
    from foxglove.messages import Color, ImageAnnotations, Point2, PointsAnnotation
    from foxglove.messages import PointsAnnotationType as Type

    curves: ImageCurves = item.value
    stamp = _stamp(item)
    colors = {True: Color(**_rgba(TRUSTED)), False: Color(**_rgba(FLAGGED))}
    shared = {"timestamp": stamp, "type": Type.LineLoop, "thickness": 1.0}
    loops = [
        PointsAnnotation(
            points=[Point2(x=x, y=y) for x, y in points], outline_color=colors[trusted], **shared
        )
        for points, trusted in zip(curves.points.tolist(), curves.trusted.tolist(), strict=True)
    ]
    return ImageAnnotations(timestamp=stamp, points=loops)


def _mesh(item: messages.Message) -> Any:
    from foxglove.messages import Color, Point3, TriangleListPrimitive

    mesh: RenderedMesh = item.value
    surface = TriangleListPrimitive(
        pose=_pose(np.eye(3), np.zeros(3)),
        points=[Point3(x=x, y=y, z=z) for x, y, z in mesh.points.tolist()],
        indices=mesh.triangles.ravel().tolist(),
        color=Color(**_rgba(mesh.rgba)),
    )
    return _entity(item, triangles=[surface])


def _arrows(item: messages.Message) -> Any:
    from foxglove.messages import ArrowPrimitive, Color

    arrows: Arrows = item.value
    colour = Color(**_rgba(arrows.rgba))
    primitives = []
    for tail, vector in zip(arrows.tails, arrows.vectors, strict=True):
        length = float(np.linalg.norm(vector))
        width = min(_ARROW_WIDTH, length / 4)
        shaft = {"shaft_length": 0.7 * length, "shaft_diameter": width}
        head = {"head_length": 0.3 * length, "head_diameter": 2 * width}
        pose = _pose(_along(vector), tail)
        primitives.append(ArrowPrimitive(pose=pose, **shaft, **head, color=colour))
    return _entity(item, arrows=primitives)


def _entity(item: messages.Message, **shapes: Any) -> Any:
    """Return an entity of a 3D scene; it replaces the earlier one of the same topic."""
    from foxglove.messages import SceneEntity, SceneUpdate

    entity = SceneEntity(**_header(item), id=item.topic, frame_locked=True, **shapes)
    return SceneUpdate(entities=[entity])


def _along(vector: Array) -> Array:
    """Return a rotation (3, 3) whose x axis is along `vector`, the axis of Foxglove's arrows."""
    x = vector / max(float(np.linalg.norm(vector)), 1e-12)
    aside = np.eye(3)[int(np.abs(x).argmin())]
    y = np.cross(aside, x)
    y /= np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])


def _rgba(rgba: Sequence[float]) -> dict[str, float]:
    return dict(zip("rgba", map(float, rgba), strict=True))


def _camera(item: messages.Message) -> Any:
    from foxglove.messages import CameraCalibration

    c = item.value
    P = np.column_stack([c.K, np.zeros(3)])
    return CameraCalibration(
        **_header(item),
        width=c.width,
        height=c.height,
        distortion_model=c.lens.definition.foxglove,
        D=list(c.distortion),
        K=c.K.ravel().tolist(),
        R=np.eye(3).ravel().tolist(),
        P=P.ravel().tolist(),
    )


def _cloud(item: messages.Message) -> Any:
    from foxglove.messages import PackedElementField, PackedElementFieldNumericType, PointCloud

    cloud: messages.Cloud = item.value
    fields = [
        PackedElementField(name=name, offset=8 * k, type=PackedElementFieldNumericType.Float64)
        for k, name in enumerate(cloud.names)
    ]
    return PointCloud(
        **_header(item),
        pose=_pose(np.eye(3), np.zeros(3)),
        fields=fields,
        point_stride=8 * len(fields),
        data=np.ascontiguousarray(cloud.values, "<f8").tobytes(),
    )


def _joints(item: messages.Message) -> Any:
    from foxglove.messages import JointState, JointStates

    keys = ("position", "velocity", "effort")
    joints = []
    for name, values in item.value.items():
        known = {k: v if np.isfinite(v) else None for k, v in zip(keys, values, strict=True)}
        joints.append(JointState(name=name, **known))
    return JointStates(timestamp=_stamp(item), joints=joints)


def _frames(item: messages.Message) -> Any:
    from foxglove.messages import FrameTransform, FrameTransforms

    transforms = []
    for t in item.value:
        frames = {"parent_frame_id": t.parent, "child_frame_id": t.child}
        pose = {"translation": _vector(t.p), "rotation": _quaternion(t.R)}
        transforms.append(FrameTransform(timestamp=_stamp(item), **frames, **pose))
    return FrameTransforms(transforms=transforms)


def _pose(R: Array, p: Array) -> Any:
    from foxglove.messages import Pose

    return Pose(position=_vector(p), orientation=_quaternion(R))


def _vector(p: Array) -> Any:
    from foxglove.messages import Vector3

    return Vector3(**dict(zip("xyz", map(float, p), strict=True)))


def _quaternion(R: Array) -> Any:
    from foxglove.messages import Quaternion

    return Quaternion(**dict(zip("xyzw", messages.quaternion(R), strict=True)))


def _json(item: messages.Message) -> Any:
    if item.kind == "wrench":
        values = dict(zip(_WRENCH, item.value, strict=True))
    else:
        values = dict(item.value)
    sec, nsec = divmod(messages.nanoseconds(item.time), 10**9)
    return to_json({"timestamp": {"sec": sec, "nsec": nsec}, "frame_id": item.frame, **values})


_MESSAGES: dict[str, Callable[[messages.Message], Any]] = {
    "image": _image,
    "curves": _curves,
    "mesh": _mesh,
    "arrows": _arrows,
    "camera": _camera,
    "cloud": _cloud,
    "joints": _joints,
    "frames": _frames,
    "static": _frames,
    "wrench": _json,
    "touch": _json,
    "cycle": _json,
}
