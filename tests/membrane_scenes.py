"""Scenes shared by tests of the membrane."""

import mujoco
import numpy as np

from mjtactile.sim.attach import attach_membrane, configure_options
from mjtactile.sim.scenes.world import World


def scene(design, mesh=(13, 11), timestep=8e-3, gravity=(0, 0, 0)):
    """Return a scene with one sensor at rest, fixed to the world."""
    spec = mujoco.MjSpec()
    configure_options(spec, timestep)
    spec.option.gravity = gravity
    spec.worldbody.add_site(name="mount")
    return World(spec, [attach_membrane(spec, design, site="mount", mesh=mesh)])


def settle(world, pressure, speed=1e-6):
    """Open the valve at `pressure` and step until all speeds are below `speed`, m/s."""
    world.sensors[0].open_valve(pressure)
    for _ in range(100):
        world.step(10)
        if np.abs(world.data.qvel).max() < speed:
            return
    raise AssertionError("did not settle")
