"""The two experiments on one fixed sensor: inflate it (bulge test), and drive an indenter into it,
as the paper does.

Both report the truth next to what theory or the sensing chain says; they are experiments, so they
may see the truth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjtactile.core import theory
from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Touch
from mjtactile.experiments.station import View, take_references
from mjtactile.run.estimate import press_errors
from mjtactile.sim import truth
from mjtactile.sim.scenes.indentation import Indenter, PressWorld
from mjtactile.sim.sensor.switches import Effect

_NOWHERE = Indenter("sphere", 1e-3)

Say = Callable[[str], None]


def inflate(
    design: SensorDesign,
    pressures: Sequence[float],
    *,
    mesh: tuple[int, int] | None = None,
    say: Say = lambda _: None,
) -> dict[str, Any]:
    """Bulge test at each gauge pressure, Pa; the JSON of `mjtactile inflate`."""
    world = _world(design, _NOWHERE, mesh=mesh)
    steps = []
    for pressure in pressures:
        converged = world.inflate(pressure, seal=False)
        sensor = world.sensors[0]
        stretch, area = sensor.stretch_and_area()

        steps.append(
            {
                "pressure_kPa": 1e-3 * pressure,
                "centre_height_mm": 1e3 * sensor.height_at(0.0, 0.0),
                "volume_mL": 1e6 * sensor.volume,
                "area_mm2": 1e6 * area,
                "max_stretch": stretch,
                "theory_height_mm": 1e3 * theory.bulge_height(design, pressure),
                "converged": converged,
            }
        )
        say(f"{steps[-1]['pressure_kPa']:.3g} kPa: {steps[-1]['centre_height_mm']:.3f} mm")
    return {"sensor": design.name, "steps": steps, "flags": world.flags}


@dataclass(frozen=True)
class PressPlan:
    """Where and how the indenter goes: `at` m in S, `depths` m below first touch, `tilt` rad,
    `shear` m along x after each depth, chamber sealed or with its valve open to the supply."""

    indenter: Indenter
    depths: Sequence[float]
    at: tuple[float, float] = (0.0, 0.0)
    tilt: float = 0.0
    shear: float = 0.0
    sealed: bool = True


def press(
    design: SensorDesign,
    plan: PressPlan,
    *,
    mesh: tuple[int, int] | None = None,
    seed: int = 0,
    say: Say = lambda _: None,
    error_estimate: bool = False,
    **simulation: Any,
) -> dict[str, Any]:
    """Drive the indenter in steps; the JSON of `mjtactile press`. Estimates come from rendered
    images alone.

    `error_estimate`: run again on a coarser mesh, and let every step report its own force error.
    `simulation`: `timestep` s and `effects` of the world.
    """
    world = _world(design, plan.indenter, at=plan.at, tilt=plan.tilt, mesh=mesh, **simulation)
    view = View(world, design, seed=seed, shadows=Effect.SHADOWS in simulation.get("effects", ()))
    take_references(world, [view], design.chamber.supply_gauge, sealed=plan.sealed)
    steps = []
    for depth in plan.depths:
        converged = world.press(depth)
        if plan.shear:
            converged = world.press(depth, plan.shear)
        steps.append(_step(world, view.touch(), converged))
        if plan.shear:
            world.press(depth)
        say(
            f"depth {1e3 * depth:.2f} mm: {-steps[-1]['force_true_N'][2]:.3f} N, "
            f"felt {-steps[-1]['force_estimated_N'][2]:.3f} N"
        )
    if error_estimate:
        grid = world.sensors[0].mesh
        errors = press_errors(
            lambda m, t: _bare_steps(design, plan, m, simulation | {"timestep": t}),
            steps,
            (grid.nx, grid.ny),
            world.timestep,
        )
        for step, error in zip(steps, errors, strict=True):
            step["force_error_estimate_N"] = error
    return {"sensor": design.name, "steps": steps, "flags": world.flags}


def _bare_steps(
    design: SensorDesign, plan: PressPlan, mesh: tuple[int, int], simulation: dict[str, Any]
) -> list[dict[str, Any]]:
    """The true forces of the same plan on another mesh, without a camera."""
    world = _world(design, plan.indenter, at=plan.at, tilt=plan.tilt, mesh=mesh, **simulation)
    world.inflate(design.chamber.supply_gauge, seal=plan.sealed)
    steps = []
    for depth in plan.depths:
        world.press(depth)
        if plan.shear:
            world.press(depth, plan.shear)
        steps.append({"force_true_N": truth.contact_force(world, 0)})
        if plan.shear:
            world.press(depth)
    return steps


def _step(world: PressWorld, touch: Touch, converged: bool) -> dict[str, Any]:
    """One row of the JSON."""
    sensor = world.sensors[0]
    wrench = touch.traction.wrench if touch.traction is not None else np.full(6, np.nan)
    area = touch.contact.area if touch.contact is not None else np.nan

    return {
        "depth_mm": 1e3 * world.depth,
        "force_true_N": truth.contact_force(world, 0),
        "drive_force_N": world.drive_force,
        "force_estimated_N": wrench[:3],
        "wrench_estimated": wrench,
        "force_estimated_sd_N": touch.force_normal_sd,
        "contact_area_mm2": 1e6 * area,
        "contact_area_true_mm2": 1e6 * truth.contact_area(world, 0),
        "penetration_mm": 1e3 * truth.penetration(world, 0),
        "pressure_kPa": 1e-3 * sensor.pressure_gauge,
        "volume_mL": 1e6 * sensor.volume,
        "converged": converged,
        "status": touch.status,
    }


def _world(
    design: SensorDesign, indenter: Indenter, *, mesh: tuple[int, int] | None, **placing: Any
) -> PressWorld:
    options: dict[str, Any] = placing if mesh is None else placing | {"mesh": mesh}
    return PressWorld(design, indenter, **options)
