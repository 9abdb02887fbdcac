"""Links whose contacts with a sensor do not count: on the model, and as excludes of the mesh."""

import mujoco
import pytest

import mjtactile
from mjtactile.sim.sensor.own_links import own_links

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
