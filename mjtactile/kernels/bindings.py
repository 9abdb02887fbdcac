"""Python bindings of the C functions declared in `kernels.h`.

Arrays are checked and passed by address. In a declaration, a comment after each array gives its
shape in terms of the integer arguments: `double *out /* n, 3 */`. An optional array is declared
with `/* n, 3 or NULL */`. An array of the wrong type or size, or a non-contiguous one, never
reaches C. Every error code raises an exception.
"""

from __future__ import annotations

import ctypes
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from mjtactile.kernels import build

_NUMBERS = {"double": ctypes.c_double, "int64_t": ctypes.c_int64}
_DTYPES = {
    "double": np.dtype("<f8"),
    "float": np.dtype("<f4"),
    "int64_t": np.dtype("<i8"),
    "int32_t": np.dtype("<i4"),
    "uint8_t": np.dtype("|u1"),
}
# Name of a return code in kernels.h: exception and message.
_ERRORS = {
    "NO_MEMORY": (MemoryError, "no memory"),
    "REFUSED": (ValueError, "invalid arguments"),
    "NOT_DEFINITE": (np.linalg.LinAlgError, "a matrix is not finite or not positive definite"),
}
_DECLARATION = re.compile(r"^(int64_t|double|void) (\w+)\(([^;]*)\);", re.M)
_ARGUMENT = re.compile(r"(const )?(\w+) (\*?)(\w+)(?: /\* (.*?)( or NULL)? \*/)?(?:, |$)")
_MACRO = re.compile(r"^#define (\w+)\((\w+)\) (.*?)(?: /\*.*)?$", re.M)
_CONSTANT = re.compile(r"^#define (\w+) (\d+)(?: /\*.*)?$", re.M)


def kernel(name: str) -> Callable[..., Any]:
    """Return the C function `name` as a Python function that runs without Python's lock.

    It takes the arguments of the declaration in `kernels.h`. Input arrays are converted if
    necessary. Output arrays must be C-contiguous and of the declared type. It raises TypeError or
    ValueError for an unusable argument, MemoryError and numpy.linalg.LinAlgError by the kernel's
    return code. An unknown name raises KeyError.
    """
    return _library()[name].call


def bound(name: str, *values: Any) -> Callable[..., Any]:
    """Bind the C function `name` to given arrays and numbers, for repeated calls.

    Each `...` in `values` stands for an argument given at every call. The others are checked now,
    and the arrays are kept alive. Raises TypeError for an array that needs conversion, or whose
    size depends on a later argument; ValueError as `kernel` does.
    """
    return _library()[name].bind(values)


def words(call: Callable[..., Any]) -> np.ndarray:
    """Return the arguments (n,) int64 of a fully `bound` function, for a kernel that calls it.

    They are integers, bit patterns of floats, and addresses. The caller must keep `call`.
    """
    return np.array(
        [
            np.float64(value).view(np.int64) if isinstance(value, float) else int(value or 0)
            for value in call.fixed  # type: ignore[attr-defined]
        ],
        np.int64,
    )


def band_stride(width: int) -> int:
    """Return the stride between columns of a band matrix, as in kernels/band_cholesky_f64.h."""
    return _macros()["BAND_STRIDE"](width)


@dataclass(frozen=True)
class KernelArgument:
    """Argument of a C function. `shape` is the declared array shape, "" for a scalar."""

    name: str
    kind: str
    shape: str
    written: bool
    optional: bool


@dataclass(frozen=True)
class Declaration:
    """One C function: its name, the type that it returns, and its arguments in order."""

    name: str
    result: str
    arguments: tuple[KernelArgument, ...]

    def sizes(self) -> Callable[..., tuple[float, ...]]:
        """Return a function from argument values to the sizes of all arrays (0 for a number)."""
        names = [argument.name for argument in self.arguments]
        products = [
            "*".join(f"({side})" for side in argument.shape.split(", ")) if argument.shape else "0"
            for argument in self.arguments
        ]
        source = f"lambda {', '.join(names)}: ({', '.join(products)},)"
        return eval(source, {"__builtins__": {}, **_macros()})


@cache
def declarations() -> Mapping[str, Declaration]:
    """Return all declarations of `kernels.h` by name. Raises RuntimeError for a missing size."""
    text = _header()
    found = {}
    for result, name, arguments in _DECLARATION.findall(text):
        found[name] = Declaration(name, result, _arguments(name, " ".join(arguments.split())))
    return found


def _arguments(function: str, text: str) -> tuple[KernelArgument, ...]:
    found = []
    for const, kind, star, name, shape, optional in _ARGUMENT.findall(text):
        if bool(star) != bool(shape):
            raise RuntimeError(f"kernels.h: {function}: {name} must have a size if it is an array")
        found.append(KernelArgument(name, kind, shape, bool(star) and not const, bool(optional)))
    return tuple(found)


@cache
def _header() -> str:
    return (build.FOLDER / "kernels.h").read_text()


@cache
def _macros() -> dict[str, Any]:
    """Return the header's constants and macros of one integer argument, for array sizes."""
    constants = {name: int(value) for name, value in _CONSTANT.findall(_header())}
    return constants | {
        name: eval(f"lambda {argument}: {body.replace('/', '//')}", {"__builtins__": {}})
        for name, argument, body in _MACRO.findall(_header())
    }


