"""ROS 2 bags, one per episode: standard messages, `mjtactile_msgs`, and the log as JSON text."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core.types import COMMAND_FIELDS
from mjtactile.export import messages
from mjtactile.export.episode import RecordedEpisode, write_each
from mjtactile.recording.files import to_json

PACKAGE = "mjtactile_msgs"
_GOALS = {name: entry for name, entry in COMMAND_FIELDS.items() if entry.kind == "number"}
MESSAGES = {
    "Touch": """\
# Estimates of one sensor from one image. NaN: unknown, see status.
# Frame: header.frame_id, z out of the sensor.
std_msgs/Header header
float64 force_normal        # N, positive under load
float64 force_normal_sd
float64 force_shear         # N, magnitude
float64[6] wrench           # N and N m about the frame center, of the world on the membrane
float64[6] wrench_sd
bool touching
string status               # "ok", or why the force is unknown
string status_code
float64 age                 # s, age of the image at the end of sensing
float64 contact_area        # m^2
float64[2] contact_centroid # m
float64 contact_depth       # m
string slip_state           # none, sticking, incipient, slipping, unknown
float64[2] slip_velocity    # m/s
float64 slip_distance       # m
float64 stick_ratio
string shape_kind           # smooth, flat, edge, point, multiple, unknown; none if not requested
string shape_family         # ball, cylinder, smooth, disc, block
float64 shape_area          # m^2
float64 shape_radius        # m
float64 shape_direction     # rad from x
float64[2] shape_curvatures # 1/m, the larger first
float64[3] shape_place      # m, its point nearest to the sensor
float64[2] shape_rolling    # rad/s about x and y
float64[2] shape_sliding    # m/s over the rubber
float64 shape_spinning      # rad/s about z
float64 marker_count
bool valve_open             # false for a finger without a valve
float64 gauge_pressure      # Pa
""",
    "Command": """\
# Command sent to the gripper. NaN: unchanged.
std_msgs/Header header
"""
    + "".join(f"float64 {name:<20}# {entry.unit}\n" for name, entry in _GOALS.items())
    + "string phase\n",
}
GRASP = """\
# One grasp. Empty: the default.
string object               # egg
string controller           # adaptive
---
bool success                # the controller ended in the phase "done"
string phase                # last phase
string message              # reason of an abort
---
string phase
float64[] force_normal      # N, of each finger; NaN: unknown
"""
"""Definition of the action of examples/ros2/touch_node.py."""
_TEXT = ("status", "status_code", "slip_state", "shape_kind", "shape_family")
_RENAMED = {"age": "touch_age"}
_PACKAGE_XML = f"""\
<?xml version="1.0"?>
<package format="3">
  <name>{PACKAGE}</name><version>0.2.0</version>
  <description>Estimates of mjtactile's sensors</description>
  <maintainer email="nobody@example.com">mjtactile</maintainer><license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend><buildtool_depend>rosidl_default_generators</buildtool_depend>
  <depend>std_msgs</depend><depend>action_msgs</depend><exec_depend>rosidl_default_runtime</exec_depend>
  <member_of_group>rosidl_interface_packages</member_of_group><export><build_type>ament_cmake</build_type></export>
</package>
"""
_CMAKE = f"""\
cmake_minimum_required(VERSION 3.8)
project({PACKAGE})
find_package(ament_cmake REQUIRED)
find_package(std_msgs REQUIRED)
find_package(rosidl_default_generators REQUIRED)
rosidl_generate_interfaces(${{PROJECT_NAME}}
  {" ".join(f'"msg/{name}.msg"' for name in MESSAGES)} "action/Grasp.action" DEPENDENCIES std_msgs)
ament_package()
"""


def write(
    episodes: Sequence[RecordedEpisode],
    out: Path,
    *,
    notify: Callable[[str], None] = lambda _: None,
    leave_out: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """Write the bags `episode_000000` and so on, and the message package's source, into `out`."""
    _write_package(out / PACKAGE)
    return write_each(
        episodes,
        out,
        "",
        lambda path, own: _Bag(own).write(path),
        notify=notify,
        leave_out=leave_out,
    )


