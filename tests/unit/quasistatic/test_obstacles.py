"""Tests of every kind of obstacle against an equal one of another kind, or against statics; and of
invalid obstacles."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull, Delaunay

from mjtactile import InputError, QuasistaticMembrane

CORNERS = np.array(np.meshgrid(*[[-3e-3, 3e-3]] * 2, [-5e-3, 5e-3])).reshape(3, -1).T


@pytest.fixture(scope="module")
def quasistatic():
    return QuasistaticMembrane("dense", grid=(21, 16), gauge_pressure=1000.0)


def force(quasistatic, *bodies):
    state = quasistatic.solve(bodies)
    assert state.converged
    return state.force_normal


def box_of_triangles():
    """Return the lower face of the box spanned by CORNERS, as two triangles."""
    a, b, c, d = (corner for corner in CORNERS if corner[2] < 0)
    return np.array([[a, b, c], [b, d, c]])


CLOUD = np.random.default_rng(3).normal(size=(30, 3)) * [4e-3, 3e-3, 2e-3]
AXES = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
R_SO = AXES * np.sign(np.linalg.det(AXES))
TILTED = np.array([[1, 0, 0], [0, np.cos(0.3), -np.sin(0.3)], [0, np.sin(0.3), np.cos(0.3)]])
PLACE = np.array([0.5e-3, -0.4e-3, 8e-3])
HALF_THICKNESS = 1.5e-4


def in_bowl(x):
    k_x, k_y, extent = 90.0, -40.0, 6e-3
    return (x[:, 2] >= (k_x * x[:, 0] ** 2 + k_y * x[:, 1] ** 2) / 2) & (
        np.hypot(x[:, 0], x[:, 1]) <= extent
    )


def in_rimmed_disc(x):
    """Return all points within 1 mm of a disc of 4 mm radius and 3 mm half height."""
    beyond = np.stack([np.hypot(x[:, 0], x[:, 1]) - 4e-3, np.abs(x[:, 2]) - 3e-3])
    return np.linalg.norm(np.maximum(beyond, 0), axis=0) <= 1e-3


def in_hull(x):
    return Delaunay(CLOUD).find_simplex(x) >= 0


# Inside test of each body in its own frame, by its definition alone; and its rotation.
INSIDE = {
    "plane": ((), None, lambda x: x[:, 2] >= 0, TILTED),
    "quadric": ((90.0, -40.0, 6e-3), None, in_bowl, TILTED),
    "disc": ((5e-3, 4e-3, 1e-3), None, in_rimmed_disc, TILTED),
    "mesh": ((), CLOUD, in_hull, R_SO),
    "triangles": ((), CLOUD[ConvexHull(CLOUD).simplices], in_hull, R_SO),
}


def lowest_inside(inside, turn, places):
    """Return heights (n,), m, at which a vertical line from below enters a body: search in steps of
    0.1 mm, then bisection to 1e-12 m."""
    steps = np.arange(-4e-3, 20e-3, 1e-4)
    at = np.repeat(places, len(steps), axis=0)
    lines = np.column_stack([at, np.tile(steps, len(places))])
    hits = inside((lines - PLACE) @ turn).reshape(len(places), -1)
    first = hits.argmax(axis=1)
    high = np.where(hits.any(axis=1) & (first > 0), steps[first], np.nan)
    low = high - 1e-4
    for _ in range(27):
        midpoint = (low + high) / 2
        is_in = inside((np.column_stack([places, midpoint]) - PLACE) @ turn)
        low, high = np.where(is_in, low, midpoint), np.where(is_in, midpoint, high)
    return high


@pytest.mark.parametrize("kind", INSIDE)
def test_heights_are_those_at_which_a_line_from_below_enters_the_body(quasistatic, kind):
    """Obstacle heights are the points where a line from below enters the body, less half a
    thickness.

    The reference uses only the inside test. Half the membrane's thickness is measured across the
    surface's slope.
    """
    sizes, data, inside, rotation = INSIDE[kind]
    places = np.random.default_rng(1).uniform(-4e-3, 4e-3, (60, 2))
    found = quasistatic.obstacle_heights(
        quasistatic.obstacle(kind, sizes, PLACE, rotation, data=data), places
    )
    step = 1e-7  # step in m; slopes come from differences of heights that are exact to 1e-12
    ahead = [lowest_inside(inside, rotation, places + step * axis) for axis in np.eye(2)]
    height = lowest_inside(inside, rotation, places)
    slope = np.hypot(*(item - height for item in ahead)) / step
    flat = (slope < 0.9) & np.isfinite(found)  # steeper rims count as ended
    assert flat.sum() > 10
    off = HALF_THICKNESS * np.sqrt(1 + slope[flat] ** 2)
    # tolerance in m; the slope of a rim of 1 mm changes by 1e-4 over the step, and the offset by
    # 1e-8
    np.testing.assert_allclose(found[flat], height[flat] - off, atol=2e-8)
    if kind == "mesh":
        np.testing.assert_array_equal(np.isfinite(found), np.isfinite(height))


def test_a_disc_that_is_all_rim_is_a_ball(quasistatic):
    place = (0.7e-3, 0.2e-3, 8.5e-3)
    disc = force(quasistatic, quasistatic.obstacle("disc", (8e-3, 8e-3, 8e-3), place, TILTED))
    # its offset is taken across its slope where a ball's is exact: 1 um at the contact's rim
    assert disc == pytest.approx(
        force(quasistatic, quasistatic.obstacle("sphere", (8e-3,), place)), rel=3e-3
    )


def test_a_tilted_plane_bears_along_its_normal(quasistatic):
    """Without friction all of the force is across the plane; so is each node's."""
    c, s = np.cos(0.06), np.sin(0.06)  # 0.9 mm at the frame
    rotation = np.array([[1.0, 0, 0], [0, c, -s], [0, s, c]])
    state = quasistatic.solve(quasistatic.obstacle("plane", p_SO=(0, 0, 1.8e-3), R_SO=rotation))
    normal = rotation[:, 2]
    assert state.converged and state.force_normal > 0.05
    np.testing.assert_allclose(
        state.wrench[:2] / state.wrench[2], normal[:2] / normal[2], atol=1e-6
    )


