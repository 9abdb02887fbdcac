"""Membranes in Warp against the CPU's quasi-static membrane, which has its own code and solver."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import RectBivariateSpline
from scipy.spatial.transform import Rotation

from mjtactile import InputError
from mjtactile.core.design import load_sensor
from mjtactile.quasistatic import QuasistaticMembrane

pytest.importorskip("mujoco_warp")

from mjtactile.warp import Iteration, Membranes
from mjtactile.warp.device.equilibrium import NOT_CONVERGED
from mjtactile.warp.device.obstacles import BOX, CAPSULE, CYLINDER, ELLIPSOID, SPHERE

pytestmark = pytest.mark.slow  # importing MuJoCo Warp takes 3 s

KINDS = {
    "sphere": SPHERE,
    "capsule": CAPSULE,
    "ellipsoid": ELLIPSOID,
    "cylinder": CYLINDER,
    "box": BOX,
}
# single precision, and sums of 300 nodes in it
EXACT = Iteration(outer=60, tolerance=1e-7)


def put(membranes, rows):
    """Write one geom per membrane: kind, sizes, position, rotation."""
    geoms = membranes.geoms.numpy().copy()
    for f, (kind, sizes, p, R) in enumerate(rows):
        geoms["kind"][f, 0] = KINDS[kind]
        geoms["size"][f, 0] = [*sizes, *[0.0] * (3 - len(sizes))]
        geoms["p"][f, 0], geoms["R"][f, 0] = p, R
    membranes.geoms.assign(geoms)


def touching_height(membrane, kind, sizes, xy, R):
    """Return the height of the obstacle's center at which it begins to touch, m, between nodes."""
    x, y = (np.linspace(line[0], line[-1], 8 * len(line) - 7) for line in (membrane.x, membrane.y))
    rest = RectBivariateSpline(membrane.x, membrane.y, membrane.rest.x[2])(x, y).ravel()
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    body = membrane.obstacle(kind, sizes, (*xy, 0.0), R)
    return float((rest - membrane.obstacle_heights(body, grid)).max())


def pressed(kinds, depth, iteration=EXACT, design="dense"):
    """Press each body by `depth` m in ten steps; return forces and pressures of both codes."""
    membranes = Membranes(design, len(kinds), device="cpu", iteration=iteration)
    membrane = membranes.membrane
    start = [touching_height(membrane, *row) for row in kinds]
    states = [None] * len(kinds)
    for step in np.linspace(0, depth, 11)[1:]:
        places = [(*row[2], z - step) for row, z in zip(kinds, start, strict=True)]
        put(membranes, [(k, s, p, R) for (k, s, _, R), p in zip(kinds, places, strict=True)])
        membranes.solve()
        states = [
            membrane.solve(membrane.obstacle(k, s, p, R), state)
            for (k, s, _, R), p, state in zip(kinds, places, states, strict=True)
        ]
    force = membranes.fields.force.numpy().sum(axis=1)
    exact = np.array([state.force_normal for state in states])
    gauge = np.array([state.gauge_pressure for state in states])
    return membranes, force, exact, membranes.fields.pressure.numpy(), gauge


UPRIGHT = np.eye(3)
LYING = Rotation.from_euler("y", 90, degrees=True).as_matrix()
ASKEW = Rotation.from_euler("xyz", [5, 8, 30], degrees=True).as_matrix()


def test_a_ball_and_a_box_press_as_on_the_cpu():
    rows = [
        ("sphere", (0.01,), (0.001, 0.002), UPRIGHT),
        ("box", (0.005, 0.004, 0.005), (0, 0), UPRIGHT),
    ]
    _, force, exact, pressure, gauge = pressed(rows, 1e-3)
    # 0.3 %: the largest difference of tolerances of the two solvers
    assert force == pytest.approx(exact, rel=5e-3)
    assert pressure == pytest.approx(gauge, rel=1e-3)


