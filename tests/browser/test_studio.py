"""Tests of `mjtactile studio` in a real browser: headless Chromium and real physics. One session
and one page serve all tests, in the order of this file.
"""

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

from tests.browser.page import CHROMIUM, LIMIT, open_page

CHECKOUT = Path(__file__).resolve().parents[2]
pytestmark = [
    pytest.mark.browser,
    pytest.mark.clock,
    pytest.mark.xdist_group("browser"),
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here"),
]
# where the page is kept while it holds, for the documentation
PICTURE = os.environ.get("MJTACTILE_PICTURE")
SCENE = np.s_[40:330, 300:890]  # px: outside all windows
NOWHERE = (600, 180)  # px, in it


class Studio:
    """The command and its page."""

    def __init__(self, folder):
        self.folder = folder
        self._open = contextlib.ExitStack()
        self.page: Any = None
        self._mouse: Any = None  # last position, px
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self.log = folder / "log"
        command = [
            sys.executable,
            "-m",
            "tests.browser.host",
            "--no-browser",
            "--no-wait",
            "--no-realtime",
            "--port",
            str(self.port),
        ]
        with self.log.open("w") as log:
            self.process: Any = subprocess.Popen(
                command,
                cwd=CHECKOUT,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                stderr=log,
                env={**os.environ, "HOME": str(folder)},
            )

    @property
    def url(self):
        return f"http://localhost:{self.port}/"

    def open(self, name):
        """Open the page in its own browser."""
        self.page = self._open.enter_context(
            open_page(
                self.url,
                self.folder / name,
                until=self.log,
                sparing=True,
                scale=1.0 if PICTURE else 0.5,
            )
        )

    def close(self):
        self._open.close()

    def ask(self, line="say"):
        """Return the state of the windows in the last frame."""
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()
        while not (answer := self.process.stdout.readline()).startswith("{"):
            assert answer, self.log.read_text()
        return json.loads(answer)

    def until(self, condition, expected):
        end = time.monotonic() + LIMIT
        while not condition(found := self.ask()):
            assert time.monotonic() < end, f"waited in vain until {expected}: {found}"
            time.sleep(0.05)
        return found

    def press(self, label, fraction=0.5):
        """Press the widget and release it, each after the previous action has arrived.

        `fraction` is the position along its width. A window that grows by a line moves the widgets
        below between a query and a press. Then another widget or none is pressed. In that case the
        mouse is released outside all windows, which is not a click, and the widget is located
        again.
        """
        end = time.monotonic() + LIMIT
        while True:
            x, y = self._come_to(label, fraction, end)
            self.page.mouse("mousePressed", x, y, buttons=1)
            frames = self.ask()["frames"]
            observed = self.until(
                lambda f, frames=frames: f["active"] or f["frames"] > frames + 20, "a press is seen"
            )
            if observed["active"] == label:
                break
            self.page.mouse("mouseMoved", *NOWHERE, buttons=1)
            self.page.mouse("mouseReleased", *NOWHERE)
        self.page.mouse("mouseReleased", x, y)
        self.until(lambda f: f["active"] != label, f"{label!r} is let go of")

    def _come_to(self, label, fraction, end):
        """Move the mouse to the widget and return its position."""
        while True:
            found = self.until(lambda f: label in f["places"], f"there is {label!r}")
            left, top, right, bottom = found["places"][label]
            x = left + fraction * (right - left)
            y = (top + bottom) / 2
            if found["hovered"] == label and self._mouse == (x, y):
                return x, y
            assert time.monotonic() < end, f"the mouse never came to {label!r}"
            self._mouse = (x, y)
            # a new page does not receive input at once
            for place in (x - 1, x):
                self.page.mouse("mouseMoved", place, y, button="none", clickCount=0)
            time.sleep(0.2)

    def is_up(self):
        """Wait until a page is open and shows a cycle; return its state."""
        before = self.ask()["frames"]
        return self.until(
            lambda f: f["frames"] > before + 1 and f["number"] >= 0 and f["places"],
            "the page is up",
        )

    def image(self, good):
        """Return the page as soon as it is `good`, and its images: left camera, left membrane,
        right camera, right membrane. The scene is drawn after the windows."""
        end = time.monotonic() + LIMIT
        while True:
            shot = self.page.image()
            places = self.ask()["places"]
            # textures are numbered
            parts = [
                shot[round(top) + 2 : round(bottom) - 2, round(left) + 2 : round(right) - 2]
                for name, (left, top, right, bottom) in places.items()
                if name.isdecimal()
            ]
            if good(shot, parts):
                return shot, parts
            assert time.monotonic() < end, "the page never showed it"
            time.sleep(0.5)


@pytest.fixture(scope="module")
def studio(tmp_path_factory):
    studio = Studio(tmp_path_factory.mktemp("studio"))
    try:
        studio.open("one")
        if not studio.page.run("document.createElement('canvas').getContext('webgl2') !== null"):
            pytest.skip("this Chromium has no WebGL")
        yield studio
    finally:
        studio.close()
        studio.process.kill()
        studio.process.communicate()


def is_dark(bgr):
    """Return True where the colour map starts: violet, zero indentation."""
    return bgr[:, :, 1] < 60


