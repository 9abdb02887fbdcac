# pyright: reportMissingImports=false
"""Touch as an `Observable` of robosuite: the Panda of `Lift` closes until it touches the cube.

Tested with robosuite 1.5.2 (docs/how-to/integrations.md).
"""

from types import SimpleNamespace

import mujoco
import numpy as np
from robosuite.controllers.parts import controller
from robosuite.environments.manipulation.lift import Lift
from robosuite.models.grippers.panda_gripper import PandaGripper
from robosuite.utils import binding_utils
from robosuite.utils.observables import Observable, sensor

import mjtactile

# three names that MuJoCo 4.0 changed after robosuite 1.5.2
binding_utils.MjModel.jnt_type = property(lambda model: model._model.jnt_type.tolist())
binding_utils.MjData.qM = property(lambda data: data._data)
controller.mujoco = SimpleNamespace(mj_fullM=lambda model, M, data: mujoco.mj_fullM(model, data, M))
PandaGripper.speed = 0.05  # fraction of its stroke per action


class TouchLift(Lift):
    def edit_model_xml(self, xml_str):
        spec = mujoco.MjSpec.from_string(super().edit_model_xml(xml_str))
        mjtactile.configure_options(spec, timestep=0.002)  # robosuite's
        for k, side in ((1, 1), (2, -1)):
            body = spec.body(f"gripper0_right_finger_joint{k}_tip")
            body.add_site(name=f"{k}", pos=[0, -0.011 * side, -0.015], quat=[1, side, 0, 0])
        dense = {"sensor": "dense", "carrier_contact": False}  # the pads are in the chambers
        self.mounts = [mjtactile.attach(spec, **dense, site=k, prefix=f"tip{k}/") for k in "12"]
        spec.compile()
        return spec.to_xml()

    def _reset_internal(self):
        super()._reset_internal()
        model, data = self.sim.model._model, self.sim.data._data
        self.fingers = [mount.bind(model, data) for mount in self.mounts]
        self.sim.step = lambda: mjtactile.step(model, data, self.fingers)

    def _setup_observables(self):
        @sensor(modality="touch")
        def force_normal(_):
            return np.array([finger.touch.force_normal for finger in self.fingers])

        force = Observable("force_normal", force_normal, sampling_rate=30)
        return super()._setup_observables() | {"force_normal": force}


env = TouchLift("Panda", has_offscreen_renderer=False, use_camera_obs=False, lite_physics=False)
observation = env.reset()
close = lift = 0.0
while lift < 0.1:
    way = observation["cube_pos"] - observation["robot0_eef_pos"] + [0, 0, 0.012]
    way[2] += lift + 2 * np.hypot(*way[:2])  # descends over the cube
    close = close or float(np.linalg.norm(way) < 4e-3)
    grip = close * float(observation["force_normal"].mean() < 1.0)
    lift += 0.01 * (close - grip)
    observation, *_ = env.step([*np.clip(15 * way, -1, 1), 0, 0, 0, grip if close else -1])
height = observation["cube_pos"][2]
print(f"estimated {observation['force_normal'].round(2)} N, the cube is at {height:.3f} m")
