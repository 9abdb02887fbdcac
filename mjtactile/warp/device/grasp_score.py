"""Ground-truth score and end of the grasps in all worlds, as `mjtactile.runtime.grasp_scoring`."""

from __future__ import annotations

import warp as wp

from mjtactile.core import policy
from mjtactile.runtime import grasp_scoring
from mjtactile.warp.device.grasp_phase import (
    APPROACH,
    HOLD,
    LIFT,
    LOWER,
    RELEASE,
    Commands,
    TaskLimits,
)
from mjtactile.warp.device.gripper import Drive, height_of
from mjtactile.warp.device.sensing_errors import Estimates
from mjtactile.warp.device.task_score import Criteria, TaskState, is_failed

wp.set_module_options({"enable_backward": False})

RUNNING = wp.constant(0)
HELD = wp.constant(1)
DROPPED = wp.constant(2)
CRUSHED = wp.constant(3)
FAILED = wp.constant(4)
OUTCOMES = ("", "held", "dropped", "crushed", "error")
_RISEN = wp.constant(grasp_scoring.RISEN)
_HELD_FRACTION = wp.constant(grasp_scoring.HELD_FRACTION)
_HELD_SLACK = wp.constant(grasp_scoring.HELD_SLACK)
_LEAD = wp.constant(policy.LEAD)
_CLEAR = wp.constant(policy.CLEAR)


@wp.struct
class Scores:
    """Score of each world's grasp.

    Forces in N, heights and `slip` in m, `time` in s. `counted` is the phase that counts: that of
    the command before the last one. `outcome` is a number of `OUTCOMES`.
    """

    counted: wp.array(dtype=int)
    peak_force: wp.array(dtype=float)
    break_force: wp.array(dtype=float)
    crushed: wp.array(dtype=int)
    lost: wp.array(dtype=int)
    fell: wp.array(dtype=int)
    held_steps: wp.array(dtype=int)
    hold_steps: wp.array(dtype=int)
    hold_force: wp.array(dtype=float)
    rest_height: wp.array(dtype=float)
    release_height: wp.array(dtype=float)
    has_grip: wp.array(dtype=int)
    grip_start: wp.array(dtype=wp.vec3)
    slip: wp.array(dtype=float)
    rejected: wp.array(dtype=int)
    start: wp.array(dtype=float)
    first_opening: wp.array(dtype=float)
    progress: wp.array(dtype=float)
    outcome: wp.array(dtype=int)
    reward: wp.array(dtype=float)
    truncated: wp.array(dtype=bool)
    terminated: wp.array(dtype=bool)


@wp.kernel
def score_step(
    scores: Scores,
    drive: Drive,
    fingers: int,
    grasped: int,
    gripper: int,
    max_drop: float,
    wrench: wp.array2d(dtype=float),
    status: wp.array(dtype=int),
    qpos: wp.array2d(dtype=float),
    xpos: wp.array2d(dtype=wp.vec3),
    xipos: wp.array2d(dtype=wp.vec3),
):
    """Add one physics step to the score."""
    world = wp.tid()
    total = float(0.0)
    peak = float(0.0)
    for k in range(fingers):
        f = world * fingers + k
        force = -wrench[f, 2]
        total += force
        peak = wp.max(peak, force)
        if status[f] > 1:
            scores.rejected[world] += 1
    scores.peak_force[world] = wp.max(scores.peak_force[world], peak)
    if peak > scores.break_force[world]:
        scores.crushed[world] = 1
    phase = scores.counted[world]
    p = xipos[world, grasped]
    if phase == RELEASE:
        if not wp.isfinite(scores.release_height[world]):
            scores.release_height[world] = p[2]
        if scores.release_height[world] - p[2] > max_drop:
            scores.fell[world] = 1
    if phase == LIFT or phase == HOLD:
        relative = p - xpos[world, gripper]
        if scores.has_grip[world] == 0:
            scores.has_grip[world] = 1
            scores.grip_start[world] = relative
        slip = wp.length(relative - scores.grip_start[world])
        scores.slip[world] = wp.max(scores.slip[world], slip)
        lifted = height_of(drive, qpos, world)
        rise = p[2] - scores.rest_height[world]
        risen = int(0)
        if rise > _HELD_FRACTION * lifted - _HELD_SLACK:
            risen = 1
        if lifted > _RISEN and risen == 0:
            scores.lost[world] = 1
        if phase == HOLD:
            scores.hold_force[world] += total / float(fingers)
            scores.hold_steps[world] += 1
            scores.held_steps[world] += risen


