"""Test of snapshots of a world: repeated steps are bit-identical."""

import numpy as np

from mjtactile.sim.fast_reset import Snapshot
from mjtactile.sim.scenes.grasp_world import GraspWorld


def test_a_restored_snapshot_repeats_the_simulation():
    """The scene has contact and history of rubber, gas and friction: one missing state variable
    would change the last digits."""
    world = GraspWorld("dense", "egg", opening=0.045)
    for number in range(2):
        world.sensors[number].open_valve()
    world.step(60)
    for number in range(2):
        world.sensors[number].close_valve()
    world.set_finger_target(0.033, 4.0)
    world.step(120)
    assert world.data.ncon > 10
    kept = Snapshot(world)

    def follow():
        world.set_finger_target(0.031, 3.0)
        world.step(40)
        return np.concatenate(
            [
                world.data.qpos,
                world.data.qvel,
                world.data.sensordata,
                [world.time, world.step_count, *(s.gauge_pressure for s in world.sensors)],
            ]
        )

    first = follow()
    kept.restore()
    np.testing.assert_array_equal(follow(), first)
