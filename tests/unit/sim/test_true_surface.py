"""Tests of the size of a true object against closed forms."""

import mujoco
import numpy as np
import pytest

from mjtactile.sim.true_surface import TrueSurface

HALF = np.array([16e-3, 12e-3, 20e-3])


def surface(kind: str) -> TrueSurface:
    """Create the surface of an ellipsoid or a box, with a known starting point for each of a
    hundred directions."""
    size = " ".join(map(str, HALF))
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody><geom type="{kind}" size="{size}"/></worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    directions = np.random.default_rng(4).normal(size=(100, 3))
    norm = (
        np.linalg.norm(directions / HALF, axis=1)
        if kind == "ellipsoid"
        else np.abs(directions / HALF).max(1)
    )
    return TrueSurface(directions / norm[:, None], model, data)


AXES = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]


@pytest.mark.parametrize("axes", [np.eye(3), AXES])
def test_extents_of_an_ellipsoid(axes):
    true = 2 * np.linalg.norm(HALF[:, None] * axes, axis=0)
    estimated = surface("ellipsoid")
    # the farthest of the points is 0.09 to 1 mm short of it
    assert (np.ptp(estimated.points @ axes, axis=0) < true - 5e-5).all()
    assert estimated.extents(axes) == pytest.approx(true, abs=1e-6)


def test_extents_of_a_box_are_those_of_its_faces_and_nearly_of_its_corners():
    box = surface("box")
    assert box.extents(np.eye(3)) == pytest.approx(2 * HALF, abs=1e-9)
    # a corner is reached within the last step, along flanks of up to 45 degrees and more
    assert box.extents(AXES) == pytest.approx(2 * HALF @ np.abs(AXES), abs=1e-4)
