"""Tests of contact: converged force, penetration, selection of the contact model, and the flag of
features finer than the mesh."""

import mujoco
import numpy as np
import pytest

from mjtactile.core.errors import InputError
from mjtactile.sim import ground_truth
from mjtactile.sim.scenes.grasp_world import GraspWorld
from mjtactile.sim.scenes.indentation import Indenter, PressWorld
from mjtactile.sim.sensor.curvature_standoff import curvatures

DEPTHS = (2e-3, 3e-3)


def pressed(indenter, depths=DEPTHS, *, pressure=1000.0, **how):
    """Return forces, N, and penetrations, m, of a sealed press at each depth."""
    world = PressWorld("paper16", Indenter.parse(indenter), **how)
    world.inflate(pressure, seal=True)
    rows = []
    for depth in depths:
        world.press(depth)
        rows.append((-ground_truth.contact_force(world, 0)[2], ground_truth.penetration(world, 0)))
    return np.array(rows).T, world


# Forces, N, by indenter and position, m, at 33 x 27 vertices without stand-off. Regenerate:
# `pressed(...)` with facets.SHARE = 0. For the first, an independent solver gives 0.2562 and 0.4847
# (frictionless; 1-3 % more with sticking contact).
FINE = {
    ("sphere:8", (0.0, 0.0)): (0.2569, 0.4929),
    ("sphere:15", (0.0, 0.0)): (0.3355, 0.6945),
    ("sphere:8", (5e-3, 3e-3)): (0.2499, 0.4741),
    ("sphere:15", (5e-3, 3e-3)): (0.3263, 0.6655),
}


@pytest.mark.parametrize("case", FINE)
def test_default_force_equals_the_converged_force(case):
    (force, depth), _ = pressed(case[0], at=case[1])
    # the requirement is 3 %, and all eight cases meet it; friction depends on the path, and the
    # last bits of a processor change the force by 1 %
    np.testing.assert_allclose(force, FINE[case], rtol=0.04)
    assert (depth < 0.03 * np.array(DEPTHS)).all()  # the project's bound


def test_stand_off_vanishes_on_a_fine_mesh_and_on_flat_faces():
    coarse, fine = (
        pressed("sphere:8", (2e-3,), mesh=mesh)[1].sensors[0] for mesh in ((13, 11), (25, 21))
    )
    off = [sensor._stand_off.margins.max() for sensor in (coarse, fine)]
    # as the area of a vertex
    assert off[0] / off[1] == pytest.approx((24 * 20) / (12 * 10), rel=0.05)
    _, flat = pressed("box:60", (1e-3,), mesh=(11, 9))
    assert not flat.sensors[0]._stand_off.margins.any()


@pytest.mark.parametrize(
    ("geom", "size", "normal", "expected"),
    [
        ("sphere", [0.01, 0, 0], [0, 0.6, 0.8], 200),
        ("capsule", [0.01, 0.02, 0], [1, 0, 0], 100),
        ("cylinder", [0.01, 0.02, 0], [0, 1, 0], 100),
        ("cylinder", [0.01, 0.02, 0], [0, 0, 1], 0),
        ("box", [0.01] * 3, [0, 0, 1], 0),
        ("ellipsoid", [0.01] * 3, [0, 0.6, 0.8], 200),
        ("ellipsoid", [0.01, 0.02, 0.04], [1, 0, 0], 0.01 / 0.02**2 + 0.01 / 0.04**2),
    ],
)
def test_curvature_of_primitives(geom, size, normal, expected):
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=getattr(mujoco.mjtGeom, f"mjGEOM_{geom.upper()}"), size=size)
    found = curvatures(spec.compile(), np.zeros(1, int), np.array([normal], float))
    assert found == pytest.approx(expected, rel=1e-9)  # exact


@pytest.mark.parametrize(("pressure", "bound"), [(0.0, 0.03), (5e3, 0.03), (8e3, 0.03)])
def test_penetration_stays_small_at_any_pressure(pressure, bound):
    (_, depth), _ = pressed("sphere:8", pressure=pressure)
    assert (depth < bound * np.array(DEPTHS)).all()


