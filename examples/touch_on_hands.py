"""Fingertips of a Robotiq 2F-85 or of a Shadow Hand grip an object in the air; then it weighs.

The 2F-85 is that of MuJoCo Menagerie (clone its repository), the Shadow Hand that of
gymnasium-robotics (`pip install 'mjtactile[examples]'`):

    python examples/touch_on_hands.py mujoco_menagerie/robotiq_2f85/2f85.xml
    python examples/touch_on_hands.py shadow

It prints the rows of a table in docs/how-to/integrations.md.
"""

import sys
import time
from functools import partial
from importlib.util import find_spec

import mujoco
import numpy as np

import mjtactile

BALL = (mujoco.mjtGeom.mjGEOM_SPHERE, [0.02, 0, 0])
BOX = (mujoco.mjtGeom.mjGEOM_BOX, [0.0125, 0.0125, 0.02])
JOINTS = ("FFJ3", "FFJ2", "FFJ1", "FFJ0", "THJ4", "THJ3", "THJ2", "THJ1", "THJ0")
OPEN = np.array([-0.35, 0.09, 0.54, 0.47, 0.99, 0.99, -0.06, 0.52, -0.19])  # rad
SHUT = np.array([-0.35, 1.0, 0.32, 0.22, 0.73, 1.1, -0.08, 0.52, 0.0])


def robotiq(file):
    """Return the gripper, its sites, and the object's position, m, and quaternion."""
    spec = mujoco.MjSpec.from_file(file)
    for side in ("left", "right"):  # 3 mm in front of the pad; x of the sensor is up the finger
        pad = spec.body(f"{side}_pad")
        pad.add_site(name=side, pos=[0, -0.0096, 0.01875], quat=[0.5, 0.5, -0.5, 0.5])
    return spec, ("left", "right"), [0, 0, 0.152], [1, 0, 1, 0]


def shadow():
    """Return the hand, its sites, and the object's position, m, and quaternion."""
    package = find_spec("gymnasium_robotics").submodule_search_locations[0]
    spec = mujoco.MjSpec.from_file(f"{package}/envs/assets/hand/reach.xml")
    index, thumb = spec.body("robot0:ffdistal"), spec.body("robot0:thdistal")
    index.add_site(name="index", pos=[0, -0.009, 0.015], quat=[0.5, 0.5, -0.5, 0.5])
    thumb.add_site(name="thumb", pos=[-0.011, 0, 0.015], quat=[0.83, 0, -0.55, 0])
    return spec, ("index", "thumb"), [0.9735, 0.836, 0.187], [1, 0, 0, 0]


def move(data, command):
    """Command the 2F-85 (0 to 255) or the Shadow Hand (0: OPEN, its start; 1: SHUT)."""
    if data.model.nu == 1:
        data.ctrl[0] = command
        return
    for joint, angle in zip(JOINTS, OPEN + command * (SHUT - OPEN), strict=True):
        if data.time == 0:
            data.joint(f"robot0:{joint}").qpos = angle
        if joint != "FFJ0":  # a tendon couples it to FFJ1
            data.actuator(f"robot0:A_{joint}").ctrl = angle


def hold(robot, shape, command, effects):
    """Close in 1 s, let gravity act after 1.5 s. Returns forces (fingers, estimated and true), N,
    averaged from 2.5 to 3 s, flags, and the time of a step, ms."""
    spec, sites, position, quaternion = robot()
    mjtactile.configure_options(spec)
    options = {"effects": effects, "carrier_contact": False}
    tips = [mjtactile.attach(spec, "dense", site=s, prefix=f"{s}/", **options) for s in sites]
    body = spec.worldbody.add_body(name="object", pos=position, quat=quaternion, gravcomp=1)
    body.add_freejoint()
    body.add_geom(name="object", type=shape[0], size=shape[1], mass=0.05)
    model = spec.compile()
    data = mujoco.MjData(model)
    move(data, 0.0)
    fingers = [tip.bind(model, data) for tip in tips]
    began, seen = time.process_time(), []
    while data.time < 3.0:
        move(data, command * min(data.time, 1.0))
        model.body_gravcomp[model.body("object").id] = data.time < 1.5
        mjtactile.step(model, data, fingers)
        if data.time > 2.5:
            seen.append([(f.touch.force_normal, -f.ground_truth_wrench()[2]) for f in fingers])
    cost = 1e3 * (time.process_time() - began) * model.opt.timestep / data.time
    return np.mean(seen, axis=0), ", ".join({k for f in fingers for k in f.flags}), cost


if __name__ == "__main__":
    hand = shadow if sys.argv[1] == "shadow" else partial(robotiq, sys.argv[1])
    balls, boxes = ((0.9, 1.0), ()) if hand is shadow else ((126, 132), (115, 118))
    for name, shape, commands in (("ball", BALL, balls), ("box", BOX, boxes)):
        for command in commands:
            for membrane, effects in (("mesh", "auto"), ("quasi-static", "-mesh")):
                force, flags, cost = hold(hand, shape, command, effects)
                error = 100 * (force[:, 0] / force[:, 1] - 1)
                row = [f"{name}, command {command}", membrane, force[:, 1].round(2), error.round(1)]
                print("|", *row, flags or "none", f"{cost:.1f}", sep=" | ")
