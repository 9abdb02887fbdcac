"""The simulated rig: a `GraspWorld` behind the rig's Protocols. Waiting on its clock is what moves
the world."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from mjtactile.core.calibration import GAUGE_SD
from mjtactile.core.design import SensorDesign
from mjtactile.core.scenario import Scenario
from mjtactile.core.task import DrawnTask, Task, load_task
from mjtactile.core.types import Command, GripperState, ValveState
from mjtactile.rig.file import load_sim_rig
from mjtactile.rig.finger import Rig, make_fingers
from mjtactile.rig.limits import Limits
from mjtactile.rig.registry import RigRequest
from mjtactile.rig.simulated import SimRigFile
from mjtactile.rig.specimen import SpecimenConfig, true_design
from mjtactile.rig.variation import FAULTLESS, Drawn, ObjectChange, RigChange, draw
from mjtactile.sim.camera import SimCamera
from mjtactile.sim.chain_errors import load_errors
from mjtactile.sim.drawn import TouchDrawer
from mjtactile.sim.effects.catalog import choose, film_serves
from mjtactile.sim.effects.fidelity import DEFAULT_FORCE_ERROR, Fidelity
from mjtactile.sim.scenes.grasp_world import GraspWorld, finger_designs
from mjtactile.sim.scenes.happenings import Happenings
from mjtactile.sim.scenes.objects import ObjectModel, load_object
from mjtactile.sim.scenes.world import World
from mjtactile.sim.sensor.any import AnySensor
from mjtactile.sim.sensor.switches import Effect, set_design

_SCATTER = 2e-3  # m, to each side
_HOSE_TIME = 0.05  # s, time constant of a regulated supply, as the emulated board's
_LARGEST_STEP = 6.7e-3  # s; against 1 ms, forces change by 1 mN (docs/accuracy.md)
# s; at 4 ms what is light and stands in a cup is held back by the damping that keeps it stable
_LARGEST_STEP_OF_A_FILM = 2.1e-3


class _Later:
    """Stands in for a Future: what is done when its result is asked for."""

    def __init__(self, do: Callable[[], None]):
        self.result = do


class SimClock:
    """Simulated time. Between `start` and `wait_until` the world steps in a thread of its own.

    MuJoCo lets go of Python while it computes, so physics and perception use a core each. What is
    commanded meanwhile takes effect when the time is reached: one camera period of latency, as on a
    real rig, and the same every run.
    """

    def __init__(self, world: World):
        self._world = world
        # both draw, one steps
        self._pool: ThreadPoolExecutor | None = ThreadPoolExecutor(2, thread_name_prefix="physics")
        self._running: Future[None] | _Later | None = None
        self._pending: list[Callable[[], None]] = []
        self.on_arrival: list[Callable[[], None]] = []
        """What to do at the same time when a time given to `start` is reached: draw what the
        cameras see then."""

    def now(self) -> float:
        return self._world.time

    def start(self, time: float) -> None:
        if self._running is None:
            self._running = self._begin(lambda: self._go(time))

    def wait_until(self, time: float) -> None:
        """Step the world until `time`, then do what was deferred; a time in the past only does the
        latter.

        Raises SimulationError when the world diverged.
        """
        if self._running is not None:
            running = self._running
            self._running = None
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
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)

    def step_in_turn(self) -> None:
        """From now on, step and draw in the thread that waits, with the same result and a quarter
        less core time: for whoever has a process for each processor."""
        self.close()
        self._pool = None

    def _begin(self, do: Callable[[], None]) -> Future[None] | _Later:
        return _Later(do) if self._pool is None else self._pool.submit(do)

    def _go(self, time: float) -> None:
        self._advance(time)
        first, *others = self.on_arrival or [lambda: None]
        beside = [self._begin(action) for action in others]
        first()
        for action in beside:
            action.result()

    def _advance(self, time: float) -> None:
        missing = round((time - self._world.time) / self._world.timestep)
        if missing > 0:
            self._world.step(missing)


class SimValve:
    """The valve of one chamber, with the gauge of a valve board: whole pascals, their noise, and
    `zero` Pa that it shows too much. In a world that moves while it is asked, `defer` puts off
    what it does, and `move` is called after each step."""

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
        # Pa: what the chamber is to be kept at, and where its supply is on the way
        self._goal: float | None = None
        self._supply = 0.0
        self._moved = 0.0  # s, when it was there
        self.reseed(seed)

    def reseed(self, seed: int) -> None:
        """Draw the gauge's noise from another generator."""
        self._rng = np.random.default_rng([seed, 2])

    def state(self) -> ValveState:
        sensor = self._sensor
        shown = sensor.pressure_gauge + self._zero + GAUGE_SD * self._rng.standard_normal()
        age = sensor.time - sensor.gas_time
        return ValveState(sensor.valve_is_open, float(round(shown)), sensor.gas_time, age)

    def open(self, supply_gauge: float) -> None:
        self._defer(lambda: self._open(supply_gauge))

    def close(self) -> None:
        self._defer(self._close)

    def follow(self, pressure_gauge: float | None) -> None:
        self._defer(lambda: self._follow(pressure_gauge))

    def move(self) -> None:
        """One step of the world: the supply goes to the goal as through a hose."""
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

    def _follow(self, pressure_gauge: float | None) -> None:
        if pressure_gauge is None:
            if self._goal is not None:
                self._close()
            return
        if self._goal is None:
            self._supply = self._sensor.pressure_gauge
            self._moved = self._sensor.time
        self._goal = pressure_gauge - self._zero  # it goes by its own gauge


