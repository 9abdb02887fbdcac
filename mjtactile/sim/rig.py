"""The simulated rig: a `GraspWorld` behind the rig's Protocols. Waiting on its clock is what moves the world."""

from __future__ import annotations

import numpy as np

from mjtactile.design import SensorDesign
from mjtactile.rig import Limits, Rig
from mjtactile.sim.camera import Renderer
from mjtactile.sim.gripper import GraspWorld
from mjtactile.types import Command, GripperState, Image, ValveState

_SCATTER = 2e-3  # m, to each side
_LARGEST_STEP = 4e-3  # s; contact forces are within 3 % of their converged value (docs/equations.md)


class SimClock:
    """Simulated time."""

    def __init__(self, world: GraspWorld):
        self._world = world

    def now(self) -> float:
        return self._world.time

    def wait_until(self, time: float) -> None:
        """Step the world until `time`; a time in the past returns at once."""
        missing = round((time - self._world.time) / self._world.timestep)
        if missing > 0:
            self._world.step(missing)


class SimCamera:
    """Renders one sensor's image when it is read, and not otherwise."""

    def __init__(self, world: GraspWorld, sensor: int, seed: int):
        self._world, self._sensor = world, sensor
        self._renderer = Renderer(world.design, seed=seed)

    def read(self) -> Image:
        """The image of the membrane now."""
        p_SM, n_S = self._world.marker_poses(self._sensor)
        return self._renderer.render(p_SM, n_S, self._world.time)


class SimValve:
    """The valve of one chamber; this rig has no pressure sensor, as the paper's device has none."""

    def __init__(self, world: GraspWorld, sensor: int):
        self._world, self._sensor = world, sensor

    def state(self) -> ValveState:
        return ValveState(is_open=self._world.sensors[self._sensor].valve_is_open)

    def open(self, supply_gauge: float) -> None:
        self._world.open_valve(self._sensor, supply_gauge)

    def close(self) -> None:
        self._world.close_valve(self._sensor)


class SimGripper:
    """Jaw servo and lift of the world."""

    def __init__(self, world: GraspWorld):
        self._world = world

    def state(self) -> GripperState:
        world = self._world
        return GripperState(world.opening, world.opening_speed, world.grip_force, world.lift_height)

    def command(self, command: Command) -> Command:
        """Set the goals of jaw and lift; a force limit of 0 leaves the servo's limit as it was."""
        self._world.set_finger_target(command.opening, command.force_limit if command.force_limit > 0 else None)
        self._world.set_lift_target(command.lift_height)
        return command


def build_sim_rig(design: SensorDesign, *, object_name: str, seed: int) -> Rig:
    """A simulated grasp. `seed` places the object by a few millimetres and fixes the cameras' noise."""
    rng = np.random.default_rng(seed)
    steps = int(np.ceil(1 / (design.camera.rate * _LARGEST_STEP)))  # a whole number of steps per camera frame
    x, y = rng.uniform(-_SCATTER, _SCATTER, 2)
    world = GraspWorld(design, object_name, timestep=1 / (design.camera.rate * steps),
                       object_pose=(x, y, rng.uniform(-np.pi, np.pi)))
    seeds = rng.integers(2**31, size=len(world.sensors))
    return Rig(
        name="sim", design=design,
        cameras=tuple(SimCamera(world, i, int(s)) for i, s in enumerate(seeds)),
        valves=tuple(SimValve(world, i) for i in range(len(world.sensors))),
        gripper=SimGripper(world), clock=SimClock(world),
        limits=Limits(opening=(0.0, world.max_opening), force=8.0), close=lambda: None, scene=world)
