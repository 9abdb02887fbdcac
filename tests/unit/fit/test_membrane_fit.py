"""Tests of the membrane fit from holds: it recovers the differing membrane of the simulator."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mjtactile.core.design import load_sensor
from mjtactile.fit.gauss_newton import gauss_newton
from mjtactile.fit.measurements import Evidence, Hold, Series
from mjtactile.fit.membrane_fit import DISCRETIZATION, FitOptions, fit_membrane
from mjtactile.fit.simulated_holds import finer_mesh, simulate, stage_world
from mjtactile.recording.stage_protocol import Move, Stage

# coarse: of the same mesh both times
DESIGN = load_sensor("paper16")
MESH = (7, 6)
NOTHING = Series(np.empty(0), np.empty(0), np.empty(0))


def evidence_of(true, pressure, mesh=MESH):
    """Return the rest shape at a pressure, with 3 um of noise."""
    empty = Hold(true.markers.p_SM, np.zeros((true.markers.count, 3, 3)), pressure, None)
    observed = simulate(true, Evidence("made", None, empty, (), NOTHING, ()), mesh=mesh)[0].p_SM
    noise = np.random.default_rng(round(pressure)).normal(0, 3e-6, observed.shape)
    cov = np.broadcast_to(9e-12 * np.eye(3), (len(observed), 3, 3))
    return Evidence(
        f"{pressure:g} Pa", None, Hold(observed + noise, cov, pressure, None), (), NOTHING, ()
    )


@pytest.fixture(scope="module")
def true():
    return replace(DESIGN, membrane=replace(DESIGN.membrane, young=1.2e6, pre_stretch=1.04))


PRESSURES = (500.0, 3000.0)


@pytest.fixture(scope="module")
def two_pressures(true):
    """Provide images at two pressures, and their fit."""
    evidence = [evidence_of(true, p) for p in PRESSURES]
    return evidence, fit_membrane(DESIGN, evidence, known={}, options=FitOptions(mesh=MESH))


def test_two_pressures_determine_modulus_and_pre_stretch(two_pressures):
    """Two pressures determine modulus and pre-stretch, and the covariance covers the error.

    Tension holds the membrane at 0.5 kPa, the modulus at 3 kPa. With heights of 1-4 mm known to a
    few um each, both are known to a percent or two.
    """
    _, found = two_pressures
    assert found.values["young"] == pytest.approx(1.2e6, rel=0.03)
    assert found.values["pre_stretch"] == pytest.approx(1.04, abs=0.002)
    off = np.array([found.values["young"] - 1.2e6, found.values["pre_stretch"] - 1.04])
    assert off @ np.linalg.solve(found.cov[:2, :2], off) < 9.2  # 99 % of two numbers


def test_a_start_near_the_solution_gives_the_same_fit(two_pressures):
    """The result is that of the file's start, within a fraction of the sd."""
    options = FitOptions(mesh=MESH)
    evidence, far = two_pressures
    start = {"young": 1.19e6, "pre_stretch": 1.0405}
    near = fit_membrane(DESIGN, evidence, known={}, options=options, start=start)
    sd = np.sqrt(np.diag(far.cov))
    for i, name in enumerate(("young", "pre_stretch")):
        assert near.values[name] == pytest.approx(far.values[name], abs=0.3 * sd[i])


def test_one_pressure_does_not_determine_modulus_and_pre_stretch(true):
    """One pressure gives one height, so that modulus and pre-stretch stay strongly
    anticorrelated."""
    found = fit_membrane(
        DESIGN, [evidence_of(true, 1000.0)], known={}, options=FitOptions(mesh=MESH)
    )
    sd = np.sqrt(np.diag(found.cov))
    assert found.cov[0, 1] / (sd[0] * sd[1]) < -0.9
    assert sd[0] > 0.05e6


def test_a_single_deep_move_into_a_closed_chamber(true):
    """The simulated hold has the markers of a closed chamber, whose pressure rises with the depth.

    The contact sticks, so that the state depends on the pressures of the move. At the pressure of
    the hold from the start, markers are off by 26 um (rms); the fit's marker floor is 8 um.
    """
    stage = Stage("sphere:10", (0.0, 0.0), (Move(0.0, 3.5e-3, speed=0.01),))
    count = true.markers.count
    rest = Hold(np.zeros((count, 3)), np.zeros((count, 3, 3)), 1000.0, None)
    recording = Evidence("made", stage, rest, (), NOTHING, ())
    world = stage_world(true, recording, MESH)
    world.inflate(1000.0, seal=True)
    world.press(3.5e-3, 0.0, 0.01)
    hold = replace(rest, pressure=world.sensors[0].gauge_pressure, move=stage.moves[0])
    assert hold.pressure > 1500.0
    observed = world.marker_poses(0)[0]
    found = simulate(true, replace(recording, holds=(hold,)), mesh=MESH)[1].p_SM
    assert np.sqrt(np.mean((found - observed) ** 2)) < 8e-6


def loaded(true, scale, height_fraction=0.02, jitter=0.0):
    """Return indentations to 1-3 mm at 1 kPa, with all measured heights `scale` times the true
    ones."""
    stage = Stage("sphere:8", (0.0, 0.0), tuple(Move(t, 1e-3 * t) for t in (1.0, 3.0)))
    count = true.markers.count
    nothing = (np.zeros((count, 3)), np.zeros((count, 3, 3)))
    holds = tuple(Hold(*nothing, 1000.0, move) for move in stage.moves)
    made = Evidence("made", stage, Hold(*nothing, 1000.0, None), holds, NOTHING, ())
    rng = np.random.default_rng(3)
    observed = []
    for found in simulate(true, made, mesh=MESH):
        p = found.p_SM * [1.0, 1.0, scale] + rng.normal(0, 3e-6 + jitter, (count, 3))
        observed.append((p, np.broadcast_to(9e-12 * np.eye(3), (count, 3, 3))))
    rest, *others = observed
    return Evidence(
        "made",
        stage,
        Hold(*rest, 1000.0, None),
        tuple(Hold(*one, 1000.0, move) for one, move in zip(others, stage.moves, strict=True)),
        NOTHING,
        (),
        height_fraction,
    )


