"""MuJoCo Studio with touch in it: a session watched live (`mjtactile studio`), or `Panel` in a
Studio of your own."""

from mjtactile.studio.local_server import launch as launch
from mjtactile.studio.panel import Panel as Panel
from mjtactile.studio.user_scene import Sensors as Sensors

__all__ = ["Panel", "Sensors", "launch"]