class SimGripper:
    """Jaw servo and lift of the world, with what the gears' play, a slow bus and a noisy current
    make of them."""

    def __init__(
        self, world: GraspWorld, clock: SimClock, change: RigChange = FAULTLESS, seed: int = 0
    ):
        self._world = world
        self._clock = clock
        self._change = change
        self._asked: GripperState | None = None
        self.reseed(seed)
        # m: where the gears' output and the motor are to be
        self._jaw = self._motor = world.opening
        self._late: deque[tuple[float, Command]] = deque()
        if change.delay or change.jitter:
            world.after_each_stretch(self._apply_late, self._due)

    def reseed(self, seed: int) -> None:
        """Draw noise and delays from another generator."""
        self._rng = np.random.default_rng([seed, 1])

    def ask(self) -> None:
        world = self._world
        force = world.grip_force + (
            self._change.force_noise * self._rng.standard_normal()
            if self._change.force_noise
            else 0.0
        )
        opening = world.opening + self._motor - self._jaw  # servos say where their motors are
        self._asked = GripperState(
            opening, world.opening_speed, force, world.lift_height, world.time, 0.0
        )

    def state(self) -> GripperState:
        if self._asked is None:
            self.ask()
        state = self._asked
        self._asked = None
        assert state is not None
        return state

    def command(self, command: Command) -> Command:
        """Set the goals of jaw and lift; a force limit of 0 leaves the servo's limit as it was."""
        self._clock.defer(lambda: self._arrive(command))
        return command

    def _arrive(self, command: Command) -> None:
        change = self._change
        if not (change.delay or change.jitter):
            self._apply(command)
            return
        due = self._world.time + change.delay + change.jitter * self._rng.random()
        self._late.append((max(due, self._late[-1][0]) if self._late else due, command))

    def _due(self) -> float:
        """s, when the next command arrives."""
        return self._late[0][0] if self._late else math.inf

    def _apply_late(self) -> None:
        while self._late and self._late[0][0] <= self._world.time:
            self._apply(self._late.popleft()[1])

    def _apply(self, command: Command) -> None:
        """The jaw follows the motor when the gears' play is used up."""
        half = self._change.backlash / 2
        self._motor = min(command.opening, self._world.max_opening)
        self._jaw = min(max(self._jaw, self._motor - half, 0.0), self._motor + half)
        self._world.set_finger_target(
            self._jaw, command.force_limit if command.force_limit > 0 else None
        )
        self._world.set_lift_target(command.lift_height)