# The wall is over the nodes beyond the block's edges. It is out of reach at 1.2 and 4.5 mm, and
# carries a part of the load at 0.3 mm.
@pytest.mark.parametrize("gap", [0.3e-3, 1.2e-3, 4.5e-3])
def test_a_block_in_front_of_a_wall_presses_as_on_the_cpu(gap):
    membranes = Membranes("dense", 1, slots=2, device="cpu", iteration=EXACT)
    membrane = membranes.membrane
    low = float(membrane.rest.x[2].max()) - 1e-3
    block = (0.004, 0.006, 0.003), (0.001, 0.0, low + 0.003)
    wall = (0.05, 0.05, 0.003), (0.0, 0.0, low + gap + 0.003)
    geoms = membranes.geoms.numpy().copy()
    for g, (size, p) in enumerate((block, wall)):
        geoms["kind"][0, g] = BOX
        geoms["size"][0, g], geoms["p"][0, g], geoms["R"][0, g] = size, p, UPRIGHT
    membranes.geoms.assign(geoms)
    membranes.solve()
    obstacles = [membrane.obstacle("box", size, p) for size, p in (block, wall)]
    exact = membrane.solve(obstacles).force_normal
    alone = membrane.solve(obstacles[0]).force_normal
    assert (exact > 1.05 * alone) == (gap < 1e-3)
    assert membranes.fields.force.numpy().sum() == pytest.approx(exact, rel=5e-3)


@pytest.mark.slow(40)
@pytest.mark.parametrize("depth", [0.5e-3, 1.5e-3, 2.5e-3])
def test_forces_of_all_shapes(depth):
    rows = [
        *[("sphere", (r,), (0, 0), UPRIGHT) for r in (0.004, 0.008, 0.016, 0.03)],
        ("sphere", (0.008,), (0.008, 0.004), UPRIGHT),
        ("box", (0.005, 0.004, 0.005), (0, 0), UPRIGHT),
        ("box", (0.0061, 0.0043, 0.005), (0.003, 0.002), ASKEW),
        ("cylinder", (0.005, 0.005), (0, 0), UPRIGHT),
        ("cylinder", (0.004, 0.006), (0, 0), LYING),
        ("capsule", (0.004, 0.006), (0.002, 0), LYING),
        ("ellipsoid", (0.007, 0.012, 0.019), (0, 0), ASKEW),
    ]
    _, force, exact, pressure, gauge = pressed(rows, depth)
    error = force / exact - 1
    assert np.sqrt(np.mean(error**2)) < 0.005  # required: 2 %
    assert np.abs(error).max() < 0.02
    assert pressure == pytest.approx(gauge, rel=3e-3)  # required: 1 %


@pytest.mark.slow(10)
def test_another_sensor():
    rows = [("sphere", (0.008,), (0.001, 0.001), UPRIGHT)]
    _, force, exact, *_ = pressed(rows, 1e-3, design="fine")
    assert force == pytest.approx(exact, rel=5e-3)


def test_large_objects_deep_in_a_soft_membrane_are_followed():
    """With full steps of the heights, the steep strip next to the frame alternates between two
    shapes, and solutions are rejected. Four outer steps per 0.1 mm lag behind by less than 1 %."""
    dense = load_sensor("dense")
    soft = replace(dense, membrane=replace(dense.membrane, young=0.7 * dense.membrane.young))
    rows = [("capsule", (0.024, 0.03), (0, 0), LYING), ("cylinder", (0.027, 0.027), (0, 0), LYING)]
    states, steps = [None] * len(rows), np.linspace(0, 2.7e-3, 28)[1:]
    membranes = Membranes(soft, len(rows), device="cpu", iteration=Iteration())
    membrane = membranes.membrane
    start = [touching_height(membrane, *row) for row in rows]
    for step in steps:
        places = [(*row[2], z - step) for row, z in zip(rows, start, strict=True)]
        put(membranes, [(k, s, p, R) for (k, s, _, R), p in zip(rows, places, strict=True)])
        membranes.solve()
        assert (membranes.fields.status.numpy() <= NOT_CONVERGED).all(), step
        states = [
            membrane.solve(membrane.obstacle(k, s, p, R), state)
            for (k, s, _, R), p, state in zip(rows, places, states, strict=True)
        ]
    force = membranes.fields.force.numpy().sum(axis=1)
    assert force == pytest.approx([state.force_normal for state in states], rel=0.01)


# of no symmetry
CORNERS = ((17e-3, -6e-3), (15e-3, 12e-3), (-4e-3, 14e-3), (-16e-3, -2e-3), (-5e-3, -13e-3))


