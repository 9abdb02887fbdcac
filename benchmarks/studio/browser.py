"""Page of headless Chromium with all WebGL drawing disabled.

Without a graphics card, drawing takes seconds per frame, which is unrelated to Studio. The page
keeps to 30 frames per second, since it shares the processors with the session. It records the time
at which the image of each cycle arrived.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from websockets.sync.client import connect

from benchmarks.studio.chromium import CHROMIUM, FLAGS, page_address
from benchmarks.studio.probe import MARK

_LIMIT = 60.0  # time limit for the start of the page, s
_SCRIPT = """(() => {
    const context = WebGL2RenderingContext.prototype;
    const drawing = [
        "clear", "clearBufferfi", "clearBufferfv", "clearBufferiv", "clearBufferuiv",
        "drawArrays", "drawArraysInstanced", "drawElements", "drawElementsInstanced",
        "drawRangeElements", "blitFramebuffer", "invalidateFramebuffer",
    ];
    for (const name of drawing) context[name] = () => {};
    const soon = window.requestAnimationFrame.bind(window);
    let last = 0;
    window.requestAnimationFrame = one => {
        const call = time => { last = performance.now(); one(time); };
        return setTimeout(() => soon(call), Math.max(0, last + 25 - performance.now()));
    };
    window.images = [];
    for (const name of ["texImage2D", "texSubImage2D"]) {
        const real = context[name];
        context[name] = function (...all) {
            const k = all.findIndex(ArrayBuffer.isView), at = all[k + 1] || 0;
            if (k >= 0 && all.includes(320) && all.includes(240) && all[k][at + 2] === MARK)
                window.images.push([all[k][at] + 256 * all[k][at + 1], Date.now()]);
            return real.apply(this, all);
        };
    }
})()""".replace("MARK", str(MARK))


@contextlib.contextmanager
def check_image(url: str, folder: Path) -> Iterator[Callable[[], list[tuple[int, float]]]]:
    """Open a page with `url`.

    Yield a function that returns the cycles whose images arrived, and their clock times, s.
    """
    assert CHROMIUM is not None
    process = subprocess.Popen(
        [CHROMIUM, *FLAGS, f"--user-data-dir={folder}", "about:blank"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        with connect(page_address(folder, _LIMIT), max_size=None) as socket:
            numbers = itertools.count(1)

            def ask(method: str, **params: Any) -> Any:
                number = next(numbers)
                socket.send(json.dumps({"id": number, "method": method, "params": params}))
                while (answer := json.loads(socket.recv())).get("id") != number:
                    pass
                return answer["result"]

            ask("Page.enable")
            ask("Page.addScriptToEvaluateOnNewDocument", source=_SCRIPT)
            ask("Page.navigate", url=url)
            yield lambda: [
                (int(n), 1e-3 * ms)
                for n, ms in ask(
                    "Runtime.evaluate", expression="window.images", returnByValue=True
                )["result"]["value"]
            ]
    finally:
        process.kill()
        process.wait()
