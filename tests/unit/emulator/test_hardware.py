"""Tests of the requests of emulated devices to the world, without a world."""

import contextlib
import math
import os
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from mjtactile.core import platform_support
from mjtactile.core.design import load_sensor
from mjtactile.emulator.faults import Faults
from mjtactile.emulator.hardware import EmulatedHardware
from mjtactile.emulator.options import EmulatorOptions
from mjtactile.emulator.shared_memory import SharedState
from mjtactile.emulator.world import _FALL_SPEED_MAX, EmulatedWorld
from mjtactile.rig.file import load_rig_file
from tests.emulated import servo_bench, wait_for


@pytest.mark.clock
def test_a_lift_without_torque_has_no_goal():
    descriptor = platform_support.memory_file("test")
    shared = SharedState(descriptor)
    os.close(descriptor)
    shared["opening"] = 0.08
    with contextlib.closing(
        EmulatedHardware(load_rig_file("emulated"), shared, Faults())
    ) as hardware:
        lift = hardware.servos[3]
        assert wait_for(lambda: math.isnan(shared["lift_goal"]))
        # 2 rad on a rack of 20 mm
        for address, size, value in ((11, 1, 5), (64, 1, 1), (116, 4, 1304)):
            assert lift.write(address, value.to_bytes(size, "little")) == 0
        # half a tick is 15 um
        assert wait_for(lambda: shared["lift_goal"] == pytest.approx(0.040, abs=2e-5))
        lift.brown_out()
        assert wait_for(lambda: math.isnan(shared["lift_goal"]))
    shared.close()


@pytest.fixture
def world():
    """Provide the emulated world, stepped by hand, without a host."""
    descriptor = platform_support.memory_file("test")
    shared = SharedState(descriptor)
    os.close(descriptor)
    options = EmulatorOptions(load_rig_file("emulated"), load_sensor("paper16"), "egg")
    world = EmulatedWorld(options, shared)
    shared["goal"] = shared["lift_goal"] = math.nan
    yield world
    world.close()


def test_an_untouched_object_does_not_move(world):
    """An egg on its end that leans creeps on, and falls within minutes."""
    joint = world.scene.data.joint(world._object_joint.id)

    def lean(seconds):
        for _ in range(round(seconds / world.scene.timestep)):
            world._step()
        return math.degrees(2 * math.asin(np.linalg.norm(joint.qpos[4:6])))

    half = 0.5 * math.radians(1)
    joint.qpos[3:] = [math.cos(half), math.sin(half), 0, 0]
    world._cached_pose = None
    seated = lean(0.3)
    assert 0.5 < seated < 3 and lean(2.0) == pytest.approx(seated, abs=0.05)


def test_gear_friction_holds_jaws_without_torque(world):
    """Less than the gears' friction (0.05 N) moves them no farther than their slack; more does."""
    moved = []
    for force in (0.02, 0.2):
        opening = world.scene.opening
        for joint in ("left", "right"):
            world.scene.data.joint(f"{joint}_jaw").qfrc_applied[:] = -force
        for _ in range(round(1.0 / world.scene.timestep)):
            world._step()
        moved.append(abs(world.scene.opening - opening))
    assert moved[0] < 2e-4 and moved[1] > 1e-3


@pytest.mark.clock
def test_a_host_that_does_not_read_does_not_block_the_emulator():
    with servo_bench() as bench:
        host = os.open(bench.bus.path, os.O_RDWR | os.O_NOCTTY)
        thread = threading.Thread(target=bench.bus._port.write, args=(bytes(200_000),), daemon=True)
        thread.start()
        thread.join(10.0)
        assert not thread.is_alive()  # excess bytes are lost, as on a wire
        assert not bench.bus.is_busy()
        os.close(host)


def test_without_a_goal_the_lift_falls_freely():
    requested = []
    scene = SimpleNamespace(
        timestep=0.004, set_lift_target=lambda height, speed=None: requested.append((height, speed))
    )
    world = SimpleNamespace(scene=scene, _travel=0.15, _fall_speed=0.0)
    for goal in (0.05, 9.0, *[math.nan] * 5, 0.02, math.nan):
        EmulatedWorld._lift(world, goal)
    falling = [(0.0, pytest.approx(9.81 * 0.004 * n)) for n in range(1, 6)]
    # after holding, the fall restarts
    assert requested == [(0.05, None), (0.15, None), *falling, (0.02, None), falling[0]]
    for _ in range(100):
        EmulatedWorld._lift(world, math.nan)
    assert requested[-1] == (0.0, _FALL_SPEED_MAX)
