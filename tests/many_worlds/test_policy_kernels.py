"""Kernels of policy and sensing errors, against the CPU's own code."""

import numpy as np
import pytest
from scipy.stats import ks_2samp, spearmanr

from mjtactile.core import policy
from mjtactile.core.design import load_sensor
from mjtactile.core.types import Command, GripperState, Observation, TaskGoal, Touch
from mjtactile.rig.command_limits import CommandLimits
from mjtactile.sim.sensing_error_model import load_errors
from mjtactile.sim.synthetic_touch import SensingErrorSampler

pytest.importorskip("warp")

import warp as wp

from mjtactile.warp.arrays import zeros_of
from mjtactile.warp.device import grasp_phase, sensing_errors
from mjtactile.warp.device.gripper import Goals
from mjtactile.warp.grasp_setup import error_model

pytestmark = pytest.mark.slow(20)  # compiles kernels
WORLDS, PERIOD = 400, 1 / 31  # no whole number of periods in a time limit
GOALS = [TaskGoal(lift_height=0.01, hold_time=0.2, handover=taken) for taken in (False, True)]
LIMITS = CommandLimits(speed=0.05, lift_speed=0.05, force=7.0)


@pytest.fixture(autouse=True)
def on_the_cpu():
    with wp.ScopedDevice("cpu"):
        yield


def limits_of_kernel(goal):
    limits = grasp_phase.TaskLimits()
    limits.lift_height, limits.hold_time = goal.lift_height, goal.hold_time
    limits.handover = int(goal.handover)
    limits.opening_min, limits.opening_max = LIMITS.opening
    limits.speed, limits.force, limits.period = LIMITS.speed, LIMITS.force, PERIOD
    limits.lift_max, limits.lift_speed = LIMITS.lift[1], LIMITS.lift_speed
    return limits


@pytest.mark.parametrize("goal", GOALS, ids=["lift", "hand-over"])
def test_commands_and_phases_follow_command_from_action_through_complete_grasps(goal):
    """The touch is random but persistent, so that all phases occur; forces are known."""
    rng = np.random.default_rng(0)
    commands, goals = zeros_of(grasp_phase.Commands, WORLDS, measured=4), zeros_of(Goals, WORLDS)
    estimates = zeros_of(sensing_errors.Estimates, 2 * WORLDS, wrench=6, slow=6)
    estimates.known.fill_(1)
    measured = np.tile([0.06, 0.0, 0.0, 0.0], (WORLDS, 1)).astype(np.float32)
    commands.opening.fill_(0.06)
    commands.grip_opening.fill_(0.06)
    commands.force.fill_(-1.0)
    last = [Command(0.06, None, 0.0)] * WORLDS
    time = wp.zeros(WORLDS, dtype=float)
    observed = wp.zeros((WORLDS, 30), dtype=float)
    maximum = wp.array(policy.policy_bounds(2).astype(np.float32), dtype=float)
    touching = np.zeros((WORLDS, 2), np.int32)
    phases = set()
    rate = np.geomspace(0.01, 0.3, WORLDS)[:, None]
    for _ in range(120):
        changes = rng.random((WORLDS, 2)) < rate
        touching = np.where(changes, 1 - touching, touching).astype(np.int32)
        estimates.touching.assign(touching.ravel())
        commands.measured.assign(measured)
        actions = np.clip(rng.normal([0, 0, 0.3], 0.7, (WORLDS, 3)), -1.2, 1.2).astype(np.float32)
        actions[:, 0] += [c.phase == "release" for c in last]
        actions[:, 2] -= [2 * (c.phase == "lower") for c in last]
        seen = [observation(touching[w], measured[w], last[w], goal) for w in range(WORLDS)]
        wp.launch(grasp_phase.observe_all, WORLDS, [2, maximum, estimates, commands, observed])
        requested = np.array([policy.policy_observation(item) for item in seen])
        np.testing.assert_allclose(observed.numpy(), requested, atol=1e-5)  # single precision
        wp.launch(
            grasp_phase.command_all,
            WORLDS,
            [
                limits_of_kernel(goal),
                2,
                wp.array(actions, dtype=float),
                estimates,
                commands,
                goals,
                time,
            ],
        )
        last = [
            LIMITS.apply(policy.command_from_action(one, action), before, PERIOD)
            for one, action, before in zip(seen, actions, last, strict=True)
        ]
        found = np.column_stack(
            [commands.opening.numpy(), commands.force.numpy(), commands.lift.numpy()]
        )
        requested = [(c.opening, c.force_limit, c.lift_height) for c in last]
        np.testing.assert_allclose(found, requested, atol=2e-5)  # single precision
        names = np.array(grasp_phase.NAMES)[commands.phase.numpy()]
        assert names.tolist() == [c.phase for c in last]
        phases |= set(names)
        measured[:, 0] = commands.opening.numpy() + rng.normal(0, 1e-4, WORLDS)
        measured[:, 3] = commands.lift.numpy()
    assert phases == set(grasp_phase.NAMES)


def observation(touching, measured, last, goal):
    touches = tuple(
        Touch(0.0, 0.0, 0.0, 0.01, bool(item), traction=None) for item in touching.tolist()
    )
    opening, speed, effort, height = (float(item) for item in measured)
    state = GripperState(opening, speed, effort, height)
    return Observation(0.0, PERIOD, touches, state, (), last, goal)


@pytest.mark.parametrize("load", [0.0, 0.4, 2.0])
def test_the_distribution_of_sensing_errors_is_that_of_the_cpu(load):
    """10^5 samples of each: distributions, persistence and the fraction of unknown touches."""
    errors = load_errors(load_sensor("dense"))
    true = np.array([0.1 * load, -0.05 * load, -load, 1e-3 * load, 0.0, 5e-4 * load])
    count, images, elapsed = 10_000, 10, PERIOD
    model = error_model(errors)
    estimates = zeros_of(sensing_errors.Estimates, count, wrench=6, slow=6)
    estimates.random.assign(np.random.SeedSequence(1).generate_state(count))
    wp.launch(sensing_errors.restart_all, count, [model, estimates])
    wrench = wp.array(np.tile(true, (count, 1)).astype(np.float32), dtype=float)
    device, known = [], []
    for _ in range(images):
        wp.launch(sensing_errors.estimate_all, count, [model, estimates, elapsed, wrench])
        device.append(estimates.wrench.numpy().copy())
        known.append(estimates.known.numpy().copy())
    known = np.array(known, bool)
    rng = np.random.default_rng(2)
    sampler = SensingErrorSampler(errors)
    cpu = []
    for _ in range(count):
        sampler.start(rng)
        cpu.append([sampler.estimated(true, elapsed, rng)[0].copy() for _ in range(images)])
    cpu = np.array(cpu).transpose(1, 0, 2)
    device = np.array(device)
    unknown = float(errors.at(load).unknown)
    sd = np.sqrt(unknown * (1 - unknown) / known.size)
    assert abs((~known).mean() - unknown) <= 5 * sd + 1e-6
    for c in range(6):
        for k in (0, images - 1):
            assert ks_2samp(device[k][known[k], c], cpu[k][:, c]).pvalue > 1e-4  # of 36 tests
        # persistence from the first image to the last; ranks, since the tails are heavy
        sees = known[0] & known[-1]
        here = spearmanr(device[0][sees, c], device[-1][sees, c]).statistic
        there = spearmanr(cpu[0][:, c], cpu[-1][:, c]).statistic
        assert abs(here - there) < 5 * np.sqrt(2 / count)
