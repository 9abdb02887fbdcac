"""Touch in MuJoCo Studio, with a model of yours; name your sites below.

python -m mujoco.studio.viewer --gfx web --model my_robot.xml --plugins examples/touch_in_studio.py
"""

import mjtactile.studio


class Tips(mjtactile.studio.Sensors):
    """The sensors, and who steps them."""

    # of your model, and the sensor that is put there: a shipped name or a file
    sites = {"fingertip": "dense"}


class TipsPanel(mjtactile.studio.Panel):
    """The windows: images, forces, contacts."""

    def __init__(self):
        super().__init__(Tips.fingers)
