"""`mjtactile bench shape`: contact shapes estimated from images alone, on indenters not used for
tuning.

Indenters are balls, ellipsoids, lying and standing cylinders, round rims, blocks, wedges, corners
and two balls together. They are pressed into the simulated membrane of `dense` in steps, tilted and
off the center, on a mesh finer than the default. They are held for some images at the end, then
dragged aside by up to a millimetre.

Each image of a load is evaluated three times: alone, in a sequence with `contact_shapes`, and in
one without it, as in each touch by default: its area is that of the contact, its force is nodal.
Images of drags count for the wrench alone. Ground truth is the indenter's shape, and the
simulator's forces and contact area. The area of lines and points is left out.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.shape import foreign_shapes, independent_reference
from benchmarks.shape.random_indenters import Case, sample_case
from benchmarks.shape.tables import summary, table
from mjtactile.core.design import load_sensor
from mjtactile.core.types import Array, ContactShape, Touch, Traction
from mjtactile.experiments.test_bench import View, take_references
from mjtactile.sensing.contact_shape.estimator import ContactShapeEstimator
from mjtactile.sensing.contact_shape.hypotheses import PressHistory
from mjtactile.sensing.pipeline_state import PipelineState
from mjtactile.sim import ground_truth
from mjtactile.sim.scenes.indentation import Indenter, PressWorld

__all__ = ["run", "table"]
FIRST_SEED = 1120  # seeds below and 2000 to 2059 were used in tuning
INDENTERS, INDENTERS_QUICK = 20, 2
MESH = (33, 25)
_DEPTHS = np.array([0.4, 0.8, 1.2, 1.7, 2.3, 3.0]) * 1e-3
_FORCE_MIN, _MAX_FORCE = 0.06, 1.5  # range of evaluated forces, N
_HELD = 4  # images of the hold
_PERIOD = 1 / 30  # time between them, s
_DRAG = 1e-3  # maximum drag displacement, m
_DRAGGED = (0.5, 1.0)  # evaluated fractions of the drag

Notify = Callable[[str], None]


def run(out: Path, *, quick: bool = False, notify: Notify = lambda _: None) -> dict[str, Any]:
    """Press each indenter; return a row for each image.

    Args:
        out: Folder, not used; only the table is written.
        quick: Two indenters.
        notify: Receiver of a message for each indenter.

    Returns:
        Rows, and their summary.
    """
    del out
    balls = independent_reference.rows()
    few = foreign_shapes.OBJECTS_QUICK
    foreign = foreign_shapes.rows(few) if quick else foreign_shapes.rows()
    notify(f"{len(foreign)} images of foreign shapes")
    rows: list[dict[str, Any]] = []
    for seed in range(FIRST_SEED, FIRST_SEED + (INDENTERS_QUICK if quick else INDENTERS)):
        rows += _press(seed)
        reported = [row["kind"] for row in rows if row["seed"] == seed and row["stage"] == "press"]
        notify(f"body {seed}, {rows[-1]['name']}: {', '.join(reported)}")
    return {"mesh": MESH, "rows": rows, "independent": balls, "foreign": foreign} | {
        "summary": summary(rows)
    }


def _press(seed: int) -> list[dict[str, Any]]:
    case = sample_case(seed)
    with tempfile.TemporaryDirectory() as folder:
        indenter = Indenter("model", path=case.write(Path(folder)))
        world = PressWorld("dense", indenter, at=case.at, mesh=MESH)
    view = View(world, load_sensor("dense"), seed=seed)
    take_references(world, [view], world.design.chamber.supply_gauge)
    finder = view.perception.pipeline.make_shape_estimator(view.perception.state)  # made once
    drag = float(np.random.default_rng([seed, 78]).uniform(-_DRAG, _DRAG))
    rows: list[dict[str, Any]] = []
    plain = _EveryTouch(finder)
    for stage in _stages(world, drag):
        true = ground_truth.contact_wrench(world, 0)
        before = view.perception.state
        row = _followed(case, view, finder, true)
        if row is None:
            continue
        touch = row.pop("touch")
        default = plain.estimate(case, view, before, touch)
        if -true[2] < _FORCE_MIN:
            continue
        row |= {"seed": seed, "stage": stage, "first": not rows}
        row |= {"area_true_mm2": 1e6 * ground_truth.contact_area(world, 0)}
        rows.append(row)
        rows.append(row | {"stage": "default", "within": stage} | default)
        if stage == "press":
            rows.append(row | _alone(case, view, touch))
    return rows


class _EveryTouch:
    """The estimate that each touch has by default: area and kind, without force and motion."""

    def __init__(self, finder: ContactShapeEstimator):
        self._finder = finder
        self._press: PressHistory | None = None

    def estimate(
        self, case: Case, view: View, before: PipelineState, touch: Touch
    ) -> dict[str, Any]:
        """Evaluate the next image of a sequence, whose previous state was `before`."""
        now = view.perception.state
        start = time.thread_time()
        found, after = view.perception.pipeline.track_contact_shape(
            replace(before, press=self._press), now, touch, self._finder, with_load=False
        )
        seconds = time.thread_time() - start
        self._press = after.press
        assert found.shape is not None and found.contact is not None
        return _reported(case, found.shape) | {
            "milliseconds": 1e3 * seconds,
            "area_mm2": 1e6 * found.contact.area,
            "area_interval_mm2": [1e6 * end for end in found.contact.area_interval],
        }


def _stages(world: PressWorld, drag: float) -> Iterator[str]:
    """Load in steps up to the force limit or the frame, hold, then drag by `drag`, m."""
    reached = 0.0
    for depth in _DEPTHS:
        world.press(float(depth))
        on_frame = ground_truth.frame_load(world, 0) > 0
        if on_frame or -ground_truth.contact_force(world, 0)[2] > _MAX_FORCE:
            world.press(reached)
            break
        reached = float(depth)
        yield "press"
    for _ in range(_HELD):
        world.step(round(_PERIOD / world.timestep))
        yield "hold"
    for fraction in _DRAGGED:
        world.press(reached, fraction * drag)
        yield "drag"


def _followed(
    case: Case, view: View, finder: ContactShapeEstimator, true: Array
) -> dict[str, Any] | None:
    """Evaluate the next image of a sequence; None without contact."""
    perception = view.perception
    before = perception.state
    nodal = view.touch()
    if nodal.traction is None or not nodal.touching:
        return None
    start = time.thread_time()
    estimated, perception.state = perception.pipeline.track_contact_shape(
        before, perception.state, nodal, finder
    )
    seconds = time.thread_time() - start
    assert estimated.shape is not None and estimated.traction is not None
    contact = nodal.contact
    return {
        "touch": nodal,
        "force_true_N": -float(true[2]),
        "force_N": estimated.force_normal,
        "force_nodal_N": nodal.force_normal,
        "chi2": _chi2(estimated.traction, true),
        "chi2_nodal": _chi2(nodal.traction, true),
        "area_nodal_mm2": 1e6 * contact.area if contact is not None else np.nan,
        "area_nodal_interval_mm2": [1e6 * end for end in contact.area_interval]
        if contact is not None
        else [np.nan, np.nan],
        "milliseconds": 1e3 * seconds,
        **_reported(case, estimated.shape),
    }


def _alone(case: Case, view: View, touch: Touch) -> dict[str, Any]:
    """Evaluate the same image alone."""
    start = time.thread_time()
    shape = view.perception.shape(touch)
    seconds = time.thread_time() - start
    return {"stage": "image", "milliseconds": 1e3 * seconds, **_reported(case, shape)}


def _reported(case: Case, shape: ContactShape) -> dict[str, Any]:
    return {
        "name": case.name,
        "family": case.family,
        "kind": shape.kind,
        "probability": shape.probabilities.get(case.family, np.nan),
        "area_mm2": 1e6 * shape.area,
        "area_interval_mm2": [1e6 * value for value in shape.area_interval],
        "radius_true_mm": 1e3 * case.radius,
        "radius_mm": 1e3 * shape.radius,
        "curvatures_true_per_m": list(case.curvatures),
        "curvatures_per_m": list(shape.curvatures),
        "curvatures_sd_per_m": list(shape.curvatures_sd),
        "misfit": shape.misfit,
        **_edge(case, shape),
    }


def _chi2(traction: Traction, true: Array) -> float:
    """Compute chi-square of the wrench, divided by its six components."""
    off = traction.wrench - true
    return float(off @ np.linalg.solve(traction.wrench_cov, off)) / len(off)


def _edge(case: Case, shape: ContactShape) -> dict[str, float]:
    """Return the distance from a wedge's edge, mm, and the angle to it, deg."""
    if case.name != "wedge":
        return {"edge_off_mm": np.nan, "edge_turn_deg": np.nan}
    across = np.array([-np.sin(case.direction), np.cos(case.direction)])
    off = abs(float((shape.p_SO[:2] - case.at) @ across))
    angle = (shape.direction - case.direction + np.pi / 2) % np.pi - np.pi / 2
    return {"edge_off_mm": 1e3 * off, "edge_turn_deg": abs(float(np.degrees(angle)))}
