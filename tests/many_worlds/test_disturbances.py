"""Disturbances of the worlds on a device against those of the simulated rig, without stepping."""

import mujoco
import numpy as np
import pytest

from mjtactile.core.scenario import Scenario
from mjtactile.core.task import load_task
from mjtactile.sim.rig import build_sim_rig

pytest.importorskip("mujoco_warp")

import warp as wp

from mjtactile.warp.grasp_setup import TASKS
from mjtactile.warp.grasps import Grasps

pytestmark = pytest.mark.slow(15)  # compiles kernels
WORLDS, SEED = 2, 60
TIMES = (0.3, 0.9, 1.1, 1.7, 2.3, 3.05, 6.0)  # after the lift, s


@pytest.fixture(autouse=True)
def on_the_cpu():
    with wp.ScopedDevice("cpu"):
        yield


def on_the_rig(seed, task):
    """Yield gravity, mass, force, membrane and object friction at `TIMES` in the rig's world."""
    rig = build_sim_rig(Scenario(object="egg", task=task, seed=seed, effects="-mesh,-pipeline"))
    world = rig.scene
    body, geom = world.model.body("object/object").id, world.model.geom("object/shell").id
    world.data.qpos[0] = load_task(task).goal.lift_height
    mujoco.mj_kinematics(world.model, world.data)
    for time in (0.0, *TIMES):
        world.data.time = time
        for call in world._after_step_batch:
            if call.__qualname__ == "DisturbanceSchedule.step":
                call()
        yield (
            *world.model.opt.gravity,
            world.model.body_mass[body],
            *world.data.xfrc_applied[body, :3],
            *(sensor.friction for sensor in world.sensors),
            world.model.geom_friction[geom, 0],
            world.model.body_pos[world.model.body("table/table").id, 2],
        )
    rig.close()


@pytest.mark.parametrize("task", TASKS)
def test_disturbances_are_those_of_the_rig(task):
    """Single precision: 1e-5 of values of up to 20."""
    many = Grasps(Scenario(object="egg", task=task), WORLDS, rewards={}, device="cpu")
    many.reset(SEED)
    body = many.model.body("object/object").id
    geom = many.model.geom("object/shell").id
    table = many.model.geom("table/table").id
    m, d = many._m, many._d
    qpos = d.qpos.numpy().copy()
    qpos[:, 0] = many._limits.lift_height
    d.qpos.assign(qpos)
    expected = [list(on_the_rig(SEED + world, task)) for world in range(WORLDS)]
    changes = []
    for k, time in enumerate((0.0, *TIMES)):
        d.time.fill_(time)
        if not many._is_plain:
            many._disturb()
        found = np.column_stack(
            [
                m.opt.gravity.numpy(),
                m.body_mass.numpy()[:, body],
                d.xfrc_applied.numpy()[:, body, :3],
                many.touch.friction.numpy(),
                m.geom_friction.numpy()[:, geom, 0],
                d.geom_xpos.numpy()[:, table, 2] - m.geom_pos.numpy()[:, table, 2],
            ]
        )
        np.testing.assert_allclose(found, [rows[k] for rows in expected], atol=2e-4, rtol=1e-5)
        changes.append(found)
    assert bool(np.ptp(changes, axis=0).any()) == (task not in ("lift", "weigh"))
    many.rig.close()
