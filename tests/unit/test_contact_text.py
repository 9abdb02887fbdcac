"""Text of a contact in the results of `mjtactile grasp`."""

import pytest

from mjtactile.commands.grasp import _contact_text


@pytest.mark.parametrize(
    ("probability", "misfit", "text"),
    [
        (0.97, 1.0, "smooth (97 %), radii 20 mm and above 100 mm"),
        (0.53, 1.0, "kind unclear, likeliest smooth (53 %)"),
        (1.0, 2.7, "kind unclear, explained by no model (nearest: smooth)"),
    ],
)
def test_a_kind_that_is_not_clear_is_printed_with_reserve(probability, misfit, text):
    contact = {"kind": "smooth", "probability": probability, "misfit": misfit, "area_mm2": 64.0}
    contact["area_interval_mm2"] = [61.0, 119.0]
    contact |= {"curvatures_1_m": [50.0, 2.0], "curvatures_sd_1_m": [8.0, 4.0]}
    assert _contact_text(contact) == f"{text}, area 64 mm2 (68 %: 61 to 119)"
