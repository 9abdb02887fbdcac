"""Many steps in one go are the very steps that are done one by one."""

import numpy as np
import pytest

from mjtactile.core.errors import SimulationError
from mjtactile.core.scenario import Scenario
from mjtactile.rig.registry import build_rig


def hand():
    """An egg between inflated films."""
    rig = build_rig(Scenario(object="egg", effects="-sheet,-chain", seed=3))
    world = rig.scene
    for act in (world.open_valve, world.close_valve):
        for sensor in range(2):
            act(sensor)
        world.step(50)
    return rig, world


def test_steps_in_one_go_are_those_one_by_one():
    """Bit for bit, through closing, grip and lift; and what is seen of each step on the way."""
    found = []
    for ahead in (True, False):
        rig, world = hand()
        if not ahead:
            world._ahead = None
        forces = []
        world.after_each_stretch(
            lambda world=world, forces=forces: forces.extend(
                [[s.wrench[2] for s in world.sensors]]
                if world.stretch is None
                else world.stretch[:, :, 2].tolist()
            )
        )
        world.set_finger_target(0.03, 1.0)
        world.step(500)
        world.set_lift_target(0.01)
        world.step(131)
        rig.close()
        found.append((world.data.qpos.copy(), world.data.qvel.copy(), world.time, np.array(forces)))
    (*fast, fast_forces), (*slow, slow_forces) = found
    for ours, theirs in zip(fast, slow, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    # where the scene is looked at, forces are those of after the step
    assert (fast_forces == slow_forces).mean() > 0.99
    assert found[0][3].shape == (631, 2) and found[0][3][-1].max() < -0.9  # N: it is held


def test_what_goes_wrong_ends_it_in_that_step():
    rig, world = hand()
    world.data.qvel[-6:-3] = np.nan
    before = world.step_count
    with pytest.raises(SimulationError, match="not finite"):
        world.step(40)
    assert world.step_count == before + 1
    rig.close()


def test_a_stretch_ends_where_somebody_is_due():
    rig, world = hand()
    dues = iter([world.time + 3.5 * world.timestep, np.inf, np.inf])
    calls = []
    due = [next(dues)]

    def call():
        calls.append(round(world.time / world.timestep))
        due[0] = np.inf

    start = round(world.time / world.timestep)
    world.after_each_stretch(call, lambda: due[0])
    world.step(20)
    assert calls[0] - start == 4 and calls[-1] - start == 20
    rig.close()
