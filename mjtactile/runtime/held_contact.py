"""Kind and area of the contacts of a grasp, from the last image of its hold."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mjtactile.core.status import OK
from mjtactile.core.types import ContactShape, Touch
from mjtactile.runtime.cycle import Cycle
from mjtactile.sensing.contact_shape.contact_area import resolves_kind
from mjtactile.sensing.settings import ContactShapeSettings
from mjtactile.sensing.stateful_pipeline import StatefulPipeline

EXPLAINED = 2.0
"""Maximum misfit of a shape that explains the last image."""


class HeldContacts:
    """Last touch of each finger in the hold."""

    def __init__(self) -> None:
        self._held: list[Touch | None] = []

    def add(self, cycle: Cycle) -> None:
        """Store the touches of a cycle in the hold."""
        if len(self._held) != len(cycle.touch):
            self._held = [None for _ in cycle.touch]
        if cycle.sent.phase != "hold":
            return
        for finger, touch in enumerate(cycle.touch):
            if touch.status == OK and touch.touching:
                self._held[finger] = touch

    def estimate(self, perceptions: Sequence[Any]) -> tuple[dict[str, Any] | None, ...]:
        """Return kind and area of the contact of each finger at the end of the hold; None: there
        was none."""
        found = zip(perceptions, self._held, strict=False)
        return tuple(_contact(*contact) for contact in found)


def _contact(perception: Any, held: Touch | None) -> dict[str, Any] | None:
    if held is None or held.shape is None or not isinstance(perception, StatefulPipeline):
        return None
    shape = held.shape
    if shape.misfit > EXPLAINED:
        # the images of the load may have excluded the right model
        alone = perception.shape([held])
        shape = alone if alone.misfit <= EXPLAINED else shape
    return _report(shape, held, perception.pipeline.settings.contact_shape)


def _report(shape: ContactShape, held: Touch, s: ContactShapeSettings) -> dict[str, Any]:
    """Return kind, probability, misfit, principal curvatures, 1/m, with their sd, and area, mm^2,
    with its 68 % interval. Unknown values are NaN. The area of a shape that does not explain the
    image is that of the traction."""
    area = held.contact if shape.misfit > EXPLAINED and held.contact is not None else shape
    return {
        "kind": shape.kind,
        "kind_resolved": resolves_kind(shape.area, s),
        "probability": float(shape.probabilities.get(shape.kind, float("nan"))),
        "misfit": float(shape.misfit),
        "curvatures_1_m": [float(one) for one in shape.curvatures],
        "curvatures_sd_1_m": [float(one) for one in shape.curvatures_sd],
        "area_mm2": 1e6 * float(area.area),
        "area_interval_mm2": [1e6 * float(end) for end in area.area_interval],
        "status": str(shape.status),
    }