def build_sim_rig(
    scenario: Scenario, *, file: SimRigFile | None = None, drawn: Drawn | None = None
) -> Rig:
    """A simulated grasp. The seed places the object by a few millimetres and fixes the cameras'
    noise.

    The world is made of what was drawn; sensing knows the fingers' designs, and the limits are the
    file's.

    Args:
        scenario: Object, sensor, accuracy (fidelity.py), effects (catalog.py) and seed.
        file: The rig, where that is not the scenario's.
        drawn: The world, where that is not the one that the scenario's seed draws.

    Returns:
        The rig; its `scene` is the simulated world.

    Raises:
        InputError: For bad names or files.
    """
    design = scenario.design()
    file = load_sim_rig(scenario.rig) if file is None else file
    drawn = draw(scenario.vary, scenario.seed, design, file) if drawn is None else drawn
    seed = scenario.seed
    pose, seeds = start_of(seed)
    task = load_task(scenario.task)
    drawn_task = task.draw(seed, len(file.fingers))
    grasped = load_object(scenario.object)
    fidelity = None
    if scenario.accuracy:
        films = film_serves(design, grasped, scenario.effects)
        fidelity = Fidelity.parse(scenario.accuracy, films=films)
    largest = _LARGEST_STEP if fidelity is None else fidelity.timestep * (1 + 1e-9)
    drawn = replace(drawn, object=_with_task(drawn.object, drawn_task, grasped, design))
    grasped = _breaking(grasped.changed(drawn.object), task, drawn_task, len(file.fingers))
    wanted = DEFAULT_FORCE_ERROR if fidelity is None else fidelity.asked
    overrides = scenario.effects
    if fidelity is not None:
        overrides = fidelity.with_effects(overrides)
    chosen = choose(design, grasped, force_error=wanted, overrides=overrides)
    specimens = [drawn.specimen(finger.name) for finger in file.fingers]
    creeps = {Effect.RELAXATION} if any(one.creep for one in specimens) else set()
    on = chosen.on | creeps  # sensing knows nothing of it: its design has none
    files = finger_designs(file, design)
    designs = tuple(set_design(own, on) for own in files)
    if Effect.SHEET not in on:
        largest = min(largest, _LARGEST_STEP_OF_A_FILM)
    rate = min(own.camera.rate for own in designs)
    steps = int(np.ceil(1 / (rate * largest)))  # a whole number of steps per camera frame
    true = [
        set_design(_true_design(own, specimen, drawn), on)
        for own, specimen in zip(files, specimens, strict=True)
    ]
    grip = replace(file.gripper, speed=(1 + drawn.rig.speed) * file.gripper.speed)
    mesh = fidelity.mesh if fidelity is not None and Effect.SHEET in on else None
    world = GraspWorld(
        set_design(design, on),
        grasped,
        rig=replace(file, gripper=grip),
        timestep=1 / (rate * steps),
        effects=on,
        mesh=mesh,
        object_pose=place(grasped, pose),
        specimens=true,
    )
    if fidelity is not None:
        world.model.opt.tolerance = fidelity.tolerance
    if drawn_task.events:
        happens = Happenings(world, drawn_task.events, task.orders.lift_height)
        world.after_each_step(happens.step)
    clock = SimClock(world)
    drawn_seeds = seeds(len(world.sensors))
    cameras = _cameras(world.sensors, drawn_seeds, on, files, specimens, drawn)
    for sensor, own in zip(world.sensors, specimens, strict=True):
        if own.leak or own.warming:
            sensor.puncture(own.leak)
            sensor.warm(own.warming)
    clock.on_arrival += [camera.draw for camera in cameras]
    valves = tuple(
        SimValve(sensor, seed + k, own.valve_zero, clock.defer)
        for k, (sensor, own) in enumerate(zip(world.sensors, specimens, strict=True))
    )
    for valve in valves:
        world.after_each_stretch(valve.move)
    sheet = world.sensors[0].mesh
    return Rig(
        name=file.name,
        fingers=make_fingers(
            tuple(finger.name for finger in file.fingers), designs, cameras, valves
        ),
        gripper=SimGripper(world, clock, drawn.rig, seed),
        clock=clock,
        limits=_limits(file),
        close=clock.close,
        varied={**drawn.values, **drawn_task.values},
        flags=lambda: world.flags,
        touch_is_drawn=Effect.CHAIN not in on,
        scene=world,
        simulated={
            "mesh": (sheet.nx, sheet.ny),
            "timestep_ms": 1e3 / (rate * steps),
            "effects": chosen.summary(),
        },
    )


