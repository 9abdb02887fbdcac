"""Frames of an episode as one tree: world, gripper_start, gripper, sensors, cameras."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjtactile.core.types import Array
from mjtactile.recording.mounting import Mounting, all_finite, finite


@dataclass(frozen=True, eq=False)
class Transform:
    """Pose of `child` in `parent`: position `p` (3,) m and rotation `R` (3, 3)."""

    parent: str
    child: str
    R: Array
    p: Array


def static_frames(
    mounting: Mounting, cameras: Mapping[str, tuple[Array, Array]]
) -> list[Transform]:
    """Return the start of the gripper in the world and the camera in each sensor.

    Args:
        mounting: Poses of gripper and sensors.
        cameras: R_SC and p_SC, m, by finger.
    """
    return [
        Transform("world", "gripper_start", mounting.R_WG, mounting.p_WG),
        *(Transform(f"{name}_sensor", f"{name}_camera", R, p) for name, (R, p) in cameras.items()),
    ]


def moving_frames(
    mounting: Mounting, fingers: Sequence[str], row: Mapping[str, Any], view: Any = None
) -> Iterator[Transform]:
    """Yield the poses of gripper (relative to its start) and sensors; simulated: of the object.

    Args:
        mounting: Poses of gripper and sensors.
        fingers: Names of the fingers.
        row: Line of the log.
        view: The scene at that time, with the exact poses of the sensors.
    """
    lift = np.array([0.0, 0.0, finite(row["lift_height"])])
    yield Transform("gripper_start", "gripper", np.eye(3), lift)
    if view is None:
        R_GS = mounting.R_GS
        p_GS = mounting.sensors(finite(row["opening"], mounting.opening))
    else:
        R_GS = mounting.R_WG.T @ view.R_WS
        p_GS = (view.p_WS - mounting.p_WG) @ mounting.R_WG - lift
    for name, R, p in zip(fingers, R_GS, p_GS, strict=True):
        yield Transform("gripper", f"{name}_sensor", R, p)
    if "object_position_true" in row:
        R = _rotation(row["object_quaternion_true"])
        p = np.asarray(row["object_position_true"], float)
        if all_finite(p) and all_finite(R):
            yield Transform("world", "object_true", R, p)


def _rotation(wxyz: Any) -> Array:
    """Return the rotation (3, 3) of a recorded quaternion; NaN for an unknown one."""
    from scipy.spatial.transform import Rotation

    w, x, y, z = np.asarray(wxyz, float)
    norm = float(np.linalg.norm((w, x, y, z)))
    return Rotation.from_quat((x, y, z, w)).as_matrix() if norm > 0 else np.full((3, 3), np.nan)
