"""Clock, valves and gripper of a simulated rig. Waiting on its clock advances the world."""

from __future__ import annotations

import math
import time as wall
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from mjtactile.core.calibration import GAUGE_SD
from mjtactile.core.types import Command, GripperState, ValveState
from mjtactile.rig.command_limits import UNLIMITED
from mjtactile.rig.domain_randomization import FAULTLESS, RigChange
from mjtactile.rig.play_compensation import PlayCompensation
from mjtactile.sim.scenes.grasp_world import GraspWorld
from mjtactile.sim.scenes.world import World
from mjtactile.sim.sensor.sensor_types import AnySensor

_HOSE_TIME = 0.05  # time constant of a regulated supply, that of the emulated board, s


class _Later:
    """Replacement for a Future: runs its action when the result is requested."""

    def __init__(self, do: Callable[[], None]):
        self.result = do


class SimClock:
    """Simulated time. Between `start` and `wait_until` the world steps in a separate thread.

    MuJoCo releases the Python GIL while it computes. Commands given meanwhile take effect when the
    time is reached. The latency is one camera period, as on a real rig.
    """

    def __init__(self, world: World):
        self._world = world
        # both threads render, one of them steps
        self._pool: ThreadPoolExecutor | None = ThreadPoolExecutor(2, thread_name_prefix="physics")
        self._running: Future[None] | _Later | None = None
        self._pending: list[Callable[[], None]] = []
        self.physics_time = self.rendering_time = 0.0  # wall times so far, s
        self.on_arrival: list[Callable[[], None]] = []
        """Actions run in parallel when the time given to `start` is reached: rendering of the
        camera images."""

    def now(self) -> float:
        return self._world.time

    def advance_towards(self, time: float) -> None:
        if self._running is None:
            self._running = self._start(lambda: self._go(time))

    def wait_until(self, time: float) -> None:
        """Step the world until `time`, then run the deferred actions. Raises SimulationError."""
        if self._running is not None:
            running = self._running
            self._running = None
            running.result()
        self._advance(time)
        for action in self._pending:
            action()
        self._pending.clear()

    def defer(self, action: Callable[[], None]) -> None:
        """Run `action` now, or after the world has stopped moving."""
        if self._running is None:
            action()
        else:
            self._pending.append(action)

    def close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)

    def step_in_turn(self) -> None:
        """Step and render in the waiting thread from now on, for one process per processor."""
        self.close()
        self._pool = None

    def _start(self, do: Callable[[], None]) -> Future[None] | _Later:
        return _Later(do) if self._pool is None else self._pool.submit(do)

    def _go(self, time: float) -> None:
        self._advance(time)
        start = wall.perf_counter()
        first, *others = self.on_arrival or [lambda: None]
        started = [self._start(action) for action in others]
        first()
        for action in started:
            action.result()
        self.rendering_time += wall.perf_counter() - start

    def _advance(self, time: float) -> None:
        missing = round((time - self._world.time) / self._world.timestep)
        if missing > 0:
            start = wall.perf_counter()
            self._world.step(missing)
            self.physics_time += wall.perf_counter() - start


