"""Adaptive grasp: grip as lightly as the load permits; estimate load and friction during the grasp.

- **Load.** The shear force on a finger is the load that it carries. The grip follows the largest
  shear of the last second, plus an announced push or acceleration from any side.
- **Friction.** A Bayesian filter estimates the friction coefficient, which may change while the
  object is held (docs/theory/friction.md). The grip is the minimum force at which the probability
  of slip is below RISK. Close over the table a larger risk is taken, until friction is known.
- **Jaws.** Their goal follows the target immediately, by the measured stiffness, in both
  directions. A force is compared with the opening that was sent DELAY before.
- **Table and external pull.** Shear that vanishes, and returns with the opposite sign, is support
  by the table: release. Any other lasting change of shear is an external pull.

`step` is pure: its memory is `Command.memory`. It uses no clock and no direction of gravity.
"""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from mjtactile.grasp_estimation import (
    FrameLoadEstimator,
    FrictionFilter,
    GripStiffnessEstimator,
    LoadEstimator,
    estimate_weight,
    phases,
    slip_sign,
    stands,
)
from mjtactile.types import Command, Observation

MAX_FORCE, MIN_FORCE = 2.2, 0.18  # grip force limits per finger, N; the first grip uses the minimum
# minimum in the air: 0.1 N may be put on it without notice, faster than the jaws follow, and the
# first contact takes as much anyway
HOLD_FORCE = 0.30
MIN_TEST_FORCE = 0.10  # minimum force, N, of the friction test close over the table
# touch threshold, N, well above noise; maximum push, N, until both fingers touch
TOUCH_FORCE, MAX_PUSH = 0.08, 0.5
SERVO_FORCE_LIMIT = 5.0  # maximum force of the servo, N, at any measured force
# probability of slip: in the air, during the first lift, and while friction is tested
RISK, LOW_RISK, TEST_RISK = 0.01, 0.25, 0.5
# friction is known if its 5 % quantile is this fraction of the median; maximum time of the test, s
KNOWN, TEST_TIME, FRICTION_MAX = 0.85, 2.0, 1.0
LOOSENING = 1.0  # relative decrease of the grip while friction is tested, 1/s
LOADED = 0.25  # minimum load over grip force of an object that may slip out, a low friction
# a slip ends after SLIP_WAIT without a sign; the lift waits at most GRIP_WAIT for slip and grip, s
SLIP_WAIT, GRIP_WAIT = 0.3, 1.0
GROWS = 1.05  # relative growth of the load from slip to slip while the table carries a part
# delay from a command to its force in an image, s; time scale of force errors, s
DELAY, SETTLING = 0.1, 0.2
CLOSING_SPEED, OPENING_SPEED = 0.020, 0.060  # all speeds in m/s
LIFT_SPEED, WEIGH_SPEED, PLACE_SPEED = 0.030, 0.003, 0.007
# m/s^2: a step of the speed loads the grip by more than the weight, or unloads it like the table
LIFT_ACCELERATION = 0.1
WEIGH_HEIGHT = 0.003  # height of the slow first lift, m, during which the load builds up
TIGHTEN_SPEED, LOOSEN_SPEED = 0.015, 0.003  # faster where it must hold than to spare
FORCE_TOLERANCE = 0.06  # tolerance around the target for a settled force, N
SETTLE_TIME = 0.25  # s
SEARCH = 0.030  # search range for the table around the specified place height, m
# pull over all fingers, N, and its duration, s; a bump is shorter
PULL_FORCE, PULL_TIME = 0.20, 0.09
MEMORY_KEYS = {
    LoadEstimator: "load",
    GripStiffnessEstimator: "spring",
    FrameLoadEstimator: "frames",
    FrictionFilter: "friction",
}
START = {f"{clock}_time": 0.0 for clock in ("pull", "wait", "test", "slip")} | {
    "low": WEIGH_HEIGHT,
    "speed": WEIGH_SPEED,
    "slid": 0.0,
    "target": MIN_FORCE,
    "sent": [],
    "load": vars(LoadEstimator()),
    "spring": vars(GripStiffnessEstimator()),
    "frames": vars(FrameLoadEstimator()),
    "friction": vars(FrictionFilter()),
    "risk": LOW_RISK,
    "stands": False,
}


def step(observation: Observation) -> Command:
    """Run one control cycle: the function of the last command's phase."""
    return phases.run_cycle(
        observation,
        PHASES,
        start=START,
        force_limit=SERVO_FORCE_LIMIT,
        contact_force=TOUCH_FORCE / 2,
        update=grip_as_needed,
    )


def _stored(kind: Any, command: Command) -> Any:
    """Return the estimator of this class as the previous image left it."""
    kept: Any = command.memory[MEMORY_KEYS[kind]]
    return kind(**kept)


