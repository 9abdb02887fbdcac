"""The same grasp with rigid pads in place of membranes, with and without MuJoCo's `touch_grid`.

It gives the cost of soft membranes.
"""

from __future__ import annotations

import mujoco
import numpy as np

from mjtactile.core import resources
from mjtactile.core.design import SensorDesign
from mjtactile.sim.attach import configure_options
from mjtactile.sim.scenes.objects import add_object, load_object
from mjtactile.sim.scenes.world import World

SITES = ("left_fingertip", "right_fingertip")  # sites of the shipped gripper
_GRID = (9, 9)  # taxels, as many as the dense sensor has markers
TOUCH_GRID = "mujoco.sensor.touch_grid"


def scene(
    design: SensorDesign, grasped: str, timestep: float, *, touch_grid: bool
) -> mujoco.MjSpec:
    """Build gripper, table and object of a grasp with a rigid pad, as large as the membrane, on
    each finger.

    The solver is Newton with an elliptic cone, as MuJoCo's manual recommends for grasping rigid
    objects.
    """
    spec = mujoco.MjSpec.from_file(str(resources.find("two_finger", "models/grippers", ".xml")))
    configure_options(spec, timestep)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    item = load_object(grasped)
    spec.body("hand").pos = [0.0, 0.0, item.grasp_height]
    for name in SITES:
        _add_pad(spec, name, design)
    table = spec.worldbody.add_body(name="table")
    table.add_geom(
        name="table",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[0, 0, -0.01],
        size=[0.2, 0.2, 0.01],
        friction=[0.3, 0.005, 0.0001],
    )
    add_object(spec, item)
    return _with_touch_grids(spec) if touch_grid else spec


def hold(
    design: SensorDesign, grasped: str, timestep: float, force: float, *, touch_grid: bool = False
) -> World:
    """Simulate the object between rigid pads that press with `force` N, lifted by 10 mm."""
    world = World(scene(design, grasped, timestep, touch_grid=touch_grid), [])
    jaw, lift = (world.model.actuator(name).id for name in ("jaw", "lift"))
    for joint in ("left_jaw", "right_jaw"):
        world.data.qpos[world.model.joint(joint).qposadr[0]] = 0.025
    world.model.actuator_forcerange[jaw] = (-force, force)
    world.set_control(jaw, 0.01)
    world.step(round(1.0 / timestep))
    for height in np.linspace(0, 0.01, round(0.2 / timestep)):
        world.set_control(lift, height)
        world.step()
    return world


def _add_pad(spec: mujoco.MjSpec, site_name: str, design: SensorDesign) -> None:
    half = (design.frame.length / 2, design.frame.width / 2, 0.002)
    child = mujoco.MjSpec()
    pad = child.worldbody.add_body(name="pad")
    pad.add_geom(
        name="pad",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=[0, 0, -half[2]],
        size=half,
        mass=0.05,
        priority=1,
        friction=[design.membrane.friction, 0.005, 0.0001],
        contype=0,
        conaffinity=1,
    )
    # touch_grid faces -z of its site
    pad.add_site(name="viewpoint", pos=[0, 0, -0.02], quat=[0, 1, 0, 0])
    spec.attach(child, site=site_name, prefix=f"{site_name}/")


def _with_touch_grids(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """Return the scene with a `touch_grid` sensor at each fingertip.

    The sensors are added as XML: added to a spec, the plugin crashes MuJoCo 4.0.
    """
    sensors = "".join(
        f'''<plugin name="{name}_touch" plugin="{TOUCH_GRID}"
                objtype="site" objname="{name}/viewpoint">
        <config key="size" value="{_GRID[0]} {_GRID[1]}"/><config key="fov" value="45 45"/>
        <config key="gamma" value="0"/><config key="nchannel" value="3"/></plugin>'''
        for name in SITES
    )
    head, _, body = spec.to_xml().partition("<worldbody>")
    body = body.replace("</mujoco>", f"<sensor>{sensors}</sensor></mujoco>")
    return mujoco.MjSpec.from_string(
        f'{head}<extension><plugin plugin="{TOUCH_GRID}"/></extension><worldbody>{body}'
    )


def bare_step(world: World) -> None:
    """Step MuJoCo alone, without sensor updates and checks."""
    mujoco.mj_step(world.model, world.data)
