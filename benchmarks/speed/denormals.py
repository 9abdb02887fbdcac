"""Denormal numbers in the arrays that a sensor's chain and camera keep from image to image.

A matrix product with many of them takes up to twenty times as long on some processors. On others it
does not, so that a timing test cannot detect them. They occurred in the renderer's tables and in
the prior.
"""

from __future__ import annotations

import gc
from typing import Any

import numpy as np


def count(*roots: Any) -> int:
    """Count denormal numbers in all float arrays that `roots` refer to.

    References through other objects of this package are followed.
    """
    found = 0
    visited = set()
    waiting = list(roots)
    while waiting:
        item = waiting.pop()
        if id(item) in visited:
            continue
        visited.add(id(item))
        if isinstance(item, np.ndarray):
            found += _denormal(item)
        elif isinstance(item, (list, tuple, dict)) or type(item).__module__.startswith(
            "mjtactile."
        ):
            waiting += gc.get_referents(item)
    return found


def _denormal(array: np.ndarray) -> int:
    if array.dtype.kind != "f":
        return 0
    size = np.abs(array)
    return int(np.count_nonzero((size > 0) & (size < np.finfo(array.dtype).tiny)))
