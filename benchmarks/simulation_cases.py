"""Simulator settings varied in the benchmarks, and the two experiments that measure each of them.

Accuracy is measured on one sensor, into which spheres are driven to a given depth; the force is the
result. Cost and noise are measured on two sensors that hold an egg, the simulator's main
application. Times are core time, so that other load on the machine has little effect. Compare only
ratios of one run.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import MjtactileError
from mjtactile.core.types import Array
from mjtactile.sim import ground_truth
from mjtactile.sim.attach import DEFAULT_MESH
from mjtactile.sim.scenes.grasp_world import GraspWorld
from mjtactile.sim.scenes.indentation import Indenter, PressWorld

HOLD_FORCE = 0.6  # hold force on each finger, N
SENSOR = "dense"


@dataclass(frozen=True)
class Setting:
    """`mesh` vertices along x, y; `timestep` s; CG `tolerance` and `iterations`; `softness` scales
    the depth to which objects sink into the membrane."""

    mesh: tuple[int, int] = DEFAULT_MESH
    timestep: float = 1 / 240
    tolerance: float = 1e-7
    iterations: int = 300
    softness: float = 1.0

    def apply(self, world: Any) -> None:
        option = world.model.opt
        option.tolerance = self.tolerance
        option.iterations = self.iterations
        for sensor in world.sensors:
            world.model.geom_solref[sensor.vertex_geom_ids, 0] *= np.sqrt(self.softness)

    def summary(self) -> dict[str, Any]:
        return {
            "mesh": list(self.mesh),
            "timestep_ms": 1e3 * self.timestep,
            "tolerance": self.tolerance,
            "iterations": self.iterations,
            "softness": self.softness,
        }


@dataclass(frozen=True)
class Case:
    """A sphere of `radius` m driven `depth` m below first touch at `at` m."""

    radius: float
    depth: float
    at: tuple[float, float]


# The positions are no symmetry points of any mesh: the error of a coarse mesh depends on where the
# vertices are.
CASES = (
    Case(16e-3, 2.5e-3, (0.7e-3, 0.4e-3)),
    Case(16e-3, 2.0e-3, (-3.1e-3, 2.3e-3)),
    Case(8e-3, 2.0e-3, (1.9e-3, -1.2e-3)),
    Case(8e-3, 1.0e-3, (-4.7e-3, 3.1e-3)),
)


@dataclass(frozen=True, eq=False)
class Pressed:
    """Result of a load: normal `force`, N, marker positions `p_SM` (N, 3), m, `penetration`, m."""

    force: float
    p_SM: Array
    penetration: float


def press(setting: Setting, case: Case, design: SensorDesign | str = SENSOR) -> Pressed:
    """Inflate to 1 kPa, seal, press, settle, and average over 20 steps. Raises SimulationError."""
    world = PressWorld(
        design,
        Indenter("sphere", case.radius),
        at=case.at,
        timestep=setting.timestep,
        mesh=setting.mesh,
    )
    setting.apply(world)
    world.inflate(1000.0, seal=True)
    world.press(case.depth)
    forces = []
    places = []
    for _ in range(20):
        world.step()
        forces.append(-ground_truth.contact_force(world, 0)[2])
        places.append(world.marker_poses(0)[0])
    return Pressed(
        float(np.mean(forces)), np.mean(places, axis=0), ground_truth.penetration(world, 0)
    )


def held(
    setting: Setting,
    *,
    grasped: str = "egg",
    design: SensorDesign | str = SENSOR,
    settle: float = 0.8,
) -> GraspWorld:
    """Simulate two sealed sensors that hold `grasped` in the air, at rest.

    Raises:
        SimulationError: The simulation failed.
    """
    world = GraspWorld(design, grasped, timestep=setting.timestep, mesh=setting.mesh, opening=0.05)
    setting.apply(world)
    return hold(world, settle)


def hold(world: GraspWorld, settle: float = 0.8) -> GraspWorld:
    """Inflate, seal, close on the object, lift it by 10 mm, and wait."""

    def run(seconds: float) -> None:
        world.step(max(1, round(seconds / world.timestep)))

    for sensor in range(len(world.sensors)):
        world.sensors[sensor].open_valve()
    run(0.15)
    for sensor in range(len(world.sensors)):
        world.sensors[sensor].close_valve()
    world.set_finger_target(0.01, HOLD_FORCE)
    run(1.0)
    world.set_lift_target(0.01)
    run(settle)
    return world


def core_ms(action: Callable[[], Any], count: int) -> float:
    """Measure the core time of one `action()`, ms: the minimum of five bursts.

    Other load on the machine only adds time.
    """
    return in_turns([action], max(count // 5, 1), rounds=5)[0]


def in_turns(actions: Sequence[Callable[[], Any]], count: int, rounds: int = 12) -> list[float]:
    """Measure the core time of each action, ms: the minimum over its bursts of `count`.

    The bursts of all actions alternate.
    """
    minimum = [math.inf] * len(actions)
    for _ in range(rounds):
        for k, action in enumerate(actions):
            start = time.thread_time()
            for _ in range(count):
                action()
            minimum[k] = min(minimum[k], 1e3 * (time.thread_time() - start) / count)
    return minimum


def cost_and_noise(setting: Setting, seconds: float = 0.6) -> dict[str, float]:
    """Measure cost, force noise and solver iterations while holding.

    The cost is in ms per simulated second, the noise a standard deviation in N, the iterations are
    per step.
    """
    world = held(setting)
    ms = core_ms(world.step, round(seconds / setting.timestep))
    forces = []
    iterations = []
    for _ in range(round(0.2 / setting.timestep)):
        world.step()
        forces.append([ground_truth.contact_force(world, i)[2] for i in range(len(world.sensors))])
        iterations.append(int(world.data.solver_niter[0]))
    return {
        "ms_per_s": ms / setting.timestep,
        "ms_per_step": ms,
        "force_noise_N": float(np.std(forces, axis=0).mean()),
        "iterations_mean": float(np.mean(iterations)),
        "penetration_um": 1e6
        * max(ground_truth.penetration(world, i) for i in range(len(world.sensors))),
    }


def attempt(measure: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Return the measurement, or {"failed": reason} if the setting cannot be run."""
    try:
        return measure()
    except MjtactileError as error:
        return {"failed": " ".join(str(error).split())}