@cache
def _library() -> dict[str, _Kernel]:
    loaded = ctypes.CDLL(str(build.library()))
    return {
        name: _Kernel(declaration, getattr(loaded, name))
        for name, declaration in declarations().items()
    }


class _Kernel:
    """A C function with the converters and checks of its arguments."""

    def __init__(self, declaration: Declaration, function: Any):
        self.declaration = declaration
        self.function = function
        self.sizes = declaration.sizes()
        function.restype = _NUMBERS.get(declaration.result)
        function.argtypes = [
            ctypes.c_void_p if argument.shape else _NUMBERS[argument.kind]
            for argument in declaration.arguments
        ]
        if declaration.result == "int64_t":
            function.errcheck = self._raise_code
        self.convert = [_converter(declaration.name, one) for one in declaration.arguments]

    def call(self, *values: Any) -> Any:
        held: list[Any] = []
        given = zip(self.convert, values, self.sizes(*values), strict=True)
        return self.function(*[convert(value, size, held) for convert, value, size in given])

    def bind(self, values: Sequence[Any]) -> Callable[..., Any]:
        later = [position for position, value in enumerate(values) if value is ...]
        # NaN for a later argument makes all sizes that depend on it NaN
        known = self.sizes(*[np.nan if value is ... else value for value in values])
        fixed = [
            None if value is ... else self._fixed(position, value, known[position])
            for position, value in enumerate(values)
        ]
        function = self.function
        given = [(position, self.convert[position]) for position in later]

        def call(*now: Any) -> Any:
            held: list[Any] = []
            every = list(values)
            arguments = fixed.copy()
            for position, value in zip(later, now, strict=True):
                every[position] = value
            sizes = self.sizes(*every)
            for position, convert in given:
                arguments[position] = convert(every[position], sizes[position], held)
            return function(*arguments)

        def call_with_nothing(*now: Any) -> Any:
            if now:
                raise TypeError(f"{self.declaration.name}: all arguments are bound")
            return function(*fixed)

        bound_call = call if later else call_with_nothing
        bound_call.fixed = fixed  # type: ignore[attr-defined]
        bound_call.kept = values  # type: ignore[attr-defined]  # the arrays' owner, perhaps the only one
        return bound_call

    def _fixed(self, position: int, value: Any, size: float) -> Any:
        """Return a number unchanged, or the address of an array that is kept alive."""
        argument = self.declaration.arguments[position]
        if math.isnan(size):
            raise TypeError(
                f"{self.declaration.name}: the size of {argument.name} is not known yet"
            )
        copies: list[Any] = []
        address = self.convert[position](value, size, copies)
        if copies:
            array = f"a {value.dtype} array of shape {value.shape}"
            raise TypeError(f"{self.declaration.name}: {argument.name} needs a copy of {array}")
        return address

    def _raise_code(self, code: int, _function: Any, _arguments: Any) -> int:
        if code >= 0:
            return code
        for name, (error, description) in _ERRORS.items():
            if re.search(rf"\b{name} = {code}\b", _header()):
                raise error(f"kernel {self.declaration.name}: {description}")
        raise RuntimeError(f"kernel {self.declaration.name} returned {code}")


# Function that returns the C argument for a value: the number, or the address of the array.
# Temporary copies are appended to `held`, which must outlive the call.
_Converter = Callable[[Any, float, list[Any]], Any]


def _converter(function: str, argument: KernelArgument) -> _Converter:
    if not argument.shape:
        return lambda value, _size, _held: value
    name = f"{function}: {argument.name}"
    convert = _written if argument.written else _read
    return convert(name, argument, _DTYPES[argument.kind])


def _read(label: str, argument: KernelArgument, dtype: np.dtype) -> _Converter:
    def address(value: Any, size: float, held: list[Any]) -> Any:
        if value is None:
            return _null(label, argument)
        try:
            if value.dtype == dtype and value.size == size:
                return ctypes.addressof(ctypes.c_char.from_buffer(value))
        except (AttributeError, TypeError, ValueError):
            # a list, or an array that is read-only, empty or with gaps
            pass
        contiguous = np.ascontiguousarray(value, dtype)
        if contiguous.size != size:
            raise ValueError(_wrong_size(label, argument, contiguous, size))
        if contiguous is not value:
            held.append(contiguous)
        return contiguous.ctypes.data

    return address


def _written(label: str, argument: KernelArgument, dtype: np.dtype) -> _Converter:
    def address(value: Any, size: float, _held: list[Any]) -> Any:
        if value is None:
            return _null(label, argument)
        is_valid = isinstance(value, np.ndarray) and value.dtype == dtype
        if not (is_valid and value.flags.c_contiguous and value.flags.writeable):
            raise TypeError(f"{label} must be a writable C-contiguous array of {dtype}")
        if value.size != size:
            raise ValueError(_wrong_size(label, argument, value, size))
        if not size:
            return value.ctypes.data
        return ctypes.addressof(ctypes.c_char.from_buffer(value))  # type: ignore[arg-type]

    return address


def _null(label: str, argument: KernelArgument) -> None:
    if not argument.optional:
        raise TypeError(f"{label} is required")


def _wrong_size(label: str, argument: KernelArgument, array: np.ndarray, size: float) -> str:
    return (
        f"{label}: shape {array.shape} has {array.size} elements, ({argument.shape}) needs {size:g}"
    )
