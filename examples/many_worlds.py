"""Thousands of grippers on one GPU: each closes on an egg by touch and lifts it.

Needs `pip install 'mjtactile[warp]'`. Without a GPU it runs on the CPU; use few worlds there.
"""

import sys

import mujoco
import mujoco_warp as mjw
import warp as wp

import mjtactile
import mjtactile.warp

GRIPPER = """
<mujoco>
  <worldbody>
    <geom name="table" type="box" size="0.2 0.2 0.01" pos="0 0 -0.01" friction="0.3"/>
    <body name="gripper" pos="0 0 0.023" gravcomp="1">
      <joint name="lift" type="slide" axis="0 0 1" damping="5"/>
      <inertial pos="0 0 0" mass="0.5" diaginertia="1e-3 1e-3 1e-3"/>
      <body name="left" pos="-0.04 0 0" gravcomp="1">
        <joint name="left" type="slide" axis="1 0 0" damping="2" armature="0.05"/>
        <inertial pos="0 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/>
        <site name="left_tip" quat="0.5 0.5 0.5 0.5"/>
      </body>
      <body name="right" pos="0.04 0 0" gravcomp="1">
        <joint name="right" type="slide" axis="-1 0 0" damping="2" armature="0.05"/>
        <inertial pos="0 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/>
        <site name="right_tip" quat="0.5 -0.5 -0.5 0.5"/>
      </body>
    </body>
    <body name="egg" pos="0 0 0.0231">
      <freejoint/><geom type="ellipsoid" size="0.022 0.022 0.023" mass="0.02" friction="0.3"/>
    </body>
  </worldbody>
  <actuator>
    <position name="lift" joint="lift" kp="2000"/>
    <position name="left" joint="left" kp="1000"/><position name="right" joint="right" kp="1000"/>
  </actuator>
</mujoco>
"""
FORCE = 0.6  # goal on each finger, N


@wp.kernel
def close_by_touch(
    wrench: wp.array3d(dtype=float),
    time: wp.array(dtype=float),
    timestep: float,
    ctrl: wp.array2d(dtype=float),
):
    """Move the jaws by the estimated force; lift from 1.4 s on."""
    world = wp.tid()
    force = -0.5 * (wrench[world, 0, 2] + wrench[world, 1, 2])
    speed = wp.clamp(0.01 * (FORCE - force) / 0.3, -0.02, 0.02)
    for jaw in range(2):
        ctrl[world, 1 + jaw] = ctrl[world, 1 + jaw] + speed * timestep
    ctrl[world, 0] = 0.03 * wp.clamp((time[world] - 1.4) / 0.6, 0.0, 1.0)


def grasp(worlds: int, seconds: float):
    """Return forces (worlds, 2), N, and heights of the eggs (worlds,), m, at the end."""
    spec = mujoco.MjSpec.from_string(GRIPPER)
    mjtactile.configure_options(spec, 0.0025)
    tips = [
        mjtactile.attach(spec, "dense", site=f"{side}_tip", prefix=f"{side}/", effects="-mesh")
        for side in ("left", "right")
    ]
    model = spec.compile()
    model.opt.disableflags = 0  # MuJoCo Warp has no `autoreset`
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    m, d = mjw.put_model(model), mjw.put_data(model, data, nworld=worlds, nconmax=32, njmax=96)
    touch = mjtactile.warp.bind(model, m, d, tips)
    timestep = model.opt.timestep

    def step():
        wp.launch(close_by_touch, dim=worlds, inputs=[touch.wrench, d.time, timestep, d.ctrl])
        mjw.step(m, d)

    step()  # compiles; a capture cannot
    with wp.ScopedCapture() as capture:
        step()
    for _ in range(round(seconds / timestep) - 1):
        wp.capture_launch(capture.graph)
    return -touch.wrench.numpy()[:, :, 2], d.qpos.numpy()[:, model.joint(3).qposadr[0] + 2]


if __name__ == "__main__":
    worlds = int(sys.argv[1]) if len(sys.argv) > 1 else 4096 if wp.get_device().is_cuda else 2
    force, height = grasp(worlds, 2.4)
    held = height > 0.04
    print(f"{held.sum()} of {worlds} eggs lifted, by {force[held].mean():.3f} N on each finger")