def test_membrane_deforms_in_a_grasp_and_panel_values_equal_session_values(studio):
    studio.is_up()
    # a scene that is not black, markers, and no contact
    first, _ = studio.image(
        lambda shot, parts: (
            shot[SCENE].std() > 10
            and len(parts) == 4
            and parts[0].std() > 20
            and is_dark(parts[1]).mean() > 0.98
        )
    )
    studio.press("resume")
    studio.until(
        lambda f: f["phase"] == "hold" and f["paused"], "it holds; the host pauses it there"
    )
    now = studio.ask()
    held = studio.until(lambda f: f["frames"] > now["frames"] + 3, "some frames go by")
    assert held["number"] == now["number"]  # the scene is paused
    for estimated in held["estimates"]:
        for text in (
            f"normal {estimated['force']:+.3f} N, 2 sd {2 * estimated['sd']:.3f}",
            f"ground truth {estimated['true']:+.3f} N",
        ):
            assert text in held["reported"]
        assert abs(estimated["force"] - estimated["true"]) < 5 * estimated["sd"]
    later, (_, membrane, *_) = studio.image(
        lambda shot, parts: (parts[1][:, :, 1] > 180).mean() > 0.005
    )
    if PICTURE:
        cv2.imwrite(PICTURE, later)
    # the scene has changed
    assert (np.abs(first[SCENE].astype(int) - later[SCENE]).max(axis=2) > 24).mean() > 0.02
    height, width = membrane.shape[:2]
    assert is_dark(membrane[: height // 6]).mean() > 0.9  # the edge of the frame does not move
    # green: the deepest
    x, y = (np.mean(where) for where in np.nonzero(membrane[:, :, 1] > 180)[::-1])
    # fractions of the frame's opening
    centroid = np.array(held["estimates"][0]["centroid"]) / [0.040, 0.030]
    np.testing.assert_allclose([x / width - 0.5, y / height - 0.5], centroid, atol=0.06)


def test_the_supply_slider_changes_the_pressure(studio):
    studio.press("supply, kPa", 0.2)
    supply = studio.ask()["values"]["supply, kPa"]
    assert 0.4 < supply < 0.8  # kPa; before: 1
    studio.press("open valves")
    number = studio.ask()["number"]
    studio.press("one cycle")
    studio.until(lambda f: f["number"] == number + 1, "one cycle goes by")
    studio.press("one cycle")
    studio.until(
        lambda f: f["estimates"][0]["pressure"] == pytest.approx(1e3 * supply, abs=1),
        "the pressure is the supply's",
    )


def test_exception_of_a_handler_is_shown_and_the_session_continues(studio):
    studio.ask("break")
    studio.until(
        lambda f: any("ZeroDivisionError" in text for text in f["reported"]), "the error is shown"
    )
    number = studio.ask()["number"]
    studio.press("one cycle")
    studio.until(lambda f: f["number"] > number, "it goes on")
    studio.ask("mend")
    studio.until(
        lambda f: any(text.startswith("normal") for text in f["reported"]),
        "the finger is shown again",
    )


def test_second_page_is_read_only_and_other_origins_change_no_state(studio):
    """Studio serves its windows to one page at a time and the scene to all, but rejects other web
    sites and clients that do not use HTTP."""
    address = f"ws://localhost:{studio.port}"
    own = Origin(f"http://localhost:{studio.port}")
    with connect(f"{address}/state?sid=second", origin=own) as second:
        roster = next(
            text for text in second if isinstance(text, str) and text.startswith("viewers=")
        )
        assert roster.startswith("viewers=2;role=spectator")
        payload = next(part for part in second if isinstance(part, bytes))
        assert len(payload) > 1000
        with (
            connect(f"{address}/ui?sid=second") as windows,
            pytest.raises(ConnectionClosed, match="4001"),
        ):
            windows.recv(timeout=LIMIT)
    before = studio.ask()
    for path in ("ui", "state", "drop"):
        with (
            pytest.raises(InvalidStatus, match="403"),
            connect(f"{address}/{path}?sid=evil", origin=Origin("https://evil.example")),
        ):
            pass
    with socket.create_connection(("127.0.0.1", studio.port)) as stranger:
        stranger.sendall(b"\x00\xff garbage \r\n\r\n" * 1000)
    after = studio.until(lambda f: f["frames"] > before["frames"] + 2, "it goes on")
    assert (after["number"], after["paused"], after["runs"]) == (before["number"], True, 1)
    listening = Path("/proc/net/tcp").read_text() + Path("/proc/net/tcp6").read_text()
    # 127.0.0.1 only
    assert re.findall(rf"\s([0-9A-F]+):{studio.port:04X}\s+0+:0000 0A", listening) == ["0100007F"]


def test_a_reopened_page_continues(studio):
    number = studio.ask()["number"]
    studio.close()
    studio.open("two")
    studio.is_up()
    studio.image(lambda shot, _: shot[SCENE].std() > 10)
    studio.press("resume")
    studio.until(lambda f: f["number"] > number, "it goes on")


def test_ctrl_c_in_a_pause_leaves_no_process(studio):
    studio.press("pause")
    studio.until(lambda f: f["paused"], "it pauses")
    studio.process.send_signal(signal.SIGINT)
    studio.process.wait(2 * LIMIT)  # the gripper first lowers and opens
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", studio.port), timeout=5).close()
    assert "Traceback" not in studio.log.read_text()
