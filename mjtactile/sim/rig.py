"""The simulated rig: a `GraspWorld` behind the rig's Protocols. Waiting on its clock is what moves the world."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Command, GripperState, ValveState
from mjtactile.rig.file import load_sim_rig
from mjtactile.rig.finger import Rig, make_fingers
from mjtactile.rig.limits import Limits
from mjtactile.rig.registry import RigRequest
from mjtactile.rig.simulated import SimRigFile
from mjtactile.sim.attach import DEFAULT_MESH
from mjtactile.sim.camera import SimCamera
from mjtactile.sim.effects.catalog import choose
from mjtactile.sim.effects.fidelity import DEFAULT_FORCE_ERROR, Fidelity
from mjtactile.sim.scenes.grasp_world import GraspWorld, finger_designs
from mjtactile.sim.scenes.objects import load_object
from mjtactile.sim.scenes.world import World
from mjtactile.sim.sensor.runtime import TactileSensor
from mjtactile.sim.sensor.switches import set_design

_SCATTER = 2e-3  # m, to each side
_LARGEST_STEP = 6.7e-3  # s; against 1 ms, forces change by 1 mN (docs/accuracy.md)


class SimClock:
    """Simulated time. Between `start` and `wait_until` the world steps in a thread of its own.

    MuJoCo lets go of Python while it computes, so physics and perception use a core each. What is commanded meanwhile
    takes effect when the time is reached: one camera period of latency, as on a real rig, and the same every run.
    """

    def __init__(self, world: World):
        self._world = world
        self._pool = ThreadPoolExecutor(2, thread_name_prefix="physics")  # both draw; one of them steps
        self._running: Future[None] | None = None
        self._pending: list[Callable[[], None]] = []
        self.on_arrival: list[Callable[[], None]] = []
        """What to do at the same time when a time given to `start` is reached: draw what the cameras see then."""

    def now(self) -> float:
        return self._world.time

    def start(self, time: float) -> None:
        if self._running is None:
            self._running = self._pool.submit(self._go, time)

    def wait_until(self, time: float) -> None:
        """Step the world until `time`, then do what was deferred; a time in the past only does the latter.

        Raises SimulationError when the world diverged.
        """
        if self._running is not None:
            running, self._running = self._running, None
            running.result()
        self._advance(time)
        for action in self._pending:
            action()
        self._pending.clear()

    def defer(self, action: Callable[[], None]) -> None:
        """Do `action` now, or when the world has stopped moving."""
        if self._running is None:
            action()
        else:
            self._pending.append(action)

    def close(self) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _go(self, time: float) -> None:
        self._advance(time)
        first, *others = self.on_arrival or [lambda: None]
        beside = [self._pool.submit(action) for action in others]
        first()
        for action in beside:
            action.result()

    def _advance(self, time: float) -> None:
        missing = round((time - self._world.time) / self._world.timestep)
        if missing > 0:
            self._world.step(missing)


class SimValve:
    """The valve of one chamber; this rig has no pressure sensor, as the paper's device has none."""

    def __init__(self, sensor: TactileSensor):
        self._sensor = sensor

    def state(self) -> ValveState:
        return ValveState(self._sensor.valve_is_open, time=self._sensor.time, age=0.0)

    def open(self, supply_gauge: float) -> None:
        self._sensor.open_valve(supply_gauge)

    def close(self) -> None:
        self._sensor.close_valve()


class SimGripper:
    """Jaw servo and lift of the world."""

    def __init__(self, world: GraspWorld, clock: SimClock):
        self._world, self._clock = world, clock
        self._asked: GripperState | None = None

    def ask(self) -> None:
        world = self._world
        self._asked = GripperState(world.opening, world.opening_speed, world.grip_force, world.lift_height, world.time, 0.0)

    def state(self) -> GripperState:
        if self._asked is None:
            self.ask()
        state, self._asked = self._asked, None
        assert state is not None
        return state

    def command(self, command: Command) -> Command:
        """Set the goals of jaw and lift; a force limit of 0 leaves the servo's limit as it was."""
        self._clock.defer(lambda: self._apply(command))
        return command

    def _apply(self, command: Command) -> None:
        self._world.set_finger_target(command.opening, command.force_limit if command.force_limit > 0 else None)
        self._world.set_lift_target(command.lift_height)


def build_sim_rig(design: SensorDesign, *, object_name: str, seed: int, accuracy: str = "", effects: str = "auto",
                  file: SimRigFile | str | Path = "sim", specimens: Sequence[SensorDesign] = ()) -> Rig:
    """A simulated grasp with the rig of `file`. `seed` places the object by a few millimetres and fixes the cameras' noise.

    `accuracy` is "", "0.02N" or "realtime" (fidelity.py), `effects` "auto" or "+name,-name" (catalog.py); `specimens` as in
    `GraspWorld`. Sensing knows the fingers' designs, not the specimens.
    """
    rng = np.random.default_rng(seed)
    file = file if isinstance(file, SimRigFile) else load_sim_rig(file)
    fidelity = Fidelity.parse(accuracy) if accuracy else None
    largest = _LARGEST_STEP if fidelity is None else fidelity.timestep * (1 + 1e-9)
    x, y = rng.uniform(-_SCATTER, _SCATTER, 2)
    grasped = load_object(object_name)
    wanted = DEFAULT_FORCE_ERROR if fidelity is None else fidelity.asked
    on = choose(design, grasped, force_error=wanted, overrides=effects).on
    designs = tuple(set_design(own, on) for own in finger_designs(file, design))
    rate = min(own.camera.rate for own in designs)
    steps = int(np.ceil(1 / (rate * largest)))  # a whole number of steps per camera frame
    world = GraspWorld(set_design(design, on), grasped, rig=file, timestep=1 / (rate * steps), effects=on,
                       mesh=DEFAULT_MESH if fidelity is None else fidelity.mesh,
                       object_pose=(x, y, grasped.turn * rng.uniform(-1, 1)),
                       specimens=[set_design(own, on) for own in specimens] or designs)
    if fidelity is not None:
        world.model.opt.tolerance = fidelity.tolerance
    clock = SimClock(world)
    seeds = rng.integers(2**31, size=len(world.sensors))
    cameras = tuple(SimCamera(sensor, int(s), on) for sensor, s in zip(world.sensors, seeds, strict=True))
    clock.on_arrival += [camera.draw for camera in cameras]
    valves = tuple(SimValve(sensor) for sensor in world.sensors)
    limits = Limits(file.gripper.opening, file.gripper.speed, file.gripper.force_max, (0.0, file.lift.travel), file.lift.speed)
    return Rig(
        name=file.name, fingers=make_fingers(tuple(finger.name for finger in file.fingers), designs, cameras, valves),
        gripper=SimGripper(world, clock), clock=clock, limits=limits, close=clock.close, scene=world)


def build(request: RigRequest) -> Rig:
    """The backend "sim" of `mjtactile.rig.registry`; without a file, the shipped "sim"."""
    file = request.file if isinstance(request.file, SimRigFile) else "sim"
    return build_sim_rig(request.design, object_name=request.object, seed=request.seed, accuracy=request.accuracy,
                         effects=request.effects, file=file)