def typestore() -> Any:
    """Return the message types of ROS 2 Humble and our own; later versions also read them."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in MESSAGES.items():
        store.register(get_types_from_msg(text, f"{PACKAGE}/msg/{name}"))
    return store


class _Bag:
    """Makes messages of one episode's items."""

    def __init__(self, episode: RecordedEpisode):
        self._episode = episode
        self._store = typestore()
        self._make: dict[str, tuple[str, Callable[[messages.Message], Any]]] = {
            "image": ("sensor_msgs/msg/Image", self._image),
            "camera": ("sensor_msgs/msg/CameraInfo", self._camera),
            "wrench": ("geometry_msgs/msg/WrenchStamped", self._wrench),
            "touch": (f"{PACKAGE}/msg/Touch", self._touch),
            "cloud": ("sensor_msgs/msg/PointCloud2", self._cloud),
            "joints": ("sensor_msgs/msg/JointState", self._joints),
            "frames": ("tf2_msgs/msg/TFMessage", self._frames),
            "static": ("tf2_msgs/msg/TFMessage", self._frames),
            "command": (f"{PACKAGE}/msg/Command", self._command),
            "cycle": ("std_msgs/msg/String", self._line),
        }

    def write(self, path: Path) -> None:
        from rosbags.rosbag2 import Writer

        connections: dict[str, Any] = {}
        with Writer(path, version=8) as bag:
            for item in self._items():
                kind, make = self._make[item.kind]
                if item.topic not in connections:
                    settings = {"typestore": self._store, "offered_qos_profiles": _qos(item.kind)}
                    connections[item.topic] = bag.add_connection(item.topic, kind, **settings)
                data = self._store.serialize_cdr(make(item), kind)
                bag.write(connections[item.topic], messages.nanoseconds(item.time), data)
            for name, value in self._episode.facts.items():
                bag.set_custom_data(name, value if isinstance(value, str) else json.dumps(value))
        for name, text in self._episode.files.items():
            (path / name).write_text(text, encoding="utf-8")

    def _items(self) -> Any:
        """Yield the reference images, the items of the episode, and a command for each log line."""
        for reference in self._episode.recording.references:
            for k, finger in enumerate(self._episode.fingers):
                topic = f"/{finger}/reference/{reference.stage}"
                frame = f"{finger}_camera"
                for image in reference.images(k) if reference.names else ():
                    yield messages.Message(topic, "image", image.time, frame, (image,))
        for item in messages.items(self._episode):
            yield item
            if item.kind == "cycle":
                yield messages.Message("/command", "command", item.time, "", item.value)

    def _message(self, kind: str, /, **values: Any) -> Any:
        return self._store.types[kind](**values)

    def _header(self, item: messages.Message, frame: str | None = None) -> Any:
        sec, nanosec = divmod(messages.nanoseconds(item.time), 10**9)
        return self._message(
            "std_msgs/msg/Header",
            stamp=self._message("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec),
            frame_id=item.frame if frame is None else frame,
        )

    def _image(self, item: messages.Message) -> Any:
        pixels = item.value[0].pixels
        height, width = pixels.shape
        return self._message(
            "sensor_msgs/msg/Image",
            header=self._header(item),
            height=height,
            width=width,
            encoding="mono8",
            is_bigendian=0,
            step=width,
            data=np.ascontiguousarray(pixels).ravel(),
        )

    def _camera(self, item: messages.Message) -> Any:
        c = item.value
        size = dict.fromkeys(("x_offset", "y_offset", "height", "width"), 0)
        full_image = self._message("sensor_msgs/msg/RegionOfInterest", **size, do_rectify=False)
        return self._message(
            "sensor_msgs/msg/CameraInfo",
            header=self._header(item),
            height=c.height,
            width=c.width,
            distortion_model=c.distortion_model,
            d=np.array(c.distortion),
            k=c.K.ravel(),
            r=np.eye(3).ravel(),
            p=np.column_stack([c.K, np.zeros(3)]).ravel(),
            binning_x=0,
            binning_y=0,
            roi=full_image,
        )

    def _vector(self, values: Any) -> Any:
        x, y, z = map(float, values)
        return self._message("geometry_msgs/msg/Vector3", x=x, y=y, z=z)

    def _wrench(self, item: messages.Message) -> Any:
        force, torque = self._vector(item.value[:3]), self._vector(item.value[3:])
        wrench = self._message("geometry_msgs/msg/Wrench", force=force, torque=torque)
        return self._message(
            "geometry_msgs/msg/WrenchStamped", header=self._header(item), wrench=wrench
        )

    def _touch(self, item: messages.Message) -> Any:
        name = f"{PACKAGE}/msg/Touch"
        values = {
            field: _value(item.value.get(_RENAMED.get(field, field)), field, kind)
            for field, kind in self._store.fielddefs[name][1]
            if field != "header"
        }
        return self._message(name, header=self._header(item), **values)

    def _cloud(self, item: messages.Message) -> Any:
        cloud: messages.Cloud = item.value
        fields = [
            self._message(
                "sensor_msgs/msg/PointField", name=name, offset=4 * k, datatype=7, count=1
            )
            for k, name in enumerate(cloud.names)
        ]
        data = np.ascontiguousarray(cloud.values, "<f4")
        return self._message(
            "sensor_msgs/msg/PointCloud2",
            header=self._header(item),
            height=1,
            width=len(data),
            fields=fields,
            is_bigendian=False,
            point_step=4 * len(fields),
            row_step=data.nbytes,
            data=np.frombuffer(data.tobytes(), np.uint8),
            is_dense=bool(np.isfinite(data).all()),
        )

    def _joints(self, item: messages.Message) -> Any:
        states = np.ascontiguousarray(np.array(list(item.value.values()), float).T)
        values = dict(zip(("position", "velocity", "effort"), states, strict=True))
        head = {"header": self._header(item), "name": list(item.value)}
        return self._message("sensor_msgs/msg/JointState", **head, **values)

    def _frames(self, item: messages.Message) -> Any:
        transforms = []
        for t in item.value:
            x, y, z, w = map(float, messages.quaternion(t.R))
            rotation = self._message("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
            pose = {"translation": self._vector(t.p), "rotation": rotation}
            transform = self._message("geometry_msgs/msg/Transform", **pose)
            frames = {"header": self._header(item, t.parent), "child_frame_id": t.child}
            stamped = "geometry_msgs/msg/TransformStamped"
            transforms.append(self._message(stamped, **frames, transform=transform))
        return self._message("tf2_msgs/msg/TFMessage", transforms=transforms)

    def _command(self, item: messages.Message) -> Any:
        row: Mapping[str, Any] = item.value
        values = {name: float(row.get(entry.column, np.nan)) for name, entry in _GOALS.items()}
        head = {"header": self._header(item), "phase": str(row["phase"])}
        return self._message(f"{PACKAGE}/msg/Command", **head, **values)

    def _line(self, item: messages.Message) -> Any:
        return self._message("std_msgs/msg/String", data=json.dumps(to_json(item.value)))


def _value(value: Any, field: str, kind: Any) -> Any:
    """Convert a value to a message field; unknown values become NaN or ""."""
    if field in _TEXT:
        return "" if value is None else str(value)
    if field in ("touching", "valve_open"):
        return bool(value) if value is not None and value == value else False
    if kind[0].name == "ARRAY":
        return np.full(kind[1][1], np.nan) if value is None else np.asarray(value, float)
    return float("nan") if value is None else float(value)


def _qos(kind: str) -> Sequence[Any]:
    """Return the quality of service: static frames are also sent to late subscribers."""
    from rosbags import interfaces as ros

    if kind != "static":
        return ()
    forever = ros.QosTime(sec=2147483647, nsec=4294967295)
    reliable = ros.QosReliability.RELIABLE
    durable = ros.QosDurability.TRANSIENT_LOCAL
    lively = ros.QosLiveliness.AUTOMATIC
    last = ros.QosHistory.KEEP_LAST
    return (ros.Qos(last, 1, reliable, durable, forever, forever, lively, forever, False),)


def _write_package(folder: Path) -> None:
    """Write the source package of the messages, to be built in a ROS workspace."""
    (folder / "msg").mkdir(parents=True)
    for name, text in MESSAGES.items():
        (folder / "msg" / f"{name}.msg").write_text(text, encoding="utf-8")
    (folder / "action").mkdir()
    (folder / "action" / "Grasp.action").write_text(GRASP, encoding="utf-8")
    (folder / "package.xml").write_text(_PACKAGE_XML, encoding="utf-8")
    (folder / "CMakeLists.txt").write_text(_CMAKE, encoding="utf-8")
