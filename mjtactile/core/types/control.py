"""Goal of a task, and observation of a controller."""

from __future__ import annotations

from dataclasses import dataclass, field

from mjtactile.core.signature_checks import validated
from mjtactile.core.types.command import Command
from mjtactile.core.types.devices import GripperState, ValveState
from mjtactile.core.types.touch import Touch


@dataclass(frozen=True)
class TaskGoal:
    """Goal of a task for the robot.

    Attributes:
        lift_height: Lift height, m.
        hold_time: Hold time at that height, s.
        place_height: Height of the gripper above the grip height at which the object shall be set
            down, m; it may be negative.
        handover: True if a person will take the object out of the gripper.
        push: Maximum force of pushes by a person, from any side, N.
        acceleration: Maximum acceleration of the gripper during the hold, m/s^2.
    """

    lift_height: float = 0.040
    hold_time: float = 2.0
    place_height: float = 0.0
    handover: bool = False
    push: float = 0.0
    acceleration: float = 0.0


@validated()
@dataclass(frozen=True, eq=False)
class Observation:
    """Observation of a controller in one control cycle: only sensor data.

    Attributes:
        time: Time on the rig's clock, s.
        period: Time from one cycle to the next, s.
        touch: One value per finger, in the order of the rig (left, right).
        gripper: The gripper's newest state.
        valves: The valves' states, in the order of the fingers that have one.
        command: The last command that was sent, with the controller's `phase` and `memory`.
        goal: Goal of the task.
    """

    time: float
    period: float
    touch: tuple[Touch, ...]
    gripper: GripperState
    valves: tuple[ValveState, ...]
    command: Command
    goal: TaskGoal = field(default_factory=TaskGoal)
