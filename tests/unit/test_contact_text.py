"""Text of a contact in the results of `mjtactile grasp`."""

from dataclasses import replace
from typing import Any

import pytest

from mjtactile.commands.grasp import _contact_text
from mjtactile.core.types import SHAPES, ContactShape, Touch
from mjtactile.runtime.held_contact import _report
from mjtactile.sensing.settings import DEFAULTS


@pytest.mark.parametrize(
    ("probability", "misfit", "resolved", "text"),
    [
        (0.97, 1.0, True, "smooth (97 %), radii 20 mm and above 100 mm"),
        (0.53, 1.0, True, "kind unclear, likeliest smooth (53 %)"),
        (1.0, 2.7, True, "kind unclear, explained by no model (nearest: smooth)"),
        (0.97, 1.0, False, "kind not resolved by the simulated mesh, likeliest smooth (97 %)"),
    ],
)
def test_a_kind_that_is_not_clear_is_printed_with_reserve(probability, misfit, resolved, text):
    contact: dict[str, Any] = {"kind_resolved": resolved}
    contact |= {"kind": "smooth", "probability": probability, "misfit": misfit, "area_mm2": 64.0}
    contact["area_interval_mm2"] = [61.0, 119.0]
    contact |= {"curvatures_1_m": [50.0, 2.0], "curvatures_sd_1_m": [8.0, 4.0]}
    assert _contact_text(contact) == f"{text}, area 64 mm2 (68 %: 61 to 119)"


@pytest.mark.parametrize(
    ("area_mm2", "spacing_mm", "resolved"), [(37, 2.2, False), (80, 2.2, True), (5, 1.25, True)]
)
def test_a_contact_of_few_cells_has_no_kind(area_mm2, spacing_mm, resolved):
    """An egg of 0.18 N touches eight cells of the default mesh, and resembles a disc of 3 mm."""
    shape = ContactShape("flat", dict.fromkeys(SHAPES, 0.0) | {"flat": 1.0}, area=area_mm2 * 1e-6)
    shape = replace(shape, misfit=1.0)
    settings = replace(DEFAULTS.contact_shape, mesh_spacing=spacing_mm * 1e-3)
    touch = Touch(0.0, 0.0, 0.18, 0.0, True)
    assert _report(shape, touch, settings)["kind_resolved"] == resolved