def _cameras(
    sensors: Sequence[AnySensor],
    seeds: Sequence[int],
    on: frozenset[str],
    designs: Sequence[SensorDesign],
    specimens: Sequence[SpecimenConfig],
    drawn: Drawn,
) -> tuple[SimCamera, ...] | tuple[TouchDrawer, ...]:
    """What sees each sensor: a camera, or where the chain is left out what draws its touches."""
    if Effect.CHAIN in on:
        return tuple(
            SimCamera(sensor, seed, on, own)
            for sensor, seed, own in zip(sensors, seeds, specimens, strict=True)
        )
    return tuple(
        TouchDrawer(sensor, load_errors(own, drawn.values != {}), own.membrane.friction, seed)
        for sensor, own, seed in zip(sensors, designs, seeds, strict=True)
    )


def _limits(file: SimRigFile) -> Limits:
    """What the rig file allows."""
    return Limits(
        file.gripper.opening,
        file.gripper.speed,
        file.gripper.force_max,
        (0.0, file.lift.travel),
        file.lift.speed,
        (0.0, file.air.pressure_max),
        file.air.pressure_rate,
    )


def _with_task(
    change: ObjectChange, task: DrawnTask, grasped: ObjectModel, design: SensorDesign
) -> ObjectChange:
    """The object's changes with the mass and the friction that the task says, if it does."""
    if task.mass is not None:
        plain = (1 + change.size) ** 3 * grasped.mass
        change = replace(change, mass=task.mass / plain - 1)
    if task.friction is not None:
        change = replace(change, friction=task.friction / design.membrane.friction - 1)
    return change


def _breaking(grasped: ObjectModel, task: Task, drawn: DrawnTask, fingers: int) -> ObjectModel:
    """The object with the break force that the task says, if it does: it goes with what the task
    needs of a finger."""
    if drawn.breaking is None or drawn.friction is None:
        return grasped
    need = drawn.need(grasped.mass, drawn.friction, fingers)
    return replace(grasped, break_force=max(task.thing.breaking_least, drawn.breaking * need))


def build(request: RigRequest) -> Rig:
    """The backend "sim" of `mjtactile.rig.registry`; without a file, the shipped "sim"."""
    file = request.file if isinstance(request.file, SimRigFile) else load_sim_rig("sim")
    return build_sim_rig(request.scenario, file=file)


def start_of(seed: int) -> tuple[tuple[float, float, float], Callable[[int], list[int]]]:
    """What a seed says where nothing else was drawn: the object's pose (m, m, share of its turn),
    and so many cameras' seeds."""
    rng = np.random.default_rng(seed)
    pose = *rng.uniform(-_SCATTER, _SCATTER, 2), rng.uniform(-1, 1)
    return pose, lambda count: [int(one) for one in rng.integers(2**31, size=count)]


def place(grasped: ObjectModel, pose: tuple[float, float, float]) -> tuple[float, float, float]:
    """Where the object stands and how it is turned: as drawn, else by the seed's `pose` (m, m,
    share of its turn)."""
    x, y = pose[:2] if grasped.changes.place is None else grasped.changes.place
    yaw = grasped.turn * pose[2] if grasped.changes.yaw is None else grasped.changes.yaw
    return x, y, min(max(yaw, -grasped.turn), grasped.turn)


def _true_design(design: SensorDesign, specimen: SpecimenConfig, drawn: Drawn) -> SensorDesign:
    """The sensor as it is; the friction of a pair is the membrane's alone (it has the higher
    priority)."""
    true = true_design(design, specimen)
    return replace(
        true,
        membrane=replace(
            true.membrane, friction=(1 + drawn.object.friction) * true.membrane.friction
        ),
    )
