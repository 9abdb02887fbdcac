"""Ground-truth score of a task in all worlds, as `mjtactile.runtime.task_scoring`."""

from __future__ import annotations

import warp as wp

from mjtactile.runtime import task_scoring
from mjtactile.warp.device.grasp_phase import HOLD, LIFT, LOWER, RELEASE

wp.set_module_options({"enable_backward": False})

_RELEASED = wp.constant(task_scoring.RELEASED)
_STANDS = wp.constant(task_scoring.STANDS)


@wp.struct
class TaskState:
    """Disturbances and score of the task in each world.

    `up_since` is the end of the lift, s; negative before. `rise` m is the height of the support
    over its initial one. `taken` is 1 once a pulled object has left the grip. `impact` N s is the
    impulse of the support on the object beyond its weight. `released_at` s is the time of release
    after the lift, `torn` 1 if the grip was not opened.
    """

    up_since: wp.array(dtype=float)
    rise: wp.array(dtype=float)
    taken: wp.array(dtype=int)
    impact: wp.array(dtype=float)
    released_at: wp.array(dtype=float)
    torn: wp.array(dtype=int)


@wp.struct
class Criteria:
    """Success criteria: angle rad, impulse N s, time s, fall m; infinite if not required."""

    max_tilt: float
    max_impact: float
    release_within: float
    max_drop: float


@wp.kernel
def score_task(
    task: TaskState,
    free_bodies: wp.array(dtype=int),
    dofs: wp.array(dtype=int),
    fingers: int,
    timestep: float,
    phase: wp.array(dtype=int),
    gravity: wp.array(dtype=wp.vec3),
    time: wp.array(dtype=float),
    body_mass: wp.array2d(dtype=float),
    constraint: wp.array2d(dtype=float),
    wrench: wp.array2d(dtype=float),
):
    """Add one physics step after the lift to the score: impact on the support, and release.

    Constraints of a rigid object are its contacts with the table and its stand.
    """
    w = wp.tid()
    if task.up_since[w] < 0.0:
        return
    strongest = float(0.0)
    second = float(0.0)
    for k in range(fingers):
        force = -wrench[w * fingers + k, 2]
        second = wp.max(second, wp.min(force, strongest))
        strongest = wp.max(strongest, force)
    if fingers == 1:
        second = strongest
    now = phase[w]
    if not wp.isfinite(task.released_at[w]) and second < _RELEASED:
        task.released_at[w] = time[w] - task.up_since[w]
        task.torn[w] = wp.where(now == LIFT or now == HOLD, 1, 0)
    if now == LOWER or now == RELEASE:
        support = float(0.0)
        mass = float(0.0)
        for b in range(free_bodies.shape[0]):
            support += constraint[w, dofs[b] + 2]
            mass += body_mass[w, free_bodies[b]]
        pressed = wp.max(support - mass * wp.length(gravity[w]), 0.0)
        task.impact[w] += pressed * timestep


@wp.func
def is_failed(
    task: TaskState, criteria: Criteria, pulls: float, up: float, height: float, w: int
) -> bool:
    """Return True if a requirement of the task failed.

    `pulls` is the time of the pull after the lift, s. `up` is the vertical component of the
    object's z axis, `height` m that of its center over its initial one.
    """
    failed = bool(False)
    if wp.isfinite(criteria.release_within):
        late = task.released_at[w] - pulls
        in_time = late >= 0.0 and late <= criteria.release_within
        failed = not in_time or task.torn[w] != 0
    else:
        if wp.isfinite(criteria.max_tilt):
            tilt = wp.acos(wp.clamp(up, -1.0, 1.0))
            failed = tilt > criteria.max_tilt or wp.abs(height - task.rise[w]) > _STANDS
        if task.impact[w] > criteria.max_impact:
            failed = True
    return failed
