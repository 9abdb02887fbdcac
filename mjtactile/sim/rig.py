"""The simulated rig: a `GraspWorld` behind the rig's Protocols."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.effect_names import Effect
from mjtactile.core.scenario import Scenario
from mjtactile.core.task import SampledTask, Task, load_task
from mjtactile.rig.as_built_sensor import AsBuiltSensor, true_design
from mjtactile.rig.command_limits import CommandLimits
from mjtactile.rig.domain_randomization import ObjectChange, SampledWorld, sample_world
from mjtactile.rig.file import load_sim_rig
from mjtactile.rig.finger import Rig, make_fingers
from mjtactile.rig.registry import RigRequest
from mjtactile.rig.scenario import with_sensors
from mjtactile.rig.simulated import SimRigFile
from mjtactile.rig.workload import Workload
from mjtactile.sim.camera import SimCamera
from mjtactile.sim.devices import SimClock, SimGripper, SimValve
from mjtactile.sim.effects.catalog import Chosen, choose, quasistatic_is_valid
from mjtactile.sim.effects.fidelity import DEFAULT_FORCE_ERROR, Fidelity
from mjtactile.sim.scenes.disturbances import DisturbanceSchedule
from mjtactile.sim.scenes.grasp_world import GraspWorld, finger_designs
from mjtactile.sim.scenes.objects import ObjectModel, load_object, with_liquid
from mjtactile.sim.sensing_error_model import load_errors
from mjtactile.sim.sensor.effect_switches import set_design
from mjtactile.sim.sensor.sensor_types import AnySensor
from mjtactile.sim.synthetic_touch import SyntheticTouchSource

_SCATTER = 2e-3  # object offset to each side, m
# largest time step, s; against 1 ms, forces change by 1 mN (docs/validation/accuracy.md)
_LARGEST_STEP = 6.7e-3
# largest quasi-static time step, s; at 4 ms the stabilizing damping slows down light objects
# standing in a cup
_QS_STEP_MAX = 2.1e-3


@dataclass(frozen=True)
class _Plan:
    """Components of a scenario's rig, with `designs` and as-built `as_built` in the rig file's
    order."""

    scenario: Scenario
    file: SimRigFile
    sampled: SampledWorld
    task: Task
    sample_task: SampledTask
    object: ObjectModel
    fidelity: Fidelity | None
    chosen: Chosen
    on: frozenset[Effect]
    designs: tuple[SensorDesign, ...]
    as_built: tuple[AsBuiltSensor, ...]

    @property
    def steps_per_second(self) -> float:
        """Number of steps per second, Hz. Each image period is a whole number of steps."""
        largest = _LARGEST_STEP
        if self.fidelity is not None:
            largest = self.fidelity.timestep * (1 + 1e-9)
        if Effect.MESH not in self.on:
            largest = min(largest, _QS_STEP_MAX)
        rate = min(design.camera.rate for design in self.designs)
        return rate * int(np.ceil(1 / (rate * largest)))


def build_sim_rig(
    scenario: Scenario, *, file: SimRigFile | None = None, sampled: SampledWorld | None = None
) -> Rig:
    """Build a simulated grasp.

    The world uses the randomized values. Sensing uses the fingers' designs, and the limits are the
    file's. `file` and `sampled` replace the scenario's rig and the randomized world of its seed.
    Raises InputError for bad names or files.
    """
    file = load_sim_rig(scenario.rig) if file is None else file
    file = with_sensors(file, scenario.sensors)
    if sampled is None:
        sampled = sample_world(scenario.randomization, scenario.seed, scenario.design(), file)
    plan = _plan(scenario, file, sampled)
    return _rig(plan, _world(plan))


def _plan(scenario: Scenario, file: SimRigFile, sampled: SampledWorld) -> _Plan:
    design = scenario.design()
    fingers = len(file.fingers)
    task = load_task(scenario.task)
    sample_task = task.sample(scenario.seed, fingers)
    grasped = load_object(scenario.object)
    overrides = scenario.effects
    fidelity = None
    if scenario.accuracy:
        membranes = quasistatic_is_valid(design, grasped, overrides)
        fidelity = Fidelity.parse(scenario.accuracy, membranes=membranes)
        overrides = fidelity.with_effects(overrides)
    sampled = replace(sampled, object=object_in_task(sampled.object, sample_task, grasped, design))
    grasped = grasped.changed(sampled.object)
    if sample_task.liquid is not None:
        grasped = with_liquid(grasped, sample_task.liquid)
    grasped = strength_in_task(grasped, task, sample_task, fingers)
    force_error = DEFAULT_FORCE_ERROR if fidelity is None else fidelity.asked
    chosen = choose(design, grasped, force_error=force_error, overrides=overrides)
    as_built = tuple(sampled.as_built_sensor(finger.name) for finger in file.fingers)
    # unknown to sensing: its design has no creep
    creeps = {Effect.RELAXATION} if any(sensor.creep for sensor in as_built) else set()
    return _Plan(
        scenario,
        file,
        sampled,
        task,
        sample_task,
        grasped,
        fidelity,
        chosen,
        chosen.on | creeps,
        tuple(finger_designs(file, design)),
        as_built,
    )


def _world(plan: _Plan) -> GraspWorld:
    """Return the ground-truth world with its disturbances."""
    grip = plan.file.gripper
    true = [
        set_design(_true_design(design, as_built, plan.sampled), plan.on)
        for design, as_built in zip(plan.designs, plan.as_built, strict=True)
    ]
    fidelity = plan.fidelity
    pose, _ = start_of(plan.scenario.seed)
    world = GraspWorld(
        set_design(plan.scenario.design(), plan.on),
        plan.object,
        rig=replace(
            plan.file, gripper=replace(grip, speed=(1 + plan.sampled.rig.speed) * grip.speed)
        ),
        timestep=1 / plan.steps_per_second,
        effects=plan.on,
        mesh=fidelity.mesh if fidelity is not None and Effect.MESH in plan.on else None,
        object_pose=place(plan.object, pose),
        as_built_designs=true,
        path=plan.sample_task.path,
        stacked=plan.sample_task.stacked(),
    )
    if fidelity is not None:
        world.model.opt.tolerance = fidelity.tolerance
    if plan.sample_task.events or plan.sample_task.path:
        schedule = DisturbanceSchedule(
            world, plan.sample_task.events, plan.task.goal.lift_height, plan.sample_task.path
        )
        world.after_each_step_batch(schedule.step, schedule.due)
    for sensor, built in zip(world.sensors, plan.as_built, strict=True):
        if built.leak or built.warming:
            sensor.puncture(built.leak)
            sensor.warm(built.warming)
    return world


def _rig(plan: _Plan, world: GraspWorld) -> Rig:
    """Return the world's devices, and the finger designs assumed by sensing."""
    file = plan.file
    seed = plan.scenario.seed
    clock = SimClock(world)
    _, seeds = start_of(seed)
    cameras = _cameras(
        world.sensors, seeds(len(world.sensors)), plan.on, plan.designs, plan.as_built, plan.sampled
    )
    clock.on_arrival += [camera.capture for camera in cameras]
    valves = tuple(
        SimValve(sensor, seed + k, as_built.valve_zero, clock.defer)
        for k, (sensor, as_built) in enumerate(zip(world.sensors, plan.as_built, strict=True))
    )
    for valve in valves:
        world.after_each_step_batch(valve.move)
    rubber = world.sensors[0].mesh
    names = tuple(finger.name for finger in file.fingers)
    assumed = tuple(set_design(design, plan.on) for design in plan.designs)
    return Rig(
        name=file.name,
        fingers=make_fingers(names, assumed, cameras, valves),
        gripper=SimGripper(world, clock, plan.sampled.rig, seed),
        clock=clock,
        limits=_limits(file),
        close=clock.close,
        randomized={**plan.sampled.values, **plan.sample_task.values},
        flags=lambda: world.flags,
        touch_is_synthetic=Effect.PIPELINE not in plan.on,
        scene=world,
        grip_force_available=world.grip_force_available,
        workload=lambda: _workload(world, clock),
        simulated={
            "mesh": (rubber.nx, rubber.ny),
            "timestep_ms": 1e3 / plan.steps_per_second,
            "effects": plan.chosen.summary(),
        },
    )


