"""Start of new grasps in the worlds of a mask."""

from __future__ import annotations

import warp as wp

from mjtactile.warp.device.grasp_phase import APPROACH, Commands, measure
from mjtactile.warp.device.grasp_score import Scores
from mjtactile.warp.device.gripper import Drive, Goals, limit_force
from mjtactile.warp.device.sensing_errors import ErrorModel, Estimates, restart_errors
from mjtactile.warp.device.task_score import TaskState

wp.set_module_options({"enable_backward": False})


@wp.struct
class Objects:
    """Objects of a batch, K of them, with the geoms and free bodies of `Starts`.

    Geoms (K, geoms): `size`, `pos`, `quat` and `rbound` of MuJoCo, bounding box `box` (K, geoms, 2)
    and `mesh`, its number or -1. Bodies (K, bodies): `mass`, `inertia`, `ipos`, `iquat`, inverse
    weight `lightness`, and `diagonal` (K, bodies, 6) of the mass matrix. `rise` (K,) m is added to
    the height of the gripper.
    """

    size: wp.array2d(dtype=wp.vec3)
    pos: wp.array2d(dtype=wp.vec3)
    quat: wp.array2d(dtype=wp.quat)
    rbound: wp.array2d(dtype=float)
    box: wp.array3d(dtype=wp.vec3)
    mesh: wp.array2d(dtype=int)
    mass: wp.array2d(dtype=float)
    inertia: wp.array2d(dtype=wp.vec3)
    ipos: wp.array2d(dtype=wp.vec3)
    iquat: wp.array2d(dtype=wp.quat)
    lightness: wp.array2d(dtype=wp.vec2)
    diagonal: wp.array3d(dtype=float)
    rise: wp.array(dtype=float)


@wp.struct
class Starts:
    """Initial states; entry e of world w is row (w + e * worlds) % rows of the others.

    `qpos` (nq,) and `ctrl` (nu,) are common. `free` (rows, bodies, 7) and `fixed` (rows, bodies, 7)
    are poses of the object's bodies, those with a free joint at `address` in qpos and `dof` in
    qvel. `kind` is the number of the object in `objects`. Relative to it are `scale`, its size,
    `mass`, `friction` (rows, 1 + fingers) of its geoms and of each membrane, and `modulus` (rows,
    fingers) of the membranes. `volume` (rows, fingers) are their rest volumes, m^3. `break_force`
    is in N. `pulls` (rows,) is the time of a pull after the lift, s. `rig` (rows, 5): delay,
    jitter, play, speed, force noise. `episode` (worlds,) counts; `row` (worlds,) is the present
    one. `fixed_geoms` are the geoms of the fixed bodies, which are the object's and the table.
    """

    objects: Objects
    kind: wp.array(dtype=int)
    dof: wp.array(dtype=int)

    qpos: wp.array(dtype=float)
    ctrl: wp.array(dtype=float)
    opening: float
    force: float
    free_bodies: wp.array(dtype=int)
    address: wp.array(dtype=int)
    fixed_bodies: wp.array(dtype=int)
    fixed_geoms: wp.array(dtype=int)
    geoms: wp.array(dtype=int)
    free: wp.array3d(dtype=float)
    fixed: wp.array3d(dtype=float)
    scale: wp.array(dtype=float)
    mass: wp.array(dtype=float)
    friction: wp.array2d(dtype=float)
    modulus: wp.array2d(dtype=float)
    volume: wp.array2d(dtype=float)
    break_force: wp.array(dtype=float)
    rest_height: wp.array(dtype=float)
    pulls: wp.array(dtype=float)
    rig: wp.array2d(dtype=float)
    episode: wp.array(dtype=int)
    row: wp.array(dtype=int)


@wp.struct
class Scene:
    """Fields of MuJoCo Warp's model that differ between worlds, and compiled values.

    `friction` (geoms,), `membrane_friction` and `height`, m, of the body `gripper` are the compiled
    ones. `diagonal` (worlds, nv) is that of the mass matrix.
    """

    body_pos: wp.array2d(dtype=wp.vec3)
    body_quat: wp.array2d(dtype=wp.quat)
    body_ipos: wp.array2d(dtype=wp.vec3)
    body_iquat: wp.array2d(dtype=wp.quat)
    body_mass: wp.array2d(dtype=float)
    body_subtreemass: wp.array2d(dtype=float)
    body_inertia: wp.array2d(dtype=wp.vec3)
    body_invweight0: wp.array2d(dtype=wp.vec2)
    geom_size: wp.array2d(dtype=wp.vec3)
    geom_pos: wp.array2d(dtype=wp.vec3)
    geom_quat: wp.array2d(dtype=wp.quat)
    geom_rbound: wp.array2d(dtype=float)
    geom_aabb: wp.array3d(dtype=wp.vec3)
    geom_dataid: wp.array2d(dtype=int)
    geom_friction: wp.array2d(dtype=wp.vec3)
    diagonal: wp.array2d(dtype=float)
    body_of: wp.array(dtype=int)
    friction: wp.array(dtype=wp.vec3)
    membrane_friction: float
    gripper: int
    height: float


