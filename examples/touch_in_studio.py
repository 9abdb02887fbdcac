"""Touch in MuJoCo Studio, with your own model; name its sites below.

python -m mujoco.studio.viewer --gfx web --model my_robot.xml --plugins examples/touch_in_studio.py
"""

import mjtactile.studio


class Tips(mjtactile.studio.Sensors):
    """Sensors in the scene, and the source of its steps."""

    # sites of your model, each with the sensor on it: a shipped name or a file
    sites = {"fingertip": "dense"}


class TipsPanel(mjtactile.studio.Panel):
    """Windows with images, forces and contacts."""

    def __init__(self):
        super().__init__(Tips.fingers)
