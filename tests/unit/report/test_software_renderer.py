"""Tests of the rendered scene: objects have their geometric surface, and closer ones hide farther
ones."""

import mujoco
import numpy as np
import pytest

from mjtactile.report.software_renderer import image_axes, rasterise
from mjtactile.sim.scenes.grasp_world import GraspWorld
from mjtactile.sim.scenes.scene_triangles import SceneView, _shape

R = 0.02
H = 0.03
BODIES = {
    "sphere": (f'type="sphere" size="{R}"', 4 * np.pi * R**2),
    "capsule": (f'type="capsule" size="{R} {H}"', 4 * np.pi * R**2 + 4 * np.pi * R * H),
    "cylinder": (f'type="cylinder" size="{R} {H}"', 2 * np.pi * R**2 + 4 * np.pi * R * H),
    "box": (f'type="box" size="{R} {H} {R}"', 8 * (2 * R * H + R * R)),
    "plane": ('type="plane" size="1 1 1"', 0.0),
}


@pytest.mark.parametrize("kind", BODIES)
def test_the_surface_of_a_body(kind):
    attributes, area = BODIES[kind]
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody><geom {attributes}/></worldbody></mujoco>"
    )
    points, faces = _shape(model, 0)
    a, b, c = points[faces].transpose(1, 0, 2)
    found = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    # 24 edges around: the inscribed polygon is 1 % short, squared where the body is round both
    # ways; 12 along
    assert found == pytest.approx(area, rel=1e-9 if kind == "box" else 0.03)


def test_a_disc_covers_its_area_and_the_closer_disc_is_visible():
    angle = np.linspace(0, 2 * np.pi, 61)
    rim = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(61)])
    disc = np.stack([np.zeros((60, 3)), rim[:-1], rim[1:]], axis=1)
    red = np.array([1.0, 0, 0])
    blue = np.array([0, 0, 1.0])
    near = 0.4 * disc + [0, 0, 0.5]
    far = 0.8 * disc
    for order in (1, -1):  # the rendering order has no influence
        corners = np.concatenate([near, far][::order])
        image = rasterise(
            corners,
            np.concatenate([np.tile(red, (60, 1)), np.tile(blue, (60, 1))][::order]),
            (300, 200),
        )
        is_red, is_blue = (image[..., k] > 2 * image[..., 1] + 0.1 for k in (0, 2))
        # 100 pixels are 1; half a pixel at the rim
        assert is_red.sum() == pytest.approx(np.pi * 0.4**2 * 100**2, rel=0.01)
        assert is_blue.sum() == pytest.approx(np.pi * (0.8**2 - 0.4**2) * 100**2, rel=0.01)
        assert image[150, 100, 0] > 0.5


def test_two_sensors_lie_side_by_side_seen_from_above():
    p_WS = np.array([[-0.03, 0.0, 0.1], [0.03, 0.0, 0.1]])
    right, up, towards = image_axes(p_WS)
    assert right @ (p_WS[1] - p_WS[0]) > 0.05 and up[2] > 0.9 and towards[2] > 0
    np.testing.assert_allclose(
        [right @ up, up @ towards, np.cross(right, up) @ towards], [0, 0, 1], atol=1e-12
    )


def test_the_third_sensor_is_drawn_behind_the_others():
    angle = np.radians([90, 210, 330])
    p_WS = 0.03 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(3)])
    right, _, towards = image_axes(p_WS)
    depth = p_WS @ towards
    side = p_WS @ right
    assert depth[2] < -0.028 and min(depth[:2]) > 0.01  # the viewer is on the other side
    assert abs(side[2]) < 1e-9 and side[0] * side[1] < -6e-4


def test_a_grasp_scene_shows_object_housing_and_membranes_but_no_contact_spheres():
    world = GraspWorld("paper16", "egg")
    view = SceneView.of(world)
    corners, rgba = view.triangles()
    assert corners.shape == (len(rgba), 3, 3) and np.isfinite(corners).all()
    shell = corners[np.isclose(rgba[:, :3], [0.93, 0.85, 0.75], atol=1e-3).all(axis=1)]
    # its diameters
    np.testing.assert_allclose(
        np.ptp(shell.reshape(-1, 3), axis=0), [0.032, 0.032, 0.04], rtol=0.02
    )
    assert len(corners) < 5000  # spheres on every vertex would be 140 000
