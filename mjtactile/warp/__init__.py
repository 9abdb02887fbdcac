"""Membranes for thousands of worlds on one GPU, in scenes of MuJoCo Warp (extra `warp`)."""

from importlib.util import find_spec

from mjtactile.core.errors import InputError

if find_spec("mujoco_warp") is None or find_spec("warp") is None:
    raise InputError(
        "mjtactile.warp needs MuJoCo Warp: pip install 'mjtactile[warp]'", source="mjtactile.warp"
    )

from mjtactile.warp.membranes import Iteration, Membranes
from mjtactile.warp.scene import bind
from mjtactile.warp.touch import Touch

__all__ = ["Iteration", "Membranes", "Touch", "bind"]
