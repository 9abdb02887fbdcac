"""Tests of tasks: disturbances act by mechanics, and the required grip force of the scorer is
Coulomb's."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from mjtactile import Scenario, build_rig
from mjtactile.core.errors import InputError
from mjtactile.core.gripper_path import GripperPath, Segment
from mjtactile.core.task import SampledDisturbance, load_task
from mjtactile.core.task_sections import KINDS
from mjtactile.rig.file import load_sim_rig
from mjtactile.rig.simulated import SimLift
from mjtactile.runtime.grasp import run_grasp
from mjtactile.runtime.task_scoring import TaskScorer
from mjtactile.sim import ground_truth
from mjtactile.sim.scenes.disturbances import DisturbanceSchedule
from mjtactile.sim.scenes.grasp_world import GraspWorld
from mjtactile.sim.scenes.initial_state import path_axes
from mjtactile.sim.scenes.objects import load_object, with_liquid

MESH = (11, 9)  # disturbances do not depend on the mesh: use a cheap one
MASS = 0.02  # kg of the vial


def world_with(*events):
    """Return a vial on the table under the open gripper, whose lift counts as finished."""
    world = GraspWorld("paper16", "vial", mesh=MESH)
    happens = DisturbanceSchedule(world, events, 0.0)
    world.after_each_step(happens.step)
    return world


def event(kind, start, duration, direction=(1.0, 0.0, 0.0), **values):
    return SampledDisturbance(kind, start, duration, values, direction)


def advance(world, seconds):
    world.step(round(seconds / world.timestep))


def velocity(world):
    return world.data.cvel[ground_truth.object_bodies(world)[0], 3:].copy()


def test_a_filled_object_presses_on_the_table_with_its_weight():
    world = world_with(event("fill", 0.1, 0.4, mass=0.15))
    bodies = ground_truth.object_bodies(world)
    advance(world, 0.1)
    assert ground_truth.support_force(world, bodies) == pytest.approx(MASS * 9.81, rel=0.01)
    advance(world, 0.6)
    assert ground_truth.support_force(world, bodies) == pytest.approx(
        0.15 * 9.81, rel=0.01
    )  # its contacts settle
    inertia = world.model.body_inertia[bodies[0]]
    assert inertia[2] == pytest.approx(0.5 * 0.15 * 0.011**2, rel=1e-6)  # a cylinder of 22 mm


def test_a_push_changes_momentum_by_its_impulse():
    world = world_with(event("push", 0.02, 0.04, (0.0, 0.0, 1.0), impulse=0.02))
    advance(world, 0.12)
    # upward, off the table: m dv = impulse - weight * time since its start
    flight = world.time - 0.02
    assert MASS * velocity(world)[2] == pytest.approx(0.02 - MASS * 9.81 * flight, abs=8e-4)


def test_a_shaken_gripper_is_simulated_by_gravity_and_restored_afterwards():
    direction = (0.6, 0.0, 0.8)
    world = world_with(event("shake", 0.1, 1.0, direction, acceleration=4.0, rate=2.0, tilt=0.0))
    observed = []
    for _ in range(round(1.3 / world.timestep)):
        world.step()
        observed.append(world.model.opt.gravity.copy())
    off = np.array(observed) - [0, 0, -9.81]
    np.testing.assert_allclose(np.cross(off, direction), 0, atol=1e-12)  # along its direction
    assert 3.6 < np.linalg.norm(off, axis=1).max() <= 4.0
    np.testing.assert_array_equal(world.model.opt.gravity, [0, 0, -9.81])


def test_a_turning_gripper_keeps_the_magnitude_of_gravity():
    world = world_with(event("shake", 0.0, 1.0, acceleration=0.0, rate=2.0, tilt=math.radians(30)))
    advance(world, 0.5)
    gravity = world.model.opt.gravity
    assert np.linalg.norm(gravity) == pytest.approx(9.81)
    assert math.degrees(math.acos(-gravity[2] / 9.81)) == pytest.approx(30, abs=0.1)


def test_the_stand_moves_to_its_goal_with_the_object_on_it():
    world = world_with(event("move_support", 0.0, 0.5, height=0.02))
    before = ground_truth.object_position(world)[2]
    advance(world, 0.8)
    assert ground_truth.object_position(world)[2] - before == pytest.approx(0.02, abs=2e-4)


@pytest.mark.parametrize("effects", [None, "-mesh"])
def test_friction_that_falls_raises_the_required_grip(effects):
    """The required grip is m g / (2 mu) before, half-way and after the ramp, which is linear in
    time. MuJoCo uses the larger coefficient of two geoms, so that of the object is limited."""
    scenario = Scenario(object="vial", effects=effects or "")
    world = build_rig(scenario).scene
    event_ = event("friction", 0.1, 0.4, friction=0.2)
    schedule = DisturbanceSchedule(world, [event_], 0.0)
    before = world.sensors[0].friction
    start = world.time
    for time, friction in ((0.05, before), (0.3, (before + 0.2) / 2), (0.6, 0.2)):
        schedule.step()
        world.data.time = start + time
        schedule.step()
        assert [sensor.friction for sensor in world.sensors] == pytest.approx([friction] * 2)
    surfaces = np.isin(world.model.geom_bodyid, ground_truth.object_bodies(world))
    assert world.model.geom_friction[surfaces, 0].max() <= 0.2 + 1e-9
    scorer = TaskScorer(world, load_task("wet"))
    assert scorer.friction_sum() == pytest.approx(0.4)


def test_water_on_one_side_does_not_change_friction_of_the_other():
    """Only the named contact side has the new coefficient. The object's own coefficient is at most
    that of the wet side, since MuJoCo uses the larger one of a pair."""
    world = build_rig(Scenario(object="vial", effects="-mesh")).scene
    before = world.sensors[0].friction
    wet = replace(event("friction", 0.0, 0.1, friction=0.2), finger=2)
    schedule = DisturbanceSchedule(world, [wet], 0.0)
    schedule.step()
    world.data.time += 0.2
    schedule.step()
    assert [sensor.friction for sensor in world.sensors] == pytest.approx([before, 0.2])
    surfaces = np.isin(world.model.geom_bodyid, ground_truth.object_bodies(world))
    assert world.model.geom_friction[surfaces, 0].max() <= 0.2 + 1e-9


def test_a_second_object_presses_with_its_weight_and_can_fall():
    """The table carries both weights; m g of 20 g and 30 g. Pushed sideways, the second object
    falls."""
    put = event("stack", 0.0, 0.1, added_mass=0.03, size=0.014)
    world = GraspWorld("paper16", "vial", mesh=MESH, stacked=put)
    second = world.second_object
    assert second is not None and second.load == 0.0
    world.after_each_step(DisturbanceSchedule(world, [put], 0.0).step)
    advance(world, 0.5)
    bodies = ground_truth.object_bodies(world)
    weight = (MASS + 0.03) * 9.81
    assert ground_truth.support_force(world, bodies) == pytest.approx(weight, rel=0.01)
    assert second.load == pytest.approx(0.03) and not second.has_fallen
    world.data.joint(world.model.body("second object").jntadr[0]).qvel[1] = 0.8
    advance(world, 0.5)
    assert second.has_fallen and second.load == 0.0


def test_a_liquid_sloshes_with_the_frequency_of_its_container():
    """The first mode of water 30 mm deep in a cylinder of 11 mm radius: sqrt(1.841 g / R), since
    tanh(1.841 h / R) is 1. A free oscillation has it, less an error of the time step below 1 %. The
    table carries the water too: rho pi R^2 h."""
    grasped = with_liquid(load_object("vial"), 0.6)
    world = GraspWorld("paper16", grasped, mesh=MESH, timestep=1e-3)
    liquid = grasped.liquid
    assert liquid is not None
    assert liquid.mass == pytest.approx(1000 * math.pi * 0.011**2 * 0.03, rel=1e-6)
    assert grasped.mass == pytest.approx(MASS + liquid.mass)
    bodies = ground_truth.object_bodies(world)
    advance(world, 0.2)
    weight = grasped.mass * 9.81
    assert ground_truth.support_force(world, bodies) == pytest.approx(weight, rel=0.01)
    joint = world.data.joint("object/liquid x")
    joint.qvel[0] = 0.01
    observed = []
    for _ in range(round(1.0 / world.timestep)):
        world.step()
        observed.append(float(joint.qpos[0]))
    crossings = np.flatnonzero(np.diff(np.sign(observed)) > 0)
    period = float(np.diff(crossings).mean()) * world.timestep
    expected = math.sqrt(9.81 * 1.841 / 0.011)
    assert 2 * math.pi / period == pytest.approx(expected, rel=0.015)
    # scoring takes the position of the container, not of the water
    assert len(ground_truth.solid_bodies(world)) == len(bodies) - 2


@pytest.mark.parametrize("rig", ["sim", "sim_arm", "sim_three_finger"])
def test_the_gripper_follows_the_path_of_the_task(rig):
    """The fingertips move by the waypoint in the frame of the first finger's closing direction.

    They stay where they are while the gripper tilts. The reported height does not contain the path.
    The tolerance is the servos' lag and the arm's deflection.
    """
    segment = Segment(0.02, 0.03, 0.01, math.radians(20), 0.2, 2.0, 0.0)
    path = GripperPath.of([segment])
    world = GraspWorld("paper16", "vial", rig=rig, mesh=MESH, path=path)
    world.set_lift_target(0.05)
    advance(world, 1.2)
    before = fingertips(world)
    height = world.lift_height
    schedule = DisturbanceSchedule(world, [], 0.0, path)
    world.after_each_step(schedule.step)
    advance(world, path.end + 0.2)
    moved = (fingertips(world) - before) @ path_axes(world.start).T
    np.testing.assert_allclose(moved, [0.02, 0.03, 0.01], atol=1e-3)
    assert world.lift_height == pytest.approx(height, abs=1e-3)
    up = world.data.xmat[world.start.gripper].reshape(3, 3) @ [0, 0, 1]
    tilt = math.acos(float(up[2]))
    assert math.degrees(tilt) == pytest.approx(20, abs=0.5)
    assert schedule.due() == math.inf


def test_a_path_to_another_position_has_a_stand_at_its_end():
    """The cup of an egg is at the start and, by the path, at its end; none after a way back."""
    away = GripperPath.of([Segment(0.0, 0.2, 0.0, 0.0, 0.3, 2.0, 0.0)])
    world = GraspWorld("paper16", "egg", mesh=MESH, path=away)
    offset = world.model.body("place/cup").pos - world.model.body("object/cup").pos
    np.testing.assert_allclose(offset, [0.0, 0.2, 0.0] @ path_axes(world.start), atol=1e-9)
    back = GripperPath.of([Segment(0.0, 0.05, 0.0, 0.0, 0.3, 2.0, 0.0)])
    near = GraspWorld("paper16", "egg", mesh=MESH, path=back)
    names = [near.model.body(body).name for body in range(near.model.nbody)]
    assert "object/cup" in names and "place/cup" not in names


def fingertips(world):
    return np.mean([world.data.xpos[sensor.body_id] for sensor in world.sensors], axis=0)


@pytest.mark.parametrize(
    ("rig", "text"), [("none", "does not move sideways"), ("arm", "does not reach a waypoint")]
)
def test_a_rig_that_cannot_follow_the_path_is_refused(rig, text):
    file = load_sim_rig("sim_arm" if rig == "arm" else "sim")
    if rig == "none":
        file = replace(file, lift=SimLift("none"))
    path = GripperPath.of([Segment(1.0, None, None, None, 0.2, 0.5, 0.0)])
    with pytest.raises(InputError) as caught:
        GraspWorld("paper16", "vial", rig=file, mesh=MESH, path=path)
    assert text in str(caught.value) and "\n" not in str(caught.value)


def test_a_rig_without_a_gantry_refuses_a_task_with_waypoints():
    with pytest.raises(InputError, match="does not move sideways, and the task 'carry'"):
        build_rig(Scenario(rig="two_xm430", task="carry"))


@pytest.mark.slow(3)
@pytest.mark.parametrize("task", ["carry", "stack", "slosh"])
def test_adaptive_holds_a_vial_in_the_tasks_with_motion(task):
    """The grip is above the required one, at most six times or the minimum of 0.3 N in the air. The
    vial of `carry` stands at the end of the path."""
    scenario = Scenario(
        task=task, object="vial", controller="adaptive", effects="-mesh,-pipeline", seed=6
    )
    result = run_grasp(scenario)
    assert result.outcome == "held", result.reason
    margin = result.measures["margin_true"]
    assert margin > 1.0 and (margin < 6.0 or result.hold_force_true < 1.1 * 0.3)
    if task == "carry":
        assert result.measures["place_error_mm_true"] < 5.0


def test_every_kind_of_disturbance_acts():
    """Each kind of a task file changes the world; a renamed kind had none once."""
    values = {
        "fill": {"mass": 0.1},
        "friction": {"friction": 0.2},
        "shake": {"acceleration": 3.0, "rate": 3.0},
        "push": {"impulse": 0.02},
        "move_support": {"height": 0.02},
        "pull": {"force": 1.0},
        "stack": {"added_mass": 0.01, "size": 0.01},
    }
    assert set(values) == set(KINDS)
    for kind, own in values.items():
        sampled = event(kind, 0.0, 0.4, **own)
        stacked = sampled if kind == "stack" else None
        world = GraspWorld("paper16", "vial", mesh=MESH, stacked=stacked)
        schedule = DisturbanceSchedule(world, [sampled], 0.0)
        schedule.step()
        before = _inputs(world)
        world.data.time += 0.1
        schedule.step()
        assert not np.array_equal(_inputs(world), before), kind


def _inputs(world):
    model, data = world.model, world.data
    parts = (model.body_mass, model.geom_friction, model.opt.gravity, data.xfrc_applied)
    return np.concatenate(
        [np.ravel(part) for part in (*parts, model.body_pos, model.body_gravcomp)]
    )


def test_a_person_keeps_a_released_object_at_its_position():
    world = world_with(event("pull", 0.0, 0.1, force=1.0))
    before = ground_truth.object_position(world)
    advance(world, 0.5)
    np.testing.assert_allclose(ground_truth.object_position(world), before, atol=1e-3)


def test_an_object_touched_by_one_finger_is_not_pulled_and_remains_released():
    """Two fingers hold an object; one does not, and a released object is not pulled again after a
    touch."""
    happens = DisturbanceSchedule(GraspWorld("paper16", "vial", mesh=MESH), [], 0.0)
    touched = [SimpleNamespace(is_touched=True), SimpleNamespace(is_touched=True)]
    world = happens._world
    same = SimpleNamespace(sensors=touched, data=world.data, model=world.model)
    happens._world = cast(Any, same)
    pull = event("pull", 0.0, 0.5, force=1.2)
    np.testing.assert_allclose(happens._pull(pull, 0.5), [0.6, 0.0, 0.0])
    touched[0].is_touched = False
    weight = [0.0, 0.0, MASS * 9.81]  # weight of a stationary object
    np.testing.assert_allclose(happens._pull(pull, 0.6), weight, atol=1e-9)
    touched[0].is_touched = True
    np.testing.assert_allclose(happens._pull(pull, 1.0), weight, atol=1e-9)


@pytest.mark.parametrize(
    ("phase", "failure"),
    [("release", ""), ("hold", "it was pulled out of the gripper, which did not open")],
)
def test_an_object_that_slides_out_of_a_closed_gripper_is_not_handed_over(
    monkeypatch, phase, failure
):
    scorer = TaskScorer(GraspWorld("paper16", "vial", mesh=MESH), load_task("hand-over"), pulls=0.0)
    monkeypatch.setattr(TaskScorer, "is_up", lambda _: True)
    scorer.after_step_batch([0.4, 0.4], "hold")
    advance(scorer.world, 0.2)
    scorer.after_step_batch([0.0, 0.9], phase)  # an object pressed against one finger is not held
    assert scorer.failure() == failure
    assert scorer.measures()["release_delay_s_true"] == pytest.approx(
        0.2, abs=0.01
    )  # of steps of 3 ms


def test_required_grip_is_coulombs_for_a_centered_grip():
    """The required grip force at the vial's center of mass is m g / (2 mu), independent of the grip
    force.

    It increases with an external pull and with the torque of an off-center load.
    """
    world = GraspWorld("paper16", "vial", mesh=MESH)
    scorer = TaskScorer(world, load_task("lift"))
    assert scorer.need() == 0.0  # no contact
    world.set_finger_target(0.0, 0.5)
    advance(world, 1.6)
    friction = world.sensors[0].design.membrane.friction
    # 0.2 mm between the patches' middles and the centre of mass, patches of 3 mm: 0.2 %
    assert scorer.need() == pytest.approx(MASS * 9.81 / (2 * friction), rel=0.02)
    body = ground_truth.object_bodies(world)[0]
    world.data.xfrc_applied[body, :3] = [0.0, 0.0, -0.3]
    assert scorer.need() == pytest.approx((MASS * 9.81 + 0.3) / (2 * friction), rel=0.02)
    # along the line through both fingers: the normal forces carry it
    world.data.xfrc_applied[body, :3] = [0.3, 0.0, 0.0]
    assert scorer.need() == pytest.approx(MASS * 9.81 / (2 * friction), rel=0.02)
