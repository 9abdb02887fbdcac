"""Forces and damping on the degrees of freedom of a kinematic tree.

The rules of kernels/qs_joint_forces.c, for one world per thread.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

_FREE, _BALL, _SLIDE = wp.constant(0), wp.constant(1), wp.constant(2)  # joint types of MuJoCo


@wp.struct
class Joints:
    """Kinematic tree of a model, and the damping of its degrees of freedom.

    `free` (bodies,) is the MuJoCo body whose free joint carries a body, or -1. `inertia` (1 or
    worlds, nv) is the diagonal of the mass matrix. `own` is the model's damping, `damping`
    (worlds, nv) that of the present step.
    """

    parent: wp.array(dtype=int)
    count: wp.array(dtype=int)
    first: wp.array(dtype=int)
    kind: wp.array(dtype=int)
    dof: wp.array(dtype=int)
    free: wp.array(dtype=int)
    inertia: wp.array2d(dtype=float)
    own: wp.array(dtype=float)
    damping: wp.array2d(dtype=float)


@wp.struct
class Motion:
    """Poses of bodies and joints in the world frame, and velocities, of all worlds."""

    xpos: wp.array2d(dtype=wp.vec3)
    xmat: wp.array2d(dtype=wp.mat33)
    xanchor: wp.array2d(dtype=wp.vec3)
    xaxis: wp.array2d(dtype=wp.vec3)
    qvel: wp.array2d(dtype=float)


@wp.func
def add_force(
    joints: Joints,
    motion: Motion,
    world: int,
    start: int,
    force: wp.vec3,
    torque: wp.vec3,
    at: wp.vec3,
    out: wp.array2d(dtype=float),
) -> None:
    """Add the generalized force of a force and a torque, world frame, on a body at a point."""
    body = start
    while body > 0:
        for n in range(joints.count[body]):
            j = joints.first[body] + n
            dof = joints.dof[j]
            kind = joints.kind[j]
            origin = motion.xanchor[world, j]
            if kind == _FREE:
                origin = motion.xpos[world, body]
                for c in range(3):
                    out[world, dof + c] = out[world, dof + c] + force[c]
                dof += 3
            torque_k = wp.cross(at - origin, force) + torque
            if kind == _FREE or kind == _BALL:
                local = wp.transpose(motion.xmat[world, body]) @ torque_k
                for c in range(3):
                    out[world, dof + c] = out[world, dof + c] + local[c]
            elif kind == _SLIDE:
                out[world, dof] = out[world, dof] + wp.dot(motion.xaxis[world, j], force)
            else:
                out[world, dof] = out[world, dof] + wp.dot(motion.xaxis[world, j], torque_k)
        body = joints.parent[body]


@wp.func
def add_damping(
    joints: Joints,
    motion: Motion,
    world: int,
    dof: int,
    damping: float,
    out: wp.array2d(dtype=float),
) -> None:
    """Damp one degree of freedom in this step. `out` is the passive force."""
    joints.damping[world, dof] = joints.damping[world, dof] + damping
    out[world, dof] = out[world, dof] - damping * motion.qvel[world, dof]


@wp.func
def damp_parts(
    joints: Joints,
    motion: Motion,
    world: int,
    start: int,
    carried: int,
    stiffness: wp.spatial_vector,
    R: wp.mat33,
    at: wp.vec3,
    fraction: float,
    out: wp.array2d(dtype=float),
) -> None:
    """Damp the joint axes between a body in contact and the body `carried` with the free joint.

    These joints move parts of an object against each other. `fraction` times the stiffness along an
    axis of frame `R` is its damping.
    """
    Rt = wp.transpose(R)
    body = start
    while body > 0 and body != carried:
        for n in range(joints.count[body]):
            j = joints.first[body] + n
            axes = int(1)
            if joints.kind[j] == _BALL:
                axes = 3
            for c in range(axes):
                axis = motion.xaxis[world, j]
                if axes == 3:
                    R_WB = motion.xmat[world, body]
                    axis = wp.vec3(R_WB[0, c], R_WB[1, c], R_WB[2, c])
                along = Rt @ axis
                about = wp.vec3(0.0, 0.0, 0.0)
                if joints.kind[j] != _SLIDE:
                    about = along
                    along = Rt @ wp.cross(axis, at - motion.xanchor[world, j])
                damping = float(0.0)
                for k in range(3):
                    damping += stiffness[k] * along[k] * along[k]
                    damping += stiffness[3 + k] * about[k] * about[k]
                add_damping(joints, motion, world, joints.dof[j] + c, damping * fraction, out)
        body = joints.parent[body]
