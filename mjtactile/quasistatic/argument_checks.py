"""Argument checks of the quasi-static membrane: one-line errors that name the argument."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any

import numpy as np

from mjtactile.core.errors import InputError
from mjtactile.core.signature_checks import shown
from mjtactile.core.types import Array
from mjtactile.quasistatic.obstacles import Obstacle
from mjtactile.quasistatic.solution import MembraneSolution, MembraneSolutionBatch

_MIN_NODES = 5
_MAX_NODES = 400
_MAX_GAUGE = 1e6  # maximum gauge pressure, Pa


def grid(counts: Any) -> tuple[int, int]:
    """Return the numbers of nodes along x and y. Raises InputError."""
    try:
        found = tuple(int(count) for count in counts)
    except (TypeError, ValueError):
        found = ()
    if len(found) != 2 or not all(_MIN_NODES <= count <= _MAX_NODES for count in found):
        raise InputError(
            f"{counts} is not two numbers of nodes from {_MIN_NODES} to {_MAX_NODES}", field="grid"
        )
    return found[0], found[1]


def environments(obstacles: Any) -> list[Collection[Obstacle]]:
    """Return the obstacles of each environment, the same number in each. Raises InputError."""
    is_list = isinstance(obstacles, Iterable) and not isinstance(obstacles, str)
    every: list[Any] = list(obstacles) if is_list else [obstacles]
    listed: list[Any] = [
        (environment,) if isinstance(environment, Obstacle) else environment
        for environment in every
    ]
    if not is_list or not all(isinstance(environment, Collection) for environment in listed):
        raise InputError("must be a list of obstacles for each environment", field="obstacles")
    if len({len(environment) for environment in listed}) != 1:
        raise InputError("every environment needs the same number of obstacles", field="obstacles")
    return listed


def require_batch(field: str, batch: Any, shape: tuple[int, ...]) -> None:
    """Raise InputError if `batch` is not a batch with displacements of this shape."""
    if not isinstance(batch, MembraneSolutionBatch):
        raise InputError(f"{type(batch).__name__} is not a MembraneSolutionBatch", field=field)
    if batch.x.shape != shape:
        raise InputError(f"has shape {batch.x.shape}, not {shape}", field=field)


def require_state(state: Any, shape: tuple[int, ...]) -> None:
    """Raise InputError if `state` is not a solution with displacements of this shape."""
    if not isinstance(state, MembraneSolution):
        raise InputError(f"{type(state).__name__} is not a MembraneSolution", field="state")
    if state.x.shape != shape:
        raise InputError(
            f"belongs to a membrane with {state.x.shape[1:]} nodes, not {shape[1:]}", field="state"
        )


def thread_count(threads: Any, count: int) -> int:
    """Return the number of threads for `count` environments. Raises InputError."""
    return max(1, min(_whole_number("threads", threads), count))


def step_count(steps: Any) -> int:
    """Return a maximum number of steps. Raises InputError."""
    return _whole_number("max_steps", steps)


def flag(field: str, value: Any) -> bool:
    """Return True or False. Raises InputError."""
    if not isinstance(value, (bool, np.bool_)):
        raise InputError(f"{shown(value)} is not True or False", field=field)
    return bool(value)


def points(values: Any) -> Array:
    """Return points (n, 2). Raises InputError."""
    try:
        where = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{shown(values)} is not (n, 2) numbers", field="positions") from None
    if where.ndim == 0 or where.shape[-1] != 2:
        raise InputError(f"has shape {where.shape}, not (n, 2)", field="positions")
    if not np.isfinite(where).all():
        raise InputError("is not finite", field="positions")
    return where.reshape(-1, 2)


def _whole_number(field: str, value: Any) -> int:
    if not isinstance(value, (int, np.integer)) or value < 1:
        raise InputError(f"{shown(value)} is not a whole number of at least 1", field=field)
    return int(value)


def pressure(gauge: Any) -> float:
    """Return a valid gas pressure without contact, Pa above ambient. Raises InputError."""
    try:
        found = float(gauge)
    except (TypeError, ValueError):
        raise InputError(f"{gauge!r} is not a pressure in Pa", field="gauge_pressure") from None
    if not 0 < found < _MAX_GAUGE:
        raise InputError(f"{found:g} Pa must be above ambient", field="gauge_pressure")
    return found
