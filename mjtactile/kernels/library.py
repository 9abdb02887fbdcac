"""C functions as Python ones, by their declarations in `kernels.h`: arrays are checked and handed over by address."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from mjtactile.kernels import build

_NUMBERS = {"double": ctypes.c_double, "int64_t": ctypes.c_int64}
_ARRAYS = {"double": np.dtype("<f8"), "float": np.dtype("<f4"), "int64_t": np.dtype("<i8"), "int32_t": np.dtype("<i4"),
           "uint8_t": np.dtype("|u1")}
_DECLARATION = re.compile(r"^(int64_t|double|void) (\w+)\(([^)]*)\);", re.M)
_ARGUMENT = re.compile(r"(const )?(\w+) (\*?)(\w+)$")


def kernel(name: str) -> Callable[..., Any]:
    """The C function `name`. What it only reads is converted to arrays of its types, if need be; what it writes must be
    C-contiguous arrays of them (None: NULL), else TypeError is raised. Lengths are for the caller to know.

    Other processes and threads run on while it does: it needs no Python.
    """
    return _library()[name]


@cache
def _library() -> dict[str, Callable[..., Any]]:
    loaded = ctypes.CDLL(str(build.library()))
    return {name: _wrapped(getattr(loaded, name), name, result, arguments)
            for result, name, arguments in _DECLARATION.findall((build.FOLDER / "kernels.h").read_text())}


def _wrapped(function: Any, name: str, result: str, arguments: str) -> Callable[..., Any]:
    parts = [_ARGUMENT.search(" ".join(part.split())).groups() for part in arguments.split(",")]  # type: ignore[union-attr]
    function.restype = _NUMBERS.get(result)
    function.argtypes = [ctypes.c_void_p if star else _NUMBERS[kind] for _, kind, star, _ in parts]
    convert = [(_read if const else _written)(f"{name}: {what}", _ARRAYS[kind]) if star else _as_is
               for const, kind, star, what in parts]

    def call(*values: Any) -> Any:
        held = [one(value) for one, value in zip(convert, values, strict=True)]
        return function(*[value.ctypes.data if isinstance(value, np.ndarray) else value for value in held])

    return call


def _as_is(value: Any) -> Any:
    return value


def _read(_: str, dtype: np.dtype) -> Callable[[Any], Any]:
    return lambda value: None if value is None else np.ascontiguousarray(value, dtype)


def _written(what: str, dtype: np.dtype) -> Callable[[Any], Any]:
    def check(value: np.ndarray | None) -> np.ndarray | None:
        if value is None or (value.dtype == dtype and value.flags.c_contiguous and value.flags.writeable):
            return value
        raise TypeError(f"{what} must be a writable C-contiguous array of {dtype}")

    return check
