"""`mjtactile bench shape-sensitivity`: effect of halving and doubling the tuned parameters of shape
estimation.

A ball, an ellipsoid, a block, and two close balls of which one touches later are pressed in steps
and held. Touches are recorded once, so that a change is due to the setting alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.shape.random_indenters import Case, sample_case
from benchmarks.shape.run import MESH
from mjtactile.core.design import load_sensor
from mjtactile.core.types import ContactShape, Touch
from mjtactile.experiments.test_bench import View, take_references
from mjtactile.sensing.pipeline import SensingPipeline
from mjtactile.sensing.pipeline_state import PipelineState
from mjtactile.sensing.settings import DEFAULTS, Settings
from mjtactile.sensing.settings.tunable_parameter import PRESSED
from mjtactile.sim import ground_truth
from mjtactile.sim.scenes.indentation import Indenter, PressWorld

FACTORS = (0.5, 2.0)
SAMPLED = (1035, 1038, 1023)  # seeds of known indenters; those of bench shape come later
_CLOSE = "".join(
    f'<geom type="sphere" size="5e-3" pos="{x} 0 {5e-3 + later}"/>'
    for x, later in ((-3e-3, 0.0), (3e-3, 0.2e-3))
)
_DEPTHS = np.array([0.4, 0.8, 1.2, 1.7, 2.3]) * 1e-3  # depths of the load, m
_MAX_FORCE = 1.5  # force limit, N
_HELD = 20  # images of the hold
_SIMILAR_AREA = 0.05


@dataclass(frozen=True, eq=False)
class Pressed:
    """A load: the `state` after its references, and for each image the states before and after it,
    and its touch."""

    state: PipelineState
    images: Sequence[tuple[PipelineState, PipelineState, Touch]]


@dataclass(frozen=True)
class ShapeEstimate:
    """Estimate from one image: kind and area, m^2, of the shape, its radius, m, and the force,
    N."""

    kind: str
    area: float
    radius: float
    force: float


def cases() -> list[Case]:
    """Return the indenters."""
    close = Case("multiple", "two close balls", _CLOSE, (0.5e-3, 0.5e-3))
    return [*map(sample_case, SAMPLED), close]


def record(case: Case) -> Pressed:
    """Press the indenter in steps up to the force limit, and hold it."""
    with TemporaryDirectory() as folder:
        indenter = Indenter("model", path=case.write(Path(folder)))
        world = PressWorld("dense", indenter, at=case.at, mesh=MESH)
    view = View(world, load_sensor("dense"), seed=1)
    take_references(world, [view], world.design.chamber.supply_gauge)
    perception = view.perception
    start = perception.state
    images = []
    for depth in (*_DEPTHS, *[None] * _HELD):
        if depth is not None:
            if -ground_truth.contact_force(world, 0)[2] > _MAX_FORCE:
                continue
            world.press(float(depth))
        before = perception.state
        touch = view.touch()
        if touch.traction is not None and touch.touching:
            images.append((before, perception.state, touch))
    return Pressed(start, images)


def estimate_shapes(presses: Sequence[Pressed], settings: Settings) -> list[ShapeEstimate]:
    """Estimate the shape in all images with these settings."""
    sensing_pipeline = SensingPipeline(load_sensor("dense"), settings=settings)
    shapes = []
    for pressed in presses:
        finder = sensing_pipeline.make_shape_estimator(pressed.state)
        press = None
        for before, after, touch in pressed.images:
            followed = replace(before, press=press)
            estimated, state = sensing_pipeline.track_contact_shape(followed, after, touch, finder)
            press = state.press
            shapes.append(_shape_estimate(estimated.shape, estimated.force_normal))
    return shapes


def _shape_estimate(shape: ContactShape | None, force: float) -> ShapeEstimate:
    assert shape is not None
    return ShapeEstimate(shape.kind, shape.area, shape.radius, force)


def change(before: Sequence[ShapeEstimate], now: Sequence[ShapeEstimate]) -> dict[str, float]:
    """Count images with a changed kind, area (by 5 %) or existing radius.

    Compute also the rms force change, N.
    """
    pairs = list(zip(before, now, strict=True))
    same = [(old, new) for old, new in pairs if old.kind == new.kind]
    off = [new.force - old.force for old, new in pairs]
    return {
        "kinds": sum(old.kind != new.kind for old, new in pairs),
        "areas": sum(abs(new.area / old.area - 1) > _SIMILAR_AREA for old, new in same),
        "radii": sum(np.isfinite(old.radius) != np.isfinite(new.radius) for old, new in same),
        "force_N": float(np.sqrt(np.mean(np.square(off)))),
    }


def run(out: Path, quick: bool = False) -> dict[str, Any]:
    """Vary every parameter whose source states that it was tuned here."""
    del out
    presses = [record(case) for case in cases()[: 1 if quick else None]]
    usual = estimate_shapes(presses, DEFAULTS)
    rows = []
    for field in fields(DEFAULTS.contact_shape):
        if PRESSED not in field.metadata["source"]:
            continue
        value = getattr(DEFAULTS.contact_shape, field.name)
        row: dict[str, Any] = {"name": f"contact_shape.{field.name}", "default": value}
        for factor in FACTORS:
            tried = round(factor * value) if isinstance(value, int) else factor * value
            now = estimate_shapes(presses, DEFAULTS.override({row["name"]: tried}))
            row[str(factor)] = change(usual, now)
        rows.append(row)
    return {"numbers": rows, "images": len(usual), "bodies": [case.name for case in cases()]}


def table(result: Mapping[str, Any]) -> str:
    """Format the effects of half and twice each parameter as a Markdown table."""
    lines = [
        f"Changes in {result['images']} images:",
        "",
        "| parameter | default | another kind | area | radius or none | force, mN |",
        "|---|---|---|---|---|---|",
    ]
    for row in result["numbers"]:
        tried = [row[str(factor)] for factor in FACTORS]
        cells = [_both([f"{item[key]}" for item in tried]) for key in ("kinds", "areas", "radii")]
        cells.append(_both([f"{1e3 * item['force_N']:.1f}" for item in tried]))
        lines.append(f"| `{row['name']}` | {row['default']:g} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _both(shown: Sequence[str]) -> str:
    return "" if set(shown) <= {"0", "0.0"} else "/".join(shown)
