"""One thin object or face that is driven into a sensor in a user's scene, to a depth, at a
speed."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

import mjtactile
from mjtactile.core.types import Array
from mjtactile.sim.sensor.effect_switches import PHYSICS

_STIFFNESS = 2e5  # stiffness of the drive, N/m: 5 um compliance at 1 N
_MASS = 0.2  # kg
_CLEARANCE = 1e-3  # initial height above first touch, m
_STILL = 1.2  # settling time, s
_STATED = re.compile(r"off by (\d+)%")


@dataclass(frozen=True)
class ThinObject:
    """Indenter.

    Its kind of geom, MuJoCo's sizes, m, its rotation `tilt` about x, rad. `below`, m, is the
    distance of its lowest point below its center. `depth`, m, is the target below first touch.
    """

    kind: str
    size: tuple[float, ...]
    tilt: float
    below: float
    depth: float

    def rotation(self, turn: float) -> Array:
        """Return the rotation (3, 3) in S, with the indenter rotated by `turn` rad about S's z."""
        turned = np.zeros(9)
        tilted = np.zeros(9)
        for matrix, axis, angle in ((turned, "z", turn), (tilted, "x", self.tilt)):
            quaternion = np.zeros(4)
            mujoco.mju_axisAngle2Quat(quaternion, [axis == "x", 0.0, axis == "z"], angle)
            mujoco.mju_quat2Mat(matrix, quaternion)
        return turned.reshape(3, 3) @ tilted.reshape(3, 3)


def _lying(kind: str, radius: float, half: float, depth: float) -> ThinObject:
    return ThinObject(kind, (radius, half, 0.0), np.pi / 2, radius, depth)


def _standing(radius: float, depth: float) -> ThinObject:
    return ThinObject("cylinder", (radius, 5e-3, 0.0), 0.0, 5e-3, depth)


def _square(side: float, depth: float) -> ThinObject:
    return ThinObject("box", (side / 2, side / 2, 5e-3), 0.0, 5e-3, depth)


THIN_OBJECTS = {
    "blade 0.4 x 12 mm": ThinObject("box", (2e-4, 6e-3, 5e-3), 0.0, 5e-3, 2.8e-3),
    "blade 1 x 12 mm": ThinObject("box", (5e-4, 6e-3, 5e-3), 0.0, 5e-3, 2e-3),
    "rod of 1 mm radius": _lying("capsule", 1e-3, 12e-3, 1.3e-3),
    "wire of 0.3 mm radius": _lying("cylinder", 3e-4, 10e-3, 1.5e-3),
    "wire of 0.6 mm radius": _lying("cylinder", 6e-4, 10e-3, 1.5e-3),
    "pin of 0.5 mm radius": _standing(5e-4, 1.5e-3),
    "pin of 1 mm radius": _standing(1e-3, 1.5e-3),
    "pin of 1.5 mm radius": _standing(1.5e-3, 1.5e-3),
}
FACES = {
    "square of 6 mm": _square(6e-3, 1e-3),
    "square of 12 mm": _square(12e-3, 1.5e-3),
    "disc of 6 mm": _standing(3e-3, 1e-3),
    "disc of 10 mm": _standing(5e-3, 1.5e-3),
}


@dataclass(frozen=True)
class Pressed:
    """Result of a load: the true force along its direction, N, and the finger's flags."""

    force: float
    flags: dict[str, str]

    @property
    def stated(self) -> float:
        """Relative force error stated in the flags."""
        fractions = [int(s) / 100 for text in self.flags.values() for s in _STATED.findall(text)]
        return max(fractions, default=0.0)


def press(
    item: ThinObject,
    at: tuple[float, float],
    speed: float,
    *,
    turn: float = 0.0,
    timestep: float = 4e-3,
    **attaching: Any,
) -> Pressed:
    """Press `body` into `dense` at 1 kPa, over the point `at`, rotated by `turn` about z.

    Args:
        item: Indenter.
        at: Position x and y, m, frame S.
        speed: Speed of the drive, m/s.
        turn: Rotation about S's z, before the load, rad.
        timestep: Time step of the scene, s.
        attaching: Further arguments of `mjtactile.attach`.

    Returns:
        The force when it has settled, and the flags.

    Raises:
        InputError: The scene was refused.
        SimulationError: The indenter passed through the membrane.
    """
    spec = mujoco.MjSpec()
    mjtactile.configure_options(spec, timestep)
    spec.option.gravity = [0.0, 0.0, 0.0]
    spec.option.tolerance = 1e-9
    spec.worldbody.add_body(name="base").add_site(name="here")
    carrier = spec.worldbody.add_body(name="carrier", pos=[*at, 0.05])
    carrier.add_joint(name="drive", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1])
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, item.rotation(turn).ravel())
    geom = carrier.add_geom(name="thin", mass=_MASS, quat=quaternion)
    geom.type = getattr(mujoco.mjtGeom, f"mjGEOM_{item.kind.upper()}")
    geom.size = item.size
    drive = spec.add_actuator(name="drive", target="drive", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    drive.set_to_position(kp=_STIFFNESS, kv=2 * np.sqrt(_STIFFNESS * _MASS))
    mount = mjtactile.attach(spec, "dense", site="here", effects=PHYSICS, **attaching)
    model = spec.compile()
    data = mujoco.MjData(model)
    finger = mount.bind(model, data)
    joint = int(model.joint("drive").qposadr[0])
    touch = finger.sensor.height_at(*at) + item.below - 0.05
    start = touch + _CLEARANCE
    data.qpos[joint] = start
    data.ctrl[0] = start
    mujoco.mj_forward(model, data)
    goal = touch - item.depth
    count = max(1, round((start - goal) / (speed * timestep)))
    for height in np.linspace(start, goal, count + 1)[1:]:
        data.ctrl[0] = height
        mjtactile.step(model, data, [finger])
    mjtactile.step(model, data, [finger], nstep=round(_STILL / timestep))
    return Pressed(-float(finger.ground_truth_wrench()[2]), dict(finger.flags))
