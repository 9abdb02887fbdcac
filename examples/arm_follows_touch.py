"""Arm that follows the touch: a wall moves back and forth, and the arm presses on it with 0.3 N.

mink converts the target of the fingertip to joint angles: `pip install mink daqp`.
"""

from pathlib import Path

import mink  # pyright: ignore[reportMissingImports]
import mujoco
import numpy as np

import mjtactile

FILE = str(Path(__file__).parents[1] / "models" / "grippers" / "arm_two_finger.xml")
FORCE_GOAL, GAIN, PERIOD = 0.3, 1.2e-3, 1 / 30  # force, N; gain, m per N and image; period, s
plan = mink.Configuration(mujoco.MjModel.from_xml_path(FILE))  # the arm alone, for its kinematics
plan.update_from_keyframe("home")
tip = plan.get_transform_frame_to_world("left_tip", "site")
task = mink.FrameTask("left_tip", "site", position_cost=1.0, orientation_cost=0.1)

spec = mujoco.MjSpec.from_file(FILE)
mjtactile.configure_options(spec)
mount = mjtactile.attach(spec, "dense", site="left_tip", prefix="left/")
near = tip.translation() + [0.014, 0.0, 0.0]  # z out of the sensor is x of the world here
wall = spec.worldbody.add_body(name="wall", mocap=True, pos=near)
box = mujoco.mjtGeom.mjGEOM_BOX
wall.add_geom(type=box, size=[0.01, 0.05, 0.05], contype=1, conaffinity=1)
model = spec.compile()
data = mujoco.MjData(model)
for k in range(plan.model.njnt):
    data.joint(plan.model.joint(k).name).qpos = plan.q[plan.model.jnt_qposadr[k]]
servos = [plan.model.actuator(k) for k in range(plan.model.nu)]
finger = mount.bind(model, data)
forces, goal = [], tip.translation().copy()
for image in range(150):
    goal[0] += GAIN * np.nan_to_num(FORCE_GOAL - finger.touch.force_normal)  # unknown: stay
    task.set_target(mink.SE3.from_rotation_and_translation(tip.rotation(), goal))
    plan.integrate_inplace(mink.solve_ik(plan, [task], PERIOD, "daqp"), PERIOD)
    for servo in servos:
        data.actuator(servo.name).ctrl = plan.q[plan.model.jnt_qposadr[servo.trnid[0]]]
    data.mocap_pos[0] = near + [3e-3 * np.sin(image * PERIOD), 0.0, 0.0]
    mjtactile.step(model, data, [finger], round(PERIOD / model.opt.timestep))
    forces.append(finger.touch.force_normal)
held = np.array(forces[30:])
print(f"estimated {np.nanmean(held):.2f} +- {np.nanstd(held):.2f} N while the wall moved by 6 mm")
