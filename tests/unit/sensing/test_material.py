"""Tests of the material classification on synthetic squeezes with closed forms: the result is the
given material, for any membranes."""

import sys

import numpy as np
import pytest

from mjtactile.core.errors import InputError
from mjtactile.core.types import Contact, Material, Surface, Touch, Traction
from mjtactile.sensing.touch.material import estimate_material
from mjtactile.sensing.touch.squeeze import Squeeze, covered_area, object_width

PERIOD = 1 / 30
FREE_WIDTH = 0.024
AREA = 288e-6
GRIP = 350.0  # stiffness of the two membranes in series, N/m
# durations, s
PRESS = 1.8
HOLD = 2.0
REST = 2.0
SPEED = 4e-3  # speed of the opening, m/s


def squeeze(law, *, noise=10e-6, second=True, seed=0):
    """Drive the jaws in, hold, out, and in again. `transmission` is a generator: it gets the force and
    yields the deformation.

    The opening less the membranes' give, F / GRIP, is the object's width.
    """
    rng = np.random.default_rng(seed)
    rows = []
    object_ = law()
    deformation = next(object_)
    times = np.arange(0.0, PRESS + HOLD + (REST + 3.0 if second else REST), PERIOD / 20)
    for step, time in enumerate(times):
        closed = closing(time)
        force = max(0.0, GRIP * (closed - deformation))
        if time > PRESS + HOLD + REST and force > 0.4:
            break
        deformation = object_.send((force, closed, PERIOD / 20))
        if step % 20 == 0:
            touching = force > 0.05
            width = FREE_WIDTH - deformation + rng.normal(0, noise) if touching else np.nan
            rows.append(
                (
                    time,
                    FREE_WIDTH - closed,
                    force + rng.normal(0, 3e-3),
                    3e-3,
                    width,
                    20e-6,
                    AREA if touching else 0.0,
                )
            )
    return Squeeze(*np.array(rows).T)


def closing(time):
    """Return the closing distance of the jaws beyond first touch, m."""
    travel = SPEED * PRESS
    out = PRESS + HOLD
    if time < out:
        return min(SPEED * time, travel)
    if time < out + REST:
        return max(travel - 4 * SPEED * (time - out), -1e-3)
    return -1e-3 + SPEED * (time - out - REST)


def standard_linear_solid(stiffness, arm=0.0, tau=1.0):
    """Return F = K d + arm (d - q), q' = (d - q) / tau, in series with the membranes; arm 0: a
    spring."""

    def law():
        q = 0.0
        d = 0.0
        while True:
            _, closed, dt = yield d
            d = (GRIP * max(closed, -1.0) + arm * q) / (GRIP + stiffness + arm)
            d = max(d, arm * q / (stiffness + arm))  # free: no force
            q += dt * (d - q) / tau

    return law


def yielding(stiffness, yield_force, viscosity):
    """Return an elastic part in series with a plastic part that flows at (F - F_y) / c."""

    def law():
        flowed = 0.0
        d = 0.0
        while True:
            _, closed, dt = yield d
            force = max(0.0, (closed - flowed) / (1 / GRIP + 1 / stiffness))
            flowed += dt * max(0.0, force - yield_force) / viscosity
            d = flowed + force / stiffness

    return law


def rigid():
    while True:
        yield 0.0


def test_a_rigid_object_is_solid():
    found = estimate_material(squeeze(rigid))
    assert found.kind == "solid" and found.probability["solid"] > 0.9 and found.status == "ok"
    # three sd of the fit's free width, 10 um noise over 50 images
    assert abs(found.deformation) < 20e-6
    assert np.isnan(found.modulus) and found.relaxation_time == 0.0
    # stiffness in N/m: a lower bound; its value cannot be determined
    assert found.stiffness_interval[0] > 8e3


@pytest.mark.parametrize("stiffness", [200.0, 1000.0, 3000.0])
def test_stiffness_and_modulus_of_a_soft_object_are_recovered(stiffness):
    found = estimate_material(squeeze(standard_linear_solid(stiffness)))
    assert found.kind == "soft" and found.status == "ok"
    # the free width is known to some 20 um, of 0.3 mm for the stiffest
    assert found.stiffness == pytest.approx(stiffness, rel=0.1)
    assert found.modulus == pytest.approx(stiffness * FREE_WIDTH / AREA, rel=0.1)  # E = K L / A
    assert found.modulus_interval[0] < stiffness * FREE_WIDTH / AREA < found.modulus_interval[1]
    assert found.relaxation_time == 0.0 and abs(found.permanent_set) < 30e-6


def test_compliance_of_the_membranes_is_excluded(monkeypatch):
    """The same object between softer membranes has the same estimated stiffness."""
    monkeypatch.setattr(sys.modules[__name__], "GRIP", GRIP / 1.6)
    found = estimate_material(squeeze(standard_linear_solid(1000.0)))
    assert found.stiffness == pytest.approx(1000.0, rel=0.1)


