"""Reference state of a sensor, measured on the sensor alone.

In a user's scene, contact may exist from the first step on. The references are therefore taken in a
separate world, with rendered images and the pipeline of every rig. The resulting inflated membrane
is then copied into the user's scene.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import mujoco

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array
from mjtactile.rig.finger import Finger
from mjtactile.runtime.references import take_references
from mjtactile.sensing.pipeline import SensingPipeline
from mjtactile.sensing.pipeline_state import PipelineState
from mjtactile.sensing.stateful_pipeline import StatefulPipeline
from mjtactile.sim.attach import attach_membrane, configure_options
from mjtactile.sim.camera import SimCamera
from mjtactile.sim.devices import SimClock, SimValve
from mjtactile.sim.scenes.world import World


@dataclass(frozen=True, eq=False)
class Rest:
    """Reference state of a sensor with a sealed chamber and no contact.

    `displacements` (3 k,), m, frame S, are those of the interior mesh vertices. The pipeline's
    `state` holds both references.
    """

    displacements: Array
    gauge_pressure: float
    chain: SensingPipeline
    state: PipelineState


@lru_cache(maxsize=64)
def at_rest(
    design: SensorDesign, mesh: tuple[int, int], effects: frozenset[str], seed: int
) -> Rest:
    """Inflate one sensor alone and take its references. Raises DeviceError if that fails."""
    spec = mujoco.MjSpec()
    configure_options(spec)
    spec.option.gravity = [0.0, 0.0, 0.0]
    world = World(
        spec,
        [attach_membrane(spec, design, site=spec.worldbody.add_site(), mesh=mesh, effects=effects)],
    )
    sensor = world.sensors[0]
    clock = SimClock(world)
    finger = Finger("alone", design, SimCamera(sensor, seed, effects), SimValve(sensor))
    perception = StatefulPipeline.of(design)
    flat, rest = take_references([finger], clock)
    perception.measure_flat_reference(flat.images[0])
    perception.measure_rest_reference(rest.images[0], finger.pressure(rest.gauge_pressure[0]))
    clock.close()
    return Rest(sensor.displacements, sensor.gauge_pressure, perception.chain, perception.state)
