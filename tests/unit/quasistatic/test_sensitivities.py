"""Tests of derivatives by the obstacle's parameters, against differences of whole solutions."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mjtactile import InputError, QuasistaticMembrane
from mjtactile.quasistatic.obstacles import NUMBERS, rows_and_pool
from mjtactile.quasistatic.sensitivities import approximate_sensitivities, changed_obstacles

# Functions that make obstacles from parameters, and the parameters, at positions without imminent
# changes of the touching nodes.
TURN = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
HEIGHT = 2  # the number of each that is its middle's height
SHAPES = {
    "ball": (
        lambda n: QuasistaticMembrane.obstacle("sphere", (n[3],), n[:3]),
        [1.3e-3, -0.7e-3, 9e-3, 8e-3],
    ),
    "rod": (
        lambda n: QuasistaticMembrane.obstacle("capsule", (n[3], 4e-3), n[:3], TURN),
        [1.3e-3, -0.7e-3, 5.5e-3, 4e-3],
    ),
    "quadric": (
        lambda n: QuasistaticMembrane.obstacle("quadric", (n[3], n[4], 0.012), n[:3]),
        [1.3e-3, -0.7e-3, 1.2e-3, 120, 60],
    ),
    "box": (
        lambda n: QuasistaticMembrane.obstacle("box", (n[3], n[4], 0.01), n[:3]),
        [1.3e-3, -0.7e-3, 0.0117, 5.3e-3, 4.1e-3],
    ),
}


@pytest.mark.parametrize("name", SHAPES)
def test_sensitivities_agree_with_finite_differences(monkeypatch, name):
    monkeypatch.setattr(
        "mjtactile.quasistatic.membrane.TOLERANCE", 1e-10
    )  # tolerance in m; differences are 1e-6
    membrane = QuasistaticMembrane("dense", gauge_pressure=1000.0)
    shape, numbers = SHAPES[name]

    def settled(at, state=membrane.rest):
        for _ in range(3):  # a solution updates obstacles in three steps only
            state = membrane.solve(shape(at), state)
        return state

    numbers = np.array(numbers)
    state = settled(numbers)
    by = membrane.derivatives(state, shape, numbers)
    # steps in m; curvatures have larger ones, since a contact converges to single precision
    steps = np.diag(np.where(np.abs(numbers) < 1, 1e-6, 1e-3 * numbers))
    # smooth obstacles: error of the differences; edges: three sweeps for the terms that the tangent
    # omits
    rel = 5e-3 if name == "box" else 1e-3
    for k, step in enumerate(steps):
        low, high = settled(numbers - step, state), settled(numbers + step, state)

        def difference(of, low=low, high=high, by=2 * step[k]):
            return (of(high) - of(low)) / by

        displaced = difference(lambda s: s.displacements)
        np.testing.assert_allclose(by.displacements[k], displaced, atol=rel * np.ptp(displaced))
        wrench = difference(lambda s: s.wrench)
        np.testing.assert_allclose(by.wrench[k, :3], wrench[:3], atol=rel * np.ptp(wrench[:3]))
        np.testing.assert_allclose(by.wrench[k, 3:], wrench[3:], atol=rel * np.ptp(wrench[3:]))
        assert by.gauge_pressure[k] == pytest.approx(difference(lambda s: s.gauge_pressure), rel)
        assert by.volume[k] == pytest.approx(difference(lambda s: s.volume), rel)
        area = np.abs(by.area * numbers).max() / abs(numbers[k])  # some areas hardly change
        assert by.area[k] == pytest.approx(difference(lambda s: s.area), rel, abs=rel * area)


@pytest.mark.parametrize(
    ("name", "seen"), [("ball", range(4)), ("quadric", range(5)), ("box", [HEIGHT])]
)
def test_fast_derivatives_approximate_the_derivatives(name, seen):
    """Quick changes of heights and forces equal the exact ones, except for in-plane motion.

    The parameters of a box other than its height set the ends of its face, which are not `seen`.
    """
    membrane = QuasistaticMembrane("dense", (32, 24), gauge_pressure=1000.0)
    shape, numbers = SHAPES[name]
    state = membrane.solve(shape(np.array(numbers)))
    state = membrane.solve(shape(np.array(numbers)), state)
    exact = membrane.derivatives(state, shape, numbers)
    steps = np.where(np.abs(numbers) < 1, 1e-7, 1e-4 * np.array(numbers))
    listed, by = changed_obstacles(shape, numbers, steps)
    rows, pool = rows_and_pool([body for item in listed for body in item], membrane.grid)
    by_z, by_force = approximate_sensitivities(
        membrane, state, rows.reshape(len(listed), -1, NUMBERS), pool, by
    )
    for k in seen:
        # a membrane of this curvature moves in the plane by 5 to 10 % of its height change
        off = np.linalg.norm(by_z[k] - exact.heights[k]) / np.linalg.norm(exact.heights[k])
        assert off < 0.12
    stiffer = by_force[HEIGHT].sum() / exact.force_normal[HEIGHT] - 1
    # without in-plane motion it is stiffer by once or twice that: 17, 11 and 6 % here
    assert 0.05 < stiffer < 0.25


def test_a_contact_s_stiffness_is_that_of_an_energy():
    """Without friction the contact stiffness is the second derivative of an energy by the
    obstacle's pose.

    Second derivatives by two translations are independent of their order. Those by a translation
    and a rotation, or two rotations, on fixed axes, differ by the rotation of force and torque.
    """
    membrane = QuasistaticMembrane("dense", gauge_pressure=1000.0)
    ball = membrane.obstacle("sphere", (8e-3,), (1.3e-3, -0.7e-3, 9e-3))
    state = membrane.solve(ball)
    stiffness = membrane.derivatives_by_pose(membrane.solve(ball, state)).wrench.T
    off = stiffness - stiffness.T
    spin = np.eye(3)
    along = stiffness[:3, :3]
    np.testing.assert_allclose(along, along.T, atol=1e-3 * along.max())  # error of the nodes
    force, torque = state.wrench[:3], state.wrench[3:]
    pressing, leaning = (np.cross(item, spin).T for item in (force, torque))
    # terms from the positions of neighbours are not exactly those of a force
    np.testing.assert_allclose(off[:3, 3:], -pressing, atol=0.02 * abs(force).max())
    np.testing.assert_allclose(off[3:, 3:], -leaning, atol=0.1 * abs(torque).max())


def test_derivative_by_pose_equals_that_of_a_moved_shape():
    membrane = QuasistaticMembrane("dense", gauge_pressure=1000.0)
    place, tilt = np.array([2e-3, 1e-3, 8.2e-3]), Rotation.from_euler("xyz", [0.3, 0.1, 0.5])

    def posed(numbers):
        rotation = Rotation.from_rotvec(numbers[3:])
        at = numbers[:3] + rotation.apply(place)
        block = membrane.obstacle("box", (5e-3, 4e-3, 6e-3), at, (rotation * tilt).as_matrix())
        ball = membrane.obstacle("sphere", (3e-3,), numbers[:3] + rotation.apply([-8e-3, 0, 4e-3]))
        return [block, ball]

    state = membrane.solve(posed(np.zeros(6)))
    by_pose = membrane.derivatives_by_pose(state)
    by_shape = membrane.derivatives(state, posed, np.zeros(6), steps=np.full(6, 1e-7))
    for name in ("displacements", "contact_forces", "wrench", "gauge_pressure"):
        found, same = getattr(by_pose, name), getattr(by_shape, name)
        # steps of 1e-8 and 1e-7 in m and rad; the second derivative is some 100/m
        np.testing.assert_allclose(found, same, atol=2e-4 * abs(same).max())


def test_a_state_without_its_obstacles_has_no_derivative_by_pose():
    membrane = QuasistaticMembrane("dense", (11, 9), 1000.0)
    ball = membrane.obstacle("sphere", (8e-3,), (0, 0, 9e-3))
    with pytest.raises(InputError, match="belongs to a batch"):
        membrane.derivatives_by_pose(membrane.solve_batch([[ball]])[0])
    field = membrane.obstacle(
        "heights", data=membrane.obstacle_heights(ball, _nodes(membrane)).reshape(membrane.grid)
    )
    with pytest.raises(InputError, match="height field"):
        membrane.derivatives_by_pose(membrane.solve(field))
    assert not membrane.derivatives_by_pose(membrane.rest).wrench.any()


def _nodes(membrane):
    return np.stack(np.meshgrid(membrane.x, membrane.y, indexing="ij"), -1).reshape(-1, 2)


def test_states_without_derivatives_are_refused(monkeypatch):
    membrane = QuasistaticMembrane("dense", (11, 9), 1000.0)
    shape = SHAPES["ball"][0]
    with pytest.raises(InputError, match="finite"):
        membrane.derivatives(membrane.rest, shape, [np.nan, 0, 0.02, 8e-3])
    with pytest.raises(InputError, match="steps"):
        membrane.derivatives(membrane.rest, shape, [0, 0, 0.02, 8e-3], steps=[1e-6])
    with pytest.raises(InputError, match="steps: is not finite"):
        membrane.derivatives(
            membrane.rest, shape, [0, 0, 0.02, 8e-3], steps=[1e-6, 0, 1e-6, np.inf]
        )
    with pytest.raises(InputError, match="steps: must not be zero"):
        membrane.derivatives(membrane.rest, shape, [0, 0, 0.02, 8e-3], steps=[1e-6, 0, 1e-6, 1e-6])
    with pytest.raises(InputError, match="is not an equilibrium on these obstacles"):  # 2 mm deep
        membrane.derivatives(membrane.rest, shape, [0, 0, 9e-3, 8e-3])
    pressed = membrane.solve(shape([0, 0, 9e-3, 8e-3]))
    for other in ([0, 0, 8.7e-3, 8e-3], [0, 0, 0.02, 8e-3], [0.012, 0, 9e-3, 8e-3]):
        with pytest.raises(InputError, match="is not an equilibrium on these obstacles"):
            membrane.derivatives(pressed, shape, other)
    with pytest.raises(InputError, match="shape: None is not an obstacle"):
        membrane.derivatives(pressed, lambda numbers: None, [0.0])
    empty = membrane.derivatives(membrane.rest, shape, [0, 0, 0.02, 8e-3])
    assert not empty.displacements.any() and not empty.wrench.any()  # without contact
