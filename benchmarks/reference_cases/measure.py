"""Measured numbers of a case, next to their references.

They come from the simulation and, where required, from the sensing pipeline.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from benchmarks.reference_cases.cases import Case
from benchmarks.scenes.stress_scenes import FloatWorld, FreeObject, PinchWorld
from mjtactile.core.types import Array
from mjtactile.experiments.test_bench import View, take_references
from mjtactile.sim import ground_truth
from mjtactile.sim.scenes.indentation import Indenter, PressWorld
from mjtactile.sim.scenes.world import World

# allowed error of an estimated force, N, and in its own standard deviations
FORCE_MIN = 0.04
FORCE_SD = 3.0
ESTIMATE = "estimated normal force"
"""Kind of the numbers whose reference is the simulated force."""
_IMAGES = 3  # images per load: the sd is inflated in the first image after a change of the force
# steps over which a force at rest is averaged: the solver's tolerance rocks it by 0.3-0.5 %
_REST = 20


@dataclass(frozen=True)
class Number:
    """One `measured` number and its `reference`, in `unit`.

    `at` names a depth, pressure or time step. `allowed` is the allowed deviation. An estimated
    force has its own standard deviation `sd`.
    """

    quantity: str
    at: str
    unit: str
    reference: float
    measured: float
    allowed: float
    sd: float | None = None
    flags: tuple[str, ...] = ()

    @property
    def error(self) -> float:
        return self.measured - self.reference

    @property
    def is_met(self) -> bool:
        return abs(self.error) <= self.allowed


def measure(case: Case) -> list[Number]:
    """Run a case. Raises SimulationError, and InputError for an indenter that does not exist."""
    return _MEASURES[case.motion](case)


def _indenter(case: Case) -> Indenter:
    """Return the case's indenter; its files lie next to the case."""
    text = case.plan["indenter"]
    return Indenter.parse(
        str(case.path.parent / text) if text.lower().endswith((".stl", ".xml")) else text
    )


def _press(case: Case) -> list[Number]:
    plan = case.plan
    numbers = []
    x, y = plan["at_mm"]
    world = PressWorld(case.design, _indenter(case), at=(1e-3 * x, 1e-3 * y))
    gauge = case.design.chamber.supply_gauge
    view = View(world, case.design) if plan["is_estimated"] and plan["force"] else None
    take_references(world, [view] if view else [], gauge)
    for depth, reference in plan["force"]:
        world.press(1e-3 * depth)
        at = f"{depth:g} mm"
        force = -float(_at_rest(world)[2])
        numbers.append(
            Number(
                "normal force",
                at,
                "N",
                reference,
                force,
                case.allows(reference),
                flags=tuple(world.flags),
            )
        )
        if view is not None:
            touch = [view.touch() for _ in range(_IMAGES)][-1]
            numbers.append(
                Number(
                    ESTIMATE,
                    at,
                    "N",
                    force,
                    touch.force_normal,
                    max(FORCE_MIN, FORCE_SD * touch.force_normal_sd),
                    touch.force_normal_sd,
                )
            )
    if plan["shear"] is not None:
        numbers += _shear(case, world)
    return numbers


def _shear(case: Case, world: PressWorld) -> list[Number]:
    """Compare the shear vector at `depth_mm` after the drag with the reference."""
    plan = case.plan
    depth, drag = (1e-3 * float(plan[key]) for key in ("depth_mm", "drag_mm"))
    world.press(depth)
    if drag:
        world.press(depth, drag)
    goal = np.array(plan["shear"])
    found = _at_rest(world)[:2]
    size = float(np.linalg.norm(goal))
    direction = goal / size if size else np.zeros(2)
    at = f"{plan['depth_mm']:g} mm deep, dragged {plan['drag_mm']:g} mm"
    along = float(found @ direction)
    across = float(np.linalg.norm(found - (found @ direction) * direction))
    return [
        Number("shear", at, "N", size, along, case.allows(size)),
        Number("shear perpendicular to the reference", at, "N", 0.0, across, case.allows(size)),
    ]


def _at_rest(world: World, steps: int = _REST) -> np.ndarray:
    forces = []
    for _ in range(steps):
        world.step()
        forces.append(ground_truth.contact_force(world, 0))
    return np.mean(forces, axis=0)


def _bulge(case: Case) -> list[Number]:
    world = PressWorld(case.design, Indenter("sphere", 5e-3))
    numbers = []
    for gauge, reference in case.plan["height"]:
        world.inflate(1e3 * gauge, seal=False)
        numbers.append(
            Number(
                "height",
                f"{gauge:g} kPa",
                "mm",
                reference,
                1e3 * world.sensors[0].height_at(0.0, 0.0),
                case.allows(reference),
                flags=tuple(world.flags),
            )
        )
    return numbers


