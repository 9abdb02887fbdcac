"""Tests of the gauge pressure of a shape estimator."""

import math
from types import SimpleNamespace

import pytest

from mjtactile import load_sensor
from mjtactile.runtime.session import _for_simulation
from mjtactile.sensing.apply_contact_shape import finder_gauge
from mjtactile.sensing.settings import DEFAULTS


def reference(now):
    gas = SimpleNamespace(gauge_pressure=1000.0)
    return SimpleNamespace(
        first=SimpleNamespace(gas=gas), rest=SimpleNamespace(gauge_pressure=now, gas=gas)
    )


def test_pressure_noise_makes_no_new_estimator():
    """Steps are 2 %; a pressure between two of them would change the estimator at every image."""
    between = 1000.0 * math.sqrt(1.02)
    chosen = finder_gauge(reference(between + 0.5))
    assert chosen == pytest.approx(1020.0)
    assert finder_gauge(reference(between - 0.5), chosen) == chosen
    assert finder_gauge(reference(between - 0.5)) == pytest.approx(1000.0)
    assert finder_gauge(reference(995.0), chosen) == pytest.approx(1000.0)


def test_a_simulated_mesh_has_its_model_errors():
    """13 x 11 vertices of a frame of 40 x 30 mm: cells of 10/3 by 3 mm."""
    design = load_sensor("dense")
    simulated = {"mesh": (13, 11), "effects": [{"effect": "mesh", "on": True}]}
    coarse = _for_simulation(DEFAULTS, design, simulated).contact_shape
    assert coarse.mesh_spacing == pytest.approx(math.sqrt(10) * 1e-3)
    assert coarse.mesh_ratio == pytest.approx(math.sqrt(10) / 1.25)
    fine = DEFAULTS.for_mesh(design, (61, 46)).contact_shape
    assert fine.mesh_ratio == 1.0
    for other in ({}, {"mesh": (13, 11), "effects": [{"effect": "mesh", "on": False}]}):
        assert _for_simulation(DEFAULTS, design, other) is DEFAULTS
