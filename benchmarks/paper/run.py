"""`mjtactile experiments`: the Results of the paper, repeated in simulation, next to the paper's
numbers.

Figures have the paper's names (5a, 5b, 5c, 6, 7). "air" tests its claim that the amount of air sets
the sensitivity. The load cell reads the true contact force. Estimates come from rendered images
alone. Plots are in `benchmarks.paper.figures`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.paper.marker_accuracy import paper_like
from benchmarks.paper.marker_methods import compare_methods
from benchmarks.paper.sponge import Pad
from mjtactile.calibrate.force import AreaCalibration
from mjtactile.core.design import SensorDesign, load_sensor
from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.experiments.test_bench import TestBench
from mjtactile.sim.scenes.indentation import Indenter

CYLINDER = Indenter("cylinder", 6e-3)
SPONGE = Pad("pad", 6e-3, stiffness=250.0, stiffening=2.5e5)
# Figs. 5a and 5c: the default's vertices, 3.3 mm apart, do not resolve the cylinder's face
MESH = (33, 25)
DEPTHS = (1e-3, 2e-3, 3e-3, 4e-3, 5e-3)  # the paper's 1 mm increments, up to about its 2.5 N
# speed and depth of Fig. 5c, m/s and m
DRIVE_SPEED = 2e-3
DRIVE_DEPTH = 4e-3
PAPER_CIRCLE_ERROR = 0.39e-3  # mean centre error in the paper, m

Notify = Callable[[str], None]


def fig5a(notify: Notify, quick: bool = False) -> dict[str, Any]:
    """Compare load cell and estimate in 1 mm increments, valve closed and open.

    Methods are statics and the paper's dF = c dA.
    """
    rows = []
    for name in ("dense",) if quick else ("dense", "paper16", "fine"):
        for sealed in (True, False):
            rows.append(
                _increments(
                    load_sensor(name),
                    CYLINDER,
                    sealed=sealed,
                    depths=DEPTHS[:3] if quick else DEPTHS,
                )
            )
            notify(
                f"5a {name}, valve {'closed' if sealed else 'open'}: ours off by "
                f"{rows[-1]['error_ours_N']:.3f} N, dF = c dA by {rows[-1]['error_paper_N']:.3f} N"
            )
    return {"runs": rows}


def _increments(
    design: SensorDesign, indenter: Indenter, *, sealed: bool, depths: Sequence[float]
) -> dict[str, Any]:
    """Press in steps and estimate the force at each.

    c is fitted to the same points, the best case for the paper's method.
    """
    station = TestBench(design, indenter, mesh=MESH)
    station.zero(sealed=sealed)
    rest = station.measure(10)
    steps = []
    for depth in depths:
        station.world.press(depth)
        measured = station.measure(5)
        steps.append(
            {
                "depth_mm": 1e3 * depth,
                "cell_N": station.load_cell(),
                "ours_N": measured["force_N"],
                "area_change_mm2": measured["membrane_area_mm2"] - rest["membrane_area_mm2"],
            }
        )
    cell = np.array([s["cell_N"] for s in steps])
    area = 1e-6 * np.array([s["area_change_mm2"] for s in steps])
    try:
        constant = AreaCalibration.fit(area, cell).constant
    except InputError:  # the area shrank under load
        constant = float(area @ cell / (area @ area))
    for step, estimated in zip(steps, constant * area, strict=True):
        step["paper_N"] = estimated
    computed = np.array([s["ours_N"] for s in steps])
    return {
        "sensor": design.name,
        "valve": "closed" if sealed else "open",
        "constant_N_m2": constant,
        "steps": steps,
        "error_ours_N": float(np.nanmean(np.abs(computed - cell))),
        "unknown": int(np.isnan(computed).sum()),
        "error_paper_N": float(np.abs(constant * area - cell).mean()),
    }


def fig5b(notify: Notify, quick: bool = False) -> dict[str, Any]:
    """Measure force against deformation of a solid cylinder and of a sponge with the same face.

    A line and a parabola are fitted to each.
    """
    depths = np.arange(5e-4, 4.01e-3, 1e-3 if quick else 2.5e-4)
    curves = {}
    for name, indenter in (("solid", CYLINDER), ("sponge", SPONGE)):
        station = TestBench(load_sensor("dense"), indenter)
        station.zero()
        estimated = []
        given = []
        for depth in depths:
            station.world.press(float(depth))
            measured = station.measure(2)
            estimated.append(measured["force_N"])
            given.append(float(depth) - measured["indentation_mm"] * 1e-3)
        curves[name] = {
            "depth_mm": 1e3 * depths,
            "force_N": estimated,
            "own_deformation_mm": 1e3 * np.array(given),
            **_fits(depths, np.array(estimated)),
        }
        notify(
            f"5b {name}: linear fit leaves {1e3 * curves[name]['linear_rms_N']:.0f} mN, parabola "
            f"{1e3 * curves[name]['parabola_rms_N']:.0f} mN"
        )
    sponge = curves["sponge"]
    own = 1e-3 * np.array(sponge["own_deformation_mm"])
    force = np.array(sponge["force_N"])
    known = np.isfinite(own)  # no contact is detected at the lightest loads
    columns = np.column_stack([own, own**2])[known]  # undeformed, it has no force
    stiffness, stiffening = np.linalg.lstsq(columns, force[known], rcond=None)[0]
    curves["sponge_law"] = {
        "stiffness_N_m": float(stiffness),
        "stiffening_N_m2": float(stiffening),
        "stiffness_true_N_m": SPONGE.stiffness,
        "stiffening_true_N_m2": SPONGE.stiffening,
    }
    return curves


def _fits(depth: Array, force: Array) -> dict[str, float]:
    """Compute the rms residuals, N, of a line and a parabola through the origin, and their R^2."""
    d = depth
    f = force
    left = []
    for columns in (np.column_stack([d]), np.column_stack([d, d * d])):
        coefficients = np.linalg.lstsq(columns, f, rcond=None)[0]
        left.append(float(np.sqrt(np.mean((f - columns @ coefficients) ** 2))))
    return {
        "linear_rms_N": left[0],
        "parabola_rms_N": left[1],
        "linear_r2": 1 - left[0] ** 2 / float(np.var(f)),
        "parabola_r2": 1 - left[1] ** 2 / float(np.var(f)),
    }


def fig5c(notify: Notify, quick: bool = False) -> dict[str, Any]:
    """Measure the force over time while the sensor is driven into both objects, then held.

    The speed is constant, with one image each 1/30 s.
    """
    curves = {}
    for name, indenter in (("solid", CYLINDER), ("sponge", SPONGE)):
        station = TestBench(load_sensor("dense"), indenter, mesh=MESH)
        station.zero()
        station.world.press(-2e-4)
        start = station.world.time
        period = 1 / 30
        rows = []
        for step in range(round((DRIVE_DEPTH / DRIVE_SPEED + 0.5) / period)):
            depth = min(-2e-4 + DRIVE_SPEED * period * (step + 1), DRIVE_DEPTH)
            station.world.drive(
                depth, speed=DRIVE_SPEED
            ) if depth < DRIVE_DEPTH else station.world.step(8)
            if not (quick and step % 5):
                rows.append(
                    (station.world.time - start, station.measure()["force_N"], station.load_cell())
                )
        time, estimated, cell = np.array(rows).T
        curves[name] = {
            "time_s": time,
            "force_N": estimated,
            "cell_N": cell,
            "error_N": float(np.abs(estimated - cell).mean()),
        }
        notify(
            f"5c {name}: {estimated[-1]:.2f} N at the end, mean error "
            f"{curves[name]['error_N']:.3f} N"
        )
    return curves


def fig6(notify: Notify, quick: bool = False) -> dict[str, Any]:
    """Measure the mean error of circle centers in 15 images of 16 circles in known poses.

    The paper's own method is applied to such images for comparison.
    """
    summary, errors = paper_like(images=3 if quick else 15)
    methods = compare_methods(images=1 if quick else 5)
    notify(f"6: mean error {summary['mean_mm']:.4f} mm (paper {1e3 * PAPER_CIRCLE_ERROR:.2f} mm)")
    return {
        "summary": summary,
        "methods": methods,
        "distance_error_mm": 1e3 * np.linalg.norm(errors["error"], axis=1),
        "depth_error_mm": 1e3 * errors["error"][:, 2],
    }


OBJECTS = {
    "sphere, 8 mm": (Indenter("sphere", 8e-3), {}),
    "cylinder, 4 mm": (Indenter("cylinder", 4e-3), {"at": (5e-3, -2e-3)}),
    "box, 12 mm, tilted": (Indenter("box", 12e-3), {"tilt": np.deg2rad(8.0)}),
}


def fig7(notify: Notify, quick: bool = False) -> dict[str, Any]:
    """Return image, reconstructed membrane and nodal forces for three objects."""
    found = {}
    for name, (indenter, placing) in list(OBJECTS.items())[: 1 if quick else None]:
        station = TestBench(load_sensor("dense"), indenter, **placing)
        station.zero()
        station.world.press(2.5e-3)
        touch = station.touch()
        image = station.image()
        if touch.surface is None or touch.traction is None:
            continue
        surface = touch.surface
        traction = touch.traction
        found[name] = {
            "image": image.pixels,
            "x": surface.x,
            "y": surface.y,
            "z": surface.z,
            "grid_x": traction.x,
            "grid_y": traction.y,
            "force": traction.force,
            "force_N": touch.force_normal,
            "cell_N": station.load_cell(),
        }
        notify(
            f"7 {name}: estimated {touch.force_normal:.3f} N, load cell {station.load_cell():.3f} N"
        )
    return found


def air(notify: Notify, quick: bool = False) -> dict[str, Any]:
    """Measure the sensitivity at several supply pressures and amounts of air.

    The sensor is pressed by 1 mm with the valve closed.
    """
    base = load_sensor("dense")
    pressures = (500.0, 2000.0) if quick else (250.0, 500.0, 1000.0, 2000.0, 4000.0)
    depths = (5e-3, 20e-3) if quick else (2.5e-3, 5e-3, 10e-3, 20e-3)
    rows = [
        _sensitivity(replace(base, chamber=replace(base.chamber, supply_gauge=p)), sealed=True)
        for p in pressures
    ]
    rows += [
        _sensitivity(replace(base, chamber=replace(base.chamber, depth=d)), sealed=True)
        for d in depths
    ]
    rows.append(_sensitivity(base, sealed=False))
    for row in rows:
        notify(
            f"air {row['supply_kPa']:.2f} kPa, {row['air_mL']:.1f} mL, valve {row['valve']}: "
            f"{row['stiffness_N_mm']:.3f} N/mm, noise {1e3 * row['noise_N']:.2f} mN"
        )
    return {"runs": rows}


def _sensitivity(design: SensorDesign, *, sealed: bool) -> dict[str, Any]:
    """Measure the stiffness of a 6 mm cylinder over the first mm, N/mm, and the force noise.

    The noise is the standard deviation of the estimated force over 20 images without contact.
    """
    station = TestBench(design, CYLINDER)
    station.zero(sealed=sealed)
    noise = float(np.std([station.touch().force_normal for _ in range(20)], ddof=1))
    station.world.press(1e-3)
    measured = station.measure(5)
    return {
        "supply_kPa": 1e-3 * design.chamber.supply_gauge,
        "air_mL": 1e6 * station.world.sensors[0].volume,
        "valve": "closed" if sealed else "open",
        "stiffness_N_mm": station.load_cell(),
        "estimated_N": measured["force_N"],
        "noise_N": noise,
        "noise_um": 1e3 * noise / station.load_cell(),
    }


EXPERIMENTS: dict[str, Callable[..., dict[str, Any]]] = {
    "fig5a": fig5a,
    "fig5b": fig5b,
    "fig5c": fig5c,
    "fig6": fig6,
    "fig7": fig7,
    "air": air,
}


def run(
    names: Sequence[str], out: Path | None, *, quick: bool = False, notify: Notify = lambda _: None
) -> dict[str, Any]:
    """Run the named experiments and return their data; plot figures if `out` is given."""
    from benchmarks.paper import figures  # lazily: matplotlib is optional

    results: dict[str, Any] = {}
    for name in names:
        results[name] = EXPERIMENTS[name](notify, quick)
        if out is not None:
            figures.save(name, results[name], out)
    return results


def without_arrays(results: Mapping[str, Any]) -> dict[str, Any]:
    """Return the results without images and fields, for JSON."""
    plain = {}
    for key, value in results.items():
        if isinstance(value, np.ndarray) and value.ndim > 1:
            continue
        if isinstance(value, Mapping):
            plain[key] = without_arrays(value)
        elif isinstance(value, list):
            plain[key] = [without_arrays(v) if isinstance(v, Mapping) else v for v in value]
        else:
            plain[key] = value
    return plain
