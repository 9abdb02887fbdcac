"""How results say what a simulation left out."""

import pytest

from mjtactile.core.fidelity_levels import LEFT_OUT, disabled_effects, fidelity_notes


@pytest.mark.parametrize(
    ("effects", "said"),
    [
        ({"sheet", "chain", "images"}, []),
        ({"sheet", "chain"}, ["images"]),
        ({"chain", "images"}, ["sheet"]),
        # where touch is drawn there are no markers, and nobody misses images of them
        ({"images"}, ["sheet", "chain"]),
        (set(), ["sheet", "chain"]),
    ],
)
def test_a_result_says_what_was_left_out(effects, said):
    result = dict.fromkeys(disabled_effects(effects), False)
    assert fidelity_notes(result) == {name: LEFT_OUT[name] for name in said}
