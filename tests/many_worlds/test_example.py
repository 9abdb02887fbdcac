"""The example of many worlds: eggs that are lifted by touch, with forces from statics."""

import runpy
from pathlib import Path

import pytest

pytest.importorskip("mujoco_warp")

pytestmark = pytest.mark.slow(12)

EXAMPLE = Path(__file__).resolve().parents[2] / "examples/many_worlds.py"


def test_eggs_are_lifted():
    force, height = runpy.run_path(str(EXAMPLE))["grasp"](2, 2.2)
    assert force == pytest.approx(0.6, abs=5e-3)  # the goal, N
    assert height == pytest.approx(0.0226 + 0.03, abs=1e-3)  # at rest on the table, and lifted
