"""Arrays and statuses of frozen values: read-only, with checked shapes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjtactile.core.errors import InputError
from mjtactile.core.status import Status

Array = NDArray[Any]  # of float64; numpy's stubs cannot follow dtypes through arithmetic


def fixed(array: NDArray) -> NDArray:
    """Make `array` read-only, so that values may share it, and return it."""
    array.setflags(write=False)
    return array


def keep_status(owner: Any) -> None:
    """Convert the status of the frozen dataclass `owner` to one with a code."""
    object.__setattr__(owner, "status", Status.of(owner.status))


def _converted(owner: object, name: str, value: ArrayLike, dtype: Any) -> NDArray:
    """Convert a value to an array. Raises InputError if it is none."""
    try:
        with np.errstate(invalid="ignore"):
            return np.asarray(value, dtype=dtype)
    except (TypeError, ValueError, OverflowError):
        text = f"{type(value).__name__} is not an array of {np.dtype(dtype).name} values"
        raise InputError(text, source=type(owner).__name__, field=name) from None


def freeze(
    owner: object, name: str, value: ArrayLike, shape: tuple[int | None, ...], dtype: Any = float
) -> NDArray:
    """Store `value` on the frozen dataclass `owner` as a read-only array of the given shape (None:
    any length)."""
    if type(value) is np.ndarray and value.dtype == dtype:
        array = value
    else:
        array = _converted(owner, name, value, dtype)
    if array.dtype.kind in "iu" and array is not value and not np.array_equal(array, value):
        limits = np.iinfo(array.dtype)
        text = f"a value is not a whole number from {limits.min} to {limits.max}"
        raise InputError(text, source=type(owner).__name__, field=name)
    if array.shape != shape and not _fits(array.shape, shape):
        raise InputError(
            f"shape {array.shape} does not match {shape}", source=type(owner).__name__, field=name
        )
    if array.flags.writeable:
        array = array.copy()
        array.setflags(write=False)
    object.__setattr__(owner, name, array)
    return array


def _fits(got: tuple[int, ...], shape: tuple[int | None, ...]) -> bool:
    if len(got) != len(shape):
        return False
    for have, expected in zip(got, shape, strict=True):  # a generator takes twice as long
        if expected is not None and expected != have:
            return False
    return True
