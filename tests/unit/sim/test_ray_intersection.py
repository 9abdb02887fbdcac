"""Tests of lines that enter geoms, against single rays of MuJoCo."""

import mujoco
import numpy as np
import pytest

from mjtactile.sim.sensor import ray_intersection

GEOMS = {
    "box": 'type="box" size="0.01 0.02 0.03"',
    "sphere": 'type="sphere" size="0.02"',
    "ellipsoid": 'type="ellipsoid" size="0.01 0.02 0.03"',
    "cylinder": 'type="cylinder" size="0.02 0.01"',
    "capsule": 'type="capsule" size="0.01 0.02"',
    "mesh": 'type="mesh" mesh="solid"',
}
SOLID = (
    '<asset><mesh name="solid" vertex="0.02 0 0  -0.02 0.01 0  0 -0.02 0  0 0.005 0.03  0.01 '
    '0.01 0.02"/></asset>'
)


def _model(geom: str) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco>{SOLID}<worldbody><geom {GEOMS[geom]}/></worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


@pytest.mark.parametrize("kind", GEOMS)
def test_lines_enter_at_ray_intersections(kind):
    model, data = _model(kind)
    R = data.geom_xmat[0].reshape(3, 3)
    p = data.geom_xpos[0]
    rng = np.random.default_rng(5)
    starts = rng.normal(size=(400, 3))
    starts *= 0.2 / np.linalg.norm(starts, axis=1, keepdims=True)
    aims = rng.uniform(-0.03, 0.03, (400, 3)) - starts
    directions = aims / np.linalg.norm(aims, axis=1, keepdims=True)
    entry = ray_intersection.entry_of(model, 0)
    assert entry is not None
    found = entry((starts - p) @ R, directions @ R)
    geom = np.zeros(1, np.int32)
    rays = np.array(
        [
            mujoco.mj_ray(model, data, s, d, None, 1, -1, geom)
            for s, d in zip(starts, directions, strict=True)
        ]
    )
    hit = rays >= 0
    assert 50 < hit.sum() < 400
    assert (np.isfinite(found) == hit).mean() > 0.99  # at an edge the two methods may differ
    both = hit & np.isfinite(found)
    # the mesh's vertices are single precision
    np.testing.assert_allclose(found[both], rays[both], atol=2e-6)


def test_a_line_that_starts_inside_points_back():
    model, _ = _model("sphere")
    entry = ray_intersection.entry_of(model, 0)
    assert entry is not None
    assert entry(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]))[0] == pytest.approx(-0.02)


def test_a_cylinder_along_its_axis():
    model, _ = _model("cylinder")
    entry = ray_intersection.entry_of(model, 0)
    assert entry is not None
    points = np.array([[0.0, 0.0, -0.05], [0.0199, 0.0, -0.05], [0.0201, 0.0, -0.05]])
    found = entry(points, np.tile([0.0, 0.0, 1.0], (3, 1)))
    np.testing.assert_allclose(found, [0.04, 0.04, np.inf])
