"""Two sensors on the fingertips of an existing arm: close on an object, lift it, print the forces.

The scene is the Fetch arm of gymnasium-robotics with its table and its block, which is changed to
an egg. The hand follows a mocap body, the fingers their position servos. Needs `pip install
'mjtactile[examples]'`.
"""

from importlib.util import find_spec

import mujoco
import numpy as np

import mjtactile

package = find_spec("gymnasium_robotics").submodule_search_locations[0]
spec = mujoco.MjSpec.from_file(f"{package}/envs/assets/fetch/pick_and_place.xml")
mjtactile.configure_options(spec)
tips = []
for side, inwards in (("r", -1), ("l", 1)):
    body = spec.body(f"robot0:{side}_gripper_finger_link")
    # z out of the sensor
    body.add_site(name=side, pos=[0.02, 0.017 * inwards, 0], quat=[1, -inwards, 0, 0])
    tips.append(
        mjtactile.attach(spec, "dense", site=side, prefix=f"{side}/", carrier_contact=False)
    )
egg = spec.geom("object0")
egg.type = mujoco.mjtGeom.mjGEOM_ELLIPSOID
egg.size = [0.022, 0.022, 0.028]
egg.mass = 0.05

model = spec.compile()
data = mujoco.MjData(model)
fingers = [tip.bind(model, data) for tip in tips]
# weld of the hand to the mocap body, as in that package's own scripts
model.eq_data[0, :11] = [*[0] * 6, *[1, 0, 0, 0], 1]
for joint, place in {
    "robot0:slide0": 0.405,
    "robot0:slide1": 0.48,
    "object0:joint": [1.25, 0.75, 0.428, 1, 0, 0, 0],
}.items():
    data.joint(joint).qpos = place
# above the egg, pointing down
data.mocap_pos[0] = [1.25, 0.75, 0.55]
data.mocap_quat[0] = [0.5**0.5, 0, 0.5**0.5, 0]
data.ctrl[:] = 0.05


def go(seconds, *, height=None, fingers_at=None):
    """Move hand and fingers at constant speed (positions in m), and print the final forces."""
    before = (data.mocap_pos[0, 2], data.ctrl[0])
    steps = round(seconds / model.opt.timestep)
    goals = [
        new if new is not None else old
        for new, old in zip((height, fingers_at), before, strict=True)
    ]
    for fraction in np.linspace(0, 1, steps):
        data.mocap_pos[0, 2], data.ctrl[:] = before + fraction * (np.array(goals) - before)
        mjtactile.step(model, data, fingers)
    forces = ", ".join(f"{f.name} {f.touch.force_normal:5.2f} N" for f in fingers)
    print(f"{data.time:4.1f} s   egg at {1e3 * data.body('object0').xpos[2]:3.0f} mm   {forces}")


go(0.3)
go(0.3, height=0.45)
go(0.2, fingers_at=0.028)
go(0.4, fingers_at=0.0235)
go(0.2)
go(0.4, height=0.5)
go(0.4)
