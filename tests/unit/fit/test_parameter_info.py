"""Tests of the results of a fit: intervals, correlated parameters, recommended recordings, and the
sensor file that it writes."""

import math
import tomllib

import numpy as np
import pytest

from mjtactile.core import config_fields, resources
from mjtactile.core.design import SensorDesign, load_sensor, sensor_from_table
from mjtactile.fit.parameter_info import ABOUT, FittedParameter, classify, correlations, digits
from mjtactile.fit.rewrite_sensor_file import rewrite

TEXT = resources.find("dense", "models/sensors", ".toml").read_text()


def test_a_parameter_with_a_small_sd_is_fitted_with_its_interval():
    number = classify("membrane.young_MPa", 1.1, 0.01, 1.0, "runs/press")
    assert number.state == "fitted" and number.interval == pytest.approx((1.0804, 1.1196))
    assert number.comment == "fitted: 1.080 to 1.120 (95 %), runs/press"


def test_an_undetermined_parameter_keeps_its_value_and_names_the_needed_recording():
    number = classify("membrane.friction", 0.5, 0.4, 0.9, "runs/press")
    assert (number.state, number.value) == ("not in these recordings", 0.9)
    assert "drag a loaded indenter" in number.comment


def test_prior_of_the_gas_volume_is_relative_to_all_of_the_gas():
    """The extra volume may be zero; 0.5 mL of 24 are 2 %."""
    assert classify("chamber.extra_volume_mL", 0.1, 0.5, 0.0, "", gas_mL=24.0).state == "fitted"
    assert (
        classify("chamber.extra_volume_mL", 0.1, 3.0, 0.0, "", gas_mL=24.0).state
        == "not in these recordings"
    )


def test_two_correlated_parameters_cannot_be_distinguished():
    cov = np.array([[1.0, -0.98, 0.1], [-0.98, 1.0, 0.0], [0.1, 0.0, 1.0]])
    names = ["membrane.young_MPa", "membrane.thickness_mm", "membrane.friction"]
    separate = correlations(names, cov, {"membrane.thickness_mm": "not in these recordings"})
    assert separate == [
        "modulus and thickness cannot be separated by these recordings (correlation -0.98): "
        "recordings determine only its product with the modulus: measure the thickness, then "
        "--fix membrane.thickness_mm=…"
    ]
    assert "determined better together" in correlations(names, cov, {})[0]


@pytest.mark.parametrize(
    ("value", "sd", "text"),
    [(1.23456, 0.01, "1.235"), (0.9, 0.2, "0.90"), (185.123, 3.0, "185.1"), (5.0, math.inf, "5")],
)
def test_values_are_rounded_to_their_uncertainty(value, sd, text):
    assert digits(value, sd) == text


def test_the_sensor_file_loads_and_keeps_its_comments():
    numbers = [
        FittedParameter("membrane.young_MPa", 1.234567, 0.001, "fitted", "a", 1.0),
        FittedParameter("chamber.extra_volume_mL", -2.5, 0.1, "fitted", "a", 0.0),
        FittedParameter("chamber.leak_mL_s_kPa", 0.0, math.inf, "not in these recordings", "", 0.0),
        FittedParameter("membrane.thickness_mm", 0.31, 0.0, "known", "measured by hand", 0.3),
        FittedParameter("membrane.friction", 0.9, math.inf, "not in these recordings", "", 0.9),
    ]
    text = rewrite(TEXT, numbers, "Fitted.")
    found = sensor_from_table(tomllib.loads(text), name="fitted", source="fitted.toml")
    assert found.membrane.young == pytest.approx(
        1.2346e6
    ) and found.membrane.thickness == pytest.approx(0.31e-3)
    assert found.chamber.extra_volume == pytest.approx(-2.5e-6) and found.membrane.friction == 0.9
    # unknown, and was not in the file
    assert found.chamber.leak_conductance == 0.0 and "leak_mL_s_kPa" not in text
    assert (
        "friction = 0.9   # not in these" in text.replace("0.9  #", "0.9   #")
        and "# inner opening along x" in text
    )
    assert found.markers == load_sensor("dense").markers


def test_every_parameter_is_a_field_of_the_sensor_file():
    assert set(ABOUT) <= {label for label, *_ in config_fields.scalars(SensorDesign)}
