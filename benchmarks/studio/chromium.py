"""Headless Chromium, whose page is inspected through the DevTools protocol."""

from __future__ import annotations

import json
import shutil
import time
import urllib.request
from pathlib import Path

CHROMIUM = next(
    (
        path
        for name in ("chromium", "chromium-browser", "google-chrome")
        if (path := shutil.which(name))
    ),
    None,
)
FLAGS = (
    "--headless=new",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--no-sandbox",
    "--window-size=1280,800",
    "--remote-allow-origins=*",
    "--remote-debugging-port=0",
    "--no-first-run",
    "--disable-sync",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-default-apps",
    "--disable-extensions",
    "--disable-gpu-rasterization",
)


def page_address(folder: Path, limit: float) -> str:
    """Return the page's own socket.

    Wait at most `limit`, s, for the browser, whose profile is in `folder`.
    """
    end = time.monotonic() + limit
    while True:
        try:
            port = (folder / "DevToolsActivePort").read_text(encoding="utf-8").splitlines()[0]
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/json", timeout=5) as answer:
                return next(
                    page["webSocketDebuggerUrl"]
                    for page in json.load(answer)
                    if page["type"] == "page"
                )
        except (OSError, StopIteration, IndexError):
            if time.monotonic() > end:
                raise
            time.sleep(0.2)
