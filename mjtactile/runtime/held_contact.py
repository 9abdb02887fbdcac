"""Kind and area of the contacts of a grasp, estimated once after the run from the images of its
load and hold."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mjtactile.core.status import OK
from mjtactile.core.types import ContactShape, Touch
from mjtactile.runtime.cycle import Cycle
from mjtactile.sensing.settings import ContactShapeSettings
from mjtactile.sensing.stateful_pipeline import StatefulPipeline

_GROWN = 1.4  # force ratio between two kept images of a load
_KEPT = 7  # images of a load
_FIRST = 0.05  # force of the first of them, N
EXPLAINED = 2.0
"""Maximum misfit of a shape that explains the last image."""


_CELLS = 15  # minimum cells of a coarse simulated mesh in a contact whose kind is resolved


class HeldContacts:
    """Touches of each finger that show its contact: some of the load, and the last of the hold."""

    def __init__(self) -> None:
        self._loads: list[list[Touch]] = []
        self._held: list[Touch | None] = []

    def add(self, cycle: Cycle) -> None:
        """Store the informative touches of a cycle."""
        if len(self._loads) != len(cycle.touch):
            self._loads = [[] for _ in cycle.touch]
            self._held = [None for _ in cycle.touch]
        for finger, touch in enumerate(cycle.touch):
            if touch.status != OK or not touch.touching:
                continue
            load = self._loads[finger]
            needed = _GROWN * load[-1].force_normal if load else _FIRST
            if cycle.sent.phase == "hold":
                self._held[finger] = touch
            elif self._held[finger] is None and len(load) < _KEPT and touch.force_normal > needed:
                load.append(touch)

    def estimate(self, perceptions: Sequence[Any]) -> tuple[dict[str, Any] | None, ...]:
        """Return kind and area of the contact of each finger at the end of the hold; None: there
        was none. It takes some 0.1 s."""
        found = zip(perceptions, self._loads, self._held, strict=False)
        return tuple(_contact(*contact) for contact in found)


def _contact(perception: Any, load: list[Touch], held: Touch | None) -> dict[str, Any] | None:
    if held is None or not isinstance(perception, StatefulPipeline):
        return None
    settings = perception.pipeline.settings.contact_shape
    if held.shape is not None:
        return _report(held.shape, held, settings)
    shape = perception.shape([*load, held])
    if shape.misfit > EXPLAINED and load:
        # the images of the load may have excluded the right model
        alone = perception.shape([held])
        shape = alone if alone.misfit <= EXPLAINED else shape
    return _report(shape, held, settings)


def _report(shape: ContactShape, held: Touch, s: ContactShapeSettings) -> dict[str, Any]:
    """Return kind, probability, misfit, principal curvatures, 1/m, with their sd, and area, mm^2,
    with its 68 % interval. Unknown values are NaN. The area of a shape that does not explain the
    image is that of the traction. A contact over few cells of a coarse simulated mesh does not
    resolve the kind: an egg touches at so few vertices that it resembles a small disc."""
    is_resolved = s.mesh_ratio == 1 or not shape.area < _CELLS * s.mesh_spacing**2
    area = held.contact if shape.misfit > EXPLAINED and held.contact is not None else shape
    return {
        "kind": shape.kind,
        "kind_resolved": is_resolved,
        "probability": float(shape.probabilities.get(shape.kind, float("nan"))),
        "misfit": float(shape.misfit),
        "curvatures_1_m": [float(one) for one in shape.curvatures],
        "curvatures_sd_1_m": [float(one) for one in shape.curvatures_sd],
        "area_mm2": 1e6 * float(area.area),
        "area_interval_mm2": [1e6 * float(end) for end in area.area_interval],
        "status": str(shape.status),
    }
