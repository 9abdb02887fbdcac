"""Test of Studio's red button on the emulated rig, without a page.

The button is pressed while an egg is held in the air: the gripper sets the egg down, torque goes
off, and the chambers are vented.
"""

import math

import pytest

from mjtactile.core.errors import DeviceError
from mjtactile.core.scenario import Scenario
from mjtactile.runtime.controller import load_controller
from mjtactile.runtime.grasp import run_grasp
from mjtactile.studio.session_bridge import RED_BUTTON, SessionBridge
from tests.emulated_host import controller_text, emulated_rig, rig_text
from tests.patient import SLOW_CAMERA_DESIGN

pytestmark = pytest.mark.clock


class PressedButtonBridge(SessionBridge):
    """Bridge that presses the red button as soon as the egg is held."""

    def __init__(self):
        super().__init__()
        self.states = []

    def add(self, cycle, view=None, **truth):
        super().add(cycle, view, **truth)
        self.states.append((self.latest.session.state, self.latest.session.lift_height))
        if cycle.sent.phase == "hold" and not self._halted:
            self.halt()


@pytest.fixture
def emulator():
    process = emulated_rig()
    yield process
    process.close()


@pytest.mark.slow(25)
def test_the_red_button_while_holding_sets_down_releases_and_vents(emulator, tmp_path):
    (tmp_path / "rig.toml").write_text(rig_text(emulator))
    (tmp_path / "mine.py").write_text(controller_text())
    bridge = PressedButtonBridge()
    scenario = Scenario(
        sensor=SLOW_CAMERA_DESIGN, rig=str(tmp_path / "rig.toml"), time_limit=math.inf
    )
    controller = bridge.take_over(load_controller(tmp_path / "mine.py"))
    with pytest.raises(DeviceError, match=RED_BUTTON):
        run_grasp(scenario, [bridge], controller=controller)
    truth = emulator.truth()
    assert not any(truth["torque"].values()) and set(truth["valve"].values()) == {"vent"}
    # height of the egg's center, m: the egg stands at its initial place
    assert truth["object_height"] == pytest.approx(0.031, abs=0.003)
    assert max(lift for _, lift in bridge.states) > 0.03  # height in m; the egg was in the air
    assert bridge.states[-1][0] in ("safe", "latched") and bridge.states[-1][1] < 2e-3
