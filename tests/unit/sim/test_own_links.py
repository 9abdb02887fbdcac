"""Links whose contacts with a sensor do not count: on the model, and as excludes of the mesh."""

import mujoco
import numpy as np
import pytest

import mjtactile
from mjtactile.core.errors import InputError
from mjtactile.sim.attach import attach_membrane
from mjtactile.sim.sensor.own_links import own_links

# contype, conaffinity of the knuckle, the thumb and the object
BITS = [((1, 1), (1, 1), (1, 1)), ((3, 0), (2, 1), (0, 1)), ((1, 0), (4, 8), (9, 4))]
HAND = """
<mujoco>
  <worldbody>
    <body name="palm">
      <body name="knuckle" pos="0 0 0.1">
        <joint type="hinge" axis="0 1 0"/>
        <geom size="0.01" mass="0.1"/>
        <body name="nail"><geom size="0.005" mass="0.01"/></body>
        <body name="index" pos="0 0 0.1">
          <joint type="{joint}" axis="0 1 0"/>
          <geom size="0.01" mass="0.1"/>
          <site name="tip" pos="0 0 0.1"/>
        </body>
      </body>
      <body name="thumb" pos="0 0 0.4">
        <joint type="hinge" axis="0 1 0"/>
        <geom size="0.01" mass="0.1"/>
      </body>
    </body>
    <body name="object" pos="0 0 0.6"><freejoint/><geom size="0.01" mass="0.1"/></body>
  </worldbody>
  <contact>{contact}</contact>
</mujoco>
"""


def excluded(other):
    return f'<exclude body1="{other}" body2="index"/>'


@pytest.mark.parametrize(
    ("joint", "contact", "names"),
    [
        ("hinge", "", {"knuckle", "nail"}),  # the nail is fixed to the knuckle
        ("slide", "", set()),  # the sensor moves into what it slides on
        ("slide", excluded("knuckle"), {"knuckle"}),
        ("hinge", excluded("palm"), {"knuckle", "nail", "palm"}),
        ("hinge", excluded("thumb"), {"knuckle", "nail"}),  # another finger
        ("hinge", excluded("object"), {"knuckle", "nail"}),
    ],
)
def test_links_that_carry_the_sensor_make_no_contact(joint, contact, names):
    spec = mujoco.MjSpec.from_string(HAND.format(joint=joint, contact=contact))
    mjtactile.configure_options(spec)
    mjtactile.attach(spec, "dense", site="tip", prefix="t/")
    model = spec.compile()
    found = own_links(model, model.body("index").id)
    assert {model.body(int(body)).name for body in found} == names
    pairs = {(int(pair) >> 16, int(pair) & 0xFFFF) for pair in model.exclude_signature}
    vertex = model.body("t/v100").id
    others = {a + b - vertex for a, b in pairs if vertex in (a, b)}
    robot = {"palm", "knuckle", "nail", "thumb", "object"}
    assert {model.body(other).name for other in others} & robot == names


def touches(contype, conaffinity, other_contype, other_conaffinity):
    """Return MuJoCo's rule for all pairs."""
    first = contype[:, None] & other_conaffinity[None]
    return (first | (other_contype[None] & conaffinity[:, None])) != 0


@pytest.mark.parametrize("bits", BITS)
def test_triangles_pass_own_links_and_all_other_pairs_stay(bits):
    """MuJoCo does not apply `<exclude>` to a flex."""
    spec = mujoco.MjSpec.from_string(HAND.format(joint="hinge", contact=""))
    mjtactile.configure_options(spec)
    tip = attach_membrane(spec, "dense", site="tip", prefix="t/", contact="elements")
    for name, (contype, conaffinity) in zip(("knuckle", "thumb", "object"), bits, strict=True):
        geom = spec.body(name).geoms[0]
        geom.contype, geom.conaffinity = contype, conaffinity
    model = spec.compile()
    data = mujoco.MjData(model)
    named = [model.body(name).geomadr[0] for name in ("knuckle", "nail", "thumb", "object")]
    before = touches(*[model.geom_contype, model.geom_conaffinity] * 2)[named]
    for _ in range(2):  # a reset of the sensor binds it again
        sensor = tip.bind(model, data)
    after = touches(*[model.geom_contype, model.geom_conaffinity] * 2)[named]
    vertices = sensor.vertex_geom_ids  # no contacts with triangles
    others = np.setdiff1d(np.arange(model.ngeom), vertices)
    assert np.array_equal(after[:, others], before[:, others])
    flex = [sensor.flex_id]
    geoms = (model.geom_contype[named], model.geom_conaffinity[named])
    by_flex = touches(*geoms, model.flex_contype[flex], model.flex_conaffinity[flex])[:, 0]
    assert by_flex.tolist() == [False, False, *(contype > 0 for contype, _ in bits[1:])]
    # bodies have the bits of their geoms, or more
    bodies = model.geom_bodyid[named]
    assert not (model.geom_contype[named] & ~model.body_contype[bodies]).any()
    assert not (model.geom_conaffinity[named] & ~model.body_conaffinity[bodies]).any()


def test_a_scene_without_a_free_bit_is_refused():
    spec = mujoco.MjSpec.from_string(HAND.format(joint="hinge", contact=""))
    mjtactile.configure_options(spec)
    tip = attach_membrane(spec, "dense", site="tip", prefix="t/", contact="elements")
    spec.body("thumb").geoms[0].contype = (1 << 30) - 1
    model = spec.compile()
    with pytest.raises(InputError, match="contype bits"):
        tip.bind(model, mujoco.MjData(model))