def _cameras(
    sensors: Sequence[AnySensor],
    seeds: Sequence[int],
    on: frozenset[str],
    designs: Sequence[SensorDesign],
    as_built: Sequence[AsBuiltSensor],
    sampled: SampledWorld,
) -> tuple[SimCamera, ...] | tuple[SyntheticTouchSource, ...]:
    """Return the image source of each sensor: a camera, or a synthetic touch source."""
    if Effect.PIPELINE in on:
        return tuple(
            SimCamera(sensor, seed, on, own)
            for sensor, seed, own in zip(sensors, seeds, as_built, strict=True)
        )
    return tuple(
        SyntheticTouchSource(
            sensor, load_errors(own, sampled.values != {}), own.membrane.friction, seed
        )
        for sensor, own, seed in zip(sensors, designs, seeds, strict=True)
    )


def _workload(world: GraspWorld, clock: SimClock) -> Workload:
    """Return the wall times and contacts of a world so far."""
    geoms, contacts = world.contact_counts
    is_mesh = Effect.MESH in world.effects
    return Workload(
        clock.physics_time,
        clock.rendering_time,
        contacts,
        geoms,
        0 if world.solid is None else int(world.model.nflexelem) - _membrane_elements(world),
        sum(sensor.mesh.nx * sensor.mesh.ny for sensor in world.sensors) if is_mesh else 0,
    )


