"""Tests of the flag for forces with a wide interval. Light touches, taps and unknown forces do not
raise it, and no controller reacts to it."""

import math
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

import mjtactile
from mjtactile.core.flags import FLAGS
from mjtactile.experiments.indentation import IndentationPlan, Indenter, press
from mjtactile.explore.stage import SimulatedStage
from mjtactile.gym.env import GraspEnv
from mjtactile.runtime import uncertain_force_monitor
from mjtactile.runtime.uncertain_force_monitor import KIND, UncertainForceMonitor

PERIOD = 1 / 30


def held(watch, force, sd, seconds=1.0):
    """Return the flags after `seconds` with this force and standard deviation on the left."""
    for _ in range(round(seconds / PERIOD)):
        watch.time += PERIOD
        touching = bool(force > 0.02)
        left = SimpleNamespace(force_normal=force, force_normal_sd=sd, touching=touching)
        right = SimpleNamespace(force_normal=0.5, force_normal_sd=0.02, touching=True)
        watch.on_touches(watch.time, (left, right))
    return watch.flags


@pytest.fixture
def watch():
    monitor = UncertainForceMonitor(("left", "right"))
    monitor.time = 0.0
    held(monitor, 0.0, 0.03)  # the least detectable force of the left sensor
    return monitor


@pytest.mark.parametrize(
    ("force", "sd", "seconds"),
    [
        (1.0, 0.24, 1.0),  # below a quarter
        (0.14, 0.10, 1.0),  # 4.7 times the least detectable force: a light touch
        (1.0, 0.4, 0.1),  # a tap
        (math.nan, math.nan, 1.0),
    ],
)
def test_usual_forces_raise_no_flag(watch, force, sd, seconds):
    assert not held(watch, force, sd, seconds)


def test_a_wide_interval_is_flagged_with_its_values(watch):
    flags = held(watch, 1.0, 0.26)
    assert set(flags) == {KIND}
    assert KIND in FLAGS
    assert "left measures 1 N with a standard deviation of 0.26 N, 26 %" in flags[KIND]
    # 1 s of touch after 1 s without; the flag is raised after 0.2 s, and the next cycle clears it
    assert held(watch, 0.5, 0.01)[KIND].first == pytest.approx(2.2 - 1.0 + PERIOD, abs=0.07)
    assert watch.flags[KIND].last == pytest.approx(2.0, abs=0.07)


# a threshold of 0 flags each touch: the commands stay the same, bit for bit
def test_the_flag_changes_no_command(monkeypatch):
    commands = []
    for fraction in (math.inf, 0.0):
        monkeypatch.setattr(uncertain_force_monitor, "_SD_FRACTION", fraction)
        sent = []
        with mjtactile.open_session(mjtactile.Scenario(effects="-mesh,-pipeline")) as session:
            session.take_references()
            controller = mjtactile.load_controller("adaptive")
            session.run(
                controller,
                time_limit=60.0,
                on_cycle=lambda cycle, sent=sent: sent.append(cycle.sent),
            )
            assert (KIND in session.flags) == (fraction == 0)
        commands.append([[c.opening, c.lift_height, c.force_limit or 0.0] for c in sent])
    assert len(commands[0]) > 30
    np.testing.assert_array_equal(*commands)


def stepwise():
    """Close on the egg in a loop of the caller's own."""
    with mjtactile.open_session(mjtactile.Scenario(effects="-mesh,-pipeline")) as session:
        session.take_references()
        with session.steps() as steps:
            for _ in range(60):
                observed = steps.observe()
                goal = max(observed.command.opening - 1e-3, 0.0)
                steps.send(mjtactile.Command(goal, 1.0))
        return session.flags


def environment():
    env = GraspEnv(effects="-mesh,-pipeline")
    env.reset(seed=0)
    for k in range(45):
        speed = -1.0 if k < 29 else 0.0  # stop at the first contact
        flags = env.step(np.array([speed, 0.0, 0.0]))[4]["flags"]
    env.close()
    return flags


def scene():
    """Rest a ball of 20 g on a sensor for 0.5 s."""
    spec = mujoco.MjSpec()
    mjtactile.configure_options(spec)
    spec.worldbody.add_site(name="tip")
    ball = spec.worldbody.add_body(pos=(0, 0, 0.02))
    ball.add_freejoint()
    ball.add_geom(size=(0.01, 0, 0), mass=0.02)
    mount = mjtactile.attach(spec, "dense", site="tip", effects="-mesh")
    model = spec.compile()
    data = mujoco.MjData(model)
    finger = mount.bind(model, data)
    mjtactile.step(model, data, [finger], round(0.8 / model.opt.timestep))
    return finger.flags


def pressed():
    plan = IndentationPlan(Indenter("sphere", 8e-3), [2e-3])
    return press(mjtactile.load_sensor("dense"), plan, effects=())["flags"]


# a threshold of 0 flags each touch: every way to use a sensor reports it
@pytest.mark.parametrize("use", [stepwise, environment, scene, pressed])
def test_every_loop_reports_the_flag(monkeypatch, use):
    assert KIND not in use()
    monkeypatch.setattr(uncertain_force_monitor, "_SD_FRACTION", 0.0)
    assert KIND in use()


def test_touches_of_the_simulated_stage_are_monitored():
    """A synthetic sensor estimates 1 N with a standard deviation of 0.4 N; images are 0.1 s
    apart."""
    stage: Any = object.__new__(SimulatedStage)
    world = SimpleNamespace(time=0.0, timestep=2e-3, flags={}, turn=lambda *_: None)
    world.drive = lambda depth: None
    touch = SimpleNamespace(force_normal=1.0, force_normal_sd=0.4, touching=True)

    def step(steps):
        world.time += steps * world.timestep

    world.step = step
    stage.world = world
    stage._view = SimpleNamespace(touch=lambda: touch)
    stage._uncertain = UncertainForceMonitor(["sensor"])
    assert len(list(stage._lower(np.eye(3), np.zeros(3)))) > 5
    assert "sensor measures 1 N" in stage.flags[KIND]
