"""Test of an unsensed force and of exhausted memory on the emulated rig.

A board with wings is squeezed until the wings push on the finger frames, which no membrane
measures. Then the controller allocates all of the memory.
"""

import json
import sys

import pytest

from tests.emulated_host import emulated_rig, host, shipped_with

pytestmark = pytest.mark.clock

# The wings meet the frame rims 20 to 23 mm from the center. There the board indents bulges of 2.8
# mm by 1 mm over 16 x 16 mm. This raises the chambers of 24 mL to 2.4 kPa; the valves vent at 3
# kPa.
BOARD = """<mujoco model="board"><custom><numeric name="break_force_N" data="50"/>
<text name="material" data="solid"/></custom><worldbody><body name="object" pos="0 0 0.031">
<freejoint/>
<geom type="box" size="0.015 0.008 0.008" mass="0.005"/>
<geom type="box" size="0.0168 0.004 0.031" pos="0 0.0245 0" mass="0.005"/>
<geom type="box" size="0.0168 0.004 0.031" pos="0 -0.0245 0" mass="0.005"/>
</body></worldbody></mujoco>"""
SQUEEZED = 1.0  # time in s; the monitor needs 0.3 s after the jaws have stopped
ALLOCATING_HOLD = f"""
def _hold(observation, command, felt):
    if command.memory["phase_time"] > {SQUEEZED}:
        return [0.0] * (2 << 30)
    return replace(command, opening=observation.gripper.opening - 0.01, force_limit=6.0)


def _unused("""


@pytest.mark.slow(40)
@pytest.mark.skipif(sys.platform != "linux", reason="no limit of a process's memory elsewhere")
def test_loads_on_a_frame_are_reported_and_steps_beyond_the_memory_limit_are_refused(tmp_path):
    path = tmp_path / "board.xml"
    path.write_text(BOARD)
    emulator = emulated_rig(str(path))
    text = shipped_with("gentle", CLOSING_SPEED=0.045, SETTLE_TIME=0.1, TARGET_FORCE=0.35)
    text = text.replace("def _hold(", ALLOCATING_HOLD)
    try:
        with host(emulator, tmp_path, text) as running:
            output, errors = running.ends()
            assert running.process.returncode == 2, errors
            assert "step() raised MemoryError" in errors.splitlines()[-1]
            running.has_set_down()
            recording = running.recording()
    finally:
        emulator.close()
    assert recording.columns["state"][-1] == "latched"
    # force in N: the limit of the servos is 6; membranes indented by 1.3 mm measure about 1
    reported = json.loads(output)["flags"]["unsensed_force"]["reason"]
    assert 2.0 < float(reported.split("carry ")[1].split(" N")[0]) < 8.0, reported
