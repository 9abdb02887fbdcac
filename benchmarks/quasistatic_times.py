"""Computing times of quasi-static membranes: single, in batches, by threads and by processes."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from mjtactile import Obstacle, QuasistaticMembrane
from mjtactile.core.types import Array

AT_ONCE = 64


BURSTS, BURSTS_QUICK = 20, 2
_SECONDS = 1.0  # duration of two concurrent processes, s
_STEPS = 10  # steps of a burst, each 0.05 mm deeper


def _bowl(numbers: Array) -> Obstacle:
    """Return a quadric obstacle of six parameters: position, two curvatures, rotation about z."""
    c, s = np.cos(numbers[5]), np.sin(numbers[5])
    rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    return QuasistaticMembrane.obstacle("quadric", (*numbers[3:5], 0.012), numbers[:3], rotation)


def _deeper(membrane: QuasistaticMembrane) -> list[Obstacle]:
    """Return spheres, each 0.05 mm deeper than the previous one."""
    heights = [0.0095 - 5e-5 * k for k in range(_STEPS + 1)]
    return [membrane.obstacle("sphere", (8e-3,), (0, 0, height)) for height in heights]


def times(grid: tuple[int, int], quick: bool) -> dict[str, Any]:
    """Measure the minimum times, us, of single steps and of batches.

    A step is 0.05 mm deeper and starts from the previous one.
    """
    bursts = BURSTS_QUICK if quick else BURSTS
    membrane = QuasistaticMembrane("dense", grid, 1000.0)
    balls = _deeper(membrane)
    start = membrane.solve(balls[0])
    best = {trend: np.full(_STEPS, np.inf) for trend in (True, False)}
    steps = 0
    for _ in range(bursts):
        for trend, minimum in best.items():
            state = start
            for k, one in enumerate(balls[1:]):
                clock_start = time.perf_counter()
                state = membrane.solve(one, state if trend else replace(state, trend=None))
                minimum[k] = min(minimum[k], time.perf_counter() - clock_start)
                steps = max(steps, state.steps)
    derived = np.inf
    posed = np.inf
    numbers = np.array([1e-3, 0.0, 1.5e-3, 120.0, 60.0, 0.1])
    pressed = membrane.solve(_bowl(numbers))
    for _ in range(bursts):
        start = time.perf_counter()
        membrane.derivatives(pressed, _bowl, numbers)
        between = time.perf_counter()
        membrane.derivatives_by_pose(pressed)
        derived = min(derived, between - start)
        posed = min(posed, time.perf_counter() - between)
    rates = {
        f"{size}, {threads}": _rate(membrane, balls, size, threads, bursts)
        for size, threads in ((1, 1), (8, 1), (AT_ONCE, 1), (256, 1), (AT_ONCE, 2))
    }
    return {"grid": list(grid), "step_us": 1e6 * float(np.median(best[True])),
            "alone_us": 1e6 * float(np.median(best[False])), "max_steps": steps,
            "derivatives_us": 1e6 * derived, "by_pose_us": 1e6 * posed, "batch_per_s": rates,
            "ceiling": _ceiling(grid, _SECONDS * bursts / BURSTS)}  # fmt: skip


def _rate(
    membrane: QuasistaticMembrane, balls: list[Obstacle], size: int, threads: int, bursts: int
) -> float:
    """Return the solutions per second of a batch of `size` membranes in equilibrium."""
    solve = _at_rest(membrane, balls, size, threads)
    return size / min(solve() for _ in range(bursts))


def _at_rest(
    membrane: QuasistaticMembrane, balls: list[Obstacle], size: int, threads: int
) -> Callable[[], float]:
    """Return a function that times, s, a batch of `size` membranes from their equilibrium."""
    many = [[balls[k % 8]] for k in range(size)]
    batch = membrane.solve_batch(many)
    spare, batch = batch, membrane.solve_batch(many, batch)

    def solve() -> float:
        start = time.perf_counter()
        membrane.solve_batch(many, batch, threads=threads, into=spare)
        return time.perf_counter() - start

    return solve


def _ceiling(grid: tuple[int, int], seconds: float) -> float:
    """Measure the maximum gain of a second processor: the rate of two processes over that of one.

    The processes share no data. Two threads cannot be faster: processors share caches and memory,
    if not more.
    """
    context = multiprocessing.get_context("spawn")
    rates = {}
    for count in (1, 2):
        together = context.Barrier(count)
        found: Any = context.SimpleQueue()
        given = (grid, seconds, together, found)
        workers = [context.Process(target=_alone, args=given) for _ in range(count)]
        for worker in workers:
            worker.start()
        rates[count] = sum(found.get() for _ in workers)
        for worker in workers:
            worker.join()
    return rates[2] / rates[1]


def _alone(grid: tuple[int, int], seconds: float, together: Any, found: Any) -> None:
    """Measure the maximum rate of a batch in one thread, as a separate process.

    The time starts when all processes are `together`.
    """
    membrane = QuasistaticMembrane("dense", grid, 1000.0)
    solve = _at_rest(membrane, _deeper(membrane), AT_ONCE, 1)
    together.wait()
    end = time.perf_counter() + seconds
    minimum = np.inf
    while time.perf_counter() < end:
        minimum = min(minimum, solve())
    found.put(AT_ONCE / minimum)
