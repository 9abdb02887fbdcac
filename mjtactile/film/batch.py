"""Films of several environments at once: where they begin, and the threads that share them out."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numpy as np

from mjtactile.film.state import FOUND, FilmBatch, FilmState

_SHARES = 4  # of a batch that a thread takes, one after the other


def share_out(count: int, threads: int, solve: Callable[[int, slice], None]) -> None:
    """Have `solve(thread, part)` called for parts that together are `count` environments.

    Args:
        count: Of environments.
        threads: That take parts as they come to it, this one among them.
        solve: Without Python's lock for most of its time.
    """
    size = count if threads == 1 else -(-count // (_SHARES * threads))
    firsts = iter(range(0, count, size))  # its `next` is one step of the interpreter

    def some(number: int) -> None:
        for first in firsts:
            solve(number, slice(first, min(first + size, count)))

    others = [_workers(os.getpid()).submit(some, number) for number in range(1, threads)]
    try:
        some(0)
    finally:
        for other in others:
            other.result()


def new_batch(count: int, grid: tuple[int, int]) -> FilmBatch:
    """Memory for `count` states, with nothing in it yet."""
    x, trend = (np.empty((count, parts, *grid)) for parts in (3, 4))
    return FilmBatch(x, np.empty((count, *grid)), np.empty((count, FOUND)), trend)


def begin(made: FilmBatch, batch: FilmBatch | None, rest: FilmState, part: slice) -> None:
    """Write where environments `part` of `made` begin: at `batch`, or, where that is none, at rest.

    In the thread that goes on with them: memory that is new costs as much as a fifth of a solution.
    """
    assert made.trend is not None
    if batch is None:
        made.x[part], made.force[part], made.trend[part] = rest.x, rest.force, 0.0
        return
    if made is not batch:
        made.x[part], made.force[part] = batch.x[part], batch.force[part]
        made.trend[part] = 0.0 if batch.trend is None else batch.trend[part]
    lost = np.flatnonzero(~batch.converged[part]) + part.start
    made.x[lost], made.force[lost], made.trend[lost] = rest.x, rest.force, 0.0


@cache
def _workers(process: int) -> ThreadPoolExecutor:
    """Threads that stay for the next batch, of this process; a forked one has none of another's."""
    return ThreadPoolExecutor(os.cpu_count() or 1, thread_name_prefix=f"film-{process}")