@wp.func
def _fraction(
    scores: Scores, limits: TaskLimits, commands: Commands, world: int, phase: int
) -> float:
    """Return the completed fraction of the phase."""
    found = float(0.0)
    raised = commands.measured[world, 3] / limits.lift_height
    if phase == APPROACH:
        found = 1.0 - commands.measured[world, 0] / scores.first_opening[world]
    elif phase == LIFT:
        found = raised
    elif phase == HOLD:
        found = commands.phase_time[world] / wp.max(limits.hold_time, 1.0e-9)
    elif phase == LOWER:
        found = 1.0 - raised
    elif phase == RELEASE:
        ahead = commands.opening[world] - commands.grip_opening[world] + _LEAD
        found = ahead / (_CLEAR + _LEAD)
    return wp.clamp(found, 0.0, 1.0)


@wp.func
def _progress(
    scores: Scores,
    limits: TaskLimits,
    table: wp.array2d(dtype=float),
    estimates: Estimates,
    commands: Commands,
    world: int,
    fingers: int,
) -> float:
    """Return the increase of the grasp progress by the newest step; 0 without a table."""
    phase = commands.phase[world]
    gain = float(0.0)
    if table.shape[0] > 0 and phase < table.shape[0]:
        touches = int(0)
        for k in range(fingers):
            touches += estimates.touching[world * fingers + k]
        counts = touches == fingers or phase <= 1 or phase >= 6
        if phase >= 6 and scores.progress[world] < table[5, 0]:
            counts = False
        if counts:
            fraction = _fraction(scores, limits, commands, world, phase)
            progress = table[phase, 0] + table[phase, 1] * fraction
            gain = wp.max(progress - scores.progress[world], 0.0)
            scores.progress[world] += gain
    return gain


@wp.kernel
def finish_step(
    scores: Scores,
    limits: TaskLimits,
    rewards: wp.array(dtype=float),
    table: wp.array2d(dtype=float),
    time_limit: float,
    fingers: int,
    estimates: Estimates,
    commands: Commands,
    criteria: Criteria,
    task: TaskState,
    row: wp.array(dtype=int),
    pulls: wp.array(dtype=float),
    grasped: int,
    time: wp.array(dtype=float),
    qpos: wp.array2d(dtype=float),
    xquat: wp.array2d(dtype=wp.quat),
    xipos: wp.array2d(dtype=wp.vec3),
):
    """Decide outcome, reward and end after a control step."""
    world = wp.tid()
    phase = commands.phase[world]
    scores.counted[world] = phase
    outcome = int(RUNNING)
    if scores.crushed[world] != 0:
        outcome = CRUSHED
    elif scores.lost[world] != 0 or commands.gone[world] != 0:
        outcome = DROPPED
    elif phase >= 7:
        outcome = DROPPED
        steps = scores.hold_steps[world]
        q = xquat[world, grasped]
        up = 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2])
        height = xipos[world, grasped][2] - scores.rest_height[world]
        failed = is_failed(task, criteria, pulls[row[world]], up, height, world)
        if steps > 0 and scores.held_steps[world] == steps and scores.fell[world] == 0:
            if not failed:
                outcome = HELD
    valid = int(1)
    for k in range(qpos.shape[1]):
        if not wp.isfinite(qpos[world, k]):
            valid = 0
    if valid == 0:
        outcome = FAILED
    late = time[world] - scores.start[world] >= time_limit - limits.period / 2.0
    scores.outcome[world] = outcome
    scores.terminated[world] = outcome >= 1 and outcome <= 3
    scores.truncated[world] = outcome == FAILED or (outcome == RUNNING and late)
    gain = float(0.0)
    if outcome != FAILED:
        gain = _progress(scores, limits, table, estimates, commands, world, fingers)
    scores.reward[world] = rewards[outcome] + gain
