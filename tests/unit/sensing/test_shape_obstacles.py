"""The obstacles of the shape models against their definitions in numpy."""

from dataclasses import replace

import numpy as np
import pytest

from mjtactile.quasistatic import QuasistaticMembrane
from mjtactile.sensing.contact_shape.primitives import InitialGuess
from mjtactile.sensing.contact_shape.shape_models import FAMILIES, several

GRID = (21, 16)


@pytest.fixture(scope="module")
def membrane():
    return QuasistaticMembrane("dense", GRID)


@pytest.fixture(scope="module")
def guess(membrane):
    nodes = tuple(np.meshgrid(membrane.x, membrane.y, indexing="ij"))
    return InitialGuess(
        np.array([2e-3, -1e-3]), 5e-3, 5e-5, 0.3, np.array([17e-3, 12e-3]), nodes, 7e-4, 0.3
    )


def heights(membrane, name, theta, guess, points):
    """Return the heights of the surface of a shape (n,), m."""
    made = FAMILIES[name].build(np.array(theta), guess)
    half = membrane.design.membrane.thickness / 2
    return membrane.obstacle_heights(made, points) + half


def test_round_shapes_have_their_curvature_and_lowest_point(membrane, guess):
    """Near the lowest point a surface rises by k r^2 / 2; the next term is below (k r)^2 / 4 =
    0.9 % of that for 210 /m at 0.9 mm."""
    half = membrane.design.membrane.thickness / 2
    low = np.array([2.5e-3, -1.2e-3])
    t = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    around = 0.8e-3 * np.column_stack([np.cos(t), np.sin(t)])
    K = np.array([[180.0, 50.0], [50.0, 90.0]])
    line = np.array([-np.sin(0.4), np.cos(0.4)])
    place = [0.5, -0.2, 0.3]
    for name, own, bent in (
        ("smooth", (180.0, 50.0, 90.0), K),
        ("ball", (120.0,), 120.0 * np.eye(2)),
        ("cylinder", (120.0, 0.4, 0.0), 120.0 * np.outer(line, line)),
    ):
        found = heights(membrane, name, [*place, *own], guess, low + around)
        rise = 0.5 * np.einsum("ni,ij,nj->n", around, bent, around)
        # half a thickness across the slope is more along z
        rise -= half * (np.sqrt(1 + np.square(around @ bent).sum(axis=1)) - 1)
        np.testing.assert_allclose(found - 5.3e-3, rise, atol=0.012 * rise.max(), err_msg=name)
        lowest = heights(membrane, name, [*place, *own], guess, low[None])
        np.testing.assert_allclose(lowest, 5.3e-3, atol=1e-9)  # rounding of a curvature radius


@pytest.mark.parametrize("is_round", [False, True])
def test_a_leaning_cylinder_ends_at_the_frame(guess, is_round):
    theta = np.array([0.5, -0.2, 0.3, 120.0, 0.4, 0.2])
    (body,) = FAMILIES["cylinder"].build(theta, replace(guess, round=is_round))
    row = body.parameters
    axis = row[4:13].reshape(3, 3)[:, 2]
    np.testing.assert_allclose(axis[2], -np.sin(0.2), atol=1e-12)
    R = row[4:13].reshape(3, 3)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    ends = np.array([row[13:16] + side * row[2] * axis for side in (-1, 1)])
    lowest_line = ends - R[:, 1] / 120.0
    relative = np.abs(lowest_line[:, :2]) / guess.frame
    outermost = np.hypot(*relative.T) if is_round else relative.max(axis=1)
    np.testing.assert_allclose(outermost, 1.0, atol=1e-9)


def test_faces_are_planes_with_rounded_rims(guess):
    x, y = guess.nodes[0] - 2.5e-3, guess.nodes[1] + 1.2e-3
    plane = 5.3e-3 + 0.05 * y + 0.02 * x

    def flank(distance):
        distance = distance - 1.4 * guess.rounding
        return distance + np.hypot(distance, guess.rounding)

    disc = plane + flank(np.hypot(x, y) - 4e-3)
    c, s = np.cos(0.4), np.sin(0.4)
    block = plane + flank(np.abs(c * x + s * y) - 3e-3) + flank(np.abs(c * y - s * x) - 5e-3)
    place = [0.5, -0.2, 0.3, 0.05, -0.02]
    for name, own, expected in (("disc", (4.0,), disc), ("block", (0.4, 3.0, 5.0), block)):
        (body,) = FAMILIES[name].build(np.array([*place, *own]), guess)
        np.testing.assert_allclose(body.pool.reshape(GRID), expected, rtol=0, atol=1e-15)


def test_parts_of_several_contacts_keep_their_own_heights(guess):
    family = several(["disc", "ball", "block"])
    hint = replace(guess, parts=(guess, replace(guess, height=4e-3), guess))
    disc, ball = [0.5, -0.2, 0.3, 0.05, -0.02, 4.0], [0.1, 0.2, 0.3, 90.0]
    block = [-0.5, 0.2, 0.1, 0.01, 0.02, 0.4, 3.0, 5.0]
    thetas = np.array([[*disc, *ball, *block], [*disc, *ball, *block]])
    thetas[1] += 0.01
    rows, pool = family.rows(thetas, hint)
    assert pool is not None
    assert rows.shape == (2, 3, 20)
    for index, theta in enumerate(thetas):
        for part, (name, own, alone) in enumerate(
            zip(("disc", "ball", "block"), family.split(theta), hint.parts, strict=True)
        ):
            (body,) = FAMILIES[name].build(own, alone)
            start, count = rows[index, part, 16:18].astype(int)
            np.testing.assert_array_equal(pool[start : start + count], body.pool)
            np.testing.assert_array_equal(rows[index, part, 17:], body.parameters[17:])
            np.testing.assert_array_equal(rows[index, part, :16], body.parameters[:16])


def test_a_wrong_number_of_parameters_is_refused(guess):
    with pytest.raises(ValueError, match="invalid arguments"):
        FAMILIES["ball"].build(np.zeros(5), guess)
