"""Two experiments on one fixed sensor: bulge test, and indentation as in the paper.

Both report ground truth next to theory or the sensing pipeline's estimate. They are experiments, so
access to ground truth is allowed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.effect_names import Effect
from mjtactile.core.errors import SimulationError
from mjtactile.core.flags import Reasons
from mjtactile.core.ritz_bulge import GRAVITY, inflated_height
from mjtactile.core.types import ContactShape, Touch
from mjtactile.experiments.test_bench import View, take_references
from mjtactile.runtime.discretization_error import press_errors
from mjtactile.sim import ground_truth
from mjtactile.sim.attach import default_mesh
from mjtactile.sim.scenes.indentation import Indenter, PressWorld
from mjtactile.sim.sensor.mesh import make_mesh

_COARSEST = 1.7e-3  # vertex spacing, m; marker heights are then 25 um off, as from pixel noise
_NOWHERE = Indenter("sphere", 1e-3)

Notify = Callable[[str], None]


def inflate(
    design: SensorDesign,
    pressures: Sequence[float],
    *,
    mesh: tuple[int, int] | None = None,
    notify: Notify = lambda _: None,
    keep_partial: bool = False,
) -> dict[str, Any]:
    """Simulate a bulge test at each gauge pressure, Pa; return the JSON of `mjtactile inflate`.

    `keep_partial`: as for `press`.
    """
    world = _world(design, _NOWHERE, mesh=mesh)
    steps, stopped = _until_stopped(_bulges(world, pressures), notify, keep_partial)
    return {"sensor": design.name, "steps": steps, "stopped": stopped, "flags": world.flags}


def _bulges(world: PressWorld, pressures: Sequence[float]) -> Iterator[tuple[dict[str, Any], str]]:
    """Inflate to each pressure, Pa; yield its row of the JSON, and a message."""
    for pressure in pressures:
        converged = world.inflate(pressure, seal=False)
        sensor = world.sensors[0]
        stretch, area = sensor.stretch_and_area()
        height = 1e3 * sensor.height_at(0.0, 0.0)
        step = {
            "pressure_kPa": 1e-3 * pressure,
            "centre_height_mm": height,
            "volume_mL": 1e6 * sensor.volume,
            "area_mm2": 1e6 * area,
            "max_stretch": stretch,
            "theory_height_mm": 1e3 * inflated_height(world.design, pressure, gravity=GRAVITY),
            "converged": converged,
        }
        yield step, f"{1e-3 * pressure:.3g} kPa: {height:.3f} mm"


def _until_stopped(
    steps: Iterable[tuple[dict[str, Any], str]], notify: Notify, keep_partial: bool
) -> tuple[list[dict[str, Any]], str | None]:
    """Return the completed rows, and the reason if the simulation failed or was interrupted after
    the first; without `keep_partial`, raise then."""
    done: list[dict[str, Any]] = []
    try:
        for step, message in steps:
            done.append(step)
            notify(message)
    except (KeyboardInterrupt, SimulationError) as error:
        if not (done and keep_partial):
            raise
        return done, str(error) or "interrupted"
    return done, None


@dataclass(frozen=True)
class IndentationPlan:
    """Path of the indenter.

    `at` is the position in S, m. `depths` are below first contact, m. `tilt` is in rad. `shear` is
    a motion along x after each depth, m. The chamber is sealed, or its valve is open to the
    supply.
    """

    indenter: Indenter
    depths: Sequence[float]
    at: tuple[float, float] = (0.0, 0.0)
    tilt: float = 0.0
    shear: float = 0.0
    sealed: bool = True


def press(
    design: SensorDesign,
    plan: IndentationPlan,
    *,
    mesh: tuple[int, int] | None = None,
    seed: int = 0,
    notify: Notify = lambda _: None,
    error_estimate: bool = False,
    keep_partial: bool = False,
    **simulation: Any,
) -> dict[str, Any]:
    """Drive the indenter in steps; return the JSON of `mjtactile press`.

    Estimates come from rendered images alone. `error_estimate`: True to run again on a coarser
    mesh, so that every step reports its own force error. `keep_partial`: True to return the
    completed steps, with the reason under "stopped", after an interruption or a SimulationError.
    `simulation`: `timestep` s and `effects` of the world.
    """
    world = _world(design, plan.indenter, at=plan.at, tilt=plan.tilt, mesh=mesh, **simulation)
    world.update_flags(_coarse(world))
    shadows = Effect.SHADOWS in simulation.get("effects", ())
    view = View(world, design, seed=seed, shadows=shadows, gauge=True, contact_shapes=None)
    take_references(world, [view], design.chamber.supply_gauge, sealed=plan.sealed)
    touches: list[Touch] = []
    rows = _indentations(world, view, plan, touches)
    steps, stopped = _until_stopped(rows, notify, keep_partial)
    grid = world.sensors[0].mesh
    if error_estimate and not stopped:
        errors = press_errors(
            lambda m, t: _bare_steps(design, plan, m, simulation | {"timestep": t}),
            steps,
            (grid.nx, grid.ny),
            world.timestep,
        )
        for step, error in zip(steps, errors, strict=True):
            step["force_error_estimate_N"] = error
    return {
        "sensor": design.name,
        "mesh": [grid.nx, grid.ny],
        "steps": steps,
        "shape": shape_report(view.perception.shape(touches)),
        "stopped": stopped,
        "flags": view.flags,
    }


def _indentations(
    world: PressWorld, view: View, plan: IndentationPlan, touches: list[Touch]
) -> Iterator[tuple[dict[str, Any], str]]:
    """Drive to each depth and append its touch; yield its row of the JSON, and a message."""
    for depth in plan.depths:
        converged = world.press(depth)
        if plan.shear:
            converged = world.press(depth, plan.shear)
        touches.append(view.settled_touch())
        step = _step(world, touches[-1], converged)
        if plan.shear:
            world.press(depth)
        true, estimated = (-step[f"force_{kind}_N"][2] for kind in ("true", "estimated"))
        yield step, f"depth {1e3 * depth:.2f} mm: {true:.3f} N, estimated {estimated:.3f} N"


def shape_report(shape: ContactShape) -> dict[str, Any]:
    """Convert a shape to JSON, in mm and degrees; unknown values become None.

    Args:
        shape: Estimated shape.

    Returns:
        The "shape" entry of the JSON.
    """

    def known(value: float, factor: float = 1.0) -> float | None:
        return factor * float(value) if np.isfinite(value) else None

    def pair(values: Any, factor: float = 1.0) -> list[float | None]:
        return [known(value, factor) for value in values]

    return {
        "kind": shape.kind,
        "family": shape.family,
        "probabilities": {name: known(p) for name, p in shape.probabilities.items()},
        "curvatures_per_m": pair(shape.curvatures),
        "curvatures_sd_per_m": pair(shape.curvatures_sd),
        "radius_mm": known(shape.radius, 1e3),
        "radius_sd_mm": known(shape.radius_sd, 1e3),
        "direction_deg": known(shape.direction, np.degrees(1)),
        "direction_sd_deg": known(shape.direction_sd, np.degrees(1)),
        "area_mm2": known(shape.area, 1e6),
        "area_interval_mm2": pair(shape.area_interval, 1e6),
        "force_normal_N": known(shape.force_normal),
        "pose": {
            "p_SO_mm": pair(shape.p_SO, 1e3),
            "p_SO_sd_mm": pair(np.sqrt(np.diag(shape.pose_cov)[:3]), 1e3),
            "R_SO": [pair(row) for row in shape.R_SO],
        },
        "outline_mm": (1e3 * shape.outline).round(3).tolist(),
        "misfit": known(shape.misfit),
        "status": str(shape.status),
        "parts": [shape_report(part) for part in shape.parts],
    }


def shape_mesh(design: SensorDesign) -> tuple[int, int]:
    """Return the number of vertices along x and y that contact shapes require.

    Args:
        design: Sensor.

    Returns:
        The default mesh, with its spacing halved until it is at most 1.7 mm.
    """
    frame = design.frame
    nx, ny = default_mesh(design)
    while (
        2 * max(nx, ny) - 1 <= 101
        and make_mesh(frame.length, frame.width, nx, ny, outline=frame.outline).spacing > _COARSEST
    ):
        nx, ny = 2 * nx - 1, 2 * ny - 1
    return nx, ny


def with_shape_mesh(
    design: SensorDesign, simulation: dict[str, Any], notify: Notify = lambda _: None
) -> dict[str, Any]:
    """Return the settings with the mesh that contact shapes require, unless they have a mesh.

    Args:
        design: Sensor.
        simulation: Settings of the world, with its `effects`.
        notify: Receiver of a message about the mesh and its cost.

    Returns:
        The settings; unchanged without the effect "mesh".
    """
    if "mesh" in simulation or Effect.MESH not in simulation["effects"]:
        return simulation
    nx, ny = shape_mesh(design)
    coarse = default_mesh(design)
    if (nx, ny) != coarse:
        notify(
            f"mesh of {nx} x {ny} vertices for the contact shape; for forces alone "
            f"--mesh {coarse[0]}x{coarse[1]} is sufficient and about 1.5 times as fast"
        )
    return simulation | {"mesh": (nx, ny)}


def _coarse(world: PressWorld) -> Reasons:
    """Return a flag if the mesh of the simulated membrane is too coarse for the contact shape."""
    mesh = world.sensors[0].mesh
    if mesh.spacing <= _COARSEST:
        return {}
    nx, ny = shape_mesh(world.design)
    return {
        "shape": (
            f"the simulated membrane bends only at its vertices, {1e3 * mesh.spacing:.1f} mm "
            f"apart on {mesh.nx} x {mesh.ny}, which limits the contact shape; --mesh {nx}x{ny} "
            "has the shape of real rubber"
        )
    }


def _bare_steps(
    design: SensorDesign, plan: IndentationPlan, mesh: tuple[int, int], simulation: dict[str, Any]
) -> list[dict[str, Any]]:
    """Return the true forces of the same plan on another mesh, without a camera."""
    world = _world(design, plan.indenter, at=plan.at, tilt=plan.tilt, mesh=mesh, **simulation)
    world.inflate(design.chamber.supply_gauge, seal=plan.sealed)
    steps = []
    for depth in plan.depths:
        world.press(depth)
        if plan.shear:
            world.press(depth, plan.shear)
        steps.append({"force_true_N": ground_truth.contact_force(world, 0)})
        if plan.shear:
            world.press(depth)
    return steps


def _step(world: PressWorld, touch: Touch, converged: bool) -> dict[str, Any]:
    """Return one row of the JSON."""
    sensor = world.sensors[0]
    wrench = touch.traction.wrench if touch.traction is not None else np.full(6, np.nan)
    contact = touch.contact
    area = np.nan if contact is None else contact.area
    interval = np.full(2, np.nan) if contact is None else contact.area_interval
    return {
        "depth_mm": 1e3 * world.depth,
        "force_true_N": ground_truth.contact_force(world, 0),
        "drive_force_N": world.drive_force,
        "force_estimated_N": wrench[:3],
        "wrench_estimated": wrench,
        "force_estimated_sd_N": touch.force_normal_sd,
        "contact_area_mm2": 1e6 * area,
        "contact_area_interval_mm2": 1e6 * interval,
        "contact_area_true_mm2": 1e6 * ground_truth.contact_area(world, 0),
        "penetration_mm": 1e3 * ground_truth.penetration(world, 0),
        "pressure_kPa": 1e-3 * sensor.gauge_pressure,
        "volume_mL": 1e6 * sensor.volume,
        "converged": converged,
        "status": touch.status,
    }


def _world(
    design: SensorDesign, indenter: Indenter, *, mesh: tuple[int, int] | None, **placing: Any
) -> PressWorld:
    options: dict[str, Any] = placing if mesh is None else placing | {"mesh": mesh}
    return PressWorld(design, indenter, **options)
