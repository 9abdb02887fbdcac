"""Tests of the fit of rubber relaxation to recordings of a simulated stage."""

import numpy as np
import pytest

from mjtactile.cli import main
from mjtactile.core import resources
from mjtactile.core.design import load_sensor, sensor_from_table
from mjtactile.core.errors import InputError
from mjtactile.core.toml import read_toml
from mjtactile.fit.relaxation import RelaxationFit, _solve, fit_relaxation

STEPS = "time_s,depth_mm,shear_mm,speed_mm_s,force_N\n2,3,,,\n9,,,,\n"


def test_relaxation_fractions_and_their_sd_with_sensor_noise():
    """The stated sd of the fitted fractions equals the scatter of many fits.

    All markers of an image move by the error of its pressure sensor.
    """
    rng = np.random.default_rng(3)
    images = 300
    time = np.linspace(0, 30, images)
    shape = rng.normal(size=30)
    shown = np.stack([np.exp(-time / tau)[:, None] * shape for tau in (2.0, 20.0)], axis=1)
    true = np.array([0.3, 0.2])
    found = []
    for _ in range(200):
        off = rng.normal(0, 0.1, images)[:, None] * shape
        fractions, cov = _solve(shown, np.einsum("nkj,k->nj", shown, true) + 1.0 + off)
        found.append([*fractions, np.sqrt(np.diag(cov))[1]])
    found = np.array(found)
    mean = found[:, :2].mean(axis=0)
    # 200 fits: the mean is known to 7 % of an sd
    np.testing.assert_allclose(mean, true, atol=0.3 * found[:, 1].std())
    # the sd counts neighbours for half, which these are not: sqrt(2) too wide, and a tenth of noise
    assert found[:, 2].mean() == pytest.approx(np.sqrt(2) * found[:, 1].std(), rel=0.2)


def test_the_result_is_a_section_of_a_sensor_file(tmp_path):
    found = RelaxationFit(np.array([1.0, 10.0]), np.array([0.0, 0.05]), (1.0, 30.0), 0.04, 0.004)
    text = resources.find("dense", "models/sensors", ".toml").read_text()
    (tmp_path / "mine.toml").write_text(f"{text}\n{found.section}")
    design = sensor_from_table(read_toml(tmp_path / "mine.toml"), name="mine", source="mine.toml")
    assert design.relaxation is not None
    assert design.relaxation.terms == ((0.05, 10.0),)


@pytest.mark.slow(10)
def test_a_held_and_released_press_determines_the_relaxation(tmp_path, capsys):
    text = resources.find("dense", "models/sensors", ".toml").read_text()
    assert "rate_Hz = 30.0" in text
    text = text.replace("rate_Hz = 30.0", "rate_Hz = 10.0")  # a third of the images suffice
    (tmp_path / "nominal.toml").write_text(text)
    terms = ((0.05, 1.0), (0.05, 10.0), (0.05, 100.0))
    section = f"\n[relaxation]\nterms_s = {[list(term) for term in terms]}\n"
    (tmp_path / "specimen.toml").write_text(text + section)
    (tmp_path / "steps.csv").write_text(STEPS)
    nominal = str(tmp_path / "nominal.toml")
    command = ["record", "--rig", "stage", "--sensor", nominal, "--indenter", "sphere:8"]
    command += ["--as-built", str(tmp_path / "specimen.toml")]
    command += ["--protocol", str(tmp_path / "steps.csv"), "--seconds", "23"]
    assert main([*command, "--out", str(tmp_path / "held")]) == 0
    found = fit_relaxation(tmp_path / "held", load_sensor(nominal), "left")
    start, end = found.within
    faded = sum(fraction * (np.exp(-start / tau) - np.exp(-end / tau)) for fraction, tau in terms)
    assert found.is_finite_value
    # 2.5 sd; one sd is a tenth of the value
    assert found.faded == pytest.approx(faded, abs=2.5 * found.faded_sd)
    assert found.faded_sd < 0.15 * faded


def test_a_recording_without_relaxation_information_is_refused(tmp_path):
    command = ["record", "--rig", "stage", "--sensor", "dense", "--seconds", "0.5"]
    assert main([*command, "--out", str(tmp_path / "short")]) == 0
    with pytest.raises(
        InputError, match="no unloaded membrane with known pressure for 10 s"
    ) as caught:
        fit_relaxation(tmp_path / "short", load_sensor("dense"), "left")
    assert "\n" not in str(caught.value)
