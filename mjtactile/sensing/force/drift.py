"""What a camera that is not as it was at the references does to where markers seem to be (Eq. F11).

A camera that was knocked has another place and direction; a lens that breathes shows all larger; a
curve of grey levels that changed moves all edges in or out by about as much, so that every circle
looks larger, and nearer. Each moves all markers in a way that no load on the sheet does, which is
held along its frame.
"""

from __future__ import annotations

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array
from mjtactile.sensing.settings import InverseSettings

MODES = 9
"""Place x, y, z; turn about x, y, z; scale of the picture; size of the circles, alike for all, and
as their levels changed."""


def camera_modes(
    design: SensorDesign, p_SM: Array, darker: Array, s: InverseSettings, *, knocked: bool = False
) -> Array:
    """One sd of each mode.

    Args:
        design: The sensor; its camera is where markers' places are counted from.
        p_SM: Markers (m, 3) m.
        darker: By how much each one's darkness has changed since the reference, (m,).
        s: Has the sds.
        knocked: Whether the camera has been: place and direction may then be anywhere near.

    Returns:
        (m, 3, MODES) m by which each marker seems to move.
    """
    away = p_SM - design.camera.p_SC
    depth = away[:, 2:]
    modes = np.zeros((len(p_SM), 3, MODES))
    place, turn = (s.knock_place, s.knock_turn) if knocked else (s.drift_camera, s.drift_turn)
    modes[:, :, :3] = place * np.eye(3)
    modes[:, :, 3:6] = turn * np.cross(np.eye(3), away[:, None]).transpose(0, 2, 1)
    modes[:, 2, 6] = -s.drift_zoom * depth[:, 0]
    # depth goes with one over the size, and along the ray
    radius_px = design.camera.fx * design.markers.radius / depth
    grown = -away / radius_px
    modes[:, :, 7] = s.drift_size * grown
    modes[:, :, 8] = s.drift_levels * darker[:, None] * grown
    return modes


def drift_of(found: Array, seen: Array) -> float:
    """How large the drift `found` is, in sd (gas, then the camera's modes), over what estimates of
    it have, the share `seen` of their variances: 1 is as believed. Gas counts as one mode of four.
    """
    share = found**2 / seen
    return float((share[0] + 3 * share[1:].mean()) / 4)