@pytest.mark.slow
def test_indentations_identify_a_wrong_lens(true):
    """A focal length 2 % too small in the file makes all heights 2 % too small; the stage's depths
    are right. The modulus stays within its interval."""
    others = [
        replace(e, rest=replace(e.rest, p_SM=e.rest.p_SM * [1, 1, 0.98]), height_fraction=0.02)
        for e in (evidence_of(true, p) for p in (500.0, 3000.0))
    ]
    options = FitOptions(mesh=MESH)
    found = fit_membrane(DESIGN, [*others, loaded(true, 0.98)], known={}, options=options)
    error, sd = found.heights
    assert error == pytest.approx(-0.02, abs=3 * sd) and sd < 0.006
    assert found.values["young"] == pytest.approx(1.2e6, rel=0.03)
    off = np.array([found.values["young"] - 1.2e6, found.values["pre_stretch"] - 1.04])
    assert off @ np.linalg.solve(found.cov[:2, :2], off) < 9.2  # 99 % of two numbers


@pytest.mark.slow
def test_a_misfit_widens_the_intervals(true):
    """Marker errors of 50 um where 8 um are expected: sd of the parameters grow as the misfit."""
    options = FitOptions(mesh=MESH)
    known = {"pre_stretch": 1.04}
    good, bad = (
        fit_membrane(DESIGN, [loaded(true, 1.0, 0.003, jitter)], known=known, options=options)
        for jitter in (0.0, 5e-5)
    )
    assert good.misfit < 1.0 < 4.0 < bad.misfit
    ratio = np.sqrt(bad.cov[0, 0] / good.cov[0, 0])
    assert ratio == pytest.approx(bad.misfit, rel=0.3)


def test_a_weight_indents_to_its_equilibrium_depth(true):
    """A weight F has the depth of an indenter whose force is F at 2.7 mm.

    The markers are at the same positions, within the effect of 0.3 % of the force. For a dent of
    2.7 mm this is less than 0.3 %, 8 um.
    """
    nothing = (np.zeros((true.markers.count, 3)), np.zeros((true.markers.count, 3, 3)))

    def pressed(move):
        stage = Stage("sphere:8", (0.0, 0.0), (move,))
        made = Evidence(
            "made",
            stage,
            Hold(*nothing, 1000.0, None),
            (Hold(*nothing, 1400.0, move),),
            NOTHING,
            (),
        )
        return simulate(true, made, mesh=(9, 7))[1]

    by_depth = pressed(Move(1.0, 2.7e-3))
    by_weight = pressed(Move(1.0, force=-float(by_depth.force[2])))
    assert by_weight.force[2] == pytest.approx(by_depth.force[2], rel=0.004)
    assert np.abs(by_weight.p_SM - by_depth.p_SM).max() < 8e-6


def test_gauss_newton_is_least_squares_for_a_linear_model():
    rng = np.random.default_rng(0)
    A = rng.normal(size=(20, 3))
    b = rng.normal(size=20)

    def residuals(x):
        return A @ x - b

    free = np.full(3, math.inf)
    found = gauss_newton(residuals, lambda x, now: A, np.zeros(3), low=-free, high=free)
    assert found.x == pytest.approx(np.linalg.lstsq(A, b, rcond=None)[0], abs=1e-7)
    assert found.information == pytest.approx(A.T @ A, abs=1e-7)


def test_a_step_near_the_solution_keeps_the_jacobian():
    """The Jacobian is computed once if all steps are short, and again after a long one."""
    times = np.linspace(0, 1, 50)
    calls = []

    def residuals(x):
        return 100 * (np.exp(x[0] * times) - np.exp(0.5 * times)) + np.sin(40 * times)

    def jacobian(x, now):
        calls.append(x[0])
        return (100 * times * np.exp(x[0] * times))[:, None]

    limits = {"low": np.array([-9.0]), "high": np.array([9.0])}
    near = gauss_newton(residuals, jacobian, np.array([0.503]), **limits)
    assert len(calls) == 1
    far = gauss_newton(residuals, jacobian, np.array([1.0]), **limits)
    assert len(calls) > 2
    assert near.x == pytest.approx(far.x, abs=1e-3)


def test_the_error_of_a_coarse_mesh_is_identified(true, two_pressures):
    """A sensor with a finer mesh than that of the fit: the discretization error is found, and the
    intervals cover the parameters. It has the sign of a finer mesh."""
    fine = [evidence_of(true, p, finer_mesh(MESH)[0]) for p in PRESSURES]
    _, same = two_pressures
    other = fit_membrane(DESIGN, fine, known={}, options=FitOptions(mesh=MESH))
    row = same.names.index(DISCRETIZATION)
    assert abs(same.discretization) < 2 * np.sqrt(same.cov[row, row])
    assert other.discretization - same.discretization > 0.2
    for found in (same, other):
        off = np.array([found.values["young"] - 1.2e6, found.values["pre_stretch"] - 1.04])
        assert off @ np.linalg.solve(found.cov[:2, :2], off) < 9.2  # 99 % of two numbers
