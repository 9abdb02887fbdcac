"""MuJoCo Studio with touch in it: a session watched live (`mjtactile studio`), or `Panel` in a
Studio of your own."""

from mjtactile.studio.loopback import launch as launch
from mjtactile.studio.own import Sensors as Sensors
from mjtactile.studio.panel import Panel as Panel

__all__ = ["Panel", "Sensors", "launch"]
