"""Tests of contacts that a user's scene sends past the membrane: parts of the carrier in the
chamber, and MuJoCo's collision rule."""

import mujoco
import numpy as np
import pytest

import mjtactile
from mjtactile.core.errors import SimulationError
from mjtactile.plugin.attach import CAMERA, PHYSICS

G = 9.81  # gravity, m/s^2
PAD = '<geom name="pad" type="box" size=".011 .019 .004" pos="0 0 {z}"/>'
SCENE = """<mujoco><worldbody><body name="finger">{pad}<site name="tip"/></body>
 <body name="ball" pos="0 0 {z}"><joint type="slide" axis="0 0 1" damping="2"/>{geom}</body>
 </worldbody></mujoco>"""
BALL = '<geom name="ball" size="0.02" mass="0.3"/>'
QUASISTATIC = (PHYSICS | CAMERA) - {"mesh"}


def run(geom, z, pad="", seconds=0.4, **attaching):
    spec = mujoco.MjSpec.from_string(SCENE.format(geom=geom, z=z, pad=pad))
    mjtactile.configure_options(spec)
    tip = mjtactile.attach(spec, "dense", site="tip", prefix="t/", **attaching)
    model = spec.compile()
    data = mujoco.MjData(model)
    finger = tip.bind(model, data)
    while data.time < seconds:
        mjtactile.step(model, data, [finger])
    return finger


@pytest.mark.parametrize("effects", [PHYSICS | CAMERA, QUASISTATIC], ids=["mesh", "quasi-static"])
def test_a_load_on_the_pad_behind_the_membrane_is_flagged_with_its_force(effects):
    """A pad 1.5 mm behind the membrane carries the part of the weight that the membrane does
    not. The flag has one digit after the point."""
    with pytest.warns(UserWarning, match="objects can rest on 'pad' of its carrier"):
        # without a mesh, the flag needs five checks, 0.1 s apart
        finger = run(BALL, 0.022, PAD.format(z=-0.0055), seconds=0.8, effects=effects)
    text = finger.flags["carrier_contact"]
    assert text.startswith("'pad'")
    carried = float(text.split("carries ")[1].split(" N")[0])
    on_membrane = -finger.ground_truth_wrench()[2]
    # the flag has the maximum; the ball settles within 0.1 N of it
    assert carried == pytest.approx(0.3 * G - on_membrane, abs=0.2)
    assert carried > 0.5


def test_an_excluded_pad_leaves_the_weight_to_the_membrane():
    finger = run(BALL, 0.022, PAD.format(z=-0.0055), carrier_contact=False)
    # at rest within 10 mN
    assert finger.ground_truth_wrench()[2] == pytest.approx(-0.3 * G, abs=0.02)
    assert "carrier_contact" not in finger.flags


@pytest.mark.filterwarnings("error")
def test_a_pad_behind_the_glass_is_not_named():
    depth = mjtactile.load_sensor("dense").chamber.depth
    run(BALL, 0.1, PAD.format(z=-depth - 0.0045), seconds=0.01)


@pytest.mark.parametrize("effects", [PHYSICS | CAMERA, QUASISTATIC], ids=["mesh", "quasi-static"])
@pytest.mark.parametrize(
    ("contype", "conaffinity"), [(1, 1), (0, 1), (2, 2)], ids=["default", "affinity", "other bits"]
)
def test_mujocos_collision_rule_selects_the_geoms_on_the_membrane(contype, conaffinity, effects):
    """A geom that collides with a default geom by its conaffinity alone rests on the membrane."""
    bits = f'contype="{contype}" conaffinity="{conaffinity}"'
    finger = run(f'<geom size="0.01" mass="0.05" {bits}/>', 0.0145, effects=effects)
    # the quasi-static membrane still moves by some mN
    np.testing.assert_allclose(finger.ground_truth_wrench()[2], -0.05 * G, atol=0.02)


SILENT = '<geom name="a" size="0.01" mass="0.05" contype="0" conaffinity="0"/>'
SMALL = '<geom name="b" size="0.001" pos="0 0 0.3" mass="0"/>'


def bound(objects, pad="", pair=(), exclude=(), z=0.0145, effects=None):
    spec = mujoco.MjSpec.from_string(SCENE.format(geom=objects, z=z, pad=pad))
    if pair:
        spec.add_pair(geomname1=pair[0], geomname2=pair[1])
    if exclude:
        spec.add_exclude(bodyname1=exclude[0], bodyname2=exclude[1])
    mjtactile.configure_options(spec)
    tip = mjtactile.attach(spec, "dense", site="tip", prefix="t/", effects=effects)
    model = spec.compile()
    data = mujoco.MjData(model)
    return model, data, tip.bind(model, data)


def test_a_geom_that_collides_by_a_pair_only_is_named_and_stops_the_run():
    with pytest.warns(UserWarning, match="'a' makes contact by <pair> only"):
        model, data, finger = bound(SILENT + SMALL, pair=("a", "b"))
    with pytest.raises(SimulationError, match="'a' went through the membrane"):
        mjtactile.step(model, data, [finger], nstep=100)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("pair", [("pad", "a"), ("a", "pad")])
def test_a_pair_with_the_carrier_holds_for_its_membrane(pair):
    """The weight of the ball rests on the membrane, in either order of the pair."""
    depth = mjtactile.load_sensor("dense").chamber.depth
    pad = PAD.format(z=-depth - 0.0045)  # behind the glass
    model, data, finger = bound(SILENT, pad, pair)
    mjtactile.step(model, data, [finger], nstep=100)
    np.testing.assert_allclose(finger.ground_truth_wrench()[2], -0.05 * G, atol=0.02)


@pytest.mark.parametrize("effects", [PHYSICS | CAMERA, QUASISTATIC], ids=["mesh", "quasi-static"])
@pytest.mark.parametrize("exclude", [("finger", "ball"), ("ball", "finger")])
def test_an_exclude_of_the_carrier_is_named_and_the_membrane_carries(exclude, effects):
    ball = '<geom size="0.01" mass="0.05"/>'
    with pytest.warns(UserWarning, match="<exclude> of the carrier and 'ball' does not apply"):
        model, data, finger = bound(ball, exclude=exclude, effects=effects)
    mjtactile.step(model, data, [finger], nstep=100)
    np.testing.assert_allclose(finger.ground_truth_wrench()[2], -0.05 * G, atol=0.02)
