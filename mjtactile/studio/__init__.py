"""MuJoCo Studio with touch: a live view of a session, or `Panel` in the user's own Studio.

The command `mjtactile studio` starts the live view.
"""

from mjtactile.studio.local_server import launch as launch
from mjtactile.studio.panel import Panel as Panel
from mjtactile.studio.user_scene import Sensors as Sensors

__all__ = ["Panel", "Sensors", "launch"]
