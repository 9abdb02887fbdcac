"""Flat reference of the sensor: camera pose, and true size of each marker.

It is measured with the valve open. The flat membrane is a target of known layout. Its marker
*centers* in the image determine the camera's pose relative to the frame, independent of the radii.
With the pose known, each marker's apparent depth gives its radius, to which depth is proportional.
The paper determines the frame's pose in the same way (II-B.3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mjtactile.core import geometry, optics
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import DeviceError
from mjtactile.core.optics import Camera
from mjtactile.core.types import Array, CirclePoses, Markers
from mjtactile.sensing.settings import DEFAULTS, ReferenceSettings

_STEPS = 20


_FEWEST_MARKERS = 3  # minimum number for a camera's pose


@dataclass(frozen=True, eq=False)
class FlatReference:
    """Camera pose `R_SC` (3, 3), `p_SC` (3,), m, and marker sizes from the flat membrane. `scale`
    (N,) is the true over the nominal radius of each marker (1 if not detected). `residual_px` is
    the rms of the marker centers. `scale_sd` is the rms scatter of `scale` over the images."""

    R_SC: Array
    p_SC: Array
    scale: Array
    residual_px: float
    scale_sd: float

    @classmethod
    def nominal(cls, design: SensorDesign) -> FlatReference:
        """Return the reference of the sensor file, before any measurement."""
        return cls(np.eye(3), design.camera.p_SC, np.ones(design.markers.count), 0.0, 0.0)

    def to_nominal(self, design: SensorDesign, poses: CirclePoses) -> CirclePoses:
        """Transform the circles to a camera at the sensor file's pose. There, C is parallel to S,
        at `camera.p_SC`."""
        shift = self.p_SC - design.camera.p_SC
        R = self.R_SC
        p, p_alt, n, n_alt = np.array([poses.p_CM, poses.p_CM_alt, poses.n_C, poses.n_C_alt]) @ R.T
        return replace(
            poses,
            p_CM=p + shift,
            p_CM_alt=p_alt + shift,
            n_C=n,
            n_C_alt=n_alt,
            cov_p=R @ poses.cov_p @ R.T,
        )


def measure_flat(
    design: SensorDesign,
    camera: Camera,
    images: Sequence[Markers],
    s: ReferenceSettings = DEFAULTS.reference,
) -> FlatReference:
    """Estimate the camera pose and marker radii from images of the flat membrane. `images` holds
    the identified markers of each image, located with the file's pose and radii. Raises DeviceError
    if they contradict the sensor file."""
    count = design.markers.count
    total = np.zeros((count, 2))
    times = np.zeros(count)
    for markers in images:
        total[markers.ids] += optics.project(camera, markers.p_SM - design.camera.p_SC)
        times[markers.ids] += 1
    ids = np.flatnonzero(times >= max(len(images) / 2, 1))
    if len(ids) < _FEWEST_MARKERS:
        raise DeviceError(
            f"sensor {design.name}: flat reference: {len(images)} images together show only "
            f"{len(ids)} of {count} markers"
        )
    uv = total[ids] / times[ids][:, None]
    R_SC, p_SC, residual = fit_camera_pose(design, camera, design.markers.p_SM[ids], uv)
    if residual > s.residual_max:
        raise DeviceError(
            f"sensor {design.name}: flat reference: marker centers deviate by {residual:.1f} "
            "px (rms) from the layout; check the lens, [markers] layout and radius_mm in the "
            "sensor file, and that the membrane is flat"
        )
    requested = _apparent_depth(camera, (design.markers.p_SM - p_SC) @ R_SC)
    ratios = np.full((len(images), count), np.nan)
    for row, markers in zip(ratios, images, strict=True):
        row[markers.ids] = requested[markers.ids] / _apparent_depth(
            camera, markers.p_SM - design.camera.p_SC
        )
    scale = np.ones(count)
    scale[ids] = np.nanmean(ratios[:, ids], axis=0)
    spread = float(np.sqrt(np.nanmean((ratios[:, ids] - scale[ids]) ** 2)))
    _check_scale(design, scale, s.radius_range)
    return FlatReference(R_SC, p_SC, scale, residual, spread)


def fit_camera_pose(
    design: SensorDesign, camera: Camera, p_SP: Array, uv_px: Array
) -> tuple[Array, Array, float]:
    """Fit the camera pose R_SC (3, 3), p_SC (3,), m, and return it with the rms residual, px. It
    projects points `p_SP` (n, 3), m, frame S, to `uv_px` (n, 2) through lens and glass.
    Gauss-Newton from the sensor file's pose."""
    R = np.eye(3)
    p = design.camera.p_SC.copy()
    step = 1e-6

    def project(R: Array, p: Array) -> Array:
        return optics.project(camera, (p_SP - p) @ R).ravel()

    for _ in range(_STEPS):
        base = project(R, p)
        columns = [
            (project(R @ geometry.rotation_from_vector(step * axis), p) - base) / step
            for axis in np.eye(3)
        ]
        columns += [(project(R, p + step * axis) - base) / step for axis in np.eye(3)]
        change = np.linalg.lstsq(np.column_stack(columns), uv_px.ravel() - base, rcond=None)[0]
        R = R @ geometry.rotation_from_vector(change[:3])
        p = p + change[3:]
        if np.abs(change).max() < 1e-10:
            break
    error = (project(R, p) - uv_px.ravel()).reshape(-1, 2)
    return R, p, float(np.sqrt((error**2).sum(axis=1).mean()))


def _apparent_depth(camera: Camera, p_CM: Array) -> Array:
    """Return the depth that a circle's size shows: from the camera's center, less the shift by the
    glass."""
    return p_CM[:, 2] - optics.glass_shift(camera, p_CM)


def _check_scale(design: SensorDesign, scale: Array, maximum: float) -> None:
    worst = int(np.argmax(np.abs(scale - 1)))
    if abs(scale[worst] - 1) > maximum:
        raise DeviceError(
            f"sensor {design.name}: flat reference: the size of marker {worst} deviates by "
            f"{100 * (scale[worst] - 1):+.0f} %; check [markers] radius_mm, and that the "
            "valve is open"
        )
