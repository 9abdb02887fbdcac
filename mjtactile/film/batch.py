"""Films of several environments at once: their memory, and the threads that share them out."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numpy as np

from mjtactile.film.state import FOUND, FilmBatch


def at_once(threads: int, work: Callable[[int], object]) -> None:
    """Have `work(k)` called in `threads` threads, this one among them, k from 0 on.

    Args:
        threads: How many.
        work: Takes what is left to do, without Python's lock for most of its time.
    """
    others = [_workers(os.getpid()).submit(work, number) for number in range(1, threads)]
    try:
        work(0)
    finally:
        for other in others:
            other.result()


def new_batch(count: int, grid: tuple[int, int]) -> FilmBatch:
    """Memory for `count` states, with nothing in it yet."""
    x, trend = (np.empty((count, parts, *grid)) for parts in (3, 4))
    return FilmBatch(x, np.empty((count, *grid)), np.empty((count, FOUND)), trend)


@cache
def _workers(process: int) -> ThreadPoolExecutor:
    """Threads that stay for the next batch, of this process; a forked one has none of another's."""
    return ThreadPoolExecutor(os.cpu_count() or 1, thread_name_prefix=f"film-{process}")
