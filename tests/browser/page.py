"""Headless Chromium controlled by its DevTools protocol: a page and its screenshots.

Without a graphics card a frame of a 3-D scene takes seconds of all processors. A page would draw
continuously and block all other work. A `sparing` page therefore draws only for screenshots, and is
otherwise unchanged.
"""

import base64
import contextlib
import itertools
import json
import subprocess
import time

import cv2
import numpy as np
from websockets.sync.client import connect

from benchmarks.studio.chromium import CHROMIUM, FLAGS, page_address

LIMIT = 180  # time limit of any wait, s, for a computer with other load
_SPARING = """(() => {
    let drawing = false;
    window.toDraw = 0;
    for (const name of ["clear", "clearBufferfi", "clearBufferfv", "clearBufferiv", "clearBufferuiv", "drawArrays",
                        "drawArraysInstanced", "drawElements", "drawElementsInstanced", "drawRangeElements", "blitFramebuffer",
                        "invalidateFramebuffer"]) {
        const real = WebGL2RenderingContext.prototype[name];
        WebGL2RenderingContext.prototype[name] = function (...all) { if (drawing) return real.apply(this, all); };
    }
    const soon = window.requestAnimationFrame.bind(window);
    window.requestAnimationFrame = one => setTimeout(() => soon(time => {
        drawing = window.toDraw > 0;
        try { return one(time); } finally { window.toDraw -= drawing; drawing = false; }
    }), 60);
})()"""


class Page:
    """Page of the browser, with its inputs and screenshots."""

    def __init__(self, socket, *, sparing=False):
        self._socket = socket
        self._numbers = itertools.count(1)
        self._sparing = sparing

    def open(self, url):
        if self._sparing:
            self._ask("Page.enable")
            self._ask("Page.addScriptToEvaluateOnNewDocument", source=_SPARING)
        assert not self._ask("Page.navigate", url=url).get("errorText"), url

    def _ask(self, method, **params):
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": params}))
        while (answer := json.loads(self._socket.recv(timeout=LIMIT))).get("id") != number:
            pass
        return answer["result"]

    def run(self, script):
        """Return the value of a JavaScript expression in the page."""
        answer = self._ask("Runtime.evaluate", expression=script, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def wait_for(self, script, limit=LIMIT):
        """Wait until an expression is true in the page."""
        end = time.monotonic() + limit
        while not self.run(script):
            assert time.monotonic() < end, f"never: {script}"
            time.sleep(0.1)

    def image(self):
        """Return a screenshot, blue, green, red (h, w, 3), of the page's size in px."""
        if self._sparing:
            self.run("window.toDraw = 1")
            self.wait_for("window.toDraw === 0")
        png = base64.b64decode(self._ask("Page.captureScreenshot", format="png")["data"])
        size = self.run("[window.innerWidth, window.innerHeight]")
        shot = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
        return (
            shot
            if [shot.shape[1], shot.shape[0]] == size
            else cv2.resize(shot, size, interpolation=cv2.INTER_NEAREST)
        )

    def mouse(self, kind, x, y, **more):
        """Send one mouse event, such as mouseMoved with buttons=1, or mouseWheel with deltaY px."""
        self._ask(
            "Input.dispatchMouseEvent",
            type=kind,
            x=x,
            y=y,
            **{"button": "left", "clickCount": 1} | more,
        )


@contextlib.contextmanager
def open_page(url, folder, until=None, *, sparing=False, scale=1.0):
    """Yield a `Page` with `url` in its own browser, after the server has written its address into
    the file `until`. `scale` px are drawn, along each side, for each px of the page's size."""
    command = [
        CHROMIUM,
        *FLAGS,
        f"--force-device-scale-factor={scale}",
        f"--user-data-dir={folder}",
        "about:blank",
    ]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        with connect(page_address(folder, LIMIT), max_size=None) as socket:
            end = time.monotonic() + LIMIT
            while until is not None and "inflated" not in until.read_text():
                assert time.monotonic() < end, until.read_text()
                time.sleep(0.1)
            page = Page(socket, sparing=sparing)
            page.open(url)
            yield page
    finally:
        process.kill()
        process.wait()
