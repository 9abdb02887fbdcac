"""Mounting of the sensors in the gripper, and the start of the gripper in the world."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjtactile.core.types import Array

_VERTICAL = 1e-3  # horizontal part below which a direction counts as vertical


@dataclass(frozen=True, eq=False)
class Mounting:
    """Poses of gripper and sensors at a time without lift.

    Attributes:
        R_WG: Rotation (3, 3) of the gripper in the world.
        p_WG: Its position (3,), m: the center of the sensors.
        R_GS: Rotation (n, 3, 3) of each sensor in the gripper.
        p_GS: Its position (n, 3), m, at `opening`.
        opening: Opening at that time, m.
    """

    R_WG: Array
    p_WG: Array
    R_GS: Array
    p_GS: Array
    opening: float

    @classmethod
    def assumed(cls, fingers: int) -> Mounting:
        """Return evenly spaced sensors that face the z axis of the gripper, y up.

        The first sensor is at negative x. The gripper starts at the origin of the world.
        """
        angles = np.pi + 2 * np.pi * np.arange(fingers) / max(fingers, 1)
        R_GS = np.stack([_facing(angle) for angle in angles]) if fingers else np.zeros((0, 3, 3))
        return cls(np.eye(3), np.zeros(3), R_GS, np.zeros((fingers, 3)), 0.0)

    @classmethod
    def of_view(cls, view: Any, row: Mapping[str, Any]) -> Mounting:
        """Return the poses of a simulated scene.

        z of the gripper is up. The first sensor faces along x as far as this is horizontal.

        Args:
            view: The scene, with `R_WS` and `p_WS`.
            row: Line of the log at the time of the scene.
        """
        center = np.mean(view.p_WS, axis=0)
        forward = view.R_WS[0][:, 2] * (1, 1, 0)
        length = float(np.linalg.norm(forward))
        x = forward / length if length > _VERTICAL else np.array([1.0, 0.0, 0.0])
        z = np.array([0.0, 0.0, 1.0])
        R_WG = np.column_stack([x, np.cross(z, x), z])
        R_GS = R_WG.T @ view.R_WS
        p_GS = (view.p_WS - center) @ R_WG
        height = finite(row["lift_height"])
        return cls(R_WG, center - height * z, R_GS, p_GS, finite(row["opening"]))

    @classmethod
    def of_note(cls, note: Any, fingers: int) -> Mounting:
        """Return the recorded poses; without a valid note, the assumed ones."""
        try:
            R_WG, p_WG, R_GS, p_GS = parts = tuple(
                np.array(note[key], float) for key in ("R_WG", "p_WG_m", "R_GS", "p_GS_m")
            )
            found = cls(R_WG, p_WG, R_GS, p_GS, float(note["opening_m"]))
        except (KeyError, TypeError, ValueError):
            return cls.assumed(fingers)
        shapes = tuple(part.shape for part in parts)
        valid = shapes == ((3, 3), (3,), (fingers, 3, 3), (fingers, 3))
        return found if valid and all(map(all_finite, parts)) else cls.assumed(fingers)

    def note(self) -> dict[str, Any]:
        """Return the entry of a recording's notes."""
        return {
            "R_WG": self.R_WG.tolist(),
            "p_WG_m": self.p_WG.tolist(),
            "R_GS": self.R_GS.tolist(),
            "p_GS_m": self.p_GS.tolist(),
            "opening_m": self.opening,
        }

    def sensors(self, opening: float) -> Array:
        """Return the position of each sensor in the gripper (n, 3), m; each moves along its z."""
        return self.p_GS - self.R_GS[:, :, 2] * (opening - self.opening) / 2


def _facing(angle: float) -> Array:
    """Return R_GS of a sensor at this angle about z: z to the axis, y up."""
    outward = np.array([np.cos(angle), np.sin(angle), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    return np.column_stack([np.cross(up, -outward), up, -outward])


def finite(value: Any, otherwise: float = 0.0) -> float:
    """Return a number; `otherwise` in place of one that is not finite."""
    parsed = float(value)
    return parsed if math.isfinite(parsed) else otherwise


def all_finite(values: Array) -> bool:
    """Return True if all values are finite."""
    return bool(np.isfinite(values).all())
