"""`mjtactile bench studio`: a grasp watched in Studio against the same grasp without it, in turns.

The page runs in headless Chromium on the same processors, without rendering.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from benchmarks.studio.browser import CHROMIUM, check_image
from mjtactile.core import platform_support
from mjtactile.core.errors import InputError
from mjtactile.runtime.progress import Progress

ROUNDS = 3
_FIRST = 3  # the first cycles wait for the page
_ADDRESS = re.compile(r"http://localhost:\d+/")

Notify = Callable[[str], None]


def run(out: Path, *, quick: bool = False, notify: Notify | None = None) -> dict[str, Any]:
    """Measure each round: speeds, time on the session thread, and age of the images.

    The time is in ms per cycle. The age, ms, is that on arrival in the page's frame.

    Raises:
        InputError: Chromium is not installed.
    """
    notify = notify or Progress().message
    if CHROMIUM is None:
        raise InputError(
            "Chromium is not installed: apt-get install chromium", field="bench studio"
        )
    rounds = []
    for k in range(1 if quick else ROUNDS):
        without = _probe("plain")
        watched = _probe("studio")
        rounds.append(
            {
                "without": without["factor"],
                "core_without_s": without["core_s"],
                **watched,
                "ratio": watched["factor"] / without["factor"],
                "load": os.getloadavg()[0],
            }
        )
        notify(
            f"round {k + 1}: {watched['factor']:.2f} x real time, without Studio "
            f"{without['factor']:.2f}"
        )
    return {"rounds": rounds, "processors": platform_support.processors()}


def _probe(kind: str) -> dict[str, Any]:
    """Run one grasp in a separate process; with "studio" a page is open."""
    command = [sys.executable, "-m", "benchmarks.studio.probe", kind]
    arrivals = None
    last = ""
    with (
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as home,
        contextlib.ExitStack() as stack,
    ):
        process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env={**os.environ, "HOME": home, "OPENBLAS_NUM_THREADS": "1"},
        )
        stack.callback(process.wait)
        stack.callback(process.kill)
        assert process.stdout is not None
        for line in process.stdout:
            last = line
            if arrivals is None and (found := _ADDRESS.search(line)):
                arrivals = stack.enter_context(check_image(found.group(), Path(home) / "page"))
        if not last.startswith("{"):
            raise InputError(f"the grasp ended with {last!r}", field="bench studio")
        result = json.loads(last)
        return result if arrivals is None else {**result, **ages(result["taken"], arrivals())}


def ages(taken: list[float], arrived: list[tuple[int, float]]) -> dict[str, Any]:
    """Compute the age of images when they reached the page, ms.

    `taken`: times, s, of the images; `arrived`: pairs of cycle and time, s.
    """
    first: dict[int, float] = {}
    for number, when in arrived:
        first.setdefault(number, when)
    late = sorted(
        1e3 * (when - taken[number])
        for number, when in first.items()
        if _FIRST <= number < len(taken)
    )
    if not late:
        raise InputError("the page got no image", field="bench studio")
    return {
        "pictures": len(late),
        "late_ms": statistics.median(late),
        "late_90_ms": late[int(0.9 * (len(late) - 1))],
    }


def table(result: Mapping[str, Any]) -> str:
    """Format the result as a Markdown table."""
    rounds = result["rounds"]

    def median(name: str) -> float:
        return statistics.median(round_[name] for round_ in rounds)

    return "\n".join(
        [
            "| quantity | required | target | measured |",
            "|---|---|---|---|",
            f"| speed with Studio / speed without | at least 0.7 | 0.9 | {median('ratio'):.2f} |",
            "| core time per simulated second, s: with Studio (without the web page); without "
            f"Studio |  |  | {median('core_s'):.2f}, {median('core_without_s'):.2f} |",
            "| time of Studio on the session thread, ms per cycle | less than 1 |  | "
            f"{median('spent_ms'):.2f} |",
            "| age of an image when the page shows it, median (90 %), ms | less than 150 | 80 "
            f"| {median('late_ms'):.0f} ({median('late_90_ms'):.0f}) |",
            "",
            f"Medians of {len(rounds)} egg grasps with and without Studio, alternating; "
            f"{result['processors']} processors, load average {median('load'):.1f}, at least "
            f"{min(round_['pictures'] for round_ in rounds)} images. The page runs in headless "
            "Chromium on the same processors, at most 30 frames per second, without drawing.",
            "",
        ]
    )
