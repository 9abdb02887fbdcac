"""The values that a controller gets and gives back: what a controller file imports. All of them:
`mjtactile.core.types`."""

from mjtactile.core.policy import policy_command, policy_vector
from mjtactile.core.status import Status, StatusCode
from mjtactile.core.types import (
    FINGERS,
    MATERIALS,
    PHASES,
    SHAPES,
    SLIP_STATES,
    Command,
    Contact,
    FeltShape,
    GripperState,
    Image,
    Markers,
    Material,
    Observation,
    Phase,
    Slip,
    SlipState,
    Surface,
    Touch,
    Traction,
    ValveState,
)

__all__ = [
    "FINGERS",
    "MATERIALS",
    "PHASES",
    "SHAPES",
    "SLIP_STATES",
    "Command",
    "Contact",
    "FeltShape",
    "GripperState",
    "Image",
    "Markers",
    "Material",
    "Observation",
    "Phase",
    "Slip",
    "SlipState",
    "Status",
    "StatusCode",
    "Surface",
    "Touch",
    "Traction",
    "ValveState",
    "policy_command",
    "policy_vector",
]
