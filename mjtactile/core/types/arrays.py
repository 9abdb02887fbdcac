"""Arrays and statuses of frozen values: read-only, of the shape that they say."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjtactile.core.errors import InputError
from mjtactile.core.status import Status

Array = NDArray[Any]  # of float64; numpy's stubs cannot follow dtypes through arithmetic


def keep_status(owner: Any) -> None:
    """Give the frozen dataclass `owner` a status with a code, whatever text it was made with."""
    object.__setattr__(owner, "status", Status.of(owner.status))


def freeze(
    owner: object, name: str, value: ArrayLike, shape: tuple[int | None, ...], dtype: Any = float
) -> NDArray:
    """Store `value` on the frozen dataclass `owner` as a read-only array of the given shape (None:
    any length)."""
    array = np.asarray(value, dtype=dtype)
    if array.shape != shape and (
        array.ndim != len(shape)
        or any(want not in (None, got) for want, got in zip(shape, array.shape, strict=True))
    ):
        raise InputError(
            f"shape {array.shape} does not match {shape}", source=type(owner).__name__, field=name
        )
    if array.flags.writeable:
        array = array.copy()
        array.setflags(write=False)
    object.__setattr__(owner, name, array)
    return array
