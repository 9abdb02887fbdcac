"""C functions as Python ones, by their declarations in `kernels.h`: arrays are checked and handed
over by address."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from mjtactile.kernels import build

_NUMBERS = {"double": ctypes.c_double, "int64_t": ctypes.c_int64}
_ARRAYS = {
    "double": np.dtype("<f8"),
    "float": np.dtype("<f4"),
    "int64_t": np.dtype("<i8"),
    "int32_t": np.dtype("<i4"),
    "uint8_t": np.dtype("|u1"),
}
_DECLARATION = re.compile(r"^(int64_t|double|void) (\w+)\(([^)]*)\);", re.M)
_ARGUMENT = re.compile(r"(const )?(\w+) (\*?)(\w+)$")


def kernel(name: str) -> Callable[..., Any]:
    """The C function `name`. What it only reads is converted to arrays of its types, if need be;
    what it writes must be C-contiguous arrays of them (None: NULL), else TypeError is raised.
    Lengths are for the caller to know.

    Other processes and threads run on while it does: it needs no Python.
    """
    return _library()[name][0]


def bound(name: str, *values: Any) -> Callable[..., Any]:
    """The C function `name` on these very arrays and numbers, for a call that comes again and
    again: they are checked now, and kept. For each `...` among them a value is given at every call.
    Raises TypeError for an array that would have to be converted.
    """
    function, convert = _library()[name][1:]
    addresses = [
        None if value is ... else _same(one, value, name)
        for one, value in zip(convert, values, strict=True)
    ]
    given = [(place, convert[place]) for place, value in enumerate(values) if value is ...]

    def call(*now: Any) -> Any:
        held: list[Any] = []
        arguments = addresses.copy()
        for (place, one), value in zip(given, now, strict=True):
            arguments[place] = one(value, held)
        return function(*arguments)

    call.kept = values  # type: ignore[attr-defined]  # else nobody may
    return call


@cache
def _library() -> dict[str, tuple[Callable[..., Any], Any, list[_Convert]]]:
    """Of each kernel: its Python face, the C function, and what checks or converts each
    argument."""
    loaded = ctypes.CDLL(str(build.library()))
    return {
        name: _wrapped(getattr(loaded, name), name, result, arguments)
        for result, name, arguments in _DECLARATION.findall(
            (build.FOLDER / "kernels.h").read_text()
        )
    }


def _wrapped(
    function: Any, name: str, result: str, arguments: str
) -> tuple[Callable[..., Any], Any, list[Any]]:
    parts = [_ARGUMENT.search(" ".join(part.split())).groups() for part in arguments.split(",")]  # type: ignore[union-attr]
    function.restype = _NUMBERS.get(result)
    function.argtypes = [ctypes.c_void_p if star else _NUMBERS[kind] for _, kind, star, _ in parts]
    convert = [
        (_read(_ARRAYS[kind]) if const else _written(f"{name}: {what}", _ARRAYS[kind]))
        if star
        else _as_is
        for const, kind, star, what in parts
    ]

    def call(*values: Any) -> Any:
        held: list[Any] = []
        return function(*[one(value, held) for one, value in zip(convert, values, strict=True)])

    return call, function, convert


# What is handed over for a value: itself, or an array's address. What had to be made for it is put
# into `held`, to outlive the call. Two hundred times an image: an array of numpy's own is asked for
# its buffer, and nothing else, where that will do.
_Convert = Callable[[Any, list[Any]], Any]


def _same(convert: _Convert, value: Any, name: str) -> Any:
    copies: list[Any] = []
    address = convert(value, copies)
    if copies:
        raise TypeError(
            f"{name}: a {value.dtype} array of shape {value.shape} would have to be copied"
        )
    return address


def _as_is(value: Any, _: list[Any]) -> Any:
    return value


def _read(dtype: np.dtype) -> _Convert:
    def address(value: Any, held: list[Any]) -> Any:
        if value is None:
            return None
        try:
            if value.dtype == dtype:
                return ctypes.addressof(ctypes.c_char.from_buffer(value))
        except (AttributeError, TypeError, ValueError):
            # a list, or an array that is read-only, empty or with gaps
            pass
        whole = np.ascontiguousarray(value, dtype)
        if whole is not value:
            held.append(whole)
        return whole.ctypes.data

    return address


def _written(what: str, dtype: np.dtype) -> _Convert:
    def address(value: Any, _: list[Any]) -> Any:
        if value is None:
            return None
        if (
            isinstance(value, np.ndarray)
            and value.dtype == dtype
            and value.flags.c_contiguous
            and value.flags.writeable
        ):
            if not value.size:
                return value.ctypes.data
            return ctypes.addressof(ctypes.c_char.from_buffer(value))  # type: ignore[arg-type]
        raise TypeError(f"{what} must be a writable C-contiguous array of {dtype}")

    return address
