"""Tests that calibrations and quasi-static membranes refuse values that are not finite."""

import math

import pytest

import mjtactile
from mjtactile.core.calibration_parts import CalibrationMetadata, LensCalibration
from mjtactile.core.errors import InputError
from mjtactile.core.task_sections import SuccessCriteria

LENS = {"width": 640, "height": 480, "fx": 500.0, "fy": 500.0, "cx": 320.0, "cy": 240.0}


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("fx", math.nan),
        ("fy", -500.0),
        ("cx", math.inf),
        ("cy", math.nan),
        ("distortion", (0.1, math.nan, 0.0, 0.0, 0.0)),
    ],
)
def test_intrinsics_are_finite(field, value):
    stamp = CalibrationMetadata("2026-01-01", "", {}, {})
    LensCalibration(**LENS, stamp=stamp)
    with pytest.raises(InputError, match=rf"LensCalibration: {field}"):
        LensCalibration(**(LENS | {field: value}), stamp=stamp)


def test_a_membrane_refuses_unknown_points_and_limits():
    membrane = mjtactile.QuasistaticMembrane(mjtactile.load_sensor("dense"), (11, 9))
    ball = membrane.obstacle("sphere", [0.01])
    with pytest.raises(InputError, match="positions: is not finite"):
        membrane.obstacle_heights(ball, [[0.0, 0.0], [math.nan, 0.0]])
    with pytest.raises(InputError, match="within"):
        membrane.refined_for(ball, math.nan)


def test_the_text_of_a_criterion_has_each_limit_that_is_set():
    plain = SuccessCriteria()
    assert plain.text == "held and intact; it falls by at most 15 mm at release"
    upright = SuccessCriteria(max_tilt=math.radians(10), max_impact=0.02)
    assert "tilted by at most 10 deg" in upright.text
    assert "impact of at most 0.02 N s" in upright.text