class SimValve:
    """Valve of one chamber, with a pressure sensor that has noise and an offset of `zero` Pa.

    `defer` postpones actions while the world advances. `move` is called after each step.
    """

    def __init__(
        self,
        sensor: AnySensor,
        seed: int = 0,
        zero: float = 0.0,
        defer: Callable[[Callable[[], None]], None] = lambda act: act(),
    ):
        self._sensor = sensor
        self._zero = zero
        self._defer = defer
        # target pressure of the chamber and current supply pressure, Pa
        self._goal: float | None = None
        self._supply = 0.0
        self._moved = 0.0  # time of the last supply update, s
        self.reseed(seed)

    def reseed(self, seed: int) -> None:
        """Set the generator of the pressure sensor's noise."""
        self._rng = np.random.default_rng([seed, 2])

    def state(self) -> ValveState:
        sensor = self._sensor
        shown = sensor.gauge_pressure + self._zero + GAUGE_SD * self._rng.standard_normal()
        age = sensor.time - sensor.gas_time
        return ValveState(sensor.valve_is_open, float(round(shown)), sensor.gas_time, age)

    def open(self, supply_gauge: float) -> None:
        self._defer(lambda: self._open(supply_gauge))

    def close(self) -> None:
        self._defer(self._close)

    def regulate_pressure(self, gauge_pressure: float | None) -> None:
        self._defer(lambda: self._follow(gauge_pressure))

    def move(self) -> None:
        """Move the supply pressure towards its goal by one world step, with the lag of a hose."""
        if self._goal is None:
            return
        elapsed = self._sensor.time - self._moved
        self._moved = self._sensor.time
        self._supply += (self._goal - self._supply) * min(1.0, elapsed / _HOSE_TIME)
        self._sensor.open_valve(self._supply)

    def _open(self, supply_gauge: float) -> None:
        self._goal = None
        self._sensor.open_valve(supply_gauge)

    def _close(self) -> None:
        self._goal = None
        self._sensor.close_valve()

    def _follow(self, gauge_pressure: float | None) -> None:
        if gauge_pressure is None:
            if self._goal is not None:
                self._close()
            return
        if self._goal is None:
            self._supply = self._sensor.gauge_pressure
            self._moved = self._sensor.time
        self._goal = gauge_pressure - self._zero  # the board regulates by its own sensor


class SimGripper:
    """Jaw servo and lift of the world, with backlash, command delay and force noise."""

    def __init__(
        self, world: GraspWorld, clock: SimClock, change: RigChange = FAULTLESS, seed: int = 0
    ):
        self._world = world
        self._clock = clock
        self._change = change
        self._asked: GripperState | None = None
        self.reseed(seed)
        # goals of the gear output and of the motor, m
        self._jaw = self._motor = world.opening
        file = world.rig
        self._limits = replace(
            UNLIMITED,
            opening=file.gripper.opening,
            force=file.gripper.force_max,
            lift=(0.0, file.lift.travel),
        )
        self._play = PlayCompensation(file.gripper.backlash)
        self._sent = Command(world.opening, file.gripper.force_max)
        self._late: deque[tuple[float, Command]] = deque()
        if change.delay or change.jitter:
            world.after_each_step_batch(self._apply_late, self._due)

    def reseed(self, seed: int) -> None:
        """Set the generator of noise and delays."""
        self._rng = np.random.default_rng([seed, 1])

    def request_state(self) -> None:
        world = self._world
        force = world.grip_force + (
            self._change.force_noise * self._rng.standard_normal()
            if self._change.force_noise
            else 0.0
        )
        motors = world.opening + self._motor - self._jaw  # servos report the motor position
        opening = self._play.opening(motors)
        self._asked = GripperState(
            opening, world.opening_speed, force, world.lift_height, world.time, 0.0
        )

    def state(self) -> GripperState:
        if self._asked is None:
            self.request_state()
        state = self._asked
        self._asked = None
        assert state is not None
        return state

    def command(self, command: Command) -> Command:
        """Set goals and force limit. Return the command limited to the ranges of the rig's file."""
        sent = self._sent = self._limits.clip(command.completed(self._sent))
        self._clock.defer(lambda: self._arrive(sent))
        return sent

    def _arrive(self, command: Command) -> None:
        change = self._change
        if not (change.delay or change.jitter):
            self._apply(command)
            return
        due = self._world.time + change.delay + change.jitter * self._rng.random()
        self._late.append((max(due, self._late[-1][0]) if self._late else due, command))

    def _due(self) -> float:
        """Return the arrival time of the next command, s."""
        return self._late[0][0] if self._late else math.inf

    def _apply_late(self) -> None:
        while self._late and self._late[0][0] <= self._world.time:
            self._apply(self._late.popleft()[1])

    def _apply(self, command: Command) -> None:
        """Apply a command. The jaws follow the motor after the backlash of the gears is used up."""
        half = self._change.backlash / 2
        self._motor = self._play.motor_goal(command.opening)
        self._jaw = min(max(self._jaw, self._motor - half, 0.0), self._motor + half)
        self._world.set_finger_target(self._jaw, command.force_limit)
        self._world.set_lift_target(command.lift_height)
