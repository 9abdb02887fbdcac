"""Tests of replays with closed valve: their linear model against simulation, and the effect of the
membrane fit's errors."""

from dataclasses import replace

import numpy as np
import pytest

from mjtactile.core.design import load_sensor
from mjtactile.fit import sealed_replay
from mjtactile.fit.gas import Sealed
from mjtactile.fit.measurements import Evidence, Hold, Series
from mjtactile.fit.membrane_fit import DISCRETIZATION, MembraneFit, first_touch
from mjtactile.fit.sealed_replay import (
    CONTACT_SD,
    Replay,
    ReplayedRecording,
    can_replay,
    linear_model,
    membrane_errors,
)
from mjtactile.fit.simulated_holds import finer_mesh
from mjtactile.recording.stage_protocol import Move, Stage

MESH = (7, 6)
DESIGN = load_sensor("paper16")
AIR = {"polytropic_exponent": 1.4, "heat_exchange": 0.3, "leak_conductance": 1e-11}
TIME = np.arange(36) / 30
TAP = Stage("sphere:10", (0.0, 0.0), (Move(0.2, 3e-3, speed=0.1), Move(0.8, speed=0.1)))


def evidence_of(stage, name="tap"):
    rest = Hold(DESIGN.markers.p_SM, np.zeros((16, 3, 3)), 1000.0, None)
    return Evidence(name, stage, rest, (), Series(TIME, TIME, TIME), ())


def with_chamber(**values):
    return replace(DESIGN, chamber=replace(DESIGN.chamber, **(AIR | values)))


@pytest.mark.parametrize(
    "change", [{"extra_volume": 2e-6}, {"polytropic_exponent": 1.2}, {"leak_conductance": 5e-11}]
)
def test_other_gas_without_another_simulation(change):
    """The model with the compliance of two replays equals the replay with the other gas.

    The heat that the gas loses within an image period is not the same: 4 % with a time constant of
    0.3 s. Without the compliance the change is several times too large.
    """
    recording = ReplayedRecording(evidence_of(TAP), 0.0, MESH)
    base_design = with_chamber()
    base = recording.replay(base_design)
    softness = recording.compliance(base_design, base)
    model = linear_model(base_design, base, softness, np.zeros(len(TIME)))
    run = Sealed("tap", TIME, base.pressure, base.volume)
    other = with_chamber(**change)
    exact = recording.replay(other).pressure - base.pressure
    found = model(other, run) - base.pressure
    size = np.sqrt(np.mean(exact**2))
    assert size > 2.0
    assert np.sqrt(np.mean((found - exact) ** 2)) < 0.1 * size
    np.testing.assert_allclose(model(base_design, run), base.pressure, atol=1e-6)


def test_effects_of_correlated_errors(monkeypatch):
    """The modes' covariance is J C J^T, with the correlations of C.

    Pressures are linear in modulus, pre-stretch, depth and mesh here. The found discretization
    error shifts them by its effect at an infinitely fine mesh. The contact's discretization acts as
    another depth, in the hold only.
    """
    rng = np.random.default_rng(0)
    slopes = rng.normal(size=(4, len(TIME)))
    finer, factor = finer_mesh(MESH)

    def replay(design, evidence, offset=0.0, mesh=MESH):
        rubber = design.membrane
        x = [rubber.young / 1e6, rubber.pre_stretch, 1e3 * offset, float(mesh == finer) / factor]
        return Replay(slopes.T @ x, 0 * TIME)

    monkeypatch.setattr(sealed_replay, "replay", replay)
    one = evidence_of(TAP)
    root = rng.normal(size=(4, 4)) * np.array([[1e4], [1e-3], [1e-5], [0.3]])
    names = ("young", "pre_stretch", first_touch(one), DISCRETIZATION)
    values = {"young": DESIGN.membrane.young, "pre_stretch": DESIGN.membrane.pre_stretch}
    membrane = MembraneFit(
        values, root @ root.T, names, DESIGN, (), 0.0, (0.0,), discretization=0.5
    )
    recording = ReplayedRecording(one, 0.0, MESH)
    found = membrane_errors(DESIGN, [recording], [recording.replay(DESIGN)], membrane)
    J = slopes.T * [1e-6, 1.0, 1e3, 1.0]
    *modes, contact = np.array([mode[0] for mode in found.modes])
    modes = np.array(modes)
    np.testing.assert_allclose(modes.T @ modes, J @ membrane.cov @ J.T, atol=1e-9)
    np.testing.assert_allclose(found.shift[0], 0.5 * slopes[3], atol=1e-9)
    during = (TIME >= 0.2) & (TIME < 0.8)
    np.testing.assert_allclose(contact, 1e3 * CONTACT_SD * slopes[2] * during, atol=1e-9)


def test_recordings_that_are_replayed():
    """No contact, or contact at known depths without shear; others are predicted or left out."""
    drag = Stage("sphere:8", (0.0, 0.0), (Move(0.0, 2e-3), Move(1.0, 2e-3, shear=1e-3)))
    weight = Stage("sphere:8", (0.0, 0.0), (Move(0.0, force=0.5),))
    still = Stage("sphere:8", (0.0, 0.0), (Move(0.0),))
    assert [can_replay(evidence_of(s)) for s in (TAP, drag, weight, still, None)] == [
        True,
        False,
        False,
        True,
        False,
    ]
