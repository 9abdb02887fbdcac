"""Tests of force from surface and pressure, against the force of a quasi-static membrane from
another method, and of the effects of scale, translation and rotation."""

import numpy as np
import pytest

from mjtactile import (
    InputError,
    QuasistaticMembrane,
    RestSurface,
    estimate_force_from_surface,
    load_sensor,
)

SMOOTHING = 2e-3


@pytest.fixture(scope="module")
def membrane():
    return QuasistaticMembrane(load_sensor("dense"), (61, 46))


def points_of(membrane, state):
    x, y = np.meshgrid(membrane.x, membrane.y, indexing="ij")
    return np.stack([x + state.x[0], y + state.x[1], state.x[2]], axis=-1).reshape(-1, 3)


def outline_of(membrane):
    half = [membrane.x[-1], membrane.y[-1]]
    return np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half


def rest_of(membrane):
    return RestSurface(points_of(membrane, membrane.rest), membrane.rest.gauge_pressure)


def pressed(membrane, at, radius, depth):
    state = None
    for down in np.linspace(0, depth, 12)[1:]:
        height = membrane.rest.heights.max() + radius - down
        state = membrane.solve(membrane.obstacle("sphere", (radius,), (*at, height)), state)
    assert state is not None
    return state


@pytest.mark.parametrize(
    ("at", "radius", "depth"),
    [((0, 0), 8e-3, 3e-3), ((0, 0), 20e-3, 2e-3), ((4e-3, 3e-3), 6e-3, 2.5e-3)],
)
def test_force_is_the_membranes(membrane, at, radius, depth):
    state = pressed(membrane, at, radius, depth)
    observed = points_of(membrane, state)
    # camera errors: 10 um, as of a depth camera for so small an object
    observed = observed + np.random.default_rng(1).normal(0, [0, 0, 1e-5], observed.shape)
    found = estimate_force_from_surface(
        observed, state.gauge_pressure, outline_of(membrane), rest_of(membrane), smoothing=SMOOTHING
    )
    # the membrane's tension varies over its surface, and one factor is modelled: 3 %
    assert found.force[2] == pytest.approx(state.wrench[2], rel=0.06)
    # a force through a ball's center tilts with the contact position
    assert found.force[:2] == pytest.approx(state.wrench[:2], abs=5e-3)
    # point of action, above the ball's position, less the tilt
    assert found.center == pytest.approx(np.array(at), abs=6e-4)


def test_no_contact_gives_zero_force(membrane):
    found = estimate_force_from_surface(
        points_of(membrane, membrane.rest),
        1000.0,
        outline_of(membrane),
        rest_of(membrane),
        smoothing=SMOOTHING,
    )
    assert np.abs(found.force).max() < 1e-9 and found.area == 0 and np.isnan(found.center).all()


def test_shift_rotation_and_pressure(membrane):
    # statics: a quarter's turn and a shift of the frame take the force along; twice all pressures
    # on the same shapes, twice the force
    state = pressed(membrane, (4e-3, 3e-3), 6e-3, 2.5e-3)
    given = [points_of(membrane, state), points_of(membrane, membrane.rest)]
    corners = outline_of(membrane)
    own = estimate_force_from_surface(
        given[0], 1020.0, corners, RestSurface(given[1], 1000.0), smoothing=SMOOTHING
    )
    rotation = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    shift = np.array([12e-3, -7e-3, 60e-3])
    moved = [item @ rotation.T + shift for item in given]
    outline = corners @ rotation[:2, :2].T + shift[:2]
    found = estimate_force_from_surface(
        moved[0], 2040.0, outline, RestSurface(moved[1], 2000.0), smoothing=SMOOTHING
    )
    # the rotated grid lies differently on the points, and cells at the rim of the contact are added
    # or lost
    assert found.force == pytest.approx(2 * rotation @ own.force, rel=0.04, abs=2e-3)
    assert found.center == pytest.approx(rotation[:2, :2] @ own.center + shift[:2], abs=3e-4)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"pressure": -5.0}, "pressure"),
        ({"pressure": np.nan}, "pressure"),
        ({"outline": [[0, 0], [1, 1]]}, "outline"),
        ({"smoothing": 0.05}, "smoothing"),
        ({"points": np.full((100, 3), np.nan)}, "points"),
    ],
)
def test_impossible_values_are_refused(membrane, change, field):
    given = {
        "points": points_of(membrane, membrane.rest),
        "pressure": 1000.0,
        "outline": outline_of(membrane),
        "membrane": rest_of(membrane),
        "smoothing": SMOOTHING,
    }
    with pytest.raises(InputError, match=field):
        estimate_force_from_surface(**(given | change))