def _hold(case: Case) -> list[Number]:
    """Measure the speed at which a held object sinks, um/s, by a line fit to its heights."""
    plan = case.plan
    numbers = []
    for step in plan["timestep_ms"]:
        body = FreeObject(plan["body"], 1e-3 * plan["size_mm"], 1e-3 * plan["mass_g"])
        world = PinchWorld(
            case.design,
            body,
            gauge_pressure=case.design.chamber.supply_gauge,
            squeeze=1e-3 * plan["squeeze_mm"],
            timestep=1e-3 * step,
        )
        world.step(round(0.5 / world.timestep))
        grip = -sum(float(ground_truth.contact_force(world, sensor)[2]) for sensor in range(2))
        margin = case.design.membrane.friction * grip / world.weight
        times = []
        drops = []
        for _ in range(40):
            world.step(round(plan["seconds"] / 40 / world.timestep))
            times.append(world.time)
            drops.append(world.drop)
        creep = 1e6 * float(np.polyfit(times, drops, 1)[0])
        numbers.append(
            Number(
                f"creep at {margin:.1f} times the required friction",
                f"{step:g} ms",
                "um/s",
                0.0,
                creep,
                case.allows(0.0),
            )
        )
    return numbers


def _dragged(case: Case, step: float) -> PressWorld:
    world = PressWorld(case.design, _indenter(case), timestep=1e-3 * step)
    world.inflate(case.design.chamber.supply_gauge, seal=True)
    world.press(1e-3 * case.plan["depth_mm"])
    return world


def _held_shear(case: Case) -> list[Number]:
    plan = case.plan
    numbers = []
    for step in plan["timestep_ms"]:
        world = _dragged(case, step)
        world.press(1e-3 * plan["depth_mm"], 1e-3 * plan["drag_mm"])
        world.step(round(0.5 / world.timestep))
        before = _at_rest(world, 50)[0]
        world.step(round(plan["seconds"] / world.timestep))
        fraction = float(_at_rest(world, 50)[0] / before)
        numbers.append(
            Number(
                f"remaining fraction of shear after {plan['seconds']:g} s",
                f"{step:g} ms",
                "",
                1.0,
                fraction,
                case.allows(1.0),
            )
        )
    return numbers


def _slide(case: Case) -> list[Number]:
    """Measure the friction of a sliding indenter over mu N, in both directions."""
    return [
        Number(
            "friction along the slide / (mu N)",
            f"{step:g} ms, {name}",
            "",
            1.0,
            _slid(case, step, sign),
            case.allows(1.0),
        )
        for step in case.plan["timestep_ms"]
        for sign, name in ((1.0, "+x"), (-1.0, "-x"))
    ]


def _slid(case: Case, step: float, sign: float) -> float:
    """Return the mean over the last third of a slide, well after its start."""
    plan = case.plan
    world = _dragged(case, step)
    fractions = []
    mu = case.design.membrane.friction
    direction = np.array([sign, 0.0, 0.0])
    world.after_each_step(lambda: fractions.append(_friction_along(world, 0, mu, direction)))
    world.drive(
        1e-3 * plan["depth_mm"], sign * 1e-3 * plan["drag_mm"], speed=1e-3 * plan["speed_mm_s"]
    )
    return float(np.mean(fractions[2 * len(fractions) // 3 :]))


def _spin(case: Case) -> list[Number]:
    """Compare the angular momentum of an inflated, freely rotating sensor after and before."""
    plan = case.plan
    numbers = []
    axis = np.array(plan["axis"]) / np.linalg.norm(plan["axis"])
    for step in plan["timestep_ms"]:
        world = FloatWorld(
            case.design, gauge_pressure=case.design.chamber.supply_gauge, timestep=1e-3 * step
        )
        world.turn(plan["speed_rad_s"] * axis)
        before = world.angular_momentum
        world.step(round(plan["seconds"] / world.timestep))
        numbers.append(
            Number(
                f"remaining fraction of angular momentum after {plan['seconds']:g} s",
                f"{step:g} ms",
                "",
                1.0,
                world.angular_momentum / before,
                case.allows(1.0),
            )
        )
    return numbers


_MEASURES: dict[str, Callable[[Case], list[Number]]] = {
    "press": _press,
    "bulge": _bulge,
    "hold": _hold,
    "held_shear": _held_shear,
    "slide": _slide,
    "spin": _spin,
}


def _friction_along(world: World, sensor: int, mu: float, direction: Array) -> float:
    """Return the friction on membrane `sensor` along `direction` (3,) over `mu` times the normal
    force.

    The direction, in W, is projected onto each contact's plane. The result is 1 if all of the
    membrane is dragged in that direction, -1 in the opposite direction.
    """
    data = world.data
    device = world.sensors[sensor]
    force = np.zeros(6)
    sums = np.zeros(2)
    on_membrane = np.isin(data.contact.geom, device.vertex_geom_ids)
    for row in np.flatnonzero(on_membrane.any(axis=1) & (data.contact.efc_address >= 0)):
        mujoco.mj_contactForce(world.model, data, row, force)
        axes = data.contact.frame[row].reshape(3, 3)
        # direction of the friction force, which acts on the contact's second geom
        plane = axes[1:] @ direction
        sums += (
            (1 if on_membrane[row, 1] else -1) * (force[1:3] @ plane) / np.linalg.norm(plane),
            mu * force[0],
        )
    return float(sums[0] / sums[1])