def test_a_bowl_rotated_about_its_axis_is_unchanged(quasistatic):
    c, s = np.cos(0.7), np.sin(0.7)
    rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    at = (1e-3, 0.5e-3, 1.5e-3)
    sizes = (90.0, 90.0, 0.012)
    straight = force(quasistatic, quasistatic.obstacle("quadric", sizes, at))
    assert force(
        quasistatic, quasistatic.obstacle("quadric", sizes, at, rotation)
    ) == pytest.approx(straight, 1e-4)


def test_triangles_and_hull_are_the_box_that_they_bound(quasistatic):
    place = (0.4e-3, -0.3e-3, 7e-3)
    box = force(quasistatic, quasistatic.obstacle("box", (3e-3, 3e-3, 5e-3), place))
    mesh = force(quasistatic, quasistatic.obstacle("mesh", p_SO=place, data=CORNERS))
    skin = force(
        quasistatic, quasistatic.obstacle("triangles", p_SO=place, data=box_of_triangles())
    )
    assert mesh == pytest.approx(box, rel=1e-6)
    assert skin == pytest.approx(box, rel=1e-6)


def test_triangles_that_move_press_as_the_body_that_they_follow(quasistatic):
    """Moving triangles have the force of the body that they follow.

    A soft body supplies the corners of its skin in each step, in S.
    """
    state = None
    for height in (7.2e-3, 7e-3, 6.9e-3):
        skin = box_of_triangles() + (0.4e-3, -0.3e-3, height)
        state = quasistatic.solve(quasistatic.obstacle("triangles", data=skin), state)
    assert state is not None and state.converged
    box = force(
        quasistatic, quasistatic.obstacle("box", (3e-3, 3e-3, 5e-3), (0.4e-3, -0.3e-3, 6.9e-3))
    )
    assert state.force_normal == pytest.approx(box, rel=1e-3)


def test_a_quadric_and_a_field_of_heights_are_the_ball_near_its_pole(quasistatic):
    ball = quasistatic.obstacle("sphere", (20e-3,), (1e-3, 0, 21.5e-3))
    pressed = force(quasistatic, ball)
    quadric = quasistatic.obstacle("quadric", (50.0, 50.0, 0.01), (1e-3, 0, 1.5e-3))
    # its height is less by r^4 / 8 R^3: 3 um at the contact's rim of 3.5 mm, of 1.2 mm
    assert force(quasistatic, quadric) == pytest.approx(pressed, rel=0.01)
    x, y = np.meshgrid(quasistatic.x, quasistatic.y, indexing="ij")
    inside = np.maximum(20e-3**2 - (x - 1e-3) ** 2 - y**2, 1e-4)
    field = 21.5e-3 - np.sqrt(inside)
    # bilinear between nodes, which move by 0.1 mm
    heights = quasistatic.obstacle("heights", data=field)
    assert force(quasistatic, heights) == pytest.approx(pressed, rel=0.02)


def test_a_disc_is_a_cylinder_whose_rim_is_rounded(quasistatic):
    disc, cylinder = (
        force(quasistatic, quasistatic.obstacle(kind, sizes, (0.3e-3, 0, 0.0117)))
        for kind, sizes in (("disc", (5e-3, 0.01, 1e-4)), ("cylinder", (5e-3, 0.01)))
    )
    assert disc == pytest.approx(cylinder, rel=0.03)  # its flat face ends 0.03 mm further in