@pytest.mark.parametrize("timestep", [1e-3, 8e-3])
def test_force_does_not_depend_on_the_time_step(timestep):
    (force, _), _ = pressed("sphere:8", (2e-3,))
    (other, _), _ = pressed("sphere:8", (2e-3,), timestep=timestep)
    # statics, and friction, which depends on the path
    assert other == pytest.approx(force, rel=0.015)


def test_vertices_detect_every_geom_of_a_known_shape():
    for indenter in ("sphere:8", "cylinder:0.5", "box:1"):
        assert PressWorld("paper16", Indenter.parse(indenter)).sensors[0].contact == "vertices"
    for name in ("egg", "vial", "strawberry"):
        assert {s.contact for s in GraspWorld("paper16", name, mesh=(11, 9)).sensors} == {
            "vertices"
        }, name
    with pytest.raises(InputError, match=r"edges.*auto, vertices, elements, both"):
        PressWorld("paper16", Indenter.parse("sphere:8"), contact="edges")


def test_a_pin_between_the_vertices_is_estimated_and_its_error_is_stated():
    """The force of a 1 mm pin between the vertices has an error within the stated one.

    The ground truth is about 0.161 N. An independent solver gives 0.190 for St. Venant-Kirchhoff's
    law at 2 mm. At 1 mm it gives 0.0808 with that law and 0.0685 with this one; the same ratio is
    applied. Vertices are within a tenth of the ground truth. Triangles are too stiff, and the flag
    states it.
    """
    for contact, low, high in (("auto", -0.1, 0.1), ("elements", 0.0, 1.0)):
        (force, _), world = pressed("cylinder:0.5", (2e-3,), at=(1.1e-3, 1.2e-3), contact=contact)
        assert (
            "finer than the mesh" in world.flags["small_feature"]
            and "off by" in world.flags["small_feature"]
        )
        stated = float(world.flags["small_feature"].split("off by ")[1].split("%")[0]) / 100
        off = force[0] / 0.161 - 1
        assert low < off < high and abs(off) < stated


@pytest.mark.parametrize("radius", [0.5, 1, 2, 4])
def test_small_balls_are_flagged(radius):
    _, world = pressed(f"sphere:{radius}", (1e-3,))
    assert "small_feature" in world.flags


def test_a_large_smooth_object_is_not_flagged():
    _, world = pressed("sphere:8", (2e-3,))
    assert not world.flags


# Forces of flat ends at 33 x 27 vertices, 2 mm deep, N
EDGES = {"cylinder:5": 0.537, "box:12": 0.798}


@pytest.mark.parametrize("indenter", EDGES)
def test_the_force_error_of_an_edge_equals_the_flag(indenter):
    """The ground truth agrees with the flag: an edge is between vertices, and the force of a face
    is too low by up to a third."""
    (force, _), world = pressed(indenter, (2e-3,))
    stated = float(world.flags["sharp_edge"].split("off by ")[1].split("%")[0]) / 100
    assert abs(force[0] / EDGES[indenter] - 1) < stated <= 0.7  # 0.3 to 1.4 times, and no worse


def test_actuator_contact_and_torque_agree():
    world = PressWorld("paper16", Indenter.parse("sphere:8"), at=(5e-3, -3e-3))
    world.inflate(1000.0, seal=True)
    world.press(2e-3, 5e-4)
    force = np.zeros(3)
    drive = np.zeros(3)
    torque = np.zeros(3)
    for _ in range(50):
        world.step()
        force += ground_truth.contact_force(world, 0) / 50
        torque += ground_truth.contact_wrench(world, 0)[3:] / 50
        drive += world.drive_force / 50
    # slow creep of the membrane
    np.testing.assert_allclose(force[[0, 2]], drive[[0, 2]], atol=2e-3 * np.abs(force).max())
    center = ground_truth.contact_forces(world, 0)[1].mean(axis=0)
    lever = np.abs(torque - np.cross(center, force))[:2] / abs(force[2])
    # lever in m: the force acts within half a vertex spacing of the contact's center
    assert lever.max() < 1.5e-3