@pytest.mark.parametrize("tau", [0.2, 0.5])
def test_relaxation_time(tau):
    found = estimate_material(squeeze(standard_linear_solid(300.0, arm=500.0, tau=tau)))
    assert found.kind == "soft"
    # the creep seen at held jaws is slower, tau (GRIP + K + arm) / (GRIP + K) = 1.8 tau: the
    # membranes are accounted for
    assert found.relaxation_time == pytest.approx(tau, rel=0.15)
    assert found.stiffness == pytest.approx(300.0, rel=0.15)  # not all has relaxed after 2 s


@pytest.mark.parametrize(("yield_force", "viscosity"), [(0.4, 40.0), (0.05, 400.0)])
def test_an_amorphous_object_has_a_permanent_set(yield_force, viscosity):
    found = estimate_material(squeeze(yielding(3000.0, yield_force, viscosity)))
    assert found.kind == "amorphous" and found.status == "ok"
    assert (
        found.permanent_set == pytest.approx(found.deformation, rel=0.35)
        and found.permanent_set > 1e-3
    )
    assert np.isnan(found.modulus)  # a body that flows has none
    assert found.speed > 1e-4 or yield_force > 0.3


def test_too_little_contact_is_reported():
    history = squeeze(rigid)
    faint = Squeeze(
        history.time,
        history.opening,
        0.1 * history.force,
        history.force_sd,
        history.width,
        history.width_sd,
        history.area,
    )
    for found in (estimate_material(faint), estimate_material(Squeeze(*np.zeros((7, 0))))):
        assert found.kind == "unknown" and found.status.startswith("not enough contact yet")
        assert sum(found.probability.values()) == pytest.approx(1.0)


def test_a_paste_below_the_minimum_force_is_amorphous():
    """It never reaches the least force, but its width has shrunk by millimetres."""
    found = estimate_material(squeeze(yielding(3000.0, 0.08, 30.0)))
    assert found.kind == "amorphous" and found.force < 0.35


def test_without_a_second_touch_the_release_decides():
    found = estimate_material(squeeze(yielding(3000.0, 0.3, 40.0), second=False))
    assert found.kind == "amorphous" and "no second touch" in found.status


def test_with_noise_the_kind_is_undecided_and_not_wrong():
    """With 0.4 mm of noise, the class of an object that yields by 0.2 mm stays undecided."""
    kinds = [
        estimate_material(squeeze(standard_linear_solid(4000.0), noise=4e-4, seed=seed))
        for seed in range(5)
    ]
    assert all(found.probability[found.kind] < 0.97 for found in kinds if found.kind != "unknown")


def face(height, slope, centroid):
    """Return a sensor in contact with a plane: 12 x 12 mm around `centroid`, of a membrane of 40 x
    30 mm."""
    x = np.linspace(-0.02, 0.02, 41)
    y = np.linspace(-0.015, 0.015, 31)
    z = height + slope * np.meshgrid(x, y)[0]
    mask = (np.abs(y[:, None] - centroid[1]) < 6.1e-3) & (np.abs(x - centroid[0]) < 6.1e-3)
    surface = Surface(x, y, z, 1.2e-3, 0.0, 0.0, 0.0)
    traction = Traction(x, y, np.zeros((31, 41, 3)), np.zeros(6), np.zeros((6, 6)), 1e3, "test")
    contact = Contact(True, 100e-6, np.array(centroid), 1e-3, mask)
    return Touch(0.0, 0.0, 1.0, 0.01, True, contact, traction, surface)


def test_width_of_a_tilted_block_is_measured_between_opposite_points():
    """Faces 24 mm apart, both tilted by the same angle; the left touches at y = +4 mm, the right
    (mirrored) at -(-4)."""
    left = face(1e-3, 0.05, (4e-3, 0.0))
    right = face(1e-3, 0.05, (4e-3, 0.0))
    width, sd = object_width((left, right), 0.026)
    assert width == pytest.approx(0.024, abs=1e-9)  # exact for planes
    assert 20e-6 < sd < 1e-3
    assert np.isnan(object_width((left, Touch(0.0, 0.0, 0.0, 0.01, False)), 0.026)[0])


def test_covered_area_is_the_hull():
    touch = face(0.0, 0.0, (0.0, 0.0))
    assert covered_area(touch) == pytest.approx(13e-3**2, rel=1e-6)  # 13 x 13 nodes of 1 mm
    ring = np.array(touch.contact.mask)
    ring[11:20, 16:25] = False
    hollow = Contact(True, 60e-6, touch.contact.centroid, 1e-3, ring)
    assert covered_area(
        Touch(0.0, 0.0, 1.0, 0.01, True, hollow, touch.traction, touch.surface)
    ) == pytest.approx(13e-3**2)


def test_bad_values_are_refused():
    with pytest.raises(InputError, match="width"):
        Squeeze(*[np.zeros(3)] * 4, np.zeros(2), np.zeros(3), np.zeros(3))
    with pytest.raises(InputError, match="jelly"):
        Material("jelly", {})
