"""An indenter of any size starts clear of the inflated membrane."""

import pytest

from mjtactile.sim import ground_truth
from mjtactile.sim.scenes.indentation import Indenter, PressWorld


@pytest.mark.parametrize(
    ("kind", "size", "bottom"), [("sphere", 0.06, 0.06), ("sphere", 0.2, 0.2), ("box", 0.3, 0.15)]
)
def test_a_large_indenter_starts_clear_of_the_membrane(kind, size, bottom):
    world = PressWorld("dense", Indenter(kind, size))
    assert world.start_height > bottom
    assert not world.data.ncon
    assert world.inflate(world.design.chamber.supply_gauge, seal=True)
    assert not world.data.ncon
    # the first touch is at the top of the bulge
    top = float(world.sensors[0].p_SV[:, 2].max())
    assert world._touch_height + world.start_height - bottom == pytest.approx(top, abs=1e-3)
    world.press(0.5e-3)
    assert ground_truth.contact_force(world, 0)[2] < -0.05