def test_a_plane_carries_the_gas_load_of_its_contact_area(quasistatic):
    state = quasistatic.solve(quasistatic.obstacle("plane", p_SO=(0, 0, 2e-3)))
    assert state.converged
    # the contact is flat: the force is the gas pressure over its area, except for cells at its rim
    flat = state.contact_forces > 0.9 * state.contact_forces.max()
    cell = (quasistatic.x[1] - quasistatic.x[0]) * (quasistatic.y[1] - quasistatic.y[0])
    inner = state.contact_forces[flat].min() / cell
    assert inner == pytest.approx(state.gauge_pressure, rel=0.05)  # nodes have moved apart by 4 %
    assert state.force_normal == pytest.approx(state.area * state.gauge_pressure, rel=0.15)


def test_bodies_far_apart_press_as_each_alone_but_for_the_gas(quasistatic):
    left, right = (quasistatic.obstacle("sphere", (4e-3,), (x, 0, 6e-3)) for x in (-8e-3, 8e-3))
    both = quasistatic.solve([left, right])
    one = quasistatic.solve(left)
    # both balls compress the gas, which makes each indentation stiffer
    assert 2 * one.force_normal < both.force_normal < 2.3 * one.force_normal
    assert both.wrench[4] == pytest.approx(0, abs=1e-5)  # by symmetry, N m


@pytest.mark.parametrize("behind", [0.0042, 0.006, 0.008, 0.01, 0.03, 1.0])
def test_a_wall_behind_a_block_has_no_effect(quasistatic, behind):
    """The wall is over the nodes beyond the block's edges, out of the membrane's reach."""
    block = quasistatic.obstacle("box", (0.004, 0.006, 0.003), (0.001, 0.0, 0.0045))
    wall = quasistatic.obstacle("box", (0.5, 0.5, 0.1), (0.0, 0.0, 0.1 + behind))
    alone = quasistatic.solve(block)
    both = quasistatic.solve([block, wall])
    assert alone.force_normal > 0.2
    assert both.force_normal == pytest.approx(alone.force_normal, rel=1e-9)


@pytest.mark.parametrize("behind", [0.0025, 0.0028, 0.003])
def test_a_wall_close_behind_a_block_has_no_effect(quasistatic, behind):
    """The wall is 1 to 1.5 mm behind the block's face, where the membrane does not reach it.

    A grid of twice the resolution has up to 0.6 % less force with the wall.
    """
    block = quasistatic.obstacle("box", (0.004, 0.006, 0.003), (0.001, 0.0, 0.0045))
    wall = quasistatic.obstacle("box", (0.5, 0.5, 0.1), (0.0, 0.0, 0.1 + behind))
    alone = quasistatic.solve(block)
    both = quasistatic.solve([block, wall])
    assert both.force_normal == pytest.approx(alone.force_normal, rel=0.01)


def test_the_force_of_cones_and_wedges_increases_with_depth(quasistatic):
    for kind, sizes in (("cone", (6e-3, 6e-3)), ("wedge", (5e-3, 3e-3, 5e-3))):
        forces = [
            force(quasistatic, quasistatic.obstacle(kind, sizes, (0, 0, z)))
            for z in (2e-3, 1.5e-3, 1e-3)
        ]
        assert 0 < forces[0] < forces[1] < forces[2]


@pytest.mark.parametrize("tilt", [0.1, 0.3, 0.7])
def test_a_tilted_box_is_met_at_its_edge(quasistatic, tilt):
    """Its flank is steeper than the slope limit of the membrane; both end at its edge."""
    rotation = np.array(
        [[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]]
    )
    mirrored = rotation.T
    forces = [
        force(quasistatic, quasistatic.obstacle("box", (4e-3, 4e-3, 4e-3), (0, y, 6.2e-3), R))
        for y, R in ((0.5e-3, rotation), (-0.5e-3, mirrored))
    ]
    assert forces[0] == pytest.approx(forces[1], rel=1e-3)


def test_impossible_obstacle_data_are_refused(quasistatic):
    for data, message in (
        (np.full((21, 16), np.nan), "finite"),
        (np.zeros((4, 3)), "volume"),
        ([[0.0, 0.0]], "shape"),
    ):
        kind = "heights" if message == "finite" else "mesh"
        with pytest.raises(InputError, match=message):
            quasistatic.obstacle(kind, data=data)
    with pytest.raises(InputError, match="rim"):
        quasistatic.solve(quasistatic.obstacle("plane", p_SO=(0, 0, -1e-3)))
    with pytest.raises(InputError, match="nodes"):
        quasistatic.solve(quasistatic.obstacle("heights", data=np.zeros((5, 5))))


