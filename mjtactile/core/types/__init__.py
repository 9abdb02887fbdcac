"""Frozen, validated values that the stages pass to each other; arrays in them are read-only.

SI units throughout, except where a name ends in `_px`. Frames (monogram notation,
docs/reference/conventions.md): S sensor (origin at the middle of the frame, in the flat membrane's
plane, z outward, away from the camera), C camera (x right, y down, z forward), M marker. `p_SM` is
the position of marker M expressed in S.

This, and `mjtactile.grasp_estimation`, is all of the project that a controller may import.
"""

from mjtactile.core.types.arrays import Array
from mjtactile.core.types.contact_shape import MATERIALS, SHAPES, BodyMotion, FeltShape, Material
from mjtactile.core.types.control import PHASES, TOLD, Command, Observation, Phase, Told
from mjtactile.core.types.devices import FINGERS, GripperState, PressureReading, ValveState
from mjtactile.core.types.touch import (
    SLIP_STATES,
    Contact,
    Slip,
    SlipState,
    Surface,
    Touch,
    TouchImage,
    Traction,
)
from mjtactile.core.types.vision import (
    CameraChange,
    CirclePoses,
    Ellipses,
    FiducialsSeen,
    Image,
    Markers,
    Sighting,
)

__all__ = [
    "FINGERS",
    "MATERIALS",
    "PHASES",
    "SHAPES",
    "SLIP_STATES",
    "TOLD",
    "Array",
    "BodyMotion",
    "CameraChange",
    "CirclePoses",
    "Command",
    "Contact",
    "Ellipses",
    "FeltShape",
    "FiducialsSeen",
    "GripperState",
    "Image",
    "Markers",
    "Material",
    "Observation",
    "Phase",
    "PressureReading",
    "Sighting",
    "Slip",
    "SlipState",
    "Surface",
    "Told",
    "Touch",
    "TouchImage",
    "Traction",
    "ValveState",
]
