"""Input and output values of a controller, for import by controller files: all of
`mjtactile.core.types`."""

from mjtactile.core.flags import Flag, Flags
from mjtactile.core.policy import command_from_action, policy_observation
from mjtactile.core.policy_file import Policy, load_policy
from mjtactile.core.status import Status, StatusCode
from mjtactile.core.types import (
    FINGERS,
    MATERIALS,
    PHASES,
    SHAPES,
    SLIP_STATES,
    Command,
    Contact,
    ContactShape,
    GripperState,
    Image,
    Markers,
    Material,
    Observation,
    Phase,
    RelativeMotion,
    Slip,
    SlipState,
    Surface,
    TaskGoal,
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
    "ContactShape",
    "Flag",
    "Flags",
    "GripperState",
    "Image",
    "Markers",
    "Material",
    "Observation",
    "Phase",
    "Policy",
    "RelativeMotion",
    "Slip",
    "SlipState",
    "Status",
    "StatusCode",
    "Surface",
    "TaskGoal",
    "Touch",
    "Traction",
    "ValveState",
    "command_from_action",
    "load_policy",
    "policy_observation",
]
