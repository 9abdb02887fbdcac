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
    return _library()[name][0]


def bound(name: str, *values: Any) -> Callable[..., Any]:
    """The C function `name` on these very arrays and numbers, for a call that comes again and again: they are checked now, and
    kept. For each `...` among them a value is given at every call. Raises TypeError for an array that would have to be converted.
    """
    function, convert = _library()[name][1:]
    kept = [_same(one(value), value, name) if value is not ... else None for one, value in zip(convert, values, strict=True)]
    given = [(place, convert[place]) for place, value in enumerate(values) if value is ...]
    addresses = [_address(value) for value in kept]

    def call(*now: Any) -> Any:
        held = [one(value) for (_, one), value in zip(given, now, strict=True)]
        arguments = addresses.copy()
        for (place, _), value in zip(given, held, strict=True):
            arguments[place] = _address(value)
        return function(*arguments)

    call.kept = kept  # type: ignore[attr-defined]  # else nobody may
    return call


@cache
def _library() -> dict[str, tuple[Callable[..., Any], Any, list[Callable[[Any], Any]]]]:
    """Of each kernel: its Python face, the C function, and what checks or converts each argument."""
    loaded = ctypes.CDLL(str(build.library()))
    return {name: _wrapped(getattr(loaded, name), name, result, arguments)
            for result, name, arguments in _DECLARATION.findall((build.FOLDER / "kernels.h").read_text())}


def _wrapped(function: Any, name: str, result: str, arguments: str) -> tuple[Callable[..., Any], Any, list[Any]]:
    parts = [_ARGUMENT.search(" ".join(part.split())).groups() for part in arguments.split(",")]  # type: ignore[union-attr]
    function.restype = _NUMBERS.get(result)
    function.argtypes = [ctypes.c_void_p if star else _NUMBERS[kind] for _, kind, star, _ in parts]
    convert = [(_read if const else _written)(f"{name}: {what}", _ARRAYS[kind]) if star else _as_is
               for const, kind, star, what in parts]

    def call(*values: Any) -> Any:
        held = [one(value) for one, value in zip(convert, values, strict=True)]
        return function(*[_address(value) for value in held])

    return call, function, convert


def _address(value: Any) -> Any:
    if not isinstance(value, np.ndarray):
        return value
    if value.size and value.flags.writeable:  # in a third of the time of `ctypes.data`, two hundred times an image
        return ctypes.addressof(ctypes.c_char.from_buffer(value))  # type: ignore[arg-type]  # an array is a buffer
    return value.ctypes.data


def _same(converted: Any, value: Any, name: str) -> Any:
    if isinstance(converted, np.ndarray) and converted is not value:
        raise TypeError(f"{name}: a {value.dtype} array of shape {value.shape} would have to be copied")
    return converted


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
