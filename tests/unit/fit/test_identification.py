"""Tests of parameters held at the file's value, and of the joint covariance of thickness and
modulus."""

from dataclasses import replace

import numpy as np
import pytest

from mjtactile.core.design import load_sensor
from mjtactile.core.errors import InputError
from mjtactile.fit import identification
from mjtactile.fit.identification import _HELD_FIRST, _first_undetermined, _with_fixed_values
from mjtactile.fit.measurements import LENS_FRACTION, Evidence, Hold, Series, _height_fraction
from mjtactile.fit.membrane_fit import FitOptions, MembraneFit
from mjtactile.fit.result import FitResult, covariance_of
from mjtactile.sensing.pose.flat_reference import FlatReference

DENSE = load_sensor("dense")
VALUES = {"young": 1e6, "pre_stretch": 1.05}
NAMES = ("young", "pre_stretch")


def membrane_of(cov):
    return MembraneFit(VALUES, cov, NAMES, DENSE, (), 0.0, ())


@pytest.mark.parametrize(
    ("sd", "held"), [((1e4, 1e-3), None), ((1e5, 1e-2), "pre_stretch"), ((1e5, 1e-3), "young")]
)
def test_undetermined_parameters_are_fixed_pre_stretch_first(sd, held):
    assert (
        _first_undetermined(NAMES, VALUES, np.diag(np.square(sd)), "membrane", _HELD_FIRST) == held
    )


def test_only_the_product_of_thickness_and_modulus_is_determined():
    """With unknown thickness, thickness and modulus are strongly correlated.

    var(log E) = var(log E h) + var(log h), cov(log E, log h) = -var(log h). With uncertainties of
    0.3 of h and 0.01 of E h the correlation is -0.3 / sqrt(0.3^2 + 0.01^2).
    """
    names, cov = covariance_of(membrane_of(np.diag([1e4**2, 1e-3**2])), None, known_thickness=False)
    assert names == ["membrane.young_MPa", "membrane.pre_stretch", "membrane.thickness_mm"]
    rho = cov[0, 2] / np.sqrt(cov[0, 0] * cov[2, 2])
    assert rho == pytest.approx(-0.3 / np.hypot(0.3, 0.01))
    names, cov = covariance_of(membrane_of(np.diag([1e4**2, 1e-3**2])), None, known_thickness=True)
    assert len(names) == 2 and cov[0, 0] == 1e8


@pytest.mark.parametrize(
    ("heights", "words"),
    [
        ((-0.02, 0.003), "about 612, 612 px in place of 600, 600 px"),
        ((-0.004, 0.0005), "the lens agrees"),  # below half a percent
        ((-0.02, 0.015), "do not determine the lens"),
        ((0.001, 0.002), "the lens agrees"),
    ],
)
def test_a_different_lens_is_reported(heights, words):
    """Heights that are 2 % too small: the focal length is 2 % larger than the file's."""
    membrane = replace(membrane_of(np.eye(2)), heights=heights)
    result = FitResult(DENSE, "", (), (), (), membrane, None, None, (), 1.0)
    assert words in result.lens
    assert membrane.focal_scale == (pytest.approx(1.0204, abs=1e-4) if "612" in words else 1.0)


def test_a_membrane_at_another_distance_does_not_determine_the_lens():
    """The sd of all heights is at least the relative error of the apparent distance."""

    def flat(farther):
        count = DENSE.markers.count
        p_SC = DENSE.camera.p_SC + [0.0, 0.0, farther]
        return FlatReference(np.eye(3), p_SC, np.ones(count), 0.0, 0.0)

    assert _height_fraction(DENSE, flat(0.0)) == LENS_FRACTION
    assert _height_fraction(DENSE, flat(0.9e-3)) == pytest.approx(0.02, rel=0.05)


def test_images_are_evaluated_again_with_the_lens_found(monkeypatch):
    """The first estimate of a lens 2 % longer than the file's is 30 % off: inclined markers do not
    follow the common factor. With the images evaluated again, 30 % of the remainder are left.

    The prior sd of the heights stays that of the file's lens.
    """
    read = []

    def read_evidence(path, design, finger, notify):
        read.append(design.camera.fx)
        nothing = Hold(DENSE.markers.p_SM, np.zeros((81, 3, 3)), 1e3, None)
        series = Series(np.empty(0), np.empty(0), np.empty(0))
        return Evidence(path, None, nothing, (), series, (), 0.02 if len(read) == 1 else 0.003)

    def fit(design, evidence, known, options, start=None):
        assert [e.height_fraction for e in evidence] == [0.02]
        error = 1.3 * (design.camera.fx / 612 - 1)
        found = replace(membrane_of(np.eye(2)), heights=(error, 0.001), design=design)
        return found, found

    monkeypatch.setattr(identification, "read_evidence", read_evidence)
    monkeypatch.setattr(identification, "_fit_membrane", fit)
    free, membrane, _ = identification._fit_lens(["made"], DENSE, {}, FitOptions())
    np.testing.assert_allclose(read, [600, 612 * 1.006, 612 * 0.998], rtol=1e-3)
    assert free.heights == membrane.heights
    assert membrane.focal_scale == pytest.approx(1.02, rel=0.003)


def test_known_values_have_the_unit_of_the_file():
    design, by_section = _with_fixed_values(
        DENSE, {"membrane.thickness_mm": 0.31, "chamber.extra_volume_mL": 2.0}
    )
    assert design.membrane.thickness == pytest.approx(0.31e-3) and by_section["chamber"][
        "extra_volume"
    ] == pytest.approx(2e-6)
    with pytest.raises(InputError, match="is not a field"):
        _with_fixed_values(DENSE, {"membrane.color": 1.0})
