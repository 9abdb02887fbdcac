"""Difference quotients of wrenches."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def store_difference(
    start: wp.array2d(dtype=float),
    end: wp.array2d(dtype=float),
    column: int,
    step: float,
    to: wp.array3d(dtype=float),
):
    f, row = wp.tid()
    to[f, row, column] = (end[f, row] - start[f, row]) / step
