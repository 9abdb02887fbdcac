"""Arrays and structs on a device from values on the host."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp


def floats(values: Any) -> Any:
    """Return an array of Warp in single precision."""
    return wp.array(np.ascontiguousarray(values, np.float32), dtype=float)


def ints(values: Any) -> Any:
    """Return a one-dimensional array of Warp of integers."""
    return wp.array(np.asarray(values, np.int32).reshape(-1), dtype=int)


def vectors(values: Any) -> Any:
    """Return an array of Warp of vectors of three."""
    return wp.array(np.ascontiguousarray(values, np.float32), dtype=wp.vec3)


def zeros_of(struct: Any, count: int, **columns: int) -> Any:
    """Return a struct of Warp whose arrays have `count` rows, and `columns` where named."""
    found = struct()
    for name, variable in struct.vars.items():
        shape = (count, columns[name]) if name in columns else count
        setattr(found, name, wp.zeros(shape, dtype=variable.type.dtype))
    return found
