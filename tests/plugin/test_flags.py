"""Tests of flags in a user's scene: flags on the finger, and a stop where values would be wrong."""

import mujoco
import numpy as np
import pytest

import mjtactile
from mjtactile.core.errors import SimulationError

G = 9.81  # gravity, m/s^2
SCENE = """<mujoco><worldbody><body name="base" pos="0 0 0.1"><site name="here"/></body>
 <body pos="{x} 0 {z}"><joint type="slide" axis="0 0 1"/>{geom}</body></worldbody></mujoco>"""
BALL = '<geom size="0.02" mass="0.05"/>'


def scene(geom, x=0.0, z=0.15, **attaching):
    spec = mujoco.MjSpec.from_string(SCENE.format(x=x, z=z, geom=geom))
    mjtactile.configure_options(spec)
    mount = mjtactile.attach(spec, "dense", site="here", **attaching)
    model = spec.compile()
    data = mujoco.MjData(model)
    return model, data, mount.bind(model, data)


def test_a_ball_on_the_membrane_is_weighed_without_a_flag():
    model, data, finger = scene(BALL, z=0.1245)
    mjtactile.step(model, data, [finger], nstep=200)
    # the support of a body at rest carries its weight; solver rows are accurate to a mN
    np.testing.assert_allclose(finger.ground_truth_wrench()[:3], [0, 0, -0.05 * G], atol=3e-3)
    assert finger.flags == {}
    with pytest.raises(TypeError):
        finger.flags["mine"] = "frozen"  # type: ignore[index]


def test_a_weight_on_the_frame_is_flagged_with_its_force():
    design = mjtactile.load_sensor("dense")
    rim = design.frame.length / 2 + design.frame.rim / 2
    model, data, finger = scene('<geom size="0.02" mass="0.5"/>', x=rim, z=0.1215)
    mjtactile.step(model, data, [finger], nstep=200)
    on_frame = 0.5 * G + finger.ground_truth_wrench()[2]
    assert on_frame > 1.0
    reported = float(finger.flags["frame_contact"].split(" with ")[1].split(" N")[0])
    # the flag keeps its first value, within the bounces of the first 0.1 s
    assert reported == pytest.approx(on_frame, rel=0.3)


def test_a_short_contact_of_the_frame_is_flagged_without_a_mesh():
    """Checks of quasi-static membranes are 0.1 s apart, and five of them were needed: 0.5 s."""
    design = mjtactile.load_sensor("dense")
    rim = design.frame.length / 2 + design.frame.rim / 2
    geom = '<geom size="0.02" mass="0.5"/>'
    model, data, finger = scene(geom, x=rim, z=0.1215, effects="-mesh")
    mjtactile.step(model, data, [finger], nstep=round(0.25 / model.opt.timestep))
    assert "with " in finger.flags["frame_contact"]


@pytest.mark.parametrize(
    ("turned", "above", "steps"),
    [(0, 0.006, 150), pytest.param(45, 0.0085, 300, marks=pytest.mark.slow)],
    ids=["a face", "on an edge"],
)
def test_a_box_is_weighed_and_its_edges_are_flagged(turned, above, steps):
    """The mesh carries a box of 50 g, its edges are flagged, and the estimated force is within its
    own uncertainty."""
    size = "0.006 0.006 0.006"
    geom = f'<geom type="box" size="{size}" euler="0 {turned} 0" mass="0.05"/>'
    model, data, finger = scene(geom, z=0.1045 + above)
    mjtactile.step(model, data, [finger], nstep=steps)
    assert "mm from the center of its face" in finger.flags["sharp_edge"]
    touch = finger.touch
    assert touch.status == "ok"
    # force in N: by then the box has settled within 10 mN
    assert finger.ground_truth_wrench()[2] == pytest.approx(-0.05 * G, abs=0.01)
    assert touch.force_normal == pytest.approx(0.05 * G, abs=min(3 * touch.force_normal_sd, 0.06))


def test_a_diverged_simulation_stops_although_mujoco_resets_it():
    model, data, finger = scene(BALL)
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    mjtactile.step(model, data, [finger], nstep=5)
    data.qvel[model.joint(0).dofadr[0]] = 1e12
    with pytest.raises(SimulationError, match="MuJoCo warned: BADQVEL"):
        mjtactile.step(model, data, [finger])