def test_an_invalid_body_is_refused_in_one_line(quasistatic):
    ball = quasistatic.obstacle("sphere", (8e-3,), (0, 0, 9e-3))
    for none in (None, 3.0, "sphere", [ball, 1.0]):
        with pytest.raises(
            InputError, match=r"is not an obstacle; create it with QuasistaticMembrane\.obstacle"
        ):
            quasistatic.solve(none)
    with pytest.raises(InputError, match="is not an obstacle"):
        quasistatic.solve_batch([[ball], [None]])
    with pytest.raises(InputError, match="norm 0"):  # it was treated as not rotated
        quasistatic.obstacle("box", (1e-3, 1e-3, 1e-3), R_SO=(0, 0, 0, 0))
    with pytest.raises(InputError, match="no triangle"):
        quasistatic.obstacle("triangles", data=np.zeros((0, 3, 3)))
    same = quasistatic.solve(
        item for item in [ball]
    )  # any membrane that passes through bodies is suitable
    assert same.force_normal == quasistatic.solve(ball).force_normal
    for grid in ("ab", (np.nan, 16), 21):
        with pytest.raises(
            InputError, match=r"grid: .*(two numbers of nodes|tuple of 2, each a whole number)"
        ):
            QuasistaticMembrane("dense", grid)


@pytest.mark.parametrize("at", [(0.0, 0.0), (7e-4, 3e-4)])
@pytest.mark.parametrize("wide", [2e-3, 0.67e-3])
def test_a_cone_too_steep_for_the_grid_is_refused(at, wide):
    # above its tip, rounding removed the contact, and the converged force was zero
    quasistatic = QuasistaticMembrane("dense", (21, 16), 1000.0)
    for tip in (1e-3, 2e-3):
        cone = quasistatic.obstacle("cone", (wide, 6e-3), (*at, tip))
        off = tip - quasistatic.design.membrane.thickness / 2
        assert quasistatic.obstacle_heights(cone, [at]) == pytest.approx(off, abs=1e-9)
        with pytest.raises(InputError, match=r"passes between|is not finite"):
            quasistatic.solve(cone)


def test_a_solution_is_independent_of_old_memory_content():
    """The result of a solution is independent of old memory content, to the bit or in its message.

    If a second attempt started above the membrane, its first step used a factor that had not been
    computed.
    """

    def ends(fill):
        quasistatic = QuasistaticMembrane("dense", (21, 16), 1000.0)
        quasistatic._room[:] = fill
        cones = [
            quasistatic.obstacle("cone", (wide, 6e-3), (x, 3e-4, 1e-3))
            for wide in (0.67e-3, 2e-3, 6e-3)
            for x in (0.0, 7e-4)
        ]
        found = []
        for body in (*cones, quasistatic.obstacle("sphere", (8e-3,), (0, 0, 9e-3))):
            try:
                found.append(quasistatic.solve(body).heights.tobytes())
            except InputError as error:
                found.append(str(error))
        return found

    empty = ends(0.0)
    assert len({type(item) for item in empty}) == 2  # some rest, some are refused
    assert ends(np.nan) == empty
    assert ends(1e3) == empty


def test_a_hull_has_each_face_once():
    """Qhull makes two triangles of each side of a cube."""
    cube = 0.01 * np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    planes = QuasistaticMembrane("dense").obstacle("mesh", data=cube).pool.reshape(-1, 4)
    assert len(planes) == 6
    np.testing.assert_allclose(np.abs(planes).sum(axis=1), 1.01, rtol=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_a_hull_presses_as_its_triangles_do(quasistatic, seed):
    """Triangles are evaluated individually at all nodes; hulls by their faces, only where their
    tangents are not above the membrane."""
    rng = np.random.default_rng(seed)
    cloud = rng.normal(size=(30, 3)) * (6e-3, 5e-3, 4e-3)
    hull = ConvexHull(cloud)
    lowest = cloud[cloud[:, 2].argmin()]
    place = (*rng.uniform(-4e-3, 4e-3, 2), 1.2e-3) - lowest
    mesh = quasistatic.solve(quasistatic.obstacle("mesh", p_SO=place, data=cloud))
    corners = cloud[hull.simplices]
    triangles = quasistatic.solve(quasistatic.obstacle("triangles", p_SO=place, data=corners))
    assert mesh.converged and -mesh.wrench[2] > 0.05
    # both are converged to 1e-6 m, at most a millinewton
    np.testing.assert_allclose(mesh.wrench[:3], triangles.wrench[:3], atol=1e-3)
    np.testing.assert_array_equal(mesh.force > 0, triangles.force > 0)
