"""`validated`: check of a public function's arguments against its own signature.

The annotations state the types, the decorator's keywords the ranges.

    @validated(mass=above(0), mesh=within(8, 400))
    def attach(spec: MjSpec, sensor: SensorDesign | str, *, mass: float, mesh: tuple[int, int]): ...

    attach(spec, "dense", mass=-1)    # InputError: attach: mass: -1 is not above 0

A wrong argument raises an InputError that names function, argument, value and choices. Annotations
that state no type at run time (Protocols, `Any`) are not checked.
"""

from __future__ import annotations

import collections.abc
import inspect
import math
import sys
import types
import typing
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from functools import partial, wraps
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Literal, TypeVar, Union

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core.errors import InputError

F = TypeVar("F", bound=Callable[..., Any])
Accept = Callable[[Any], bool]
_SHOWN = 60  # characters of a value in a message
_LARGEST = sys.float_info.max
_ARRAY_MEMBERS = typing.get_args(ArrayLike)
_ARRAY = "an array of numbers"


# -- ranges


@dataclass(frozen=True)
class Range:
    """Range of numbers, also of each number of an array; NaN is outside.

    `is_open` excludes `low`.
    """

    low: float = -math.inf
    high: float = math.inf
    is_open: bool = False

    def holds(self, value: Any) -> bool:
        """Return True if all numbers of `value` are in the range."""
        if isinstance(value, (int, float)):
            return (self.low < value if self.is_open else self.low <= value) and value <= self.high
        values = np.asarray(value)
        if values.dtype.kind not in "biuf":
            return True  # text, a choice of its own
        above = values > self.low if self.is_open else values >= self.low
        return bool(np.all(above & (values <= self.high)))

    def __str__(self) -> str:
        low = f"{self.low:g}"
        high = f"{self.high:g}"
        if self == FINITE:
            return "finite"
        if self.high >= _LARGEST:
            return f"above {low}" if self.is_open else f"at least {low}"
        return f"above {low}, at most {high}" if self.is_open else f"from {low} to {high}"


FINITE = Range(-_LARGEST, _LARGEST)
"""Any finite number."""


def above(low: float, high: float = _LARGEST) -> Range:
    """Return the range of finite numbers above `low`, up to `high`."""
    return Range(low, high, is_open=True)


def not_below(low: float) -> Range:
    """Return the range of finite numbers from `low` on."""
    return Range(low, _LARGEST)


def within(low: float, high: float) -> Range:
    """Return the range from `low` to `high`."""
    return Range(low, high)


# -- types


@dataclass(frozen=True)
class _Kind:
    """Type of an argument: its test, and its name in messages. `choices` are the valid texts."""

    accept: Accept
    name: str
    choices: tuple[Any, ...] = ()


_ANY = _Kind(lambda value: True, "")


