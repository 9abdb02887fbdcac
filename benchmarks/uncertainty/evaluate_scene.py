"""One scene viewed by its cameras: estimate and ground truth of each image."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.scenes.stress_scenes import PinchWorld
from benchmarks.uncertainty.scenes import Scene
from mjtactile.core.flags import Flags
from mjtactile.core.types import Array, Touch
from mjtactile.experiments.test_bench import View, take_references
from mjtactile.sim import ground_truth
from mjtactile.sim.rendering.renderer import Renderer
from mjtactile.sim.scenes.indentation import PressWorld
from mjtactile.sim.scenes.world import World

# maximum depth, m; maximum force, N; waiting height of an indenter above first touch, m
_DEEPEST = 6e-3
_STRONGEST = 2.5
_ABOVE = 1e-3
# time without a touch, s; hold time of a force, s
_QUIET = 0.2
_HOLD = 0.3
# number of taps; rest of a tap, s; duration of the oscillation, s
_TAPS = 3
_TAP_HOLD = 0.1
_RHYTHM = 1.2
# speed of a drag and of a retreat, m/s; range of the squeeze of objects, m
_SLOW = 5e-3
_FAST = 0.02
_SQUEEZE = (0.5e-3, 4e-3)
# maximum change of a constant force in a step: constant part, N, and fraction of the force
_JUMP = 0.02
_JUMP_FRACTION = 0.05
# images between two evaluations of the area; minimum force for an area, N
_AREA_EVERY = 5
_FORCE_MIN = 0.02


@dataclass(frozen=True, eq=False)
class Sample:
    """One image of one sensor: its `touch` and the ground truth.

    True values: `wrench` (6,), N and N m, and contact `area`, m^2 (NaN: not computed). `rattles` is
    true if that wrench jumps between steps although no drive moves.
    """

    touch: Touch
    wrench: Array
    area: float
    rattles: bool


@dataclass(frozen=True, eq=False)
class Watched:
    """All images of a scene, and the simulation's `flags`."""

    samples: list[Sample]
    flags: Flags


def watch(scene: Scene) -> Watched:
    """Take references, then move, and evaluate every image.

    Raises:
        SimulationError: The scene cannot be simulated.
    """
    design = scene.design
    samples = []
    world: World = PressWorld(
        design,
        scene.indenter,
        at=scene.at,
        tilt=scene.tilt,
        mesh=scene.mesh,
        mount=scene.mount,
        shake=scene.shake,
    )
    view = View(world, design, seed=scene.seed)
    take_references(world, [view], scene.supply)
    sensing = view.perception.pipeline
    rest = view.perception.state
    if scene.kind == "hold":
        squeeze = float(np.interp(scene.forces[1], (0.04, 1.8), _SQUEEZE))
        world = PinchWorld(
            design, scene.body, gauge_pressure=scene.supply, squeeze=squeeze, mesh=scene.mesh
        )
    fingers = range(len(world.sensors))
    renderers = [Renderer(design, seed=2 * scene.seed + k) for k in fingers]
    states = [rest for _ in fingers]
    period = round(1 / (design.camera.rate * world.timestep))
    before = [np.zeros(6) for _ in fingers]
    driven = np.zeros(world.model.nu)

    def sample() -> None:
        wrenches = [ground_truth.contact_wrench(world, k) for k in fingers]
        rests = bool(np.all(world.data.ctrl == driven))
        if world.step_count % period == 0:
            with_area = world.step_count // period % _AREA_EVERY == 0 and scene.kind != "shaken"
            for k in fingers:
                touch, states[k] = sensing.step(
                    states[k], renderers[k].render(*world.marker_poses(k), world.time), world.time
                )
                area = (
                    ground_truth.contact_area(world, k)
                    if with_area and -wrenches[k][2] > _FORCE_MIN
                    else np.nan
                )
                jump = float(np.abs(wrenches[k] - before[k])[:3].max())
                rattles = rests and jump > _JUMP + _JUMP_FRACTION * float(
                    np.linalg.norm(wrenches[k][:3])
                )
                samples.append(Sample(touch, wrenches[k], area, rattles))
        before[:] = wrenches
        driven[:] = world.data.ctrl

    world.after_each_step(sample)
    for seconds in _moves(scene, world):
        world.step(max(round(seconds / world.timestep), 1))
    return Watched(samples, world.flags)


def _moves(scene: Scene, world: World) -> Iterator[float]:
    """Move the indenter; yield the durations, s, for which it rests."""
    if not isinstance(world, PressWorld):
        yield 2 * _HOLD
        return
    yield _QUIET
    if scene.kind == "tap":
        for _ in range(_TAPS):
            yield from _tap(scene, world)
    elif scene.kind == "rhythm":
        _beat(scene, world)
    else:
        for force in scene.forces:
            _press_until(scene, world, force)
            yield _HOLD
        world.drive(world.depth, scene.shear, _SLOW)
        yield _HOLD
        world.drive(-_ABOVE, scene.shear, _FAST)
    world.drive(-_ABOVE, scene.shear if scene.kind in ("press", "edge", "shaken") else 0.0, _FAST)
    yield _QUIET


def _force(world: World) -> float:
    return -float(ground_truth.contact_force(world, 0)[2])


def _press_until(scene: Scene, world: PressWorld, force: float) -> None:
    """Lower the indenter in steps until `force`, N, or the maximum depth is reached."""
    depth = max(world.depth, -_ABOVE)
    while _force(world) < force and depth < _DEEPEST:
        depth += scene.speed * world.timestep
        world.drive(depth, 0.0, scene.speed)


def _tap(scene: Scene, world: PressWorld) -> Iterator[float]:
    """Lower at the scene's speed to its depth or the force limit, rest shortly, and retract."""
    depth = -_ABOVE
    while depth < scene.depth and _force(world) < _STRONGEST:
        depth = min(depth + scene.speed * world.timestep, scene.depth)
        world.drive(depth, 0.0, scene.speed)
    yield _TAP_HOLD
    world.drive(-_ABOVE, 0.0, scene.speed)
    yield _TAP_HOLD


def _beat(scene: Scene, world: PressWorld) -> None:
    """Oscillate between slightly above first touch and the scene's depth."""
    top = -0.3e-3
    start = world.time
    world.drive(top, 0.0, _FAST)
    while world.time < start + _RHYTHM:
        fraction = (1 - np.cos(2 * np.pi * scene.frequency * (world.time - start))) / 2
        world.drive(top + fraction * (scene.depth - top), 0.0, 10.0)
