"""Execution of the episodes by joblib: processes of this machine or a cluster (decision 18)."""

from __future__ import annotations

import contextlib
import os
import time
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, cast

from mjtactile.core import process
from mjtactile.core.errors import DeviceError, InputError, Interrupted
from mjtactile.evaluate.episodes import Episode, run_episode
from mjtactile.evaluate.store import Store

PROCESSES = "processes"
DASK = "dask"
BACKENDS = (PROCESSES, DASK)
_CONNECT_TIME = 10.0  # timeout for the scheduler's reply, s

Notify = Callable[[str], None]
RunOne = Callable[[Episode], dict[str, Any]]


@dataclass(frozen=True)
class Pool:
    """`workers` processes here, or all of the dask cluster of `scheduler` ("tcp://host:8786")."""

    backend: str = PROCESSES
    workers: int = 1
    scheduler: str = ""

    def __post_init__(self) -> None:
        if self.backend not in BACKENDS:
            raise InputError(f"{self.backend!r} is unknown", field="--backend", choices=BACKENDS)
        if self.backend == PROCESSES and self.scheduler:
            choices = [f"--backend {DASK}"]
            raise InputError("applies to a cluster only", field="--scheduler", choices=choices)
        if self.backend == DASK and not self.scheduler:
            choices = [f"--backend {DASK} --scheduler tcp://HOST:8786"]
            message = "the address of the cluster is missing"
            raise InputError(message, field="--backend", choices=choices)

    @contextlib.contextmanager
    def open(self, maximum: int) -> Iterator[dict[str, Any]]:
        """Yield joblib's arguments for at most `maximum` jobs. Raises InputError."""
        if self.backend == DASK:
            with _dask(self.scheduler) as jobs:
                yield {"n_jobs": max(1, min(jobs, maximum)), "pre_dispatch": "2*n_jobs"}
        else:
            yield {"n_jobs": max(1, min(self.workers, maximum)), "pre_dispatch": "n_jobs"}


@dataclass(frozen=True)
class Running:
    """Execution settings of an evaluation.

    Args:
        workers: Processes of this machine (None: one per processor; one for an emulated rig).
        backend: Backend that runs the episodes, of `BACKENDS`.
        scheduler: Address of a cluster's scheduler.
        resume: True to continue from the results in the folder.
        notify: Callback that receives one line per episode.
        run_one: Function that computes an episode's line, in another process.
    """

    workers: int | None = None
    backend: str = PROCESSES
    scheduler: str = ""
    resume: bool = False
    notify: Notify = lambda _: None
    run_one: RunOne = run_episode


HERE = Running()
"""Default: one process per processor of this machine, without progress output."""


@contextlib.contextmanager
def _dask(scheduler: str) -> Iterator[int]:
    """Connect joblib to a scheduler, and yield the number of tasks that its workers run at once."""
    from joblib import parallel_config

    try:
        from distributed import Client
    except ImportError as error:
        message = f"needs pip install 'mjtactile[cluster]' ({error})"
        raise InputError(message, field="--backend") from error
    try:
        client = Client(scheduler, timeout=_CONNECT_TIME, set_as_default=True)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"no scheduler answers at {scheduler!r}", field="--scheduler") from error
    with client:
        by_worker: Any = client.nthreads()
        threads = sum(by_worker.values())
        if not threads:
            raise InputError(f"the cluster at {scheduler} has no workers", field="--scheduler")
        with parallel_config(backend=DASK):
            yield threads


def _line(episode: Episode, run: RunOne, parent: int | None = None) -> dict[str, Any] | None:
    """Return the line of one episode; None if its worker was stopped.

    A worker process ends with the process `parent`, even if that is killed.
    """
    if parent is not None and parent != os.getpid():
        _end_with(parent)
    try:
        return run(episode)
    except Interrupted:
        return None


@cache
def _end_with(parent: int) -> None:
    """End this process with its parent; called once per worker."""
    process.watch_parent(parent)


def _progress(line: dict[str, Any], done: int, of: int, rate: float) -> str:
    why = f" ({line['reason']})" if line["outcome"] == "error" and line["reason"] else ""
    seconds = (of - done) / rate
    left = f"{seconds / 60:.0f} min" if seconds > 90 else f"{seconds:.0f} s"
    return (
        f"{done} of {of}: {line['controller']}, {line['object']}, seed {line['seed']}: "
        f"{line['outcome']}{why}; {3600 * rate:.0f} per hour, {left} left"
    )


def run_all(
    missing: Sequence[Episode], kept: Store, pool: Pool, notify: Notify, run: RunOne = run_episode
) -> None:
    """Run the `missing` episodes and store each line, which `run` computes in another process.

    Raises InputError if the cluster is not reachable. Raises DeviceError if a worker was killed or
    stopped, or if the disk is full. Completed lines are kept.
    """
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    start = time.monotonic()
    # workers of a cluster are not children of this process
    parent = os.getpid() if pool.backend == PROCESSES else None
    try:
        with (
            warnings.catch_warnings(),
            pool.open(len(missing)) as manner,
            Parallel(return_as="generator_unordered", **manner) as jobs,
        ):
            # joblib's warning about an early end
            warnings.filterwarnings("ignore", ".*could benefit from adjusting", UserWarning)
            lines = cast(
                Generator[dict[str, Any] | None, None, None],
                jobs(delayed(_line)(episode, run, parent) for episode in missing),
            )
            with contextlib.closing(lines):
                for k, line in enumerate(lines, 1):
                    if line is None:
                        raise DeviceError("a worker was stopped; --resume continues")
                    kept.add(line)
                    notify(_progress(line, k, len(missing), k / (time.monotonic() - start)))
    except TerminatedWorkerError as error:
        raise DeviceError(
            f"a worker was killed ({' '.join(str(error).split())[:90]}…); --resume continues"
        ) from error