def _is_number(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.ndim == 0 and value.dtype.kind in "iuf"
    return isinstance(value, Real) and not isinstance(value, (bool, np.bool_))


def _is_integer(value: Any) -> bool:
    return isinstance(value, Integral) and not isinstance(value, (bool, np.bool_))


def _is_path(value: Any) -> bool:
    return isinstance(value, Path) and "\0" not in str(value)


def _is_array(value: Any) -> bool:
    try:
        return np.asarray(value).dtype.kind in "biuf"
    except (TypeError, ValueError):
        return False


_SIMPLE = {
    Any: _ANY,
    inspect.Parameter.empty: _ANY,
    object: _ANY,
    None: _Kind(lambda value: value is None, "None"),
    type(None): _Kind(lambda value: value is None, "None"),
    bool: _Kind(lambda value: isinstance(value, (bool, np.bool_)), "True or False"),
    int: _Kind(_is_integer, "a whole number"),
    float: _Kind(_is_number, "a number"),
    str: _Kind(lambda value: isinstance(value, str) and "\0" not in value, "text"),
    Path: _Kind(_is_path, "a path"),
}


def _kind(annotation: Any) -> _Kind:
    """Return the check of an annotation; `_ANY` if it states no type at run time."""
    if annotation is ArrayLike:
        return _Kind(_is_array, _ARRAY)
    with_origin = typing.get_origin(annotation)
    if with_origin is None and isinstance(annotation, collections.abc.Hashable):
        simple = _SIMPLE.get(annotation)
        if simple is not None:
            return simple
    if with_origin in (Union, types.UnionType):
        members = typing.get_args(annotation)
        if set(_ARRAY_MEMBERS) <= set(members):  # typing dissolves an alias in a union
            members = (np.ndarray, *(member for member in members if member not in _ARRAY_MEMBERS))
        return _union([_kind(member) for member in members])
    if with_origin is Literal:
        choices = typing.get_args(annotation)
        return _Kind(lambda value: isinstance(value, str) and value in choices, "", choices)
    if np.ndarray in (with_origin, annotation):
        return _Kind(_is_array, _ARRAY)
    if with_origin is tuple:
        return _tuple(typing.get_args(annotation))
    return _class(with_origin or annotation, typing.get_args(annotation))


def _union(kinds: list[_Kind]) -> _Kind:
    if any(kind is _ANY for kind in kinds):
        return _ANY
    names = dict.fromkeys(kind.name for kind in kinds if kind.name)
    choices = tuple(choice for kind in kinds for choice in kind.choices)
    tests = [kind.accept for kind in kinds]
    return _Kind(lambda value: any(test(value) for test in tests), " or ".join(names), choices)


def _tuple(items: tuple[Any, ...]) -> _Kind:
    """Return the check of a tuple; a list or an array of the same length is accepted."""
    first = _kind(items[0]) if items else _ANY
    count = None if not items or items[-1] is ... else len(items)

    def accept(value: Any) -> bool:
        is_array = isinstance(value, np.ndarray) and value.ndim > 0
        if not (is_array or isinstance(value, (tuple, list))):
            return False
        return (count is None or len(value) == count) and all(map(first.accept, value))

    name = "a tuple" if count is None else f"a tuple of {count}"
    return _Kind(accept, f"{name}, each {first.name}" if first.name else name)


def _sequence(kind: type, items: tuple[Any, ...]) -> _Kind:
    """Return the check of a sequence, and of its items where this does not consume it."""
    item = _kind(items[0]) if items else _ANY
    name = f"a list or another sequence, each item {item.name}" if item.name else "a sequence"

    def accept(value: Any) -> bool:
        if not isinstance(value, kind) or isinstance(value, (str, bytes, Mapping)):
            return False
        return not isinstance(value, (list, tuple)) or all(map(item.accept, value))

    return _Kind(accept, name)


def _class(kind: Any, items: tuple[Any, ...] = ()) -> _Kind:
    if not isinstance(kind, type) or getattr(kind, "_is_protocol", False):
        return _ANY
    if kind is collections.abc.Callable:
        return _Kind(callable, "a function")
    name = kind.__name__
    if kind in (collections.abc.Sequence, collections.abc.Collection, collections.abc.Iterable):
        return _sequence(kind, items)
    if issubclass(kind, Mapping):
        return _Kind(lambda value: isinstance(value, kind), "a mapping")
    if issubclass(kind, Enum):
        return _Kind(lambda value: value in set(kind), name, tuple(kind))
    article = "an" if name[0] in "AEIO" else "a"
    return _Kind(lambda value: isinstance(value, kind), f"{article} {name}")


# -- functions


def validated(**ranges: Range) -> Callable[[F], F]:
    """Decorate a function, or a class with its constructor, to check arguments before it runs.

    `ranges` gives the range of a numeric argument by its name. The decorated function raises
    InputError for an argument of the wrong type or out of its range.
    """
    return partial(_decorate, ranges=ranges)  # type: ignore[return-value]


def _decorate(function: Any, ranges: Mapping[str, Range]) -> Any:
    if isinstance(function, type):
        made: Any = function
        made.__init__ = _wrap(made.__init__, function.__name__, ranges)
        return function
    name = function.__qualname__.rpartition("<locals>.")[-1]
    return _wrap(function, name, ranges)


def _wrap(function: Any, source: str, ranges: Mapping[str, Range]) -> Any:
    signature = inspect.signature(function)
    unknown = set(ranges) - set(signature.parameters)
    assert not unknown, f"{source} has no argument {unknown}"
    names = [
        parameter.name
        for parameter in signature.parameters.values()
        if parameter.kind in (parameter.POSITIONAL_ONLY, parameter.POSITIONAL_OR_KEYWORD)
    ]
    complete: dict[str, _Check] = {}

    @wraps(function)
    def call(*args: Any, **more: Any) -> Any:
        nonlocal complete
        checks = complete
        if not checks:  # annotations may name classes that are defined later
            # one assignment: another thread sees no part of it
            complete = checks = dict(_checks(function, signature, source, ranges))
        for name, value in zip(names, args, strict=False):
            checks[name](value)
        for name, value in more.items():
            if name in checks:
                checks[name](value)
        return function(*args, **more)

    return call


@dataclass(frozen=True)
class _Check:
    """Check of one argument."""

    source: str
    field: str
    kind: _Kind
    range: Range | None
    default: Any

    def __call__(self, value: Any) -> None:
        if value is self.default:
            return
        if not self.kind.accept(value):
            suffix = f" {self.kind.name}" if self.kind.name else " a valid value"
            raise self._error(f"{shown(value)} is not{suffix}")
        if self.range is None or value is None or isinstance(value, str):
            return
        if not self.range.holds(value):
            found = f"{shown(value)} is not {self.range}"
            raise self._error(found if np.ndim(value) == 0 else f"a value is not {self.range}")

    def _error(self, text: str) -> InputError:
        choices = self.kind.choices or None
        return InputError(text, source=self.source, field=self.field, choices=choices)


def _checks(
    function: Any, signature: inspect.Signature, source: str, ranges: Mapping[str, Range]
) -> Iterable[tuple[str, _Check]]:
    known = inspect.unwrap(function).__globals__
    for name, parameter in signature.parameters.items():
        is_self = name in ("self", "cls") or parameter.kind in (
            parameter.VAR_KEYWORD,
            parameter.VAR_POSITIONAL,
        )
        kind = _ANY if is_self else _kind(_evaluated(parameter.annotation, known))
        yield name, _Check(source, name, kind, ranges.get(name), parameter.default)


def _evaluated(annotation: Any, known: dict[str, Any]) -> Any:
    """Return the annotation itself for its text; `Any` if it is imported for type checkers only."""
    if not isinstance(annotation, str):
        return annotation
    try:
        return eval(annotation, known)
    except (NameError, AttributeError, TypeError):
        return Any


def shown(value: Any) -> str:
    """Return the value in one line, shortened."""
    text = " ".join(repr(value).split())
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 3]}..."
