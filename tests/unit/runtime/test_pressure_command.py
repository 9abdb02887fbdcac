"""Tests of pressure commands: range, rate, and the effect of failures."""

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from mjtactile.core.errors import DeviceError, InputError
from mjtactile.core.types import Command, ValveState
from mjtactile.rig.command_limits import CommandLimits
from mjtactile.runtime import control_loop
from mjtactile.runtime.supervisor import Supervisor
from tests.stub_rig import BLIND, LAST, OK, PERIOD, World


@pytest.fixture
def supervisor():
    supervisor = Supervisor(PERIOD)
    supervisor.arm(0.0)
    return supervisor


AIR = CommandLimits(pressure=(200.0, 2000.0), pressure_rate=600.0)


@pytest.mark.parametrize(
    ("requested", "last", "period", "sent"),
    [
        ((1500.0, 900.0), (1000.0, 1000.0), 0.05, (1030.0, 970.0)),  # 600 Pa/s
        ((1500.0,), (1000.0,), 0.1, (1045.0,)),  # largest change per image
        ((9000.0, 0.0), (1990.0, 210.0), 0.05, (2000.0, 200.0)),
        (None, (1000.0,), 0.05, None),
    ],
)
def test_commanded_pressure_keeps_range_and_rate(requested, last, period, sent):
    requested = Command(0.05, 1.0, gauge_pressure=requested)
    assert (
        AIR.apply(requested, Command(0.05, 1.0, gauge_pressure=last), period).gauge_pressure == sent
    )


class Chamber:
    """Valve that executes every command immediately."""

    def __init__(self):
        self.commanded = []
        self.pressure = 1000.0

    def state(self):
        return ValveState(
            bool(self.commanded) and self.commanded[-1] is not None, self.pressure, 0.0
        )

    def regulate_pressure(self, pressure):
        self.commanded.append(pressure)
        self.pressure = self.pressure if pressure is None else pressure


def run_air(world, valve, step, limits=AIR):
    rig = world.rig()
    rig = replace(rig, fingers=(replace(rig.fingers[0], valve=valve),), limits=limits)
    controller = SimpleNamespace(path=Path("mine.py"), step=step)
    feels = SimpleNamespace(perceive=lambda image, now, reading=None: OK)
    return control_loop.run_loop(rig, [feels], controller, time_limit=3.0)  # type: ignore[list-item, arg-type]


def test_regulation_starts_at_the_measured_pressure_and_ends_sealed():
    valve = Chamber()
    world = World()
    world.lift = 0.0

    def step(observation):
        calls = round(observation.time * 30)
        return replace(
            observation.command,
            phase="done" if calls == 9 else "hold",
            gauge_pressure=(600.0,) if 2 <= calls < 6 else None,
        )

    run_air(world, valve, step)
    assert valve.commanded == pytest.approx([980.0, 960.0, 940.0, 920.0, None])  # 20 Pa a cycle


@pytest.mark.parametrize(
    ("pressures", "limits", "message"),
    [
        (
            (600.0,),
            CommandLimits(),
            "Command: gauge_pressure: rig 'stub' has no controllable valves",
        ),
        ((600.0, 600.0), AIR, "Command: gauge_pressure: 2 pressures for 1 fingers"),
        ((math.nan,), AIR, "nan is not a finite number"),
    ],
)
def test_unsupported_pressure_commands_are_refused_and_the_gripper_lowers(
    pressures, limits, message
):
    world = World()
    with pytest.raises(InputError, match=message):
        run_air(
            world,
            Chamber(),
            lambda o: replace(o.command, gauge_pressure=pressures) if o.time > 0.2 else o.command,
            limits,
        )
    assert world.has_set_down()


def test_pressure_is_kept_without_images_and_in_a_retreat(supervisor):
    last = replace(LAST, gauge_pressure=(900.0,))
    requested = replace(LAST, gauge_pressure=(2000.0,))
    assert supervisor.decide(0.1, requested, last, (BLIND,), ()).gauge_pressure == (900.0,)
    supervisor.make_safe("a fault", 0.2)
    assert supervisor.decide(0.3, requested, last, (OK,), ()).gauge_pressure == (900.0,)


def test_a_valve_that_does_not_obey_leads_to_the_retreat():
    class BrokenChamber(Chamber):
        def regulate_pressure(self, pressure):
            raise DeviceError("valve left is lost")

    world = World()
    with pytest.raises(DeviceError, match="stopped safely: valve left is lost"):
        run_air(world, BrokenChamber(), lambda o: replace(o.command, gauge_pressure=(900.0,)))
    assert world.has_set_down()