@wp.struct
class Poses:
    """Poses in MuJoCo Warp's data. It computes those of geoms that are fixed to the world once."""

    xpos: wp.array2d(dtype=wp.vec3)
    xquat: wp.array2d(dtype=wp.quat)
    xmat: wp.array2d(dtype=wp.mat33)
    xipos: wp.array2d(dtype=wp.vec3)
    geom_xpos: wp.array2d(dtype=wp.vec3)
    geom_xmat: wp.array2d(dtype=wp.mat33)


@wp.func
def _matrix(q: wp.quat) -> wp.mat33:
    """Return the rotation of a quaternion in MuJoCo's order, w x y z."""
    return wp.quat_to_matrix(wp.quat(q[1], q[2], q[3], q[0]))


@wp.func
def place_fixed(starts: Starts, scene: Scene, poses: Poses, w: int, row: int, rise: float) -> None:
    """Write the poses of the fixed bodies and their geoms, all raised by `rise` m."""
    for b in range(starts.fixed_bodies.shape[0]):
        body = starts.fixed_bodies[b]
        x = starts.fixed[row, b, 0]
        y = starts.fixed[row, b, 1]
        p = wp.vec3(x, y, starts.fixed[row, b, 2] + rise)
        q = wp.quat(
            starts.fixed[row, b, 3],
            starts.fixed[row, b, 4],
            starts.fixed[row, b, 5],
            starts.fixed[row, b, 6],
        )
        R = _matrix(q)
        scene.body_pos[w, body] = p
        scene.body_quat[w, body] = q
        poses.xpos[w, body] = p
        poses.xquat[w, body] = q
        poses.xmat[w, body] = R
        poses.xipos[w, body] = p + R @ scene.body_ipos[w, body]
        for g in range(starts.fixed_geoms.shape[0]):
            geom = starts.fixed_geoms[g]
            if scene.body_of[geom] == body:
                poses.geom_xpos[w, geom] = p + R @ scene.geom_pos[w, geom]
                poses.geom_xmat[w, geom] = R @ _matrix(scene.geom_quat[w, geom])


@wp.func
def _place(starts: Starts, qpos: wp.array2d(dtype=float), w: int, row: int) -> None:
    for k in range(qpos.shape[1]):
        qpos[w, k] = starts.qpos[k]
    for b in range(starts.free_bodies.shape[0]):
        for c in range(7):
            qpos[w, starts.address[b] + c] = starts.free[row, b, c]


@wp.func
def _change(starts: Starts, scene: Scene, w: int, row: int) -> None:
    """Set the world's object, with size, mass and friction, and the gripper's height."""
    s = starts.scale[row]
    k = starts.kind[row]
    by = starts.mass[row] * s * s * s
    for b in range(starts.free_bodies.shape[0]):
        body = starts.free_bodies[b]
        mass = by * starts.objects.mass[k, b]
        scene.body_mass[w, body] = mass
        scene.body_subtreemass[w, body] = mass
        scene.body_inertia[w, body] = by * s * s * starts.objects.inertia[k, b]
        scene.body_ipos[w, body] = s * starts.objects.ipos[k, b]
        scene.body_iquat[w, body] = starts.objects.iquat[k, b]
        light = starts.objects.lightness[k, b]
        scene.body_invweight0[w, body] = wp.vec2(light[0] / by, light[1] / (by * s * s))
        for c in range(3):
            dof = starts.dof[b] + c
            scene.diagonal[w, dof] = by * starts.objects.diagonal[k, b, c]
            scene.diagonal[w, dof + 3] = by * s * s * starts.objects.diagonal[k, b, c + 3]
    for g in range(starts.geoms.shape[0]):
        geom = starts.geoms[g]
        scene.geom_size[w, geom] = s * starts.objects.size[k, g]
        scene.geom_pos[w, geom] = s * starts.objects.pos[k, g]
        scene.geom_quat[w, geom] = starts.objects.quat[k, g]
        scene.geom_rbound[w, geom] = s * starts.objects.rbound[k, g]
        scene.geom_dataid[w, geom] = starts.objects.mesh[k, g]
        for c in range(2):
            scene.geom_aabb[w, geom, c] = s * starts.objects.box[k, g, c]
        friction = scene.friction[geom]
        scene.geom_friction[w, geom] = wp.vec3(
            starts.friction[row, 0] * friction[0], friction[1], friction[2]
        )
    p = scene.body_pos[w, scene.gripper]
    p[2] = scene.height + starts.objects.rise[k]
    scene.body_pos[w, scene.gripper] = p