def grip_as_needed(observation: Observation, command: Command, forces: list[float]) -> Command:
    """Update the estimates of load and friction, and set the target force that they require."""
    touch = observation.touch
    memory = command.memory
    friction = _stored(FrictionFilter, command).after(
        touch,
        observation.period,
        is_test=memory["risk"] == TEST_RISK,
        # the table may take the load of a lowered object
        is_hanging=len(_stored(LoadEstimator, command).down) > 0 and command.phase != "lower",
    )
    is_slipping = friction.grows or slip_sign(touch) == 2
    frames = _stored(FrameLoadEstimator, command).after(
        touch, observation.gripper.effort, observation.period, is_slipping=friction.grows
    )
    load = _stored(LoadEstimator, command).after(touch, observation.period, is_slipping=is_slipping)
    slip_time = 0.0 if is_slipping else memory["slip_time"] + observation.period
    goal = observation.goal
    worst = load.expected(len(touch), goal.push, goal.acceleration)
    minimum = HOLD_FORCE if len(load.down) else MIN_FORCE
    if memory["risk"] == TEST_RISK:  # the tested friction must be fully used
        worst = load.maximum
        minimum = max(MIN_TEST_FORCE, memory["target"] * (1 - LOOSENING * observation.period))
    grip = friction.grip(worst * (1 + friction.inertia), memory["risk"])
    target = max(minimum, min(grip, MAX_FORCE, frames.maximum))
    estimators = {"load": vars(load), "friction": vars(friction), "frames": vars(frames)}
    return phases.remember(
        command,
        target=target,
        slip_time=slip_time,
        **estimators,
        mass=load.mass,
        mass_sd=estimate_weight(touch).sd,
    )


def _grip_force(forces: list[float]) -> float:
    """Return the force, N, that is regulated: one finger that pushes the object does not grip."""
    return min(sum(forces) / len(forces), 2 * max(min(forces), 0.0))


def _regulated(observation: Observation, command: Command, forces: list[float]) -> Command:
    """Move the opening so that the measured grip force reaches the target.

    The goal moves with the target immediately, by the measured stiffness. Its remaining error is
    corrected slowly: the force belongs to the opening that was sent one delay ago. The command
    stays close to the actual opening.
    """
    memory: Any = command.memory
    force = _grip_force(forces)
    spring = _stored(GripStiffnessEstimator, command)
    if min(forces) > TOUCH_FORCE / 2:
        spring = spring.after(observation.gripper.opening, force, observation.period)
    before = observation.command.memory.get("target", MIN_FORCE)
    goal = memory.get("goal", command.opening)
    sent = [*memory["sent"], command.opening][-max(1, round(DELAY / observation.period)) :]
    speed = (sent[0] - goal + spring.way(before, force)) / SETTLING
    speed = max(-TIGHTEN_SPEED, min(LOOSEN_SPEED, speed))
    goal += speed * observation.period - spring.way(before, memory["target"])
    actual = observation.gripper.opening
    opening = max(actual - 0.006, min(actual + 0.004, goal))
    return phases.remember(
        replace(command, opening=opening), goal=goal, sent=sent, spring=vars(spring)
    )


def _approach(observation: Observation, command: Command, forces: list[float]) -> Command:
    """Close until both fingers have contact. The jaws stop at the first contact of each."""
    after = phases.approach(
        observation,
        command,
        forces,
        speed=CLOSING_SPEED,
        contact_force=TOUCH_FORCE,
        max_force=MAX_PUSH,
    )
    stops = after.phase in ("close", "regulate") and after.phase != command.phase
    return replace(after, opening=observation.gripper.opening) if stops else after


def _regulate(observation: Observation, command: Command, forces: list[float]) -> Command:
    """Bring the force to the first target."""
    command = _regulated(observation, command, forces)
    is_settled = abs(_grip_force(forces) - command.memory["target"]) < FORCE_TOLERANCE
    return phases.settle(observation, command, is_settled, SETTLE_TIME)


