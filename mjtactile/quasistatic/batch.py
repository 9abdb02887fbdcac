"""Batches of quasi-static membranes: their memory, and threads that process them in parallel."""

from __future__ import annotations

import os
from collections.abc import Callable
from queue import SimpleQueue
from threading import Thread

import numpy as np

from mjtactile.quasistatic.solution import FOUND, MembraneSolutionBatch


def run_in_threads(threads: int, work: Callable[[int], object]) -> None:
    """Call `work(k)` in `threads` threads, including this one, with k from 0 on."""
    done: SimpleQueue[BaseException | None] = SimpleQueue()
    orders = _work_queue(os.getpid(), threads - 1)
    for thread_index in range(1, threads):
        orders.put((work, thread_index, done))
    try:
        work(0)
    finally:
        failures = [done.get() for _ in range(1, threads)]
    for failure in failures:
        if failure is not None:
            raise failure


def new_batch(count: int, grid: tuple[int, int]) -> MembraneSolutionBatch:
    """Allocate uninitialized memory for `count` states."""
    x, trend = (np.empty((count, parts, *grid)) for parts in (3, 4))
    return MembraneSolutionBatch(x, np.empty((count, *grid)), np.empty((count, FOUND)), trend)


_Order = tuple[Callable[[int], object], int, "SimpleQueue[BaseException | None]"]
_kept: dict[int, tuple[SimpleQueue[_Order], list[Thread]]] = {}


def _work_queue(process: int, count: int) -> SimpleQueue[_Order]:
    """Return the work queue of a process, with at least `count` waiting threads that stay alive."""
    if process not in _kept:
        _kept[process] = SimpleQueue(), []
    orders, threads = _kept[process]
    while len(threads) < count:
        name = f"membrane-{process}-{len(threads)}"
        threads.append(Thread(target=_run_work, args=(orders,), name=name, daemon=True))
        threads[-1].start()
    return orders


def _run_work(orders: SimpleQueue[_Order]) -> None:
    while True:
        work, order, done = orders.get()
        failure = None
        try:
            work(order)
        except BaseException as error:  # noqa: BLE001 - the caller raises it
            failure = error
        done.put(failure)
        del work, done, failure  # release all references until the next item arrives
