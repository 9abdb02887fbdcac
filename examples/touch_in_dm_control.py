# pyright: reportMissingImports=false
"""Touch as an observable of dm_control's composer: a weight comes to rest on a fingertip.

Tested with dm_control 1.0.50 (docs/how-to/integrations.md).
"""

import mujoco
import numpy as np
from dm_control import composer, mjcf
from dm_control.composer.observation.observable import Generic
from dm_control.mujoco.wrapper.mjbindings import sizes

import mjtactile

# 1.0.50 also requests fields that MuJoCo 4.0 has removed
for struct, have in (("mjmodel", dir(mujoco.MjModel)), ("mjdata", dir(mujoco.MjData))):
    sizes.array_sizes[struct] = {k: v for k, v in sizes.array_sizes[struct].items() if k in have}


class Fingertip(composer.Entity):
    mjcf_model = None

    def _build(self, name):  # the name under which the arena gets it
        spec = mujoco.MjSpec()
        mjtactile.configure_options(spec)
        site = spec.worldbody.add_site(name="tip")
        self.mount = mjtactile.attach(spec, "dense", site=site, prefix=f"{name}/")
        spec.compile()
        self.mjcf_model = mjcf.from_xml_string(spec.to_xml().replace(f'"{name}/', '"'))
        self.mjcf_model.model = name  # dm_control puts it before all names but those in a flex
        [flex] = self.mjcf_model.deformable.flex
        flex.body = f"{name}/{flex.body}"

    def _build_observables(self):
        observables = composer.Observables(self)
        force = Generic(lambda _: np.array(self.finger.touch.force_normal))
        observables.add_observable("force_normal", force)
        return observables

    def after_compile(self, physics, random_state):
        self.finger = self.mount.bind(physics.model.ptr, physics.data.ptr)

    def initialize_episode(self, physics, random_state):
        self.finger.reset()

    def before_substep(self, physics, random_state):
        self.finger.before_step()

    def after_substep(self, physics, random_state):
        self.finger.after_step()


arena = composer.Arena()
arena.mjcf_model.option.noslip_iterations = 0  # a membrane takes none
arena.attach(Fingertip("touch"))
weight = arena.mjcf_model.worldbody.add("body", pos=[0, 0, 0.015])
weight.add("joint", type="slide", axis=[0, 0, 1])
weight.add("geom", size=[0.01], mass=0.05)
task = composer.NullTask(arena)
task.set_timesteps(control_timestep=0.04, physics_timestep=0.004)
env = composer.Environment(task, legacy_step=False)  # each step a whole mj_step
for _ in range(25):
    observation = env.step(np.zeros(0)).observation
print(f"estimated {observation['touch/force_normal'][0]:.2f} N of {9.81 * 0.05:.2f} N")
