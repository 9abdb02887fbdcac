"""Tests of touch in a user's own Studio: their sensors, their loop, or a plug-in file."""

import os
import re
import socket
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import mujoco
import pytest
from mujoco.studio import messages, plugin
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from mjtactile.core.flags import Flag
from mjtactile.studio.user_scene import UserFingers
from tests.emulated import wait_for
from tests.fake_run import fake_image, fake_touch

CHECKOUT = Path(__file__).resolve().parents[3]
MODEL = """
<mujoco><worldbody>
  <body name="finger"><site name="fingertip"/></body>
  <body name="weight" pos="0 0 0.015"><joint type="slide" axis="0 0 1"/><geom size="0.01" mass="0.05"/></body>
</worldbody></mujoco>"""


class FakeHandle:
    """Studio's simulation side: keeps the model."""

    def set_model(self, model, path="", data=None):
        self.model = model
        self.data = data


@pytest.fixture(scope="module")
def tips(tmp_path_factory):
    """Load the shipped plug-in file as Studio does, with a third-party model."""
    path = tmp_path_factory.mktemp("model") / "their.xml"
    path.write_text(MODEL)
    sensors, panel = plugin.load_plugins([CHECKOUT / "examples" / "touch_in_studio.py"])
    sensors.handle = FakeHandle()
    assert sensors.on_load_model(messages.LoadModelEvent(path=str(path)))
    return SimpleNamespace(
        sensors=sensors, panel=panel, model=sensors.handle.model, data=sensors.handle.data
    )


def test_a_plugin_file_adds_sensors_and_steps_them_in_time(tips):
    step = messages.StepEvent(model=tips.model, data=tips.data)
    start = time.monotonic()
    while tips.data.time < 0.6:
        assert tips.sensors.on_step(step)
        assert time.monotonic() - start < 60
    assert time.monotonic() - start > 0.5  # no faster than the clock
    [estimated] = tips.panel.source.snapshot().fingers
    # the weight on it
    assert estimated.name == "fingertip" and estimated.touch.force_normal == pytest.approx(
        0.05 * 9.81, abs=0.05
    )
    assert estimated.rest is not None and estimated.body == tips.sensors.fingers[0].sensor.body_id
    assert estimated.gauge_pressure > 1000 and estimated.temperature == pytest.approx(293, abs=5)


def test_sensors_follow_pause_and_reset(tips):
    step = messages.StepEvent(model=tips.model, data=tips.data)
    tips.sensors._paused = True
    before = tips.data.time
    for _ in range(3):
        tips.sensors.on_step(step)
    assert tips.data.time == before
    tips.sensors.on_single_step(messages.SingleStepEvent())
    tips.sensors.on_step(step)
    assert tips.data.time == pytest.approx(before + tips.model.opt.timestep)
    mujoco.mj_resetData(tips.model, tips.data)
    tips.sensors._paused = False
    tips.sensors.on_step(step)
    # inflated again, without an error
    assert tips.data.time <= 2 * tips.model.opt.timestep and not tips.sensors._paused


def test_fingers_are_shown_again_when_there_is_a_new_image():
    def seen(number):
        return SimpleNamespace(
            image=fake_image(number),
            touch=fake_touch(0.1, 0.0),
            rest=None,
            gauge_pressure=1.0,
            temperature=2.0,
        )

    finger = SimpleNamespace(
        name="tip",
        design=None,
        sensor=SimpleNamespace(body_id=1),
        seen=seen(0),
        flags={"sharp_edge": Flag("one presses")},
    )
    fingers = []
    own = UserFingers(fingers)
    assert own.snapshot() is None  # none yet
    fingers.append(finger)
    first = own.snapshot()
    assert first is own.snapshot()
    finger.seen = seen(1)
    assert own.snapshot().number == first.number + 1 and len(own.history.rows) == 2


def is_open(port):
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def test_the_documented_loop_accepts_local_connections_only(tmp_path):
    """The loop of docs/how-to/studio.md accepts connections of this computer only, and of no other
    web site.

    The test adds a model and an end. It runs in its own process, since MuJoCo's viewer may crash a
    process that opens a second one.
    """
    [code] = [
        block
        for block in re.findall(
            r"```python\n(.*?)```", (CHECKOUT / "docs/how-to/studio.md").read_text(), re.DOTALL
        )
        if "launch" in block
    ]
    code = "import select, sys\n" + code.replace(
        "handle.is_running()", "not select.select([sys.stdin], [], [], 0)[0]"
    )
    (tmp_path / "their_robot.xml").write_text(MODEL)
    code += "print('felt', fingers[0].touch.time > 0)\n"
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        text=True,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, "HOME": str(tmp_path)},
    )
    try:
        port = next(
            int(found[1])
            for line in process.stdout
            if (found := re.search(r"http://localhost:(\d+)/", line))
        )
        address = f"ws://127.0.0.1:{port}/state"
        # the address is printed a moment before the server listens
        assert wait_for(lambda: is_open(port), 60.0)
        with connect(address, origin=f"http://127.0.0.1:{port}"):
            pass
        for stranger in ("https://evil.example", "http://localhost:1"):
            with pytest.raises(InvalidStatus, match="403"), connect(address, origin=stranger):
                pass
        listening = Path("/proc/net/tcp").read_text() + Path("/proc/net/tcp6").read_text()
        # 127.0.0.1 alone
        assert re.findall(rf"\s([0-9A-F]+):{port:04X}\s+0+:0000 0A", listening) == ["0100007F"]
        text, _ = process.communicate("end\n", timeout=300)
        assert "felt True" in text and process.returncode == 0
    finally:
        process.kill()
        process.communicate()
