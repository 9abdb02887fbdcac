"""Frozen, validated values exchanged between the stages; their arrays are read-only.

SI units throughout, except if a name ends in `_px`. Frames use monogram notation
(docs/reference/conventions.md):

- S: sensor. The origin is the center of the frame, in the flat membrane's plane. z points outward,
  away from the camera.
- C: camera. x right, y down, z forward.
- M: marker. `p_SM` is the position of marker M expressed in S.

A controller may import only this and `mjtactile.grasp_estimation` of the project.
"""

from mjtactile.core.types.arrays import Array
from mjtactile.core.types.command import COMMAND_FIELDS, PHASES, Command, Phase
from mjtactile.core.types.contact_shape import (
    MATERIALS,
    SHAPES,
    ContactShape,
    Material,
    RelativeMotion,
)
from mjtactile.core.types.control import Observation, TaskGoal
from mjtactile.core.types.devices import FINGERS, GripperState, PressureReading, ValveState
from mjtactile.core.types.touch import (
    SLIP_STATES,
    Contact,
    Slip,
    SlipState,
    Surface,
    SyntheticTouch,
    Touch,
    Traction,
)
from mjtactile.core.types.vision import (
    CameraDrift,
    CirclePoses,
    Ellipses,
    FiducialDetections,
    Image,
    Markers,
    SyntheticEllipses,
)
