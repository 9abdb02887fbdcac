"""Memory of many worlds, from the arrays that they allocate: the same on each device."""

from __future__ import annotations

import gc
from collections.abc import Callable
from typing import Any


def array_memory(make: Callable[[], Any]) -> float:
    """Return the memory of the Warp arrays that `make` allocates and its result keeps, GB.

    A GPU needs in addition some 0.5 GB for its context and the compiled kernels.
    """
    gc.collect()
    before = _allocated()
    kept = make()
    gc.collect()
    found = _allocated() - before
    del kept
    return found


def _allocated() -> float:
    import warp as wp

    own = {
        item.ptr: item.capacity
        for item in gc.get_objects()
        if type(item) is wp.array and item.ptr and item._ref is None
    }
    return sum(own.values()) / 1e9
