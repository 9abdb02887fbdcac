"""Tests that many steps in one call equal single steps."""

import numpy as np
import pytest

from mjtactile.core.errors import SimulationError
from mjtactile.core.scenario import Scenario
from mjtactile.rig.registry import build_rig
from mjtactile.sim import ground_truth


def gripper_rig(task="lift"):
    """Return an egg between inflated membranes."""
    rig = build_rig(Scenario(object="egg", effects="-mesh,-pipeline", seed=3, task=task))
    world = rig.scene
    for sensor in world.sensors:
        sensor.open_valve()
    world.step(50)
    for sensor in world.sensors:
        sensor.close_valve()
    world.step(50)
    return rig, world


def test_many_steps_in_one_call_equal_single_steps():
    """Batched steps equal single steps bit for bit, through closing, grip and lift; so do the
    observations of each step."""
    found = []
    for ahead in (True, False):
        rig, world = gripper_rig()
        if not ahead:
            world._batches = None
        forces = []
        world.after_each_step_batch(
            lambda world=world, forces=forces: forces.extend(
                [[s.wrench[2] for s in world.sensors]]
                if world.batch_forces is None
                else world.batch_forces[:, :, 2].tolist()
            )
        )
        world.set_finger_target(0.03, 1.0)
        world.step(500)
        world.set_lift_target(0.01)
        world.step(131)
        rig.close()
        found.append((world.data.qpos.copy(), world.data.qvel.copy(), world.time, np.array(forces)))
    (*fast, fast_forces), (*slow, slow_forces) = found
    for computed, reference in zip(fast, slow, strict=True):
        np.testing.assert_array_equal(computed, reference)
    # if the scene is read, forces are those after the step
    assert (fast_forces == slow_forces).mean() > 0.99
    # force in N: the object is held
    assert found[0][3].shape == (631, 2) and found[0][3][-1].max() < -0.9


@pytest.mark.parametrize("task", ["bump", "shake"])
def test_disturbances_occur_in_the_same_steps(task):
    """A held egg is lifted, and pushed or shaken from a height or a time: bit-identical to single
    steps."""
    found = []
    for ahead in (True, False):
        rig, world = gripper_rig(task)
        if not ahead:
            world._batches = None
        stretches = []

        def call(world=world, stretches=stretches):
            level = world.model.opt.gravity[:2]
            stretches.append(bool(world.data.xfrc_applied.any() or level.any()))

        world.after_each_step_batch(call)
        world.set_finger_target(0.03, 1.0)
        world.step(500)
        world.set_lift_target(0.05, 0.1)
        world.step(1000)
        rig.close()
        found.append((world.data.qpos.copy(), world.data.qvel.copy(), world.time))
        assert any(stretches)  # it happened
        count = len(stretches)
        assert count < 1000 if ahead else count == 1500
    for computed, reference in zip(*found, strict=True):
        np.testing.assert_array_equal(computed, reference)


def test_a_filled_object_has_the_specified_final_mass():
    """A filled object has the same final mass in batched and single steps; its mass grows in steps
    of a hundredth of a second."""
    masses = []
    for ahead in (True, False):
        rig, world = gripper_rig("pour")
        world._batches = world._batches if ahead else None
        world.set_finger_target(0.03, 3.0)
        world.step(500)
        world.set_lift_target(0.05, 0.1)
        world.step(500)
        bodies = ground_truth.object_bodies(world)
        found = []
        world.after_each_step_batch(lambda: found.append(world.model.body_mass[bodies].sum()))  # noqa: B023
        world.step(1500)
        rig.close()
        masses.append(found)
    fast, slow = masses
    assert fast[-1] == slow[-1] != fast[0] and len(fast) < 500 and len(slow) == 1500
    # a hundredth of a second is five steps, and it ends with the sixth at the latest
    assert np.abs(np.diff(fast)).max() < 6.001 * np.abs(np.diff(slow)).max()


@pytest.mark.parametrize("leak", [0.0, 1e-12])
@pytest.mark.parametrize("ahead", [True, False])
def test_reading_does_not_change_the_state(leak, ahead):
    """Reading the scene does not change a bit of the result.

    This holds for sealed and leaking gas, before and during contact and lift, in batched and single
    steps.
    """
    found = []
    for is_read in (False, True):
        rig, world = gripper_rig()
        for sensor in world.sensors:
            sensor.puncture(leak)
        if not ahead:
            world._batches = None
        world.set_finger_target(0.03, 0.3)
        for stretch in range(45):
            if stretch == 35:
                world.set_lift_target(0.02)
            world.step(13)
            for sensor in world.sensors if is_read else ():
                assert sensor.temperature > 0 and sensor.volume > 0
                assert np.isfinite(sensor.present_wrench()).all() and np.isfinite(sensor.p_SV).all()
                assert isinstance(sensor.flags(), dict) and sensor.gauge_pressure > 0
        membranes = [
            (s.present_wrench(), s.p_SV, s.gauge_pressure, s.slid, s.slides) for s in world.sensors
        ]
        found.append(
            [world.data.qpos.copy(), *(part for membrane in membranes for part in membrane)]
        )
        rig.close()
    for computed, reference in zip(*found, strict=True):
        np.testing.assert_array_equal(computed, reference)
    assert found[0][1][2] < -0.2  # force in N: the object is held


def test_a_failure_ends_the_episode_in_that_step():
    rig, world = gripper_rig()
    world.data.qvel[-6:-3] = np.nan
    before = world.step_count
    with pytest.raises(SimulationError, match="not finite"):
        world.step(40)
    assert world.step_count == before + 1
    rig.close()


def test_steps_in_one_call_end_at_the_next_disturbance():
    rig, world = gripper_rig()
    dues = iter([world.time + 3.5 * world.timestep, np.inf, np.inf])
    calls = []
    due = [next(dues)]

    def call():
        calls.append(round(world.time / world.timestep))
        due[0] = np.inf

    start = round(world.time / world.timestep)
    world.after_each_step_batch(call, lambda: due[0])
    world.step(20)
    assert calls[0] - start == 4 and calls[-1] - start == 20
    rig.close()
