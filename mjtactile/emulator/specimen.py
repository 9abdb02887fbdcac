"""The sensor that an emulated finger really has: its sensor file, changed as `[emulator.specimen.FINGER]` of a rig file says.

Only the emulated world and its devices know; the host reads the sensor file and measures the rest, as on a real rig.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mjtactile.core import geometry
from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array
from mjtactile.rig.file import SpecimenConfig


def true_design(design: SensorDesign, specimen: SpecimenConfig) -> SensorDesign:
    """The sensor as it is, but for the camera's pose; see `camera_pose`."""
    camera, k = design.camera, design.camera.distortion
    focal, (du, dv) = 1 + specimen.focal_share, specimen.center
    camera = replace(camera, fx=focal * camera.fx, fy=focal * camera.fy, cx=camera.cx + du, cy=camera.cy + dv,
                     distortion=(k[0] if specimen.k1 is None else specimen.k1, *k[1:]))
    membrane = replace(design.membrane, young=(1 + specimen.stiffness_share) * design.membrane.young)
    markers = replace(design.markers, radius=design.markers.radius + specimen.radius)
    return replace(design, camera=camera, membrane=membrane, markers=markers)


def camera_pose(design: SensorDesign, specimen: SpecimenConfig) -> tuple[Array, Array]:
    """Pose R_SC (3, 3), p_SC (3,) m of the camera, with its pane and LEDs, in S."""
    return geometry.rotation_from_vector(specimen.tilt), design.camera.p_SC + np.array(specimen.shift)
