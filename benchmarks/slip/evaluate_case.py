"""One case viewed by both cameras: the estimate from each image, and the true slip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.scenes.slip_cases import SlipCase
from benchmarks.scenes.slip_world import SlipWorld
from benchmarks.slip.operating_curve import ScaledDetectors
from mjtactile.core.design import SensorDesign
from mjtactile.core.flags import Flags
from mjtactile.core.types import Touch
from mjtactile.sensing.pipeline import SensingPipeline
from mjtactile.sensing.pipeline_state import PipelineState
from mjtactile.sim import ground_truth
from mjtactile.sim.attach import DEFAULT_MESH
from mjtactile.sim.rendering.renderer import Renderer

# images averaged for a reference; duration of the load, s; sliding distance that ends a case, m
_IMAGES = 10
_SECONDS = 1.5
_ENOUGH = 2e-3
# fractions of the friction limit: above, all slides; below, a part sticks again
_GROSS = 0.95
_STILL = 0.85


@dataclass(frozen=True, eq=False)
class Sample:
    """One image of one finger: its `touch` and the ground truth.

    The true values are `force`, N, and `used`, the fraction of the friction limit. `slid`, m, is
    the sliding distance since the whole contact began to slide (0 before), at `onset`, s (NaN: not
    yet). `signs` states, for each scale of the operating curve, if the image shows slip.
    """

    time: float
    touch: Touch
    force: float
    used: float
    slid: float
    onset: float
    signs: tuple[bool, ...]


@dataclass(frozen=True, eq=False)
class Watched:
    """Images of the left and the right finger from the start of the load, and the simulation's
    `flags`."""

    fingers: tuple[list[Sample], list[Sample]]
    flags: Flags


class _Slider:
    """Sliding distance of a membrane over the object since its whole contact began to slide."""

    def __init__(self) -> None:
        self.slid = 0.0
        self.onset = np.nan
        self.sliding = False

    def update(self, time: float, step: float, used: float, speed: float) -> None:
        if not self.sliding and used >= _GROSS:
            self.sliding = True
            if self.slid == 0.0:
                self.onset = time
        elif used < _STILL:
            self.sliding = False
        self.slid += step * speed if self.sliding else 0.0


def references(
    design: SensorDesign,
    sensing_pipeline: SensingPipeline,
    case: SlipCase,
    mesh: tuple[int, int] = DEFAULT_MESH,
) -> PipelineState:
    """Measure the sensor's references from its flat and inflated images."""
    world = SlipWorld(design, case, mesh=mesh)
    renderer = Renderer(design, seed=case.seed)
    state = sensing_pipeline.initial_state()
    world.inflate(0.0)
    state = sensing_pipeline.measure_flat_reference(
        state, [renderer.render(*world.marker_poses(0), world.time) for _ in range(_IMAGES)]
    )
    supply = design.chamber.supply_gauge
    world.inflate(supply)
    return sensing_pipeline.measure_rest_reference(
        state, [renderer.render(*world.marker_poses(0), world.time) for _ in range(_IMAGES)], supply
    )


def watch(
    design: SensorDesign,
    sensing_pipeline: SensingPipeline,
    rest: PipelineState,
    case: SlipCase,
    mesh: tuple[int, int] = DEFAULT_MESH,
    test: bool = False,
) -> Watched:
    """Grip and load the case's object; with `test` the grip is modulated meanwhile.

    Raises:
        SimulationError: The case cannot be simulated.
    """
    world = SlipWorld(design, case, mesh=mesh, test=test)
    world.inflate(design.chamber.supply_gauge)
    renderers = [Renderer(design, seed=2 * case.seed + k) for k in range(2)]
    states = [rest, rest]
    sliders = (_Slider(), _Slider())
    detectors = (ScaledDetectors(sensing_pipeline), ScaledDetectors(sensing_pipeline))
    fingers: tuple[list[Sample], list[Sample]] = ([], [])
    period = round(1 / (design.camera.rate * world.timestep))

    def see(keep: bool) -> None:
        if world.step_count % period:
            return
        for k, (renderer, slider) in enumerate(zip(renderers, sliders, strict=True)):
            image = renderer.render(*world.marker_poses(k), world.time)
            touch, states[k] = sensing_pipeline.step(states[k], image, world.time)
            signs = detectors[k].detect(touch, states[k])
            if keep:
                used, _ = ground_truth.sliding(world, k)
                true = (world.press(k), used, slider.slid, slider.onset)
                fingers[k].append(Sample(world.time, touch, *true, signs))

    for _ in world.grip():
        see(keep=False)
    for _ in world.load(_SECONDS):
        for k, slider in enumerate(sliders):
            slider.update(world.time, world.timestep, *ground_truth.sliding(world, k))
        see(keep=True)
        slid = [slider.slid for slider in sliders]
        if min(slid) > _ENOUGH or max(slid) > 2 * _ENOUGH:
            break
    return Watched(fingers, world.flags)
