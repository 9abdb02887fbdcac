"""An episode as messages in order of time, for any format: topic, kind, stamp, value."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array, Touch
from mjtactile.export.effective_camera import effective_camera
from mjtactile.export.episode import NOT_OF_A_FINGER, Perceived, RecordedEpisode
from mjtactile.export.frames import moving_frames, static_frames
from mjtactile.recording import png
from mjtactile.recording.mounting import Mounting


class Source(Protocol):
    """Source of cycles for messages: a `RecordedEpisode`, or a current run."""

    @property
    def fingers(self) -> tuple[str, ...]: ...
    @property
    def camera_poses(self) -> dict[str, tuple[Array, Array]]: ...
    @property
    def mounting(self) -> Mounting: ...
    def design_of(self, finger: str) -> SensorDesign: ...


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points in a sensor's frame: `names` of the columns of `values` (n, k), x, y, z first."""

    names: tuple[str, ...]
    values: Array


@dataclass(frozen=True, eq=False)
class Message:
    """A message at `time`, s on the rig's clock; its coordinates are in `frame`."""

    topic: str
    kind: str
    time: float
    frame: str
    value: Any


def items(episode: RecordedEpisode) -> Iterator[Message]:
    """Yield all messages of an episode; `rosbag2` lists the kinds."""
    yield static(episode, float(episode.recording.columns["time"][0]))
    for perceived in episode.cycles():
        yield from of_cycle(episode, perceived)


def static(source: Source, time: float) -> Message:
    """Return the start of the gripper, and the pose of each finger's camera in its sensor.

    The cameras are the effective ones of `effective_camera`.
    """
    placed = {
        name: effective_camera(source.design_of(name)).pose(R, p)
        for name, (R, p) in source.camera_poses.items()
    }
    return Message("/tf_static", "static", time, "", static_frames(source.mounting, placed))


def of_cycle(source: Source, perceived: Perceived) -> Iterator[Message]:
    """Yield all messages of one cycle."""
    for k, finger in enumerate(source.fingers):
        yield from _of_finger(source, perceived, k, finger)
    row = perceived.row
    gripper_time = float(row.get("gripper_time", np.nan))
    state = gripper_time if np.isfinite(gripper_time) else perceived.time
    joints = {
        "opening": (float(row["opening"]), float(row["speed"]), float(row["effort"])),
        "lift": (float(row["lift_height"]), float("nan"), float("nan")),
    }
    yield Message("/joint_states", "joints", state, "", joints)
    frames = list(moving_frames(source.mounting, source.fingers, row, perceived.view))
    yield Message("/tf", "frames", state, "", frames)
    yield Message("/cycle", "cycle", perceived.time, "", row)


def stamp_of(perceived: Perceived, finger: int) -> float:
    """Return the capture time of that finger's image, s."""
    stamp = float(perceived.row["image_time"][finger])
    return stamp if np.isfinite(stamp) else perceived.time


def _of_finger(source: Source, perceived: Perceived, index: int, finger: str) -> Iterator[Message]:
    stamp = stamp_of(perceived, index)
    camera = f"{finger}_camera"
    sensor = f"{finger}_sensor"
    if perceived.images:
        file = perceived.files[index] if perceived.files else None
        yield Message(f"/{finger}/image", "image", stamp, camera, (perceived.images[index], file))
        lens = effective_camera(source.design_of(finger)).camera
        yield Message(f"/{finger}/camera_info", "camera", stamp, camera, lens)
    own = {
        key: value[index]
        for key, value in perceived.row.items()
        if isinstance(value, (list, np.ndarray))
        and len(value) == len(source.fingers)
        and key not in NOT_OF_A_FINGER
    }
    yield Message(f"/{finger}/wrench", "wrench", stamp, sensor, np.asarray(own["wrench"], float))
    yield Message(f"/{finger}/touch", "touch", stamp, sensor, own)
    if perceived.touch:
        for name, cloud in _clouds(perceived.touch[index]):
            yield Message(f"/{finger}/{name}", "cloud", stamp, sensor, cloud)


def _clouds(touch: Touch) -> Iterator[tuple[str, Cloud]]:
    """Yield the membrane's surface, the force on each of its nodes if known, and the markers."""
    if touch.surface is not None:
        x, y = np.meshgrid(touch.surface.x, touch.surface.y)
        points = np.column_stack([x.ravel(), y.ravel(), touch.surface.z.ravel()])
        yield "membrane", Cloud(("x", "y", "z"), points)
    if touch.traction is not None:
        x, y = np.meshgrid(touch.traction.x, touch.traction.y)
        force = touch.traction.force.reshape(-1, 3)
        nodes = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size), force])
        yield "traction", Cloud(("x", "y", "z", "fx", "fy", "fz"), nodes)
    if touch.markers is not None:
        m = touch.markers
        sd = np.sqrt(np.maximum(np.diagonal(m.cov_p, axis1=1, axis2=2), 0.0))
        names = ("x", "y", "z", "id", "nx", "ny", "nz", "sd_x", "sd_y", "sd_z")
        yield "markers", Cloud(names, np.column_stack([m.p_SM, m.ids, m.n_S, sd]))


def quaternion(R: Array) -> tuple[float, float, float, float]:
    """Return (x, y, z, w) of a rotation, w >= 0."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(R).as_quat()
    return (x, y, z, w) if w >= 0 else (-x, -y, -z, -w)


def png_of(item: Message) -> bytes:
    """Return an image as a PNG file: the stored one, or the encoded image."""
    image, file = item.value
    return png.encode(image.pixels) if file is None else file.read_bytes()


def nanoseconds(time: float) -> int:
    return round(1e9 * time)
