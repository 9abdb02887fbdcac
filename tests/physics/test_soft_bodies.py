"""Soft bodies: their files, and what their strain is said to be, against closed forms."""

import mujoco
import numpy as np
import pytest

from mjtactile.core import resources
from mjtactile.core.errors import InputError
from mjtactile.sim.scenes.objects import load_object
from mjtactile.sim.scenes.soft_bodies import SHIPPED, SoftBody, tetrahedra, tetrahedron_volumes, to_mjcf
from mjtactile.sim.scenes.strain import SoftSolid, soft_flex

E, NU = 2e4, 0.45


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_soft_bodies_are_what_their_writer_writes(name):
    body, comment = SHIPPED[name]
    assert resources.find(name, "models/objects", ".xml").read_text() == to_mjcf(body, name, comment)
    flesh = load_object(name).flesh
    assert flesh is not None and flesh.young == pytest.approx(body.young)
    assert min(flesh.break_stress, flesh.break_energy) == (body.break_stress or body.break_energy)
    assert load_object(name).mass == pytest.approx(body.density * body.volume, rel=2e-3)  # as written, four digits


@pytest.mark.parametrize(("shape", "volume"), [("block", 8.0), ("ball", 4 / 3 * np.pi)])
def test_meshes_fill_their_shape(shape, volume):
    points, elements = tetrahedra(SoftBody(shape, (0.01, 0.01, 0.01), E, NU, 1e3, skin=0.0))
    volumes = tetrahedron_volumes(points, elements)
    assert (volumes > 0).all()
    assert volumes.sum() == pytest.approx(volume * 1e-6, rel=0.08)  # a polyhedron in the sphere: 6 elements across
    assert np.abs(points).max() == pytest.approx(0.01)


def block():
    spec = mujoco.MjSpec.from_string(to_mjcf(SoftBody("block", (0.014, 0.012, 0.012), E, NU, 1e3, break_stress=1e3), "block"))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return SoftSolid(model, soft_flex(model), E, NU), data, data.flexvert_xpos.copy()


def test_uniaxial_stress_and_energy_are_youngs():
    solid, data, rest = block()
    strain, volume = -0.1, np.prod([0.027, 0.023, 0.023])
    data.flexvert_xpos[:] = rest * [1 + strain, 1 - NU * strain, 1 - NU * strain]
    seen = solid.strain(data)
    assert seen.compression == pytest.approx(-strain, rel=1e-6)
    assert seen.energy_density == pytest.approx(E * strain**2 / 2, rel=1e-6)  # linear in Biot's strain: exact
    assert seen.energy == pytest.approx(E * strain**2 / 2 * volume, rel=1e-6)
    assert seen.stress == pytest.approx(-E * strain / (1 - NU * strain)**2, rel=1e-6)  # over the present section


def test_a_rigid_motion_is_a_pose_and_no_strain():
    solid, data, rest = block()
    angle, shift = 0.7, np.array([0.01, -0.02, 0.03])
    R = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    data.flexvert_xpos[:] = rest @ R.T + shift
    middle, turn = solid.pose(data)
    assert turn == pytest.approx(R, abs=1e-9)
    assert middle == pytest.approx(R @ solid.rest_middle + shift, abs=1e-12)
    assert solid.strain(data).energy == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize(("change", "words"), [
    (('<numeric name="break_stress_kPa" data="1"/>', ""), ["break_force_N"]),
    (('break_stress_kPa" data="1"', 'break_stress_kPa" data="-1"'), ["break_stress_kPa", "-1"]),
    (('young="20000"', 'young="0"'), ["young"]),
])
def test_broken_soft_bodies_are_refused(tmp_path, change, words):
    path = tmp_path / "gel.xml"
    path.write_text(to_mjcf(SoftBody("block", (0.014, 0.012, 0.012), E, NU, 1e3, break_stress=1e3), "gel").replace(*change))
    with pytest.raises(InputError) as caught:
        load_object(path)
    assert all(word in str(caught.value) for word in [str(path), *words])
