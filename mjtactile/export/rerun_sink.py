"""Rerun's messages, to a file or a viewer; frames are nested: `/world/left_sensor/left_camera`."""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core.errors import InputError
from mjtactile.export import messages
from mjtactile.export.viewer_entities import FLAGGED, TRUSTED, Arrows, ImageCurves, RenderedMesh

PORT = 9876
_WRENCH = ("fx, N", "fy, N", "fz, N", "tx, N m", "ty, N m", "tz, N m")
_ARROW_RADIUS = 3e-4  # radius of arrows, m
_POINT_RADIUS = 2e-4  # radius of points, m


class RerunSink:
    """Sender of items to a recording stream of rerun-sdk; `fingers` defines the camera views."""

    forgets = False
    where = "Rerun"

    def __init__(self, fingers: Sequence[str]):
        self._rr: Any = import_module("rerun")
        self.stream = self._rr.RecordingStream("mjtactile")
        gripper = "world/gripper_start/gripper"
        self._parents = {"world": ""} | {f"{finger}_sensor": gripper for finger in fingers}
        self._fingers = tuple(fingers)
        self._phase = ""
        self._frame = 0
        self._named: set[str] = set()
        self._log: dict[str, Callable[[messages.Message], None]] = {
            "image": self._image,
            "curves": self._curves,
            "mesh": self._mesh,
            "arrows": self._arrows,
            "camera": self._camera,
            "cloud": self._cloud,
            "joints": self._joints,
            "frames": self._frames,
            "static": self._frames,
            "wrench": self._wrench,
            "touch": self._touch,
            "cycle": self._cycle,
        }

    def log(self, item: messages.Message) -> None:
        """Send one item."""
        self.stream.set_time("rig", duration=item.time)
        self.stream.set_time("frame", sequence=self._frame)
        if item.kind == "static":
            self._send("world", self._rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._log[item.kind](item)
        self._frame += item.kind == "cycle"  # the last message of a cycle's measurements

    def close(self) -> None:
        """Wait until all data has arrived."""
        self.stream.flush()
        self.stream.disconnect()

    def blueprint(self) -> Any:
        """Return the initial layout of the views; the user may change it."""
        views: Any = import_module("rerun.blueprint")
        cameras = [
            views.Spatial2DView(name=finger, origin=f"/{self._place(f'{finger}_camera')}")
            for finger in self._fingers
        ]
        curves = views.TimeSeriesView(name="force, N", origin="/force")
        return views.Blueprint(
            views.Horizontal(
                views.Vertical(views.Spatial3DView(origin="/", name="scene"), curves),
                views.Vertical(*cameras),
                column_shares=[2, 1],
            )
        )

    def _place(self, frame: str) -> str:
        """Return the entity path of a frame."""
        if frame.endswith("_camera") and frame not in self._parents:
            self._parents[frame] = self._place(frame.removesuffix("_camera") + "_sensor")
        parent = self._parents.get(frame, "world")
        return f"{parent}/{frame}" if parent else frame

    def _send(self, path: str, entity: Any, *, static: bool = False) -> None:
        self.stream.log(path.split("/"), entity, static=static)  # parts are escaped

    def _in_frame(self, item: messages.Message) -> str:
        """Return the entity path of an item in its frame."""
        pose = self._place(item.frame)
        name = item.topic.strip("/").removesuffix("/drawn").split("/")[-1]
        return pose if item.topic == f"/{item.frame}" else f"{pose}/{name}"

    def _image(self, item: messages.Message) -> None:
        image = self._rr.EncodedImage(contents=messages.png_of(item), media_type="image/png")
        self._send(self._in_frame(item), image)

    def _curves(self, item: messages.Message) -> None:
        curves: ImageCurves = item.value
        colours = np.where(curves.trusted[:, None], _rgba(TRUSTED), _rgba(FLAGGED))
        self._send(self._in_frame(item), self._rr.LineStrips2D(curves.points, colors=colours))

    def _mesh(self, item: messages.Message) -> None:
        mesh: RenderedMesh = item.value
        surface = self._rr.Mesh3D(
            vertex_positions=mesh.points,
            triangle_indices=mesh.triangles,
            vertex_normals=_normals(mesh),
            albedo_factor=_rgba(mesh.rgba),
        )
        self._send(self._in_frame(item), surface)

    def _arrows(self, item: messages.Message) -> None:
        arrows: Arrows = item.value
        style = {"colors": _rgba(arrows.rgba), "radii": _ARROW_RADIUS}
        shape = self._rr.Arrows3D(origins=arrows.tails, vectors=arrows.vectors, **style)
        self._send(self._in_frame(item), shape)

    def _camera(self, item: messages.Message) -> None:
        lens = item.value
        size = {"resolution": [lens.width, lens.height], "image_plane_distance": 0.01}
        pinhole = self._rr.Pinhole(
            image_from_camera=lens.K, camera_xyz=self._rr.ViewCoordinates.RDF, **size
        )
        self._send(self._place(item.frame), pinhole, static=True)

    def _cloud(self, item: messages.Message) -> None:
        """Send the markers. The surface and arrows represent membrane and tractions."""
        if item.topic.endswith("/markers"):
            cloud: messages.Cloud = item.value
            points = self._rr.Points3D(cloud.values[:, :3], radii=_POINT_RADIUS)
            self._send(self._in_frame(item), points)

    def _joints(self, item: messages.Message) -> None:
        for name, (position, _, effort) in item.value.items():
            self._number(f"gripper/{name}", position, f"{name}, m")
            self._number(f"gripper/{name}_effort", effort, f"{name} effort, N")

    def _frames(self, item: messages.Message) -> None:
        for t in item.value:
            self._parents.setdefault(t.child, self._place(t.parent))
            pose = self._rr.Transform3D(translation=t.p, mat3x3=t.R)
            self._send(self._place(t.child), pose, static=item.kind == "static")

    def _wrench(self, item: messages.Message) -> None:
        if np.isfinite(item.value).all():
            finger = item.topic.split("/")[1]
            for name, value in zip(_WRENCH, item.value, strict=True):
                self._number(f"wrench/{finger}/{name.partition(',')[0]}", value, name)

    def _touch(self, item: messages.Message) -> None:
        finger = item.topic.split("/")[1]
        self._number(f"force/{finger}", item.value["force_normal"], f"{finger}, N")
        if "gauge_pressure" in item.value:
            self._number(f"pressure/{finger}", item.value["gauge_pressure"], f"{finger}, Pa")
        if item.value["status_code"] != "ok":
            self._send(f"log/{finger}", self._rr.TextLog(str(item.value["status"]), level="WARN"))

    def _cycle(self, item: messages.Message) -> None:
        row = item.value
        phase = str(row["phase"])
        if phase != self._phase:
            self._phase = phase
            self._send("log/phase", self._rr.TextLog(phase))
        for finger, true in zip(self._fingers, row.get("force_normal_true", ()), strict=False):
            self._number(f"force/{finger}_true", true, f"{finger}, ground truth, N")

    def _number(self, path: str, value: Any, name: str) -> None:
        """Send a value of a curve with its name and unit; an unknown one leaves a gap."""
        if path not in self._named:
            self._named.add(path)
            self._send(path, self._rr.SeriesLines(names=name), static=True)
        if value is not None and np.isfinite(value):
            self._send(path, self._rr.Scalars(float(value)))


def to_file(sink: RerunSink, path: Path) -> None:
    """Make a sink write to a file."""
    sink.stream.save(path, default_blueprint=sink.blueprint())
    sink.where = f"written to {path}: rerun {path}"


def to_viewer(sink: RerunSink, url: str = "") -> None:
    """Send the data of a sink to the viewer at `url`; "": the open local one, or a new one.

    Raises InputError without a display for a new one.
    """
    if url:
        sink.stream.connect_grpc(url, default_blueprint=sink.blueprint())
        sink.where = f"Rerun at {url}"
        return
    if not _is_open() and not _has_screen():
        raise InputError(
            "there is no display here for a viewer; rerun:FILE.rrd writes a file, and "
            f"rerun+http://HOST:{PORT}/proxy sends to a viewer that is open on another "
            "computer",
            field="--live",
        )
    sink.stream.spawn(port=PORT, default_blueprint=sink.blueprint())
    sink.where = "Rerun's viewer"


def _is_open() -> bool:
    """Return True if a local process listens on the port of Rerun's viewer."""
    with socket.socket() as end:
        end.settimeout(0.5)
        return end.connect_ex(("127.0.0.1", PORT)) == 0


def _has_screen() -> bool:
    if sys.platform != "linux":
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _rgba(rgba: Sequence[float]) -> np.ndarray:
    return np.round(255 * np.asarray(rgba)).astype(np.uint8)


def _normals(mesh: RenderedMesh) -> np.ndarray:
    """Return the normal at each point (n, 3): the mean of its triangles' normals, by area."""
    corners = mesh.points[mesh.triangles]
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(mesh.points)
    for k in range(3):
        np.add.at(normals, mesh.triangles[:, k], face)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
