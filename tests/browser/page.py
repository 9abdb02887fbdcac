"""Headless Chromium by its DevTools protocol: a page, its pictures, and nothing else."""

import base64
import contextlib
import itertools
import json
import shutil
import subprocess
import time
import urllib.request

import cv2
import numpy as np
from websockets.sync.client import connect

CHROMIUM = next((path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None)
_FLAGS = ["--headless=new", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox",
          "--window-size=1280,800", "--remote-allow-origins=*", "--remote-debugging-port=0"]


class Page:
    """What can be seen and done on a page."""

    def __init__(self, socket):
        self._socket, self._numbers = socket, itertools.count(1)

    def _ask(self, method, **params):
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": params}))
        while (answer := json.loads(self._socket.recv(timeout=120))).get("id") != number:
            pass
        return answer["result"]

    def run(self, script):
        """What an expression in JavaScript gives there."""
        answer = self._ask("Runtime.evaluate", expression=script, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def wait_for(self, script, limit=60):
        """Until an expression is true there."""
        end = time.monotonic() + limit
        while not self.run(script):
            assert time.monotonic() < end, f"never: {script}"
            time.sleep(0.1)

    def picture(self):
        """Blue, green, red (h, w, 3)."""
        png = base64.b64decode(self._ask("Page.captureScreenshot", format="png")["data"])
        return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)

    def mouse(self, kind, x, y, **more):
        """One event of the mouse, such as mouseMoved with buttons=1, or mouseWheel with deltaY px."""
        self._ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, **{"button": "left", "clickCount": 1} | more)


@contextlib.contextmanager
def open_page(url, folder, until=None):
    """A `Page` with `url`, in a browser of its own, once the server has written that it is there into the file `until`."""
    end = time.monotonic() + 90
    while until is not None and "inflated" not in until.read_text():
        assert time.monotonic() < end, until.read_text()
        time.sleep(0.1)
    command = [CHROMIUM, *_FLAGS, f"--user-data-dir={folder}", url]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        with connect(_socket(folder), max_size=None) as socket:
            yield Page(socket)
    finally:
        process.kill()
        process.wait()


def _socket(folder):
    """The address of the page's own socket; waits for the browser."""
    end = time.monotonic() + 60
    while True:
        try:
            port = (folder / "DevToolsActivePort").read_text().splitlines()[0]
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/json", timeout=5) as answer:
                return next(page["webSocketDebuggerUrl"] for page in json.load(answer) if page["type"] == "page")
        except (OSError, StopIteration, IndexError):
            assert time.monotonic() < end, "the browser did not come up"
            time.sleep(0.2)
