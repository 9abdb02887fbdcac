"""What body touches, from markers of an independent solver's sheet (benchmarks/film_reference.json)
with a camera's noise."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np
import pytest

import benchmarks.film
from mjtactile import Chain, Film, load_sensor
from mjtactile.core.types import Markers, Touch
from mjtactile.sensing.body.forward import Forward
from mjtactile.sensing.chain import with_shape

NOISE = np.array([3.4e-6, 3.4e-6, 19e-6])  # m: `dense`, one image


@pytest.fixture(scope="module")
def sensor():
    """The chain of `dense` with the rest of the film, which the independent sheet shares to 2 um,
    and the finder of shapes."""
    design = load_sensor("dense")
    chain = Chain(design)
    film = Film(design, (41, 31))
    rest = seen(in_order(benchmarks.film._markers(film, film.rest)))
    state = chain.set_rest(chain.begin(), rest, film.pressure_gauge)
    return chain, state, chain.shape_finder(state)


@pytest.fixture(scope="module")
def cases():
    path = Path(benchmarks.film.__file__).with_name("film_reference.json")
    return [case for case in json.loads(path.read_text())["cases"] if "markers_um" in case]


def seen(places, rng=None):
    n = len(places)
    noise = 0.0 if rng is None else NOISE * rng.standard_normal((n, 3))
    cov = np.tile(np.diag(NOISE**2), (n, 1, 1))
    return Markers(np.arange(n), places + noise, np.tile([0.0, 0, 1], (n, 1)), cov)


def touch_of(sensor, places, seed=0) -> Touch:
    chain, state, _ = sensor
    markers = seen(places, np.random.default_rng(seed))
    return chain.feel(state, markers, chain.fitter.fit(markers), 0.0)[0]


def in_order(places):
    """A reference's markers (81, 3) m in the order of the sensor's."""
    grid = benchmarks.film._MARKERS
    nominal = load_sensor("dense").markers.p_SM
    return places[[int(np.abs(grid - at[:2]).sum(axis=1).argmin()) for at in nominal]]


def layout_places(case):
    return in_order(1e-6 * np.array(case["markers_um"]))


@pytest.mark.parametrize(
    ("radius_mm", "at_mm"),
    [(8.0, [0.0, 0.0]), pytest.param(30.0, [7.0, -4.0], marks=pytest.mark.slow)],
)
def test_a_ball_is_a_ball_of_its_radius(sensor, cases, radius_mm, at_mm):
    case = next(c for c in cases if c["size_mm"] == [radius_mm] and c["at_mm"] == at_mm)
    touch = touch_of(sensor, layout_places(case))
    assert touch.contact.area_from == "nodal"
    shape = sensor[2].find([touch])
    assert shape.kind == "smooth" and shape.status == "ok"
    assert sum(shape.probabilities.values()) == pytest.approx(1.0)
    # one image knows 3 % of it; the reference's sheet meets the ball with its middle, the film
    # with its face, 0.15 mm further in
    assert 1e3 * shape.radius == pytest.approx(radius_mm - 0.15, rel=0.08)
    assert 1e3 * shape.p_SO[:2] == pytest.approx(at_mm, abs=0.2)
    low, high = shape.area_interval
    assert 0 < low < shape.area < high
    # frictionless both, and the film is within 2 %; `friction` of 3 % is added for what sticks
    assert shape.force_normal == pytest.approx(1.03 * case["force_N"], rel=0.04)
    assert pickle.loads(pickle.dumps(shape)).kind == "smooth"
    touch = with_shape(touch, shape)
    assert touch.contact.area == shape.area and touch.contact.area_from == shape.family


def test_a_flat_face_with_a_rim_is_not_smooth(sensor):
    """Markers of a film of 0.5 mm between nodes."""
    film = Film(load_sensor("dense"), (81, 61))
    radius = 4.5e-3
    cylinder = film.obstacle("cylinder", (radius, 0.02), (2e-3, -1e-3, 0.02 + 1.2e-3))
    places = in_order(benchmarks.film._markers(film, film.solve(cylinder)))
    shape = sensor[2].find([touch_of(sensor, places)])
    assert shape.kind == "face" and shape.family == "disc"
    # markers are 3 and 4 mm apart: half a millimetre of a rim's place
    assert shape.radius == pytest.approx(radius, rel=0.12)
    assert shape.area == pytest.approx(np.pi * radius**2, rel=0.2)


def test_nothing_is_said_of_what_does_not_touch(sensor):
    chain, state, finder = sensor
    still = touch_of(sensor, chain.inverse.positions(state.reference.rest.c))
    shape = finder.find([still])
    assert shape.kind == "unknown" and shape.status != "ok"
    assert with_shape(still, shape).contact.area_from == "nodal"
    assert np.isnan(shape.area) and np.isnan(shape.radius)
    assert all(np.isnan(p) for p in shape.probabilities.values())


def test_gas_that_came_since_raises_the_markers(sensor):
    """The response to a share of gas against the sheet's own, solved with that much more."""
    chain, state, finder = sensor
    forward: Forward = finder.forward
    rest = state.reference.rest
    share = 2e-3
    gas = type(rest.gas)(rest.gas.gauge, (1 + share) * rest.gas.constant)
    more = chain.inverse.sheet.equilibrium(gas, rest.stiffness_scale, start=rest.c)
    rise = (chain.inverse.positions(more) - chain.inverse.positions(rest.c))[:, 2]
    # the sheet's splines are 3 mm wide, and the response is linear to a per cent of it
    assert forward.by_gas * share == pytest.approx(rise, rel=0.05, abs=0.05 * rise.max())
