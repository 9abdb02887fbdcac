"""The simulated rig: a `GraspWorld` behind the rig's Protocols. Waiting on its clock is what moves the world."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from mjtactile.design import SensorDesign
from mjtactile.fidelity import DEFAULT_FORCE_ERROR, Fidelity
from mjtactile.rig import Limits, Rig
from mjtactile.sim.attach import DEFAULT_MESH
from mjtactile.sim.camera import Renderer
from mjtactile.sim.effects import choose
from mjtactile.sim.gripper import GraspWorld
from mjtactile.sim.objects import load_object
from mjtactile.sim.switches import CAMERA, set_design, set_picture
from mjtactile.types import Command, GripperState, Image, ValveState

_SCATTER = 2e-3  # m, to each side
_LARGEST_STEP = 6.7e-3  # s; against 1 ms, forces change by 1 mN (docs/accuracy.md)
_EXPOSURE = 8e-3  # s, for motion blur
_SHUTTER = (0.0, 0.5, 1.0)  # shares of the exposure at which the moving markers are drawn


class SimClock:
    """Simulated time. Between `start` and `wait_until` the world steps in a thread of its own.

    MuJoCo lets go of Python while it computes, so physics and perception use a core each. What is commanded meanwhile
    takes effect when the time is reached: one camera period of latency, as on a real rig, and the same every run.
    """

    def __init__(self, world: GraspWorld):
        self._world = world
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="physics")
        self._running: Future[None] | None = None
        self._pending: list[Callable[[], None]] = []
        self.on_arrival: list[Callable[[], None]] = []
        """What to do in the world's thread when a time given to `start` is reached: draw what the cameras see then."""

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
        for action in self.on_arrival:
            action()

    def _advance(self, time: float) -> None:
        missing = round((time - self._world.time) / self._world.timestep)
        if missing > 0:
            self._world.step(missing)


class SimCamera:
    """Renders one sensor's image when it is read, or before (`draw`), beside the work on the last one."""

    def __init__(self, world: GraspWorld, sensor: int, seed: int, effects: frozenset[str] = CAMERA):
        """`effects`: what is drawn; "latency" hands out the image before, "motion blur" keeps the shutter open."""
        self._world, self._sensor = world, sensor
        self._renderer = Renderer(set_picture(world.design, effects), seed=seed, shadows="shadows" in effects)
        self._moving, self._late = "motion blur" in effects, "latency" in effects
        self._before: Image | None = None
        self._drawn: Image | None = None

    def draw(self) -> None:
        """Have the image of the membrane now ready for `read`."""
        self._drawn = self._blurred() if self._moving else self._renderer.render(
            *self._world.marker_poses(self._sensor), self._world.time)

    def read(self) -> Image:
        """The image of the membrane now."""
        if self._drawn is None or self._drawn.time != self._world.time:
            self.draw()
        image, self._drawn = self._drawn, None
        assert image is not None
        before, self._before = self._before, image
        return before if self._late and before is not None else image

    def _blurred(self) -> Image:
        """The mean of what the sensor sees over the exposure that ends now."""
        poses = [self._world.sensors[self._sensor].marker_poses_before(share * _EXPOSURE) for share in _SHUTTER]
        gray = np.asarray(np.mean([self._renderer.irradiance_image(*pose) for pose in poses], axis=0, dtype=np.float32))
        return self._renderer.expose(gray, self._world.time)


class SimValve:
    """The valve of one chamber; this rig has no pressure sensor, as the paper's device has none."""

    def __init__(self, world: GraspWorld, sensor: int):
        self._world, self._sensor = world, sensor

    def state(self) -> ValveState:
        return ValveState(self._world.sensors[self._sensor].valve_is_open, time=self._world.time, age=0.0)

    def open(self, supply_gauge: float) -> None:
        self._world.open_valve(self._sensor, supply_gauge)

    def close(self) -> None:
        self._world.close_valve(self._sensor)


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


def build_sim_rig(design: SensorDesign, *, object_name: str, seed: int, accuracy: str = "", effects: str = "auto") -> Rig:
    """A simulated grasp. `seed` places the object by a few millimetres and fixes the cameras' noise.

    `accuracy` is "", "0.02N" or "realtime" (fidelity.py), `effects` "auto" or "+name,-name" (effects.py).
    """
    rng = np.random.default_rng(seed)
    fidelity = Fidelity.parse(accuracy) if accuracy else None
    largest = _LARGEST_STEP if fidelity is None else fidelity.timestep * (1 + 1e-9)
    steps = int(np.ceil(1 / (design.camera.rate * largest)))  # a whole number of steps per camera frame
    x, y = rng.uniform(-_SCATTER, _SCATTER, 2)
    grasped = load_object(object_name)
    wanted = DEFAULT_FORCE_ERROR if fidelity is None else fidelity.asked
    on = choose(design, grasped, force_error=wanted, overrides=effects).on
    design = set_design(design, on)
    world = GraspWorld(design, grasped, timestep=1 / (design.camera.rate * steps), effects=on,
                       mesh=DEFAULT_MESH if fidelity is None else fidelity.mesh,
                       object_pose=(x, y, grasped.turn * rng.uniform(-1, 1)))
    if fidelity is not None:
        world.model.opt.tolerance = fidelity.tolerance
    clock = SimClock(world)
    seeds = rng.integers(2**31, size=len(world.sensors))
    cameras = tuple(SimCamera(world, i, int(s), on) for i, s in enumerate(seeds))
    clock.on_arrival += [camera.draw for camera in cameras]
    return Rig(
        name="sim", design=design, cameras=cameras,
        valves=tuple(SimValve(world, i) for i in range(len(world.sensors))),
        gripper=SimGripper(world, clock), clock=clock,
        limits=Limits(opening=(0.0, world.max_opening), force=8.0), close=clock.close, scene=world)