def _membrane_elements(world: GraspWorld) -> int:
    flexes = [sensor.flex_id for sensor in world.sensors if sensor.flex_id >= 0]
    return int(world.model.flex_elemnum[flexes].sum())


def _limits(file: SimRigFile) -> CommandLimits:
    """Return the command limits of the rig file."""
    return CommandLimits(
        file.gripper.opening,
        file.gripper.speed,
        file.gripper.force_max,
        (0.0, file.lift.travel),
        file.lift.speed,
        (0.0, file.air.pressure_max),
        file.air.pressure_rate,
    )


def object_in_task(
    change: ObjectChange, task: SampledTask, grasped: ObjectModel, design: SensorDesign
) -> ObjectChange:
    """Return the object's changes with the mass and the friction of the task, if specified."""
    if task.mass is not None:
        plain = (1 + change.size) ** 3 * grasped.mass
        change = replace(change, mass=task.mass / plain - 1)
    if task.friction is not None:
        change = replace(change, friction=task.friction / design.membrane.friction - 1)
    return change


def strength_in_task(
    grasped: ObjectModel, task: Task, sampled: SampledTask, fingers: int
) -> ObjectModel:
    """Return the object with a break force proportional to the required force, if specified."""
    if sampled.breaking is None or sampled.friction is None:
        return grasped
    need = sampled.need(grasped.mass, sampled.friction, fingers)
    return replace(grasped, break_force=max(task.object.breaking_min, sampled.breaking * need))


def build(request: RigRequest) -> Rig:
    """Build the rig of the backend "sim" of `mjtactile.rig.registry`, by default the shipped
    "sim"."""
    file = request.file if isinstance(request.file, SimRigFile) else load_sim_rig("sim")
    return build_sim_rig(request.scenario, file=file)


def start_of(seed: int) -> tuple[tuple[float, float, float], Callable[[int], list[int]]]:
    """Return the object's pose (m, m, fraction of its yaw range) of a seed, and a source of camera
    seeds."""
    rng = np.random.default_rng(seed)
    pose = *rng.uniform(-_SCATTER, _SCATTER, 2), rng.uniform(-1, 1)
    return pose, lambda count: [int(integer) for integer in rng.integers(2**31, size=count)]


def place(grasped: ObjectModel, pose: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return position and yaw of the object: its randomized changes, or the seed's `pose`."""
    x, y = pose[:2] if grasped.changes.place is None else grasped.changes.place
    yaw = grasped.turn * pose[2] if grasped.changes.yaw is None else grasped.changes.yaw
    return x, y, min(max(yaw, -grasped.turn), grasped.turn)


def _true_design(
    design: SensorDesign, as_built: AsBuiltSensor, sampled: SampledWorld
) -> SensorDesign:
    """Return the sensor as built, with the friction of its pair with the object."""
    true = true_design(design, as_built)
    return replace(
        true,
        membrane=replace(
            true.membrane, friction=(1 + sampled.object.friction) * true.membrane.friction
        ),
    )
