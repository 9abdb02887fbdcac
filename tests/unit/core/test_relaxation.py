"""Tests of relaxing rubber in a sensor file."""

from dataclasses import replace

import closed_forms
import numpy as np
import pytest

from mjtactile.core.calibration_parts import fingerprint
from mjtactile.core.design import load_sensor, sensor_from_table
from mjtactile.core.errors import InputError
from mjtactile.core.relaxation import Relaxation, decades
from mjtactile.core.resources import folder
from mjtactile.core.toml import read_toml

TABLE = read_toml(folder("models/sensors") / "dense.toml")


def with_section(**section):
    return sensor_from_table(TABLE | {"relaxation": section}, name="dense", source="dense.toml")


def test_a_file_states_fractions_and_times():
    found = with_section(terms_s=[[0.05, 1], [0.04, 10.0]], mullins_fraction=0.1)
    assert found.relaxation == Relaxation(((0.05, 1.0), (0.04, 10.0)), 0.1)
    assert found.relaxation.quick == pytest.approx(1.09)


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ({"terms_s": [[0.0, 1.0]]}, "terms_s"),
        ({"terms_s": [[0.1, 0.0]]}, "terms_s"),
        ({"terms_s": [[0.1]]}, "pairs"),
        ({"terms_s": [[0.1, 1.0]] * 9}, "has 9 terms; at most 8"),
        ({"terms_s": []}, "terms_s is empty and mullins_fraction is 0"),
        ({"terms_s": [], "mullins_fraction": 1.0}, "mullins_fraction"),
        ({"term_s": [[0.1, 1.0]]}, "term"),
    ],
)
def test_an_invalid_value_is_reported_in_one_line(section, words):
    with pytest.raises(InputError, match=words) as caught:
        with_section(**section)
    assert "dense.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_without_relaxation_keeps_its_fingerprint():
    """Calibrations older than this section remain valid for the same files."""
    design = load_sensor("dense")
    assert fingerprint(design) == fingerprint(replace(design, relaxation=None))
    relaxing = replace(design, relaxation=Relaxation(((0.05, 1.0),)))
    assert fingerprint(relaxing) != fingerprint(design)


def test_one_term_per_decade_relaxes_linearly_in_log_time():
    rate = 0.02
    relaxation = Relaxation(decades(rate, 1.0, 1e4))
    times = np.geomspace(1.0, 1e4, 50)
    line = closed_forms.relaxed_modulus(relaxation, times[0]) - rate * np.log10(times)
    off = closed_forms.relaxed_modulus(relaxation, times) - line
    # exponentials a decade apart ripple by a few hundredths of the rate; the ends bend by a fifth
    assert np.abs(off).max() < 0.25 * rate
