"""A grasp whose fingers have a part in front of the glass."""

import contextlib

import pytest

from mjtactile.core import resources
from mjtactile.core.errors import MjtactileError
from mjtactile.core.scenario import Scenario
from mjtactile.recording.observer import Observer
from mjtactile.runtime.grasp import run_grasp
from tests.emulated_host import controller_text

PAD = '<geom name="pad" type="box" pos="{x} 0 0" size="0.004 0.011 0.009" mass="0"/>'


class _Session(Observer):
    def start(self, session):
        self.session = session


@pytest.mark.slow
def test_a_pad_behind_the_membrane_is_named_in_the_flags_of_the_grasp(tmp_path):
    """The pad ends 1.5 mm below the rim. The box presses the membrane onto it."""
    models = resources.folder("models")
    gripper = (models / "grippers" / "two_finger.xml").read_text(encoding="utf-8")
    site = '<site name="left_fingertip"'
    gripper = gripper.replace(site, PAD.format(x=-0.0055) + site)
    (tmp_path / "padded.xml").write_text(gripper, encoding="utf-8")
    rig = (models / "rigs" / "sim.toml").read_text(encoding="utf-8")
    rig = rig.replace("../grippers/two_finger.xml", "padded.xml")
    (tmp_path / "padded.toml").write_text(rig, encoding="utf-8")
    hard = controller_text(hold=0.1).replace("TARGET_FORCE = 0.6", "TARGET_FORCE = 2.5")
    (tmp_path / "hard.py").write_text(hard, encoding="utf-8")
    watching = _Session()
    scenario = Scenario(
        object="pebble",
        rig=str(tmp_path / "padded.toml"),
        controller=str(tmp_path / "hard.py"),
        effects="-mesh,-pipeline",
    )
    with contextlib.suppress(MjtactileError):  # it may stop safely
        run_grasp(scenario, [watching])
    text = str(watching.session.flags["carrier_contact"])
    assert "pad" in text.split("'")[1]
    assert float(text.split("carries ")[1].split(" N")[0]) >= 0.2
