"""Estimate the unknown angle of an edge, rotate it into line with the finger, and estimate it
again."""

import mujoco
import numpy as np

import mjtactile

SCENE = """<mujoco><worldbody><site name="tip"/>
  <body pos="0 0 0.02" gravcomp="1">
    <joint name="down" type="slide" axis="0 0 1"/><joint name="turn" axis="0 0 1"/>
    <geom type="box" size="0.025 0.007 0.007" euler="45 0 0" mass="0.2"/></body>
</worldbody><actuator><position joint="down" kp="20000" kv="120"/>
  <position joint="turn" kp="5" kv="0.05"/></actuator></mujoco>"""
spec = mujoco.MjSpec.from_string(SCENE)
mjtactile.configure_options(spec)
tip = mjtactile.attach(spec, "dense", site="tip", prefix="tip/", mesh=(21, 16))
model = spec.compile()
data = mujoco.MjData(model)
finger = tip.bind(model, data)


def press(angle: float, height: float = 0.0113) -> mjtactile.ContactShape:
    """Lift, rotate the block, lower it onto the membrane, and return the contact shape."""
    for lift, wait in ((0.02, 0.2), (height, 0.4)):
        data.ctrl[:] = lift - 0.02, angle
        end = data.time + wait
        while data.time < end:
            mjtactile.step(model, data, [finger])
    return finger.shape


angle = 0.5  # rad, unknown to the finger
before = press(angle)
angle -= (before.direction + np.pi / 2) % np.pi - np.pi / 2  # an edge has no front
after = press(angle)
print(f"estimated: {before.kind} at {np.degrees(before.direction):.0f} deg")
print(f"turned back: {after.kind} at {np.degrees(after.direction):.0f} deg")
print(f"of its own {np.degrees(0.5):.0f} deg, {np.degrees(angle):.1f} are left")
