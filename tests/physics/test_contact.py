"""Contact: converged force, penetration, which model touches, and what is said about features finer than the mesh."""

from functools import partial

import numpy as np
import pytest

from mjtactile.errors import InputError
from mjtactile.sim import attach, truth
from mjtactile.sim.gripper import GraspWorld
from mjtactile.sim.membrane import CONTACT_DEPTH
from mjtactile.sim.mesh import make_mesh
from mjtactile.sim.press import Indenter, PressWorld

DEPTHS = (2e-3, 3e-3)


def pressed(indenter, depths=DEPTHS, *, pressure=1000.0, **how):
    """Forces, N, and penetrations, m, of a sealed press at each depth."""
    world = PressWorld("paper16", Indenter.parse(indenter), **how)
    world.inflate(pressure, seal=True)
    rows = []
    for depth in depths:
        world.press(depth)
        rows.append((-truth.contact_force(world, 0)[2], truth.penetration(world, 0)))
    return np.array(rows).T, world


# Forces at 25 x 21 vertices, closer in the middle by 0.25, with contact three times as stiff: within 1 % of 33 x 27.
FINE = {"sphere:8": (0.3003, 0.5840), "sphere:15": (0.3926, 0.8221)}


@pytest.mark.parametrize("indenter", FINE)
def test_default_force_is_within_nine_per_cent_of_the_converged_one(indenter):
    (force, depth), _ = pressed(indenter)
    # 3 % is what is wanted. At 13 x 11 evenly spaced vertices only 4 to 9 touch (3-8 % low), and sinking in takes 1-2 %
    np.testing.assert_allclose(force, FINE[indenter], rtol=0.09)
    assert (depth < 0.03 * np.array(DEPTHS)).all()  # the project's bound


@pytest.mark.parametrize("indenter", FINE)
def test_vertices_closer_in_the_middle_bring_the_force_within_five_per_cent(indenter, monkeypatch):
    monkeypatch.setattr(attach, "make_mesh", partial(make_mesh, grading=0.25))
    (force, _), _ = pressed(indenter)
    np.testing.assert_allclose(force, FINE[indenter], rtol=0.05)  # as many vertices, 9-13 of which touch


@pytest.mark.parametrize(("pressure", "bound"), [(0.0, 0.03), (5e3, 0.03), (20e3, 0.03)])
def test_penetration_stays_small_at_any_pressure(pressure, bound):
    (_, depth), _ = pressed("sphere:8", pressure=pressure)
    assert (depth < bound * np.array(DEPTHS)).all()


def test_force_converges_with_contact_stiffness(monkeypatch):
    forces = []
    for factor in (4, 2, 1):
        monkeypatch.setattr("mjtactile.sim.membrane.CONTACT_DEPTH", factor * CONTACT_DEPTH)
        forces.append(pressed("sphere:8", (2e-3,))[0][0, 0])
    limit = forces[2] + (forces[2] - forces[1])  # first order in the softness
    assert forces[2] == pytest.approx(limit, rel=0.01)  # of which 3 % for the mesh leaves room
    assert abs(forces[2] - limit) < abs(forces[1] - limit) < abs(forces[0] - limit)


@pytest.mark.parametrize("timestep", [1e-3, 8e-3])
def test_force_does_not_depend_on_the_time_step(timestep):
    (force, _), _ = pressed("sphere:8", (2e-3,))
    (other, _), _ = pressed("sphere:8", (2e-3,), timestep=timestep)
    assert other == pytest.approx(force, rel=0.01)  # statics: the solver's tolerance and the last micrometres of creep


def test_contact_model_follows_the_smallest_feature():
    assert PressWorld("paper16", Indenter.parse("sphere:8")).sensors[0].contact == "vertices"
    assert PressWorld("paper16", Indenter.parse("cylinder:0.5")).sensors[0].contact == "elements"
    assert PressWorld("paper16", Indenter.parse("cylinder:0.5"), mesh=(49, 39)).sensors[0].contact == "vertices"
    for name in ("egg", "vial", "strawberry"):
        assert {s.contact for s in GraspWorld("paper16", name, mesh=(11, 9)).sensors} == {"vertices"}, name
    with pytest.raises(InputError, match=r"edges.*auto, vertices, elements, both"):
        PressWorld("paper16", Indenter.parse("sphere:8"), contact="edges")


def test_a_pin_between_the_vertices_is_felt_and_its_error_is_stated():
    """The truth, and the statement: vertices miss a 1 mm pin, triangles feel it, its force is 0.18 N +- 0.02 (bracketed by
    vertices, 0.168, and triangles, 0.214, at 41 x 33) and the flag owns up to what the default mesh makes of it."""
    place = (1.1e-3, 1.2e-3)
    with pytest.raises(InputError, match="slips between"):
        pressed("cylinder:0.5", at=place, contact="vertices")
    (force, _), world = pressed("cylinder:0.5", (2e-3,), at=place)
    assert "finer than the mesh" in world.flags["feature"] and "off by" in world.flags["feature"]
    stated = float(world.flags["feature"].split("off by ")[1].split("%")[0]) / 100
    assert 0.2 < force[0] / 0.18 - 1 < stated + 0.1


def test_a_large_smooth_object_is_not_flagged():
    _, world = pressed("sphere:8", (2e-3,))
    assert not world.flags


def test_flat_end_with_an_edge():
    """A flat cylinder's edge falls between vertices, so its force is the worst of the large shapes: 10 % and more."""
    (force, depth), _ = pressed("cylinder:5", (2e-3,))
    # 0.60 N at 25 x 21 vertices, 0.62 at 41 x 33; the edge moves by up to half a spacing, 1.2 mm of 5
    assert force[0] == pytest.approx(0.62, rel=0.2)
    assert depth[0] < 0.03 * 2e-3


def test_actuator_contact_and_torque_agree():
    world = PressWorld("paper16", Indenter.parse("sphere:8"), at=(5e-3, -3e-3))
    world.inflate(1000.0, seal=True)
    world.press(2e-3, 5e-4)
    force, drive, torque = np.zeros(3), np.zeros(3), np.zeros(3)
    for _ in range(50):
        world.step()
        force += truth.contact_force(world, 0) / 50
        torque += truth.contact_torque(world, 0) / 50
        drive += world.drive_force / 50
    np.testing.assert_allclose(force[[0, 2]], drive[[0, 2]], atol=2e-3 * np.abs(force).max())  # slow creep of the sheet
    middle = truth.contact_forces(world, 0)[1].mean(axis=0)
    lever = np.abs(torque - np.cross(middle, force))[:2] / abs(force[2])
    assert lever.max() < 1.5e-3  # m: the force acts within half a vertex spacing of the middle of the contact
