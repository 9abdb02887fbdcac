"""Camera without a glass that has the same image as a camera behind a glass.

CameraInfo, camera calibrations of Foxglove and pinholes of Rerun have no glass. Near the axis, a
glass of thickness t and index n moves every point by t (1 - 1/n) towards the camera, whatever its
depth. The effective camera therefore has its center moved by this shift along z. The remaining
difference is radial, and the coefficients of the lens absorb it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from mjtactile.core import optics
from mjtactile.core.design import SensorDesign
from mjtactile.core.optics import Camera
from mjtactile.core.sensor_parts import Pinhole
from mjtactile.core.signature_checks import validated
from mjtactile.core.types import Array

_NODES = 15  # number of points along x and y
_DEPTHS = np.linspace(-0.25, 0.35, 7)  # z in S of the fitted points, as a fraction of the chamber
_MARGIN = 0.05  # margin beyond the image, as a fraction of its size
_STEPS = 20
RESIDUAL_MAX = 0.3
"""Limit of the residual above which `mjtactile export` states it, px."""


@dataclass(frozen=True, eq=False)
class EffectiveCamera:
    """Camera without a glass.

    Attributes:
        camera: Intrinsics, with the lens of the effective camera.
        shift: Distance of its center from the real one along z of the camera frame, m.
        residual_px: Maximum difference of its projections from those through the glass, px. The
            points cover the membrane from -0.25 to 0.35 chamber depths.
    """

    camera: Pinhole
    shift: float
    residual_px: float

    def pose(self, R_SC: Array, p_SC: Array) -> tuple[Array, Array]:
        """Return the pose of this camera from that of the real one.

        Args:
            R_SC: Rotation (3, 3) of the real camera in the sensor.
            p_SC: Its position (3,), m.

        Returns:
            R_SC and p_SC of this camera.
        """
        return R_SC, p_SC + self.shift * R_SC[:, 2]


@validated()
@cache
def effective_camera(design: SensorDesign) -> EffectiveCamera:
    """Fit the effective camera of a sensor: lens coefficients and shift by Gauss-Newton steps.

    Args:
        design: Sensor with the lens that was measured.

    Returns:
        The effective camera; without a glass, the camera itself.
    """
    real = Camera.from_design(design.camera, design.glass)
    plain = Pinhole(**design.camera.intrinsics)
    if real.glass_thickness == 0 or real.glass_index == 1:
        return EffectiveCamera(plain, 0.0, 0.0)
    p_CP = _workspace(design, real)
    uv = optics.project(real, p_CP)
    first = real.glass_thickness * (1 - 1 / real.glass_index)
    scales = np.array([first, *_scales(plain)])
    step = np.zeros(len(scales))

    def camera_of(step: Array) -> EffectiveCamera:
        shift, *change = step * scales
        coefficients = tuple(np.add(plain.distortion, change).tolist())
        return EffectiveCamera(replace(plain, distortion=coefficients), first + float(shift), 0.0)

    def residual(step: Array) -> Array:
        return (_project(camera_of(step), p_CP) - uv).ravel()

    for _ in range(_STEPS):
        now = residual(step)
        J = np.column_stack([(residual(step + 1e-4 * e) - now) / 1e-4 for e in np.eye(len(step))])
        change = np.linalg.lstsq(J, -now, rcond=1e-7)[0]
        step = step + change
        if np.abs(change).max() < 1e-6:
            break
    found = camera_of(step)
    distance = np.linalg.norm(_project(found, p_CP) - uv, axis=1)
    return replace(found, residual_px=float(distance.max()))


def _scales(camera: Pinhole) -> list[float]:
    """Return the size of a step of each coefficient; 0 for tangential ones: a glass is round."""
    is_tangential = camera.lens.definition.tangential
    names = camera.lens.definition.coefficients
    return [0.0 if is_tangential and name in ("p1", "p2") else 0.1 for name in names]


def _project(effective: EffectiveCamera, p_CP: Array) -> Array:
    bare = Camera(**effective.camera.intrinsics)
    return optics.project(bare, p_CP - [0.0, 0.0, effective.shift])


def _workspace(design: SensorDesign, camera: Camera) -> Array:
    """Return points (n, 3) m in C over the membrane that are in the image."""
    x = np.linspace(-0.5, 0.5, _NODES) * design.frame.length
    y = np.linspace(-0.5, 0.5, _NODES) * design.frame.width
    grid = np.meshgrid(x, y, _DEPTHS * design.chamber.depth)
    points = np.stack([axis.ravel() for axis in grid], axis=1) - design.camera.p_SC
    size = np.array([camera.width, camera.height])
    uv = optics.project(camera, points)
    inside = np.all((uv > -_MARGIN * size) & (uv < (1 + _MARGIN) * size), axis=1)
    return points[inside]