@wp.func
def _clear(scores: Scores, w: int, start: float, opening: float, rest: float, breaks: float):
    scores.counted[w] = 0
    scores.peak_force[w] = 0.0
    scores.break_force[w] = breaks
    scores.crushed[w] = 0
    scores.lost[w] = 0
    scores.fell[w] = 0
    scores.held_steps[w] = 0
    scores.hold_steps[w] = 0
    scores.hold_force[w] = 0.0
    scores.rest_height[w] = rest
    scores.release_height[w] = wp.nan
    scores.has_grip[w] = 0
    scores.slip[w] = 0.0
    scores.rejected[w] = 0
    scores.start[w] = start
    scores.first_opening[w] = wp.max(opening, 1.0e-6)
    scores.progress[w] = 0.0
    scores.outcome[w] = 0


@wp.kernel
def restart_worlds(
    mask: wp.array(dtype=bool),
    fingers: int,
    starts: Starts,
    scene: Scene,
    drive: Drive,
    goals: Goals,
    commands: Commands,
    scores: Scores,
    model: ErrorModel,
    estimates: Estimates,
    membrane_friction: wp.array(dtype=float),
    modulus: wp.array(dtype=float),
    volume: wp.array(dtype=float),
    time: wp.array(dtype=float),
    qpos: wp.array2d(dtype=float),
    qvel: wp.array2d(dtype=float),
    warmstart: wp.array2d(dtype=float),
    ctrl: wp.array2d(dtype=float),
    actuator_force: wp.array2d(dtype=float),
    poses: Poses,
    task: TaskState,
):
    w = wp.tid()
    if not mask[w]:
        return
    row = (w + starts.episode[w] * mask.shape[0]) % starts.scale.shape[0]
    starts.episode[w] += 1
    starts.row[w] = row
    task.up_since[w] = -1.0
    task.rise[w] = 0.0
    task.taken[w] = 0
    task.impact[w] = 0.0
    task.released_at[w] = wp.nan
    task.torn[w] = 0
    _place(starts, qpos, w, row)
    _change(starts, scene, w, row)
    place_fixed(starts, scene, poses, w, row, 0.0)
    for k in range(qvel.shape[1]):
        qvel[w, k] = 0.0
        warmstart[w, k] = 0.0
    for k in range(ctrl.shape[1]):
        ctrl[w, k] = starts.ctrl[k]
        actuator_force[w, k] = 0.0
    time[w] = 0.0
    goals.opening[w] = starts.opening
    goals.opening_target[w] = starts.opening
    goals.lift[w] = 0.0
    goals.lift_target[w] = 0.0
    goals.force[w] = starts.force
    goals.motor[w] = starts.opening
    goals.jaw[w] = starts.opening
    goals.due[w] = -1.0
    goals.next_due[w] = -1.0
    goals.play[w] = starts.rig[row, 2]
    goals.speed[w] = starts.rig[row, 3]
    limit_force(drive, w, starts.force)
    commands.delay[w] = starts.rig[row, 0]
    commands.jitter[w] = starts.rig[row, 1]
    commands.noise[w] = starts.rig[row, 4]
    measure(drive, goals, commands, qpos, qvel, actuator_force, w)
    commands.opening[w] = commands.measured[w, 0]
    commands.force[w] = -1.0
    commands.lift[w] = commands.measured[w, 3]
    commands.phase[w] = APPROACH
    commands.phase_time[w] = 0.0
    commands.lost_time[w] = 0.0
    commands.gone[w] = 0
    commands.grip_opening[w] = commands.measured[w, 0]
    rest = starts.rest_height[row]
    _clear(scores, w, 0.0, commands.measured[w, 0], rest, starts.break_force[row])
    for k in range(fingers):
        f = w * fingers + k
        membrane_friction[f] = scene.membrane_friction * starts.friction[row, 1 + k]
        modulus[f] = starts.modulus[row, k]
        volume[f] = starts.volume[row, k]
        restart_errors(model, estimates, f)


@wp.kernel
def clear_results(
    over: wp.array(dtype=bool),
    reward: wp.array(dtype=float),
    terminated: wp.array(dtype=bool),
    truncated: wp.array(dtype=bool),
):
    """Clear the results of worlds whose action only starts the next episode."""
    world = wp.tid()
    if over[world]:
        reward[world] = 0.0
        terminated[world] = False
        truncated[world] = False


@wp.kernel
def find_over(
    terminated: wp.array(dtype=bool), truncated: wp.array(dtype=bool), over: wp.array(dtype=bool)
):
    world = wp.tid()
    over[world] = terminated[world] or truncated[world]
