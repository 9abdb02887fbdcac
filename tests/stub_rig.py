"""Rig of stubs with parts that fail on request, and its touch data."""

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from mjtactile.core.design import load_sensor
from mjtactile.core.errors import DeviceError
from mjtactile.core.types import Command, GripperState, Image, Touch, Traction, ValveState
from mjtactile.recording.observer import CycleCallback, Observers
from mjtactile.rig.command_limits import CommandLimits
from mjtactile.rig.finger import Finger, Rig
from mjtactile.runtime import control_loop
from mjtactile.runtime.retreat import RETREAT_OPENING

PERIOD = 0.05
OK = Touch(0.0, 0.0, 0.5, 0.01, True)
BLIND = Touch(0.0, 0.0, math.nan, math.nan, False, status="too dark")
SEALED = ValveState(False, 1000.0)
LAST = Command(0.05, 4.0, 0.02, "hold")
PERCEPTION_STUB = SimpleNamespace(perceive=lambda images, now, timeout, readings: (OK,))


def loaded(shear):
    """Return a finger with a shear force, N."""
    wrench = np.array([0.0, shear, -1.0, 0.0, 0.0, 0.0])
    grid = np.linspace(-0.01, 0.01, 3)
    traction = Traction(grid, grid, np.zeros((3, 3, 3)), wrench, np.eye(6) * 1e-6, 1e3, "made up")
    return replace(OK, traction=traction)


class World:
    """Rig of stubs with parts that fail on request; its jaws can be `stuck`."""

    def __init__(self):
        self.time = 0.0
        self.broken = ""
        self.sent = []
        self.opening = 0.05
        self.lift = 0.02
        self.force = 1.0
        self.stuck = False

    def now(self):
        return self.time

    def advance_towards(self, time):
        pass

    def wait_until(self, time):
        self.time = max(self.time, time)

    def read(self):
        if self.broken == "camera":
            raise DeviceError("left camera is stale")
        return Image(np.zeros((2, 2), np.uint8), self.time)

    def request_state(self):
        pass

    def state(self):
        if self.broken in ("gripper", "all"):
            raise DeviceError("servo 1 reports overload")
        return GripperState(self.opening, 0.0, 0.5, self.lift)

    def command(self, command):
        if self.broken == "all":
            raise DeviceError("servo port is lost")
        sent = command.completed(replace(command, force_limit=self.force))
        self.force = sent.force_limit
        if self.force > 0 and not self.stuck:
            self.opening = command.opening
        self.lift = command.lift_height
        self.sent.append(sent)
        return self.sent[-1]

    def rig(self, host_timeout=math.inf):
        return Rig(
            "stub",
            (Finger("left", load_sensor("paper16"), self),),
            self,
            self,
            CommandLimits(),
            close=lambda: None,
            host_timeout=host_timeout,
        )

    def run(
        self,
        broken,
        after=5,
        controller=lambda o: o.command,
        time_limit=30.0,
        error=DeviceError,
        act=lambda: None,
        perceive=lambda image, now, reading=None: OK,
        host_timeout=math.inf,
        stop=None,
        observer=None,
    ):
        """Run until `error`. After cycle number `after` a part is `broken`; `act` is called in each
        cycle."""
        cycles = []

        def on_cycle(cycle):
            cycles.append(cycle)
            if len(cycles) >= after:
                self.broken = broken
                act()

        with pytest.raises(error) as caught:
            control_loop.run_loop(
                self.rig(host_timeout),
                [SimpleNamespace(perceive=perceive)],  # type: ignore[list-item]
                SimpleNamespace(
                    path=Path(getattr(controller, "__code__", World.run.__code__).co_filename),
                    step=controller,
                ),  # type: ignore[arg-type]
                time_limit=time_limit,
                observer=Observers([CycleCallback(on_cycle), *([observer] if observer else [])]),
                stop=stop,
            )
        return cycles, str(caught.value)

    def has_set_down(self):
        """Check that the gripper lowered before it opened."""
        opened = next(i for i, command in enumerate(self.sent) if command.opening > 0.05 + 1e-3)
        return self.sent[opened].lift_height < 1e-3 and self.opening > 0.05 + RETREAT_OPENING - 1e-3
