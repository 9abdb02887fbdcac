"""`mjtactile bench sensors`: the shipped marker layouts on one simulated membrane.

It shows the gain from more and smaller markers, and their cost. Balls, a disc and a box press on a
membrane whose mesh is fine enough to deform like rubber. The positions were not used for tuning.
Each sensor's camera views it with its own markers.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core.design import load_sensor
from mjtactile.experiments.test_bench import View, take_references
from mjtactile.runtime.progress import Progress
from mjtactile.sim import ground_truth
from mjtactile.sim.scenes.indentation import Indenter, PressWorld

SENSORS = ("paper16", "dense", "fine", "round30", "ellipse")
MESH = (33, 25)
INDENTERS = (("sphere", 7e-3), ("sphere", 14e-3), ("cylinder", 4.5e-3), ("box", 8e-3))
DEPTHS = (1e-3, 1.5e-3, 2e-3)
IMAGES = 4
_BALLS = ("sphere",)


def run(out: Path, quick: bool = False) -> dict[str, Any]:
    """Press each indenter into each sensor; four minutes of a processor.

    Args:
        out: Not used.
        quick: One indenter.

    Returns:
        "rows", one per sensor.
    """
    del out
    notify = Progress().message
    rows = []
    for name in SENSORS:
        rows.append(_row(name, INDENTERS[:1] if quick else INDENTERS))
        notify(f"{name}: normal force off by {1e3 * rows[-1]['force_error_N']:.1f} mN")
    return {"rows": rows}


def _row(name: str, indenters: tuple[tuple[str, float], ...]) -> dict[str, Any]:
    design = load_sensor(name)
    force: list[float] = []
    marker: list[float] = []
    area: list[float] = []
    radius: list[float] = []
    spent = np.zeros(3)  # processing times, ms: rendering, perception, shape
    images = shapes = 0
    for number, (kind, size) in enumerate(indenters):
        rng = np.random.default_rng([number, 77])
        at = tuple(rng.uniform(-4e-3, 4e-3, 2))
        world = PressWorld(design, Indenter(kind, size), at=at, mesh=MESH)
        view = View(world, design, seed=number)
        take_references(world, [view], design.chamber.supply_gauge)
        for depth in DEPTHS:
            world.press(depth)
            true = -float(ground_truth.contact_force(world, 0)[2])
            for _ in range(IMAGES):
                start = time.process_time()
                image = view.image()
                sampled = time.process_time()
                touch = view.perception.perceive(image, image.time)
                spent[:2] += (sampled - start, time.process_time() - sampled)
                images += 1
                force.append(touch.force_normal - true)
                if touch.markers is not None:
                    off = touch.markers.p_SM - world.marker_poses(0)[0][touch.markers.ids]
                    marker.append(float(np.mean(off**2)) ** 0.5)
            start = time.process_time()
            shape = view.perception.shape([touch])
            spent[2] += time.process_time() - start
            shapes += 1
            area.append(shape.area / ground_truth.contact_area(world, 0) - 1)
            if kind in _BALLS:
                radius.append(shape.radius / size - 1)
    known = np.isfinite(force)
    return {
        "sensor": name,
        "markers": design.markers.count,
        "layout": f"{design.markers.columns} x {design.markers.rows}",
        "radius_mm": 1e3 * design.markers.radius,
        "image": f"{design.camera.width} x {design.camera.height}",
        "force_error_N": float(np.sqrt(np.mean(np.square(np.array(force)[known])))),
        "unknown": int(np.count_nonzero(~known)),
        "marker_error_um": 1e6 * float(np.sqrt(np.mean(np.square(marker)))),
        "area_error": _median(area),
        "radius_error": _median(radius),
        "shape_unknown": int(np.count_nonzero(~np.isfinite(area))),
        "camera_ms": 1e3 * spent[0] / images,
        "perception_ms": 1e3 * spent[1] / images,
        "shape_ms": 1e3 * spent[2] / shapes,
    }


def _median(values: list[float]) -> float:
    """Return the median of the absolute known values."""
    known = np.abs(np.array(values))
    known = known[np.isfinite(known)]
    return float(np.median(known)) if len(known) else float("nan")


def _percent(fraction: float | None, digits: int) -> str:
    """Format a percentage; contact shapes are unknown for non-rectangular frames."""
    return "unknown" if fraction is None or np.isnan(fraction) else f"{100 * fraction:.{digits}f}"


def table(result: Mapping[str, Any]) -> str:
    """Format the result as a Markdown table."""
    rows = result["rows"]
    presses = len(DEPTHS) * len(INDENTERS)

    def line(label: str, *cells: str) -> str:
        return f"| {label} | " + " | ".join(cells) + " |"

    lines = [
        line("", *(row["sensor"] for row in rows)),
        "|---" * (1 + len(rows)) + "|",
        line("markers, radius mm", *(f"{r['layout']}, {r['radius_mm']:g}" for r in rows)),
        line("image, px", *(r["image"] for r in rows)),
        line("normal force, rms error, mN", *(f"{1e3 * r['force_error_N']:.1f}" for r in rows)),
        line(
            "marker position, rms error of x, y, z, um",
            *(f"{r['marker_error_um']:.0f}" for r in rows),
        ),
        line("contact area, median error, %", *(_percent(r["area_error"], 0) for r in rows)),
        line("radius of a ball, median error, %", *(_percent(r["radius_error"], 1) for r in rows)),
        line(f"unknown contact shapes, of {presses}", *(f"{r['shape_unknown']}" for r in rows)),
        line("rendering, ms per image", *(f"{r['camera_ms']:.1f}" for r in rows)),
        line("perception, ms per image", *(f"{r['perception_ms']:.1f}" for r in rows)),
        line("contact shape, ms", *(f"{r['shape_ms']:.0f}" for r in rows)),
    ]
    return "\n".join(lines) + "\n"
