"""Many sensors in one scene, in a row, with a ball resting on each or without load."""

from __future__ import annotations

import mujoco

from mjtactile.core.design import SensorDesign
from mjtactile.sim.attach import attach_membrane, configure_options
from mjtactile.sim.scenes.world import World

# distance between two sensors, and initial height of a ball above the frame, m
_GAP = 0.03
_ABOVE = 6e-3


def row_of(
    design: SensorDesign,
    count: int,
    *,
    ball: tuple[float, float] | None,
    gauge: float,
    timestep: float,
    settle: float,
) -> World:
    """Build `count` upward sensors, inflated to `gauge` Pa and sealed.

    On each rests a `ball` (radius m, mass kg), if given. `settle` is the time before the valves
    close, and the time after, s.
    """
    spec = mujoco.MjSpec()
    configure_options(spec, timestep)
    attachments = []
    for k in range(count):
        at = k * (design.frame.length + _GAP)
        base = spec.worldbody.add_body(name=f"base{k}", pos=[at, 0, 0])
        base.add_site(name=f"site{k}")
        attachments.append(attach_membrane(spec, design, site=f"site{k}", prefix=f"s{k}/"))
        if ball is not None:
            body = spec.worldbody.add_body(name=f"ball{k}", pos=[at, 0, ball[0] + _ABOVE])
            body.add_joint(name=f"ball{k}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1])
            body.add_geom(size=[ball[0], 0, 0], mass=ball[1])
    world = World(spec, attachments)
    for sensor in world.sensors:
        sensor.open_valve(gauge)
    world.step(round(settle / timestep))
    for sensor in world.sensors:
        sensor.close_valve()
    world.step(round(settle / timestep))
    return world
