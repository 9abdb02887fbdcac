"""Membranes for thousands of worlds on one GPU, in scenes of MuJoCo Warp (extra `warp`)."""

from mjtactile.core.errors import InputError

try:
    import mujoco_warp as _mujoco_warp  # noqa: F401
    import warp as _warp  # noqa: F401
except ImportError as error:
    raise InputError(
        "mjtactile.warp needs MuJoCo Warp: pip install 'mjtactile[warp]'", source="mjtactile.warp"
    ) from error

from mjtactile.warp.membranes import Iteration, Membranes
from mjtactile.warp.scene import Touch, bind

__all__ = ["Iteration", "Membranes", "Touch", "bind"]
