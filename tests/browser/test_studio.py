"""`mjtactile studio` in a real browser: headless Chromium, real physics, the page that a user sees."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.browser.page import CHROMIUM, open_page

CHECKOUT = Path(__file__).resolve().parents[2]
pytestmark = [pytest.mark.browser, pytest.mark.xdist_group("browser"),
              pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here")]
SCENE = np.s_[200:390, 510:750]  # px: the middle of the picture, where no window lies
TABLE = np.s_[410:440, 735:760]
AGAIN = (356, 127)  # px: the panel's button
PANEL = np.s_[60:210, 770:970]  # the left finger's camera


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture
def studio(tmp_path):
    """The command, running in a home of its own; yields its port and process."""
    port = free_port()
    command = [sys.executable, "-m", "mjtactile", "studio", "--no-browser", "--fast", "--port", str(port)]
    with (tmp_path / "log").open("w") as log:
        process = subprocess.Popen(command, cwd=CHECKOUT, stdout=log, stderr=subprocess.STDOUT,
                                   env={**os.environ, "HOME": str(tmp_path)})
    end = time.monotonic() + 90
    while "inflated" not in (tmp_path / "log").read_text():
        assert process.poll() is None and time.monotonic() < end, (tmp_path / "log").read_text()
        time.sleep(0.2)
    yield port, process
    process.kill()
    process.wait()


def changed(before, after, where):
    """Share of the pixels in `where` that differ by more than the picture's compression."""
    return float((np.abs(before[where].astype(int) - after[where]).max(axis=2) > 24).mean())


def picture_until(page, condition, limit=120):
    end = time.monotonic() + limit
    while not condition(shot := page.picture()):
        assert time.monotonic() < end, "the page never showed it"
        time.sleep(1)
    return shot


def test_a_grasp_in_the_browser(studio, tmp_path):
    """The page comes up with scene and panel; a button begins another run, and what moves in it moves in the picture while the
    table stays as it is; the page can be closed and opened again; only this computer is served; Ctrl-C leaves nothing behind."""
    port, process = studio
    url = f"http://localhost:{port}/"
    with open_page(url, tmp_path / "one") as page:
        def is_up(shot):
            return shot[PANEL].std() > 20 and shot[SCENE].std() > 10  # a camera's markers, and a scene that is not black

        first = picture_until(page, is_up)
        if out := os.environ.get("MJTACTILE_PICTURE"):
            cv2.imwrite(out, first)
        page.click(*AGAIN)
        later = picture_until(page, lambda shot: changed(first, shot, SCENE) > 0.02)
        assert changed(first, later, TABLE) == 0
    with open_page(url, tmp_path / "two") as page:  # closed, and opened again
        picture_until(page, is_up)

    listening = Path("/proc/net/tcp").read_text() + Path("/proc/net/tcp6").read_text()
    here = re.findall(rf"\s([0-9A-F]+):{port:04X}\s+0+:0000 0A", listening)
    assert here == ["0100007F"]  # 127.0.0.1, and nothing else
    with socket.create_connection(("127.0.0.1", port)) as stranger:
        stranger.sendall(b"\x00\xff garbage \r\n\r\n" * 1000)
    assert process.poll() is None

    process.send_signal(signal.SIGINT)
    process.wait(30)
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port), timeout=5).close()
    assert "Traceback" not in (tmp_path / "log").read_text()
