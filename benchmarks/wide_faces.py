"""`mjtactile bench wide-faces`: force of plates that are wider than the contact zone or the frame.

Each plate is pressed in steps. Its force is compared with the ground truth, with and without a
pressure sensor. Only the plate of 60 mm at the center, without tilt, was used for tuning.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core.design import load_sensor
from mjtactile.experiments.test_bench import View, take_references
from mjtactile.sim import ground_truth
from mjtactile.sim.attach import default_mesh
from mjtactile.sim.scenes.indentation import Indenter, PressWorld

SENSORS = ("dense", "fine", "paper16", "round30")
DEPTHS = np.arange(0.5e-3, 2.8e-3, 0.25e-3)
MIN_FORCE = 0.3  # loads below are not counted, N
ALLOWED = {True: 0.03, False: 0.05}
"""Required relative force error, with and without a pressure sensor."""


@dataclass(frozen=True)
class Plate:
    """Plate `name` with an edge of `size` m, at (x, y) m, rotated by `tilt` rad."""

    name: str
    size: float
    at: tuple[float, float] = (0.0, 0.0)
    tilt: float = 0.0
    seed: int = 0


PLATES = (
    Plate("60 mm, tuned on", 0.06),
    Plate("80 mm", 0.08, seed=11),
    Plate("50 mm, 2 mm off center", 0.05, (2e-3, -1e-3), seed=12),
    Plate("40 mm, 1 degree", 0.04, tilt=np.radians(1.0), seed=13),
    Plate("30 mm", 0.03, seed=14),
)


def run(
    out: Path, *, quick: bool = False, notify: Callable[[str], None] = lambda _: None
) -> dict[str, Any]:
    """Press every plate into every sensor; five minutes of a processor.

    Args:
        out: Folder, unused.
        quick: The first plate and sensor only.
        notify: Receiver of a message for every plate.

    Returns:
        "rows", one per sensor, plate, mesh and kind of pressure measurement.
    """
    rows = []
    for sensor, plate in itertools.product(SENSORS, PLATES):
        if quick and (sensor, plate) != (SENSORS[0], PLATES[0]):
            continue
        notify(f"wide-faces: {sensor}, plate {plate.name}")
        nx, ny = default_mesh(load_sensor(sensor))
        meshes = [(nx, ny)] if quick else [(nx, ny), (2 * nx - 1, 2 * ny - 1)]
        for mesh, gauge in itertools.product(meshes, (True, False)):
            steps = list(_press(sensor, plate, mesh, gauge=gauge))
            rows.append(
                {"sensor": sensor, "plate": plate.name, "mesh": mesh, "gauge": gauge}
                | summarize(steps, ALLOWED[gauge])
            )
    return {"rows": rows}


def _press(
    sensor: str, plate: Plate, mesh: tuple[int, int], *, gauge: bool
) -> Iterator[tuple[float, float, float, bool]]:
    """Yield ground truth force, estimate and standard deviation, N, of each step above the frame;
    NaN: unknown. The last value is True with the flag `sharp_edge`."""
    design = load_sensor(sensor)
    world = PressWorld(design, Indenter("box", plate.size), at=plate.at, tilt=plate.tilt, mesh=mesh)
    view = View(world, design, seed=plate.seed, gauge=gauge)
    take_references(world, [view], design.chamber.supply_gauge)
    for depth in DEPTHS:
        world.press(depth)
        if ground_truth.frame_load(world, 0) > 0:
            return
        view.touch()  # the covariance of a sudden load change is inflated
        touch = view.touch()
        force = -float(ground_truth.contact_force(world, 0)[2])
        yield force, touch.force_normal, touch.force_normal_sd, "sharp_edge" in world.flags


def summarize(steps: Sequence[tuple[float, float, float, bool]], allowed: float) -> dict[str, Any]:
    """Return the errors of the known forces above `MIN_FORCE`, and the number of unknown ones.

    "beyond" counts errors above both `allowed`, relative, and two standard deviations, "unflagged"
    those of them without a flag.
    """
    true, estimate, sd, flagged = np.array([step for step in steps if step[0] >= MIN_FORCE]).T
    known = np.isfinite(estimate)
    error = np.abs(estimate - true)[known]
    relative = error / true[known]
    beyond = (relative > allowed) & (error > 2 * sd[known])
    return {
        "loads": len(true),
        "unknown": int((~known).sum()),
        "force_max_N": float(true.max()),
        "error_median": float(np.median(relative)) if known.any() else None,
        "error_max": float(relative.max()) if known.any() else None,
        "beyond": int(beyond.sum()),
        "unflagged": int((beyond & (flagged[known] == 0)).sum()),
    }


_COUNTS = ("loads", "beyond", "unflagged")


def table(result: Mapping[str, Any]) -> str:
    """Return the table in Markdown: one row per sensor and plate."""
    lines = [
        "Error: median on the default mesh to median on the finer mesh / largest. Beyond: loads "
        "whose error exceeds both the required one and 2 sd (in parentheses: without a flag).",
        "",
        "| sensor | plate | with pressure sensor: error, % | unknown; beyond | "
        "without: error, % | unknown; beyond |",
        "|---" * 6 + "|",
    ]
    for key, group in itertools.groupby(
        sorted(result["rows"], key=_order), key=lambda row: (row["sensor"], row["plate"])
    ):
        rows = list(group)
        sensor, plate = key
        lines.append(
            f"| `{sensor}` | {plate} | "
            + " | ".join(
                _cells([row for row in rows if row["gauge"] == gauge]) for gauge in ALLOWED
            )
            + " |"
        )
    header = "| pressure sensor | required, % | plates within | loads | beyond | without a flag |"
    lines += ["", header, "|---" * 6 + "|"]
    for gauge, allowed in ALLOWED.items():
        rows = [row for row in result["rows"] if row["gauge"] == gauge]
        met = sum(row["error_max"] <= allowed for row in rows)
        lines.append(
            f"| {'with' if gauge else 'without'} | {100 * allowed:.0f} | {met} of {len(rows)} | "
            + " | ".join(str(sum(row[key] for row in rows)) for key in _COUNTS)
            + " |"
        )
    return "\n".join(lines) + "\n"


def _cells(rows: Sequence[Mapping[str, Any]]) -> str:
    median = " to ".join(f"{100 * row['error_median']:.1f}" for row in rows)
    return (
        f"{median} / {100 * max(row['error_max'] for row in rows):.0f} | "
        f"{sum(row['unknown'] for row in rows)}; {sum(row['beyond'] for row in rows)} "
        f"({sum(row['unflagged'] for row in rows)})"
    )


def _order(row: Mapping[str, Any]) -> tuple[Any, ...]:
    plates = [plate.name for plate in PLATES]
    return row["sensor"], plates.index(row["plate"]), not row["gauge"], row["mesh"]
