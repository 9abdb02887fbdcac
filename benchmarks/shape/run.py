"""`mjtactile bench shape`: what body touches, from images alone, over bodies that nothing was tuned
on.

Balls, ellipsoids, lying and standing cylinders, round rims, blocks, wedges, corners and two balls
at once, pressed into the simulated sheet of `dense` in steps, tilted and off the middle, on a mesh
that is finer than the default's. Each image is judged by itself; at 0.3 N the press up to there,
too. The truth is the body's own, and the simulator's contact area; that of lines and points, which
have none, is left out.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.shape import independent
from benchmarks.shape.bodies import Case, draw
from benchmarks.shape.tables import summary, table
from mjtactile.core.design import load_sensor
from mjtactile.core.types import FeltShape, Touch
from mjtactile.experiments.station import View, take_references
from mjtactile.sim import truth
from mjtactile.sim.scenes.indentation import Indenter, PressWorld

__all__ = ["run", "table"]
FIRST_SEED = 1000
BODIES, BODIES_QUICK = 18, 2
MESH = (33, 25)
_DEPTHS = np.array([0.4, 0.8, 1.2, 1.7, 2.3, 3.0]) * 1e-3
_FORCE_LEAST, _FORCE_END, _FORCE_MOST = 0.06, 0.3, 1.5  # N

Say = Callable[[str], None]


def run(out: Path, *, quick: bool = False, say: Say = lambda _: None) -> dict[str, Any]:
    """Press each body; a row for each image.

    Args:
        out: A folder; not used, the table is all there is.
        quick: Two bodies.
        say: Told of each body.

    Returns:
        Rows, and their summary.
    """
    del out
    balls = independent.rows()
    rows: list[dict[str, Any]] = []
    for seed in range(FIRST_SEED, FIRST_SEED + (BODIES_QUICK if quick else BODIES)):
        rows += _press(seed)
        said = [row["kind"] for row in rows if row["seed"] == seed]
        say(f"body {seed}, {rows[-1]['name']}: {', '.join(said)}")
    return {"mesh": MESH, "rows": rows, "independent": balls, "summary": summary(rows)}


def _press(seed: int) -> list[dict[str, Any]]:
    case = draw(seed)
    with tempfile.TemporaryDirectory() as folder:
        indenter = Indenter("model", path=case.write(Path(folder)))
        world = PressWorld("dense", indenter, at=case.at, mesh=MESH)
    view = View(world, load_sensor("dense"), seed=seed)
    take_references(world, [view], world.design.chamber.supply_gauge)
    view.perception.shape([view.touch()])  # the finder is made once
    rows = []
    touches: list[Touch] = []
    ended = False
    for depth in _DEPTHS:
        world.press(float(depth))
        touch = view.touch()
        force = -float(truth.contact_force(world, 0)[2])
        if force > _FORCE_MOST:
            break
        if force < _FORCE_LEAST:
            continue
        touches.append(touch)
        area = truth.contact_area(world, 0)
        rows.append(_row(seed, case, view, [touch], force, area, "image"))
        if force > _FORCE_END and not ended:
            ended = True
            rows.append(_row(seed, case, view, touches, force, area, "press"))
    return rows


def _row(
    seed: int, case: Case, view: View, touches: list[Touch], force: float, area: float, looked: str
) -> dict[str, Any]:
    start = time.thread_time()
    shape = view.perception.shape(touches)
    seconds = time.thread_time() - start
    contact = touches[-1].contact
    return {
        "seed": seed,
        "name": case.name,
        "looked": looked,
        "family": case.family,
        "kind": shape.kind,
        "probability": shape.probabilities.get(case.family, np.nan),
        "force_true_N": force,
        "force_N": shape.force_normal,
        "force_nodal_N": touches[-1].force_normal,
        "area_true_mm2": 1e6 * area,
        "area_mm2": 1e6 * shape.area,
        "area_nodal_mm2": 1e6 * contact.area if contact is not None else np.nan,
        "area_interval_mm2": [1e6 * value for value in shape.area_interval],
        "radius_true_mm": 1e3 * case.radius,
        "radius_mm": 1e3 * shape.radius,
        "misfit": shape.misfit,
        "milliseconds": 1e3 * seconds,
        **_edge(case, shape),
    }


def _edge(case: Case, shape: FeltShape) -> dict[str, float]:
    """Across a wedge's edge, and turned from it."""
    if case.name != "wedge":
        return {"edge_off_mm": np.nan, "edge_turn_deg": np.nan}
    across = np.array([-np.sin(case.direction), np.cos(case.direction)])
    off = abs(float((shape.p_SO[:2] - case.at) @ across))
    turn = (shape.direction - case.direction + np.pi / 2) % np.pi - np.pi / 2
    return {"edge_off_mm": 1e3 * off, "edge_turn_deg": abs(float(np.degrees(turn)))}