def polygon():
    """Return a sensor with an outline without symmetry."""
    round30 = load_sensor("round30")
    frame = replace(round30.frame, shape="polygon", corners=CORNERS, corner_radius=3e-3)
    length, width = (2 * half for half in frame.outline.half_sizes)
    return replace(round30, frame=replace(frame, length=length, width=width))


@pytest.mark.slow(10)
@pytest.mark.parametrize("design", ["round30", "ellipse", polygon()], ids=["round", "ellipse", "5"])
def test_other_outlines(design):
    rows = [
        ("sphere", (0.01,), (0.001, 0.002), UPRIGHT),
        ("sphere", (0.006,), (0.004, -0.002), UPRIGHT),
        ("box", (0.005, 0.004, 0.005), (0, 0), ASKEW),
        ("cylinder", (0.004, 0.006), (0, 0), LYING),
    ]
    membranes, force, exact, pressure, gauge = pressed(rows, 1e-3, design=design)
    # 0.4 %: the largest difference of tolerances of the two solvers
    assert force == pytest.approx(exact, rel=5e-3)
    assert pressure == pytest.approx(gauge, rel=1e-3)
    assert (membranes.fields.status.numpy() < 2).all()


@pytest.mark.slow(10)
def test_blades_and_pins_between_nodes():
    """The spacing is 1.5 by 1.6 mm; without X4 they pass between nodes, and the force is zero."""
    turned = Rotation.from_euler("z", 35, degrees=True).as_matrix()
    rows = [
        ("box", (0.006, 0.0005, 0.005), (0.0011, 0.0008), UPRIGHT),
        ("box", (0.006, 0.0005, 0.005), (-0.0023, 0.0017), turned),
        ("cylinder", (0.0007, 0.005), (0.0008, -0.0007), UPRIGHT),
        ("cylinder", (0.0007, 0.005), (-0.0029, 0.0031), UPRIGHT),
    ]
    _, force, exact, pressure, gauge = pressed(rows, 1.5e-3)
    assert (exact > 0.1).all()  # N
    assert force == pytest.approx(exact, rel=0.01)
    assert pressure == pytest.approx(gauge, rel=3e-3)


def test_unsupported_membranes_are_refused():
    with pytest.raises(InputError, match="nodes; at most 1344"):
        Membranes("dense", 1, grid=(61, 46), device="cpu")


def test_a_failed_world_keeps_its_state_and_does_not_affect_the_others():
    rows = [("sphere", (0.01,), (0, 0), UPRIGHT)] * 4
    alone, force, *_ = pressed(rows, 1e-3)
    kept = alone.fields.u.numpy().copy()
    geoms = alone.geoms.numpy().copy()
    good = geoms["p"][1, 0].copy()
    geoms["p"][1, 0] = np.nan
    geoms["R"][2, 0, 0, 0] = np.nan
    geoms["p"][3, 0, 2] -= 0.05  # through the glass
    alone.geoms.assign(geoms)
    for _ in range(4):
        alone.solve()
        fields = alone.fields
        for name in ("u", "force", "pressure", "volume"):
            assert np.isfinite(getattr(fields, name).numpy()).all(), name
    status = fields.status.numpy()
    assert status[0] == 0 and status[3] > 1
    assert fields.u.numpy()[3] == pytest.approx(kept[3], abs=0)
    assert fields.force.numpy()[0].sum() == pytest.approx(force[0], rel=1e-3)
    # a valid pose again: the same equilibrium
    geoms["p"][1:, 0], geoms["R"][1:, 0] = good, np.eye(3)
    alone.geoms.assign(geoms)
    for _ in range(3):
        alone.solve()
    assert (alone.fields.status.numpy() == 0).all()
    assert alone.fields.force.numpy().sum(axis=1) == pytest.approx(force, rel=2e-3)


@pytest.mark.slow(10)
def test_a_reset_equals_the_equilibrium_on_the_cpu():
    membranes, *_ = pressed([("sphere", (0.01,), (0, 0), UPRIGHT)], 2e-3)
    membranes.reset()
    empty = membranes.geoms.numpy().copy()
    empty["kind"] = -1
    membranes.geoms.assign(empty)
    membranes.solve()
    rest = QuasistaticMembrane("dense").rest.x.reshape(3, -1)
    assert membranes.fields.u.numpy()[0] == pytest.approx(rest, abs=5e-8)
    assert membranes.fields.pressure.numpy()[0] == pytest.approx(1000.0, abs=0.1)
