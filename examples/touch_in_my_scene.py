"""Touch in an existing scene: the Fetch arm of gymnasium-robotics closes its empty gripper.

One fingertip gets a sensor, which then touches the other finger. Needs `pip install
'mjtactile[examples]'`.
"""

from importlib.util import find_spec

import mujoco

import mjtactile

package = find_spec("gymnasium_robotics").submodule_search_locations[0]
spec = mujoco.MjSpec.from_file(f"{package}/envs/assets/fetch/pick_and_place.xml")
print(*mjtactile.configure_options(spec), sep="\n")  # options that a membrane needs, with reasons

# The site's z points out of the sensor, its x along the longer side; 2 mm before the finger's own
# pad.
spec.body("robot0:r_gripper_finger_link").add_site(
    name="tip", pos=[0.01, -0.017, 0], quat=[1, 1, 0, 0]
)
tip = mjtactile.attach(spec, "dense", site="tip", prefix="tip/", carrier_contact=False)
model = spec.compile()
data = mujoco.MjData(model)
finger = tip.bind(model, data)

data.ctrl[:] = 0.0016  # opening of each finger, m
while data.time < 1.0:
    mjtactile.step(model, data, [finger])
print(f"estimated: {finger.touch.force_normal:.2f} N, chamber at {finger.gauge_pressure:.0f} Pa")
