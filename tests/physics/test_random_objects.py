"""Tests of random objects: one seed gives one object, its file is valid, it can be held, and its
size is within the documented range."""

import math

import mujoco
import numpy as np
import pytest

from mjtactile.core.errors import InputError
from mjtactile.sim.scenes.objects import load_object, read_spec
from mjtactile.sim.scenes.random_objects import _CARRIES, random_object, to_mjcf
from mjtactile.sim.sensor import feature_size

SEEDS = range(120)


def test_every_shape_is_sampled_and_its_error_is_within_the_stated_bound():
    samples = [random_object(seed) for seed in SEEDS]
    assert {random.shape for random in samples} == {
        "egg",
        "box",
        "cylinder",
        "cone",
        "bottle",
        "fruit",
    }
    for random in samples:
        assert (
            0.015 <= 2 * random.a <= 0.061
            and 0.015 <= 2 * random.c <= 0.0701
            and 0.005 <= random.mass <= 0.2
        )
        assert random.break_force >= max(1.2, _CARRIES * random.mass) * (1 - 1e-9)
    assert random_object(7) == samples[7] != samples[8]


@pytest.mark.parametrize("seed", range(30))
def test_a_written_file_describes_the_object(seed):
    """Mass, and moments of inertia against those of the hull's own vertices or the primitives; it
    stands where it is put."""
    random = random_object(seed)
    item = load_object(f"random:{seed}")
    assert item.mass == pytest.approx(random.mass, rel=1e-5) and item.break_force == pytest.approx(
        random.break_force, rel=1e-5
    )
    assert item.grasp_height >= 0.0259 and item.turn == pytest.approx(
        math.radians(3) if random.shape == "box" else math.pi
    )
    spec = read_spec(item)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.timestep = 1e-3
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 1], friction=[0.3, 0.005, 1e-4]
    )
    model = spec.compile()
    # a membrane of the default mesh meets it with its vertices
    assert feature_size.smallest_feature(model)[0] > 0.002
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 500)
    body = data.body("object")
    assert np.linalg.norm(body.xpos - [0, 0, item.grasp_height]) < 5e-4 and body.xmat[8] > 0.999


def test_a_box_has_the_sampled_size_and_inertia():
    seed = next(seed for seed in SEEDS if random_object(seed).shape == "box")
    random = random_object(seed)
    model = read_spec(load_object(f"random:{seed}")).compile()
    sizes = np.sort(np.ptp(model.mesh_vert, axis=0))  # a mesh's axes are its principal ones
    np.testing.assert_allclose(
        sizes, np.sort(2 * np.array([random.a, random.b, random.c])), rtol=1e-5
    )
    moments = (
        random.mass
        / 3
        * np.array(
            [random.b**2 + random.c**2, random.a**2 + random.c**2, random.a**2 + random.b**2]
        )
    )
    np.testing.assert_allclose(np.sort(model.body("object").inertia), np.sort(moments), rtol=1e-4)


def test_a_file_written_out_is_the_same_object(tmp_path):
    path = tmp_path / "thing.xml"
    path.write_text(to_mjcf(random_object(4), "thing"))
    loaded = load_object(path)
    sampled = load_object("random:4")
    assert (loaded.mass, loaded.break_force, loaded.grasp_height) == (
        sampled.mass,
        sampled.break_force,
        sampled.grasp_height,
    )


def test_a_random_object_requires_a_seed():
    with pytest.raises(InputError, match="unknown object"):
        load_object("random")
    with pytest.raises(InputError, match="unknown object"):
        load_object("random:x")