def _lift(observation: Observation, command: Command, forces: list[float]) -> Command:
    """Lift slowly until the fingers carry the load and the grip force has followed; then faster."""
    command = _regulated(observation, command, forces)
    target = command.memory["target"]
    grip = _grip_force(forces)
    load = _stored(LoadEstimator, command)
    waits = target - grip > min(FORCE_TOLERANCE, 0.1 * target)
    # faces that the fingers only drag along themselves slip without a load
    slips = command.memory["slip_time"] < SLIP_WAIT and load.maximum > LOADED * grip
    waits |= slips
    wait_time = command.memory["wait_time"] + observation.period if waits else 0.0
    command = phases.remember(command, wait_time=wait_time)
    is_low = command.lift_height < command.memory["low"]
    if is_low and slips and load.maximum > GROWS * command.memory["slid"]:
        # the load still grows: the table carries a part
        low = command.lift_height + WEIGH_HEIGHT
        command = phases.remember(command, low=low, slid=load.maximum)
    if not is_low and command.memory["risk"] != RISK:
        return _test_friction(observation, command)
    if 0.0 < wait_time < GRIP_WAIT:
        # grip first, within the jaws' limits; waiting longer would not help
        return phases.remember(command, speed=WEIGH_SPEED)
    goal = observation.goal.lift_height
    if not load.down and not is_low:
        command = phases.remember(command, load=vars(load.hanging(observation.touch)))
    if observation.gripper.lift_height > goal - 0.001:
        return phases.enter_phase(command, "hold")
    is_slow = is_low or waits  # the load of an object that slides grows no faster than the grip
    speed = WEIGH_SPEED if is_slow else _speed_towards(LIFT_SPEED, observation, command)
    height = min(goal, command.lift_height + speed * observation.period)
    return phases.remember(replace(command, lift_height=height), speed=speed)


def _speed_towards(goal: float, observation: Observation, command: Command) -> float:
    """Return the next speed of the lift axis, m/s, on the way to the `goal`."""
    step = LIFT_ACCELERATION * observation.period
    speed = command.memory["speed"]
    return max(speed - step, min(speed + step, goal))


def _test_friction(now: Observation, command: Command) -> Command:
    """Reduce the grip force, until friction is known or the test cannot show more of it."""
    memory = command.memory
    friction = _stored(FrictionFilter, command)
    median = friction.quantile(0.5)
    is_known = friction.quantile(0.05) > KNOWN * median or median > FRICTION_MAX
    # a light object cannot use more friction than is certain already
    most_used = _stored(LoadEstimator, command).maximum / MIN_TEST_FORCE
    is_known |= most_used < friction.utilization(RISK)
    test_time = memory["test_time"] + now.period
    slipped = memory["slip_time"] == 0.0
    if is_known or slipped or test_time > TEST_TIME:
        # after a slip the object may stand on the table again
        low = command.lift_height + slipped * WEIGH_HEIGHT
        return phases.remember(command, risk=RISK, low=low)
    return phases.remember(command, risk=TEST_RISK, test_time=test_time)


def _hold(observation: Observation, command: Command, forces: list[float]) -> Command:
    """Hold; release for an announced handover when a pull lasts longer than a bump."""
    command = _regulated(observation, command, forces)
    now = _stored(LoadEstimator, command).vector(observation.touch)
    held = np.asarray(command.memory.get("held", now))
    pulls = float(np.linalg.norm(now - held)) > PULL_FORCE
    if observation.goal.handover and pulls:
        pull_time = command.memory["pull_time"] + observation.period
        command = phases.remember(command, pull_time=pull_time)
        return phases.start_release(command) if pull_time > PULL_TIME else command
    follow = min(1.0, 2.0 * observation.period)  # in half a second
    command = phases.remember(command, held=(held + follow * (now - held)).tolist(), pull_time=0.0)
    over = command.memory["phase_time"] >= observation.goal.hold_time
    command = phases.remember(command, speed=0.0)
    return phases.enter_phase(command, "lower") if over else command


def _lower(observation: Observation, command: Command, forces: list[float]) -> Command:
    """Lower the gripper until the table carries the load, within SEARCH of the specified height."""
    command = _regulated(observation, command, forces)
    goal = max(0.0, observation.goal.place_height - SEARCH)
    above = command.lift_height - observation.goal.place_height
    highest = PLACE_SPEED if above < SEARCH else LIFT_SPEED
    speed = _speed_towards(highest, observation, command)
    height = max(goal, command.lift_height - speed * observation.period)
    carried = float(_stored(LoadEstimator, command).vector(observation.touch)[0])
    is_standing = above < SEARCH and stands(carried, float(np.asarray(command.memory["held"])[0]))
    settled_time = command.memory["settled_time"] + observation.period if height == goal else 0.0
    if is_standing:  # the gripper stops here
        height = max(0.0, observation.gripper.lift_height)
    is_sure = is_standing and command.memory["stands"]  # one image may have an error
    command = phases.remember(
        replace(command, lift_height=height),
        settled_time=settled_time,
        stands=is_standing,
        speed=speed,
    )
    is_down = settled_time > SETTLE_TIME  # the lift has followed
    return phases.start_release(command) if is_sure or is_down else command


PHASES = {
    "approach": _approach,
    "close": _approach,
    "regulate": _regulate,
    "lift": _lift,
    "hold": _hold,
    "lower": _lower,
    "release": partial(phases.release, speed=OPENING_SPEED, contact_force=TOUCH_FORCE),
}
