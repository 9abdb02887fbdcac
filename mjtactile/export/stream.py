"""An episode as messages in order of time, whatever the format: topic, kind, stamp, value."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjtactile.core.types import Array, Touch
from mjtactile.export.episode import NOT_OF_A_FINGER, Episode, Perceived

FACING = {
    0: np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]),
    1: np.array([[0.0, 0, -1], [-1, 0, 0], [0, 1, 0]]),
}
"""R_GS of the two sensors of a pair: z towards the other finger, y up, as the shipped grippers
carry them."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points in a sensor's frame: `names` of the columns of `values` (n, k), x, y, z first."""

    names: tuple[str, ...]
    values: Array


@dataclass(frozen=True, eq=False)
class Transform:
    """`child` stands at `p` (3,) m in `parent`, turned by `R` (3, 3)."""

    parent: str
    child: str
    R: Array
    p: Array


@dataclass(frozen=True, eq=False)
class Item:
    """A message: `time` s on the rig's clock is when it was so; `frame` where its coordinates
    are."""

    topic: str
    kind: str
    time: float
    frame: str
    value: Any


def items(episode: Episode) -> Iterator[Item]:
    """All messages of an episode; kinds: image, camera, wrench, touch, cloud, joints, frames,
    static, cycle."""
    first = float(episode.recording.columns["time"][0])
    cameras = [
        Transform(f"{name}_sensor", f"{name}_camera", R, p)
        for name, (R, p) in episode.camera_poses.items()
    ]
    yield Item("/tf_static", "static", first, "", cameras)
    for seen in episode.cycles():
        yield from _of_cycle(episode, seen)


def _of_cycle(episode: Episode, seen: Perceived) -> Iterator[Item]:
    row = seen.row
    time = seen.time
    stamps = [float(value) for value in row["image_time"]]
    for k, finger in enumerate(episode.fingers):
        stamp = stamps[k] if np.isfinite(stamps[k]) else time
        if seen.images:
            yield Item(
                f"/{finger}/image",
                "image",
                stamp,
                f"{finger}_camera",
                (seen.images[k], seen.files[k]),
            )
            yield Item(
                f"/{finger}/camera_info",
                "camera",
                stamp,
                f"{finger}_camera",
                episode.design_of(finger).camera,
            )
        mine = {
            key: value[k]
            for key, value in row.items()
            if isinstance(value, (list, np.ndarray))
            and len(value) == len(episode.fingers)
            and key not in NOT_OF_A_FINGER
        }
        yield Item(
            f"/{finger}/wrench",
            "wrench",
            stamp,
            f"{finger}_sensor",
            np.asarray(mine["wrench"], float),
        )
        yield Item(f"/{finger}/touch", "touch", stamp, f"{finger}_sensor", mine)
        if seen.touch:
            for name, cloud in _clouds(seen.touch[k]):
                yield Item(f"/{finger}/{name}", "cloud", stamp, f"{finger}_sensor", cloud)
    if "gripper_time" in row and np.isfinite(row["gripper_time"]):
        state = row["gripper_time"]
    else:
        state = time
    yield Item(
        "/joint_states",
        "joints",
        float(state),
        "",
        {
            "opening": (float(row["opening"]), float(row["speed"]), float(row["effort"])),
            "lift": (float(row["lift_height"]), float("nan"), float("nan")),
        },
    )
    yield Item("/tf", "frames", float(state), "", list(_frames(episode, row)))
    yield Item("/cycle", "cycle", time, "", row)


def _clouds(touch: Touch) -> Iterator[tuple[str, Cloud]]:
    """The membrane's surface, with the force on each of its nodes where that is known, and the
    markers."""
    if touch.surface is not None:
        x, y = np.meshgrid(touch.surface.x, touch.surface.y)
        yield (
            "membrane",
            Cloud(
                ("x", "y", "z"), np.column_stack([x.ravel(), y.ravel(), touch.surface.z.ravel()])
            ),
        )
    if touch.traction is not None:
        x, y = np.meshgrid(touch.traction.x, touch.traction.y)
        yield (
            "traction",
            Cloud(
                ("x", "y", "z", "fx", "fy", "fz"),
                np.column_stack(
                    [x.ravel(), y.ravel(), np.zeros(x.size), touch.traction.force.reshape(-1, 3)]
                ),
            ),
        )
    if touch.markers is not None:
        m = touch.markers
        sd = np.sqrt(np.maximum(np.diagonal(m.cov_p, axis1=1, axis2=2), 0.0))
        yield (
            "markers",
            Cloud(
                ("x", "y", "z", "id", "nx", "ny", "nz", "sd_x", "sd_y", "sd_z"),
                np.column_stack([m.p_SM, m.ids, m.n_S, sd]),
            ),
        )


def _frames(episode: Episode, row: Any) -> Iterator[Transform]:
    """Where the gripper is above its start, the two sensors of a pair in it, and, in simulation,
    the object in the world."""
    height = float(row["lift_height"])
    opening = float(row["opening"])
    if np.isfinite(height):
        yield Transform("gripper_start", "gripper", np.eye(3), np.array([0.0, 0.0, height]))
    if len(episode.fingers) == 2 and np.isfinite(opening):
        for k, side in enumerate((-1, 1)):
            yield Transform(
                "gripper",
                f"{episode.fingers[k]}_sensor",
                FACING[k],
                np.array([side * opening / 2, 0.0, 0.0]),
            )
    if "object_position_true" in row:
        w, x, y, z = np.asarray(row["object_quaternion_true"], float)
        R = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        yield Transform("world", "object_true", R, np.asarray(row["object_position_true"], float))


def quaternion(R: Array) -> tuple[float, float, float, float]:
    """(x, y, z, w) of a rotation, w >= 0."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(R).as_quat()
    return (x, y, z, w) if w >= 0 else (-x, -y, -z, -w)


def nanoseconds(time: float) -> int:
    return round(1e9 * time)
