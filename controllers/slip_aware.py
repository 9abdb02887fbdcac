"""Slip-aware grasp: grip as lightly as the object permits; tighten at slip or incipient slip.

It closes to a quarter of a newton, then lifts. The target force per finger grows with the reported
slip, up to a limit. It never decreases while the object is held. The lift waits while the grip
tightens. `step` is pure: it writes its memory into `Command.memory` and reads it back from
`Observation.command.memory`.
"""

from dataclasses import replace
from functools import partial

from mjtactile.grasp_estimation import phases
from mjtactile.types import Command, Observation

# initial and maximum target force per finger, N
FIRST_FORCE = 0.25
FORCE_MAX = 1.6
# increase of the target at a slip: fraction of the measured force, and constant, N
SLIPPING_FRACTION = 0.3
SLIPPING_STEP = 0.1
SLIP_PAUSE = 0.15  # time, s, until a lasting slip counts again: response time of the grip
INCIPIENT_RATE = 0.6  # rate of the target during incipient slip, N/s
KICK = 0.001  # immediate closing at a slip, m: about 0.15 N for two soft membranes
TOUCH_FORCE = 0.08  # touch threshold, N: several times the noise of the estimate
SERVO_FORCE_LIMIT = 4.0  # maximum force of the servo, N, at any measured force
# speeds, m/s
CLOSING_SPEED = 0.020
OPENING_SPEED = 0.040
# gain, m/s per N of force error, as in gentle.py; speed limit, m/s
REGULATION_GAIN = 0.03
REGULATION_SPEED_MAX = 0.010
# lift speed, m/s: slow, so that slip is detected early
LIFT_SPEED = 0.025
SETTLE_TIME = 0.4
FORCE_TOLERANCE = 0.06  # tolerance around the target for a settled force, N
# upward force per finger during lowering, N, that indicates a standing object
TABLE_FORCE = 0.1
START = {"target": FIRST_FORCE, "since_slip": 1.0, "slips": 0.0}


def step(observation: Observation) -> Command:
    """Run one control cycle: the function of the last command's phase."""
    return phases.run_cycle(
        observation,
        PHASES,
        start=START,
        force_limit=SERVO_FORCE_LIMIT,
        contact_force=TOUCH_FORCE,
        update=_grip_as_needed,
    )


def _grip_as_needed(observation: Observation, command: Command, forces: list[float]) -> Command:
    """Raise the target force if any finger reports slip or incipient slip; at slip also close
    immediately."""
    memory = command.memory
    since_slip = memory["since_slip"] + observation.period
    command = phases.remember(command, since_slip=since_slip)
    states = [
        touch.slip.state if touch.slip is not None else "unknown" for touch in observation.touch
    ]
    if "slipping" in states and since_slip >= SLIP_PAUSE:
        target = min(
            FORCE_MAX, max(memory["target"], *forces) * (1 + SLIPPING_FRACTION) + SLIPPING_STEP
        )
        kick = KICK if target > memory["target"] else 0.0
        command = replace(command, opening=command.opening - kick)
        return phases.remember(command, target=target, since_slip=0.0, slips=memory["slips"] + 1)
    # the target force is reached but insufficient
    if "incipient" in states and max(forces) > memory["target"] - FORCE_TOLERANCE:
        return phases.remember(
            command, target=min(FORCE_MAX, memory["target"] + INCIPIENT_RATE * observation.period)
        )
    return command


def _regulated(observation: Observation, command: Command, forces: list[float]) -> Command:
    """Move the opening so that the mean measured force reaches the target.

    The command stays close to the actual opening.
    """
    error = command.memory["target"] - sum(forces) / len(forces)
    speed = max(-REGULATION_SPEED_MAX, min(REGULATION_SPEED_MAX, REGULATION_GAIN * error))
    actual = observation.gripper.opening
    opening = command.opening - speed * observation.period
    return replace(command, opening=max(actual - 0.004, min(actual + 0.004, opening)))


def _regulate(observation: Observation, command: Command, forces: list[float]) -> Command:
    """Bring the force to the target and wait until it stays there."""
    command = _regulated(observation, command, forces)
    error = command.memory["target"] - sum(forces) / len(forces)
    is_settled = abs(error) < FORCE_TOLERANCE
    return phases.settle(observation, command, is_settled, SETTLE_TIME)


def _lift(observation: Observation, command: Command, forces: list[float]) -> Command:
    """Lift while the grip force is at its target and there is no slip."""
    command = _regulated(observation, command, forces)
    is_weak = sum(forces) / len(forces) < command.memory["target"] - FORCE_TOLERANCE
    if command.memory["since_slip"] < 2 * SLIP_PAUSE or is_weak:
        return command
    goal = observation.goal.lift_height
    if observation.gripper.lift_height > goal - 0.001:
        return phases.enter_phase(command, "hold")
    height = min(goal, command.lift_height + LIFT_SPEED * observation.period)
    return replace(command, lift_height=height)


def _hold(observation: Observation, command: Command, forces: list[float]) -> Command:
    return phases.hold(observation, _regulated(observation, command, forces))


def _lower(observation: Observation, command: Command, forces: list[float]) -> Command:
    command = _regulated(observation, command, forces)
    return phases.lower(observation, command, speed=LIFT_SPEED, table_force=TABLE_FORCE)


_approach = partial(
    phases.approach, speed=CLOSING_SPEED, contact_force=TOUCH_FORCE, max_force=FIRST_FORCE
)
PHASES = {
    "approach": _approach,
    "close": _approach,
    "regulate": _regulate,
    "lift": _lift,
    "hold": _hold,
    "lower": _lower,
    "release": partial(phases.release, speed=OPENING_SPEED, contact_force=TOUCH_FORCE),
}
