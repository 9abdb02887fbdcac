"""Grippers of primitives: a four-bar linkage as in the 2F-85, tendon-driven fingers as in the Shadow
Hand."""

import mujoco
import numpy as np

from mjtactile.core.design import load_sensor
from mjtactile.sim import ground_truth
from mjtactile.sim.attach import attach_membrane, configure_options
from mjtactile.sim.scenes.world import World

DENSE = load_sensor("dense")
_LINK = 'type="capsule" size="0.004" mass="0.02" contype="0" conaffinity="0"'
_HINGE = 'type="hinge" axis="0 1 0" damping="0.02" armature="1e-4"'

# finger on the side x > 0; the left one is turned by 180 degrees about z. Drivers and followers are
# 60 mm long, and the pad closes the parallelogram.
_FOUR_BAR = """<body name="{name}" euler="0 0 {turn}">
<body name="{name}driver" pos="0.03 0 0"><joint name="{name}driver" {hinge}/>
 <geom {link} fromto="0 0 0 0 0 0.06"/>
 <body name="{name}pad" pos="0 0 0.06"><joint name="{name}pad" {hinge}/>
  <geom {link} fromto="0 0 0 0.02 0 0"/><site name="{name}s" pos="0 0 0.02" zaxis="-1 0 0"/>
 </body></body>
<body name="{name}follower" pos="0.05 0 0"><joint name="{name}follower" {hinge}/>
 <geom {link} fromto="0 0 0 0 0 0.06"/></body></body>"""

TWO_FINGERS = (
    "<mujoco><worldbody>"
    + "".join(
        _FOUR_BAR.format(name=name, turn=turn, hinge=_HINGE, link=_LINK)
        for name, turn in (("right", 0), ("left", 180))
    )
    + """</worldbody><equality>
<connect body1="rightpad" body2="rightfollower" anchor="0.02 0 0"/>
<connect body1="leftpad" body2="leftfollower" anchor="0.02 0 0"/>
<joint joint1="rightdriver" joint2="leftdriver"/></equality>
<actuator><position name="close" joint="rightdriver" kp="100" kv="2"/></actuator></mujoco>"""
)

_TENDON_FINGER = """<body name="f{n}" euler="0 0 {turn}">
<body name="f{n}proximal" pos="0.055 0 0"><joint name="f{n}knuckle" stiffness="0.3" {hinge}/>
 <geom {link} fromto="0 0 0 0 0 0.045"/>
 <body name="f{n}distal" pos="0 0 0.045"><joint name="f{n}tip" stiffness="0.6" {hinge}/>
  <geom {link} fromto="0 0 0 0 0 0.03"/><site name="f{n}s" pos="-0.01 0 0.03" zaxis="-1 0 0"/>
 </body></body></body>"""

THREE_FINGERS = (
    "<mujoco><worldbody>"
    + "".join(_TENDON_FINGER.format(n=n, turn=120 * n, hinge=_HINGE, link=_LINK) for n in range(3))
    + "</worldbody><tendon>"
    + "".join(
        f'<fixed name="t{n}"><joint joint="f{n}knuckle" coef="1"/>'
        f'<joint joint="f{n}tip" coef="1"/></fixed>'
        for n in range(3)
    )
    + "</tendon><actuator>"
    + "".join(f'<position name="close{n}" tendon="t{n}" kp="50" kv="1"/>' for n in range(3))
    + "</actuator></mujoco>"
)


def grip(xml, sites, radius, height, goal, effects, mesh=None):
    """Close a gripper on a free ball, and return the normal force, N, of each sensor.

    Args:
        xml: Gripper.
        sites: Site of each sensor.
        radius: Radius of the ball, m.
        height: Height of its center, m.
        goal: Command of all actuators, rad.
        effects: Of `attach_membrane`.
        mesh: Vertices of the membrane; None: the default.
    """
    spec = mujoco.MjSpec.from_string(xml)
    configure_options(spec, 4e-3)
    spec.option.gravity = [0.0, 0.0, 0.0]
    ball = spec.worldbody.add_body(name="ball", pos=[0, 0, height])
    ball.add_freejoint()
    ball.add_geom(name="ball", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], mass=0.05)
    attached = [
        attach_membrane(
            spec, DENSE, site=spec.site(name), prefix=f"{name}/", effects=effects, mesh=mesh
        )
        for name in sites
    ]
    world = World(spec, attached)
    for sensor in world.sensors:
        sensor.open_valve(1000.0)
    world.step(50)
    for sensor in world.sensors:
        sensor.close_valve()
    for part in np.linspace(0.0, 1.0, 100):
        for actuator in range(world.model.nu):
            world.set_control(actuator, float(part * goal))
        world.step(2)
    world.step(150)
    return [-float(ground_truth.contact_force(world, k)[2]) for k in range(len(sites))], world
