"""One timed grasp of an egg: a script for any checkout of mjtactile that prints a line of JSON.

Usage: `PYTHONPATH=CHECKOUT python probe.py RATE core|wall`. With "core" it prints the core time of
an image, a rendering and a step by phase, all in one thread. (In the loop, world and perception
have separate processes and do not wait for each other's interpreter.) The first two are also timed
alone, repeatedly, with the last image of the hold. With "wall" it prints the ratio of simulated to
wall time of the unchanged loop. It uses only names that old checkouts have as well.
"""

from __future__ import annotations

import json
import sys
import time
from collections import defaultdict
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import Any

SEED = 0
OBJECT = "egg"
ALONE = "alone, held"
TOUCHING = ("regulate", "lift", "hold", "lower")  # phases from the first touch to the release


def main(rate: float, kind: str) -> dict[str, Any]:
    process_start = time.process_time(), time.perf_counter()
    from mjtactile.core.design import load_sensor
    from mjtactile.runtime.controller import load_controller
    from mjtactile.runtime.session import open_session
    from mjtactile.sensing.stateful_pipeline import StatefulPipeline
    from mjtactile.sim.camera import SimCamera
    from mjtactile.sim.rig import SimClock
    from mjtactile.sim.scenes.world import World

    imported = time.perf_counter() - process_start[1]
    design = load_sensor("dense")
    design = replace(design, camera=replace(design.camera, rate=rate))
    phase = ["references"]
    spent: dict[tuple[str, str], list[float]] = defaultdict(list)
    # last call of each kind in the hold, with its arguments
    last: dict[str, tuple[Any, ...]] = {}

    def timed(owner: Any, name: str, operation: str) -> None:
        inner = getattr(owner, name)

        def outer(self: Any, *args: Any) -> Any:
            if phase[0] == "hold":
                last[operation] = (inner, self, *args)
            start = time.thread_time()
            try:
                return inner(self, *args)
            finally:
                count = args[0] if operation == "a step" and args else 1
                spent[operation, phase[0]].append((time.thread_time() - start) / count)

        setattr(owner, name, outer)

    if kind == "core":
        timed(StatefulPipeline, "perceive", "image to touch")
        timed(SimCamera, "capture", "rendering an image")
        timed(World, "step", "a step")
        # an older checkout has it in another file
        clocks = sys.modules[SimClock.__module__]
        clocks.ThreadPoolExecutor = _InlineExecutor  # type: ignore[attr-defined]
    moments: list[tuple[str, float, float]] = []

    def on_cycle(cycle: Any) -> None:
        phase[0] = cycle.sent.phase
        moments.append((cycle.sent.phase, cycle.time, time.perf_counter()))

    with open_session(
        "sim", design, object_name=OBJECT, seed=SEED, workers=0 if kind == "core" else None
    ) as session:
        start = time.perf_counter()
        session.take_references()
        referenced = time.perf_counter() - start
        core = time.process_time()
        session.run(load_controller("gentle"), time_limit=60.0, on_cycle=on_cycle)
        core = time.process_time() - core
        for operation in last.keys() - {"a step"}:  # the world has moved on
            spent[operation, ALONE] = _alone(*last[operation])
    rows = {
        operation: {
            name: 1e3 * sorted(values)[len(values) // 2]
            for (kind_, name), values in spent.items()
            if kind_ == operation
        }
        for operation in {operation for operation, _ in spent}
    }
    return {
        "core_ms": rows,
        "factors": _factors(moments),
        "import_s": imported,
        "references_s": referenced,
        "core_s_per_s": core / (moments[-1][1] - moments[0][1]),
    }


class _InlineExecutor(ThreadPoolExecutor):
    """Executor that runs its tasks in the caller's thread."""

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        done: Future[Any] = Future()
        done.set_result(fn(*args, **kwargs))
        return done


def _alone(call: Any, *args: Any) -> list[float]:
    """Return the core time, s: the minimum of five bursts of ten calls."""
    bursts = []
    for _ in range(5):
        start = time.thread_time()
        for _ in range(10):
            call(*args)
        bursts.append((time.thread_time() - start) / 10)
    return [min(bursts)]


def _factors(moments: list[tuple[str, float, float]]) -> dict[str, float]:
    """Return the ratio of simulated to wall time in each phase from touch to release, and of
    all."""
    simulated: dict[str, float] = defaultdict(float)
    wall: dict[str, float] = defaultdict(float)
    for (_, t0, w0), (phase, t1, w1) in zip(moments, moments[1:], strict=False):
        for name in (phase, *(["touch to release"] if phase in TOUCHING else []), "all"):
            simulated[name] += t1 - t0
            wall[name] += w1 - w0
    return {name: simulated[name] / wall[name] for name in simulated}


if __name__ == "__main__":
    sys.stdout.write(json.dumps(main(float(sys.argv[1]), sys.argv[2])) + "\n")
