"""Tests of the reports of effects that a simulation left out."""

import pytest

from mjtactile.core.fidelity_levels import LEFT_OUT, disabled_effects, fidelity_notes


@pytest.mark.parametrize(
    ("effects", "reported"),
    [
        ({"mesh", "pipeline", "images"}, []),
        ({"mesh", "pipeline"}, ["images"]),
        ({"pipeline", "images"}, ["mesh"]),
        # sampled touch has no markers, so that images are not reported as missing
        ({"images"}, ["mesh", "pipeline"]),
        (set(), ["mesh", "pipeline"]),
    ],
)
def test_a_result_lists_its_omissions(effects, reported):
    result = dict.fromkeys(disabled_effects(effects), False)
    assert fidelity_notes(result) == {name: LEFT_OUT[name] for name in reported}
