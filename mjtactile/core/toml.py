"""Reader of TOML and JSON files field by field. Each value is checked for type and range. An error
is one line that names the file, the field, the value and the valid choices."""

from __future__ import annotations

import difflib
import json
import logging
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjtactile.core import foreign_file
from mjtactile.core.errors import InputError
from mjtactile.core.renamed import KEYS, VALUES, hint

_logger = logging.getLogger(__name__)
# maximum size of a file, bytes; a manually written file is smaller
LARGEST = 8 << 20
DEEPEST = 32  # maximum names in a dotted key; time and memory of tomllib grow with the square


def read_toml(path: Path) -> dict[str, Any]:
    """Return the table of a TOML file. Raises InputError if it cannot be read or is not TOML."""
    return _parse(path, "TOML", _toml)


def read_toml_with_text(path: Path) -> tuple[dict[str, Any], str]:
    """Return the table of a TOML file and its text; see `read_toml`."""
    return _parse(path, "TOML", lambda text: (_toml(text), text))


def toml_text(table: Mapping[str, Any], *, digits: int = 17) -> str:
    """Return a table as TOML, with sections of one level; floats have so many `digits` (17: the
    same bits when it is read). Values of None are left out."""
    sections = {key: value for key, value in table.items() if isinstance(value, Mapping)}
    plain = {key: value for key, value in table.items() if key not in sections}
    lines = _entries(plain, digits)
    for section, values in sections.items():
        lines += ["", f"[{section}]", *_entries(values, digits)]
    return "\n".join(lines) + "\n"


def _entries(table: Mapping[str, Any], digits: int) -> list[str]:
    return [f"{key} = {_value(value, digits)}" for key, value in table.items() if value is not None]


def _value(value: Any, digits: int) -> str:
    """Format a TOML value."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        text = repr(value) if digits >= 17 else f"{value:.{digits}g}"
        return text if any(mark in text for mark in ".en") else f"{text}.0"
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    return "[" + ", ".join(_value(item, digits) for item in value) + "]"


def _toml(text: str) -> dict[str, Any]:
    if re.search(r"\b0[xob][0-9a-fA-F_]{99}", text):  # Python cannot print it
        raise ValueError("a number has more than 99 digits")
    for piece in re.split(r"[,=\[\]{}#\n]", text):
        if (
            piece.count(".") >= DEEPEST
            and len(re.findall(r"[\w\"'-]\.(?=[\w\"'-])", re.sub(r"\s", "", piece))) >= DEEPEST
        ):
            raise ValueError(f"a key has more than {DEEPEST} names")
    return tomllib.loads(text)


def read_json(path: Path) -> Any:
    """Return the value of a JSON file. Raises InputError if it cannot be read or is not JSON."""
    return _parse(path, "JSON", json.loads)


def parse_toml(text: str, source: str) -> dict[str, Any]:
    """Return the table of a TOML text. Raises InputError that names `source` if it is not TOML."""
    try:
        return _toml(text)
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"not valid TOML: {' '.join(str(error).split())}", source=source
        ) from error


def _parse(path: Path, kind: str, parse: Callable[[str], Any]) -> Any:
    data = foreign_file.read_bytes(path, LARGEST, "such a file")
    try:
        # editors on Windows put a byte order mark in front
        return parse(data.decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        # ValueError: the parsers' own errors, and bytes that are not UTF-8
        raise InputError(
            f"not valid {kind}: {' '.join(str(error).split())}", source=path
        ) from error


class Section:
    """Table of a file (`source`) that is read once, field by field.

    `done` refuses keys that were not read. `label` is the table's position in the file ("" for the
    whole file). A field without `default` is required. A `default` is returned unchanged, without
    scale.
    """

    def __init__(self, table: Mapping[str, Any], label: str, source: str):
        self._table = table
        self._label = label
        self._source = source
        self._known: list[str] = []

    @property
    def source(self) -> str:
        """The file, as messages name it."""
        return self._source

    @property
    def folder(self) -> Path:
        """The folder that file names in this file are relative to."""
        return Path(self._source).parent

    def fail(self, key: str, message: str, choices: Iterable[object] | None = None) -> InputError:
        """Return the error to raise for field `key`."""
        return InputError(
            message, source=self._source, field=self._field_path(key), choices=choices
        )

    def moved(self, key: str, error: InputError) -> InputError:
        """Return the error, at field `key`."""
        return error.at(self._field_path(key), self._source)

    def number(
        self, key: str, low: float, high: float, scale: float = 1.0, default: Any = ...
    ) -> Any:
        """Return a number within [low, high] (in the file's unit), times `scale`."""
        value = self._get(key, default)
        if value is None:
            return default
        return self._number(key, value, low, high) * scale

    def numbers(
        self,
        key: str,
        names: Sequence[str],
        low: float,
        high: float,
        scale: float = 1.0,
        default: Any = ...,
        *,
        integer: bool = False,
    ) -> Any:
        """Return one number for each of `names` as a tuple of floats.

        Each lies within [low, high] (in the file's unit) and is multiplied by `scale`. With
        `integer` the numbers are ints.
        """
        value = self._get(key, default)
        if value is None:
            return default
        if not isinstance(value, list) or len(value) != len(names):
            raise self.fail(
                key, f"{value!r} is not a list of {len(names)} numbers ({', '.join(names)})"
            )
        if integer:
            return tuple(
                self._integer(f"{key}[{i}]", item, low, high) for i, item in enumerate(value)
            )
        return tuple(
            float(self._number(f"{key}[{i}]", item, low, high) * scale)
            for i, item in enumerate(value)
        )

    def pairs(self, key: str) -> tuple[tuple[float, float], ...]:
        """Return a list of [x, y] pairs of finite numbers."""
        value = self._get(key, ...)
        if not isinstance(value, list) or not all(
            isinstance(pair, list) and len(pair) == 2 for pair in value
        ):
            raise self.fail(key, f"{value!r} is not a list of [x, y] pairs")
        return tuple(
            (
                float(self._number(f"{key}[{i}]", x, -1e9, 1e9)),
                float(self._number(f"{key}[{i}]", y, -1e9, 1e9)),
            )
            for i, (x, y) in enumerate(value)
        )

    def array(self, key: str, shape: tuple[int | None, ...]) -> NDArray[np.float64]:
        """Return nested lists of finite numbers as a read-only array of this shape; None: any
        length."""
        try:
            array = np.array(self._get(key, ...), dtype=float)
        except (TypeError, ValueError):
            array = np.full(1, np.nan)
        fits = array.ndim == len(shape) and all(
            expected in (None, got) for expected, got in zip(shape, array.shape, strict=True)
        )
        if not fits or not np.isfinite(array).all():
            size = " x ".join("n" if n is None else str(n) for n in shape)
            raise self.fail(key, f"is not an array of {size} finite numbers")
        array.flags.writeable = False
        return array

    def integer(self, key: str, low: int, high: int, default: Any = ...) -> Any:
        """Return an integer within [low, high]."""
        value = self._get(key, default)
        if value is None:
            return default
        return self._integer(key, value, low, high)

    def wholes(self, key: str, low: int, high: int, default: Any = ...) -> Any:
        """Return a list of integers within [low, high] as a tuple."""
        value = self._get(key, default)
        if value is None:
            return default
        if not isinstance(value, list) or not all(
            isinstance(item, int) and not isinstance(item, bool) for item in value
        ):
            raise self.fail(key, f"{value!r} is not a list of whole numbers")
        return tuple(self._number(f"{key}[{i}]", item, low, high) for i, item in enumerate(value))

    def text(
        self,
        key: str,
        choices: Iterable[str] | None = None,
        default: Any = ...,
        *,
        empty: bool = False,
    ) -> Any:
        """Return a text, one of `choices` if given. An empty text is an error without `empty`."""
        value = self._get(key, default)
        if value is None:
            return default
        if not isinstance(value, str) or not (value or empty):
            raise self.fail(key, f"{value!r} is not text", choices)
        if "\0" in value:  # neither a file nor an element of MuJoCo can have this name
            raise self.fail(key, f"{value!r} contains a null character", choices)
        if choices is None or value in (choices := list(choices)):
            return value
        if (renamed := VALUES.get(key, {}).get(value)) in choices:
            _logger.warning(
                "%s: %s: %r is now %r", self._source, self._field_path(key), value, renamed
            )
            return renamed
        raise self.fail(key, f"{value!r} is unknown", choices)

    def has(self, key: str) -> bool:
        """Return True if the table has the field, for entries with alternative keys."""
        return key in self._table

    def kind(self, key: str) -> type | None:
        """Return the type of the field's value, for fields with several valid types; None if it is
        missing."""
        return type(self._table[key]) if key in self._table else None

    def flag(self, key: str, default: Any = ...) -> Any:
        """Return true or false."""
        value = self._get(key, default)
        if value is None:
            return default
        if not isinstance(value, bool):
            raise self.fail(key, f"{value!r} is not true or false")
        return value

    def texts(self, key: str, default: Any = ...) -> Any:
        """Return a list of texts as a tuple."""
        value = self._get(key, default)
        if value is None:
            return default
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            raise self.fail(key, f"{value!r} is not a list of texts")
        return tuple(value)

    def table(self, key: str) -> Mapping[str, Any]:
        """Return the table `[key]` with unchecked content."""
        value = self._get(key, ...)
        if not isinstance(value, Mapping):
            raise self.fail(key, "is not a table")
        return value

    def section(self, key: str) -> Section:
        """Return the table `[key]`."""
        if (found := self.optional(key)) is None:
            message = f"missing section{self._similar_unread(key)}"
            raise InputError(message, source=self._source, field=f"[{self._field_path(key)}]")
        return found

    def optional(self, key: str) -> Section | None:
        """Return the table `[key]`, or None."""
        value = self._get(key, None)
        if value is None:
            return None
        if not isinstance(value, Mapping):
            raise self.fail(key, f"is not a section; write [{self._field_path(key)}]")
        return Section(value, self._field_path(key), self._source)

    def sections(self, key: str, low: int = 1, high: int = 2) -> list[Section]:
        """Return the `low` to `high` tables `[[key]]`."""
        value = self._get(key, None if low == 0 else ...)
        value = [] if value is None else value
        if not isinstance(value, list) or not all(isinstance(item, Mapping) for item in value):
            raise self.fail(key, f"is not a list of sections; write [[{self._field_path(key)}]]")
        if not low <= len(value) <= high:
            raise self.fail(key, f"has {len(value)} sections, expected {low} to {high}")
        return [
            Section(item, f"{self._field_path(key)}[{i}]", self._source)
            for i, item in enumerate(value)
        ]

    def done(self) -> None:
        """Raise InputError for an unknown field."""
        for key in self._table:
            if key not in self._known:
                element = "section" if isinstance(self._table[key], Mapping) else "field"
                hint = self._similar_key(key)
                raise self.fail(key, f"unknown {element}{hint}", dict.fromkeys(self._known))

    def _similar_key(self, key: str) -> str:
        """Return a hint with the known field similar to an unknown one."""
        if key in KEYS:
            return hint(key)
        stems = {_stem(known): known for known in self._known if "_" in known}
        if _stem(key) in stems:
            return f", wrong unit? write it as {stems[_stem(key)]!r}"
        near = difflib.get_close_matches(key, self._known, 1)
        return f", did you mean {near[0]!r}?" if near else ""

    def _field_path(self, key: str) -> str:
        return f"{self._label}.{key}" if self._label else key

    def _get(self, key: str, default: Any) -> Any:
        """Return the value; None if it is missing and has a default."""
        self._known.append(key)
        value = self._table.get(key)
        if value is None and default is ...:
            raise self.fail(key, f"missing field{self._similar_unread(key)}")
        return value

    def _similar_unread(self, key: str) -> str:
        """Return a hint with the table's entry that is similar to the missing `key`."""
        rest = [other for other in self._table if other not in self._known]
        if old := [other for other in rest if KEYS.get(other) == key]:
            return hint(old[0])
        for other in rest:
            if "_" in key and _stem(other) == _stem(key):
                return f"; there is {other!r}: wrong unit?"
        near = difflib.get_close_matches(key, rest, 1)
        return f"; there is {near[0]!r}: wrong name?" if near else ""

    def _integer(self, key: str, value: Any, low: float, high: float) -> int:
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.fail(key, f"{value!r} is not a whole number")
        return self._number(key, value, low, high)

    def _number(self, key: str, value: Any, low: float, high: float) -> Any:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.fail(key, f"{value!r} is not a number")
        if not low <= value <= high:  # so is NaN
            raise self.fail(key, f"{value!r} is outside {low:g} to {high:g}")
        return value


def _stem(key: str) -> str:
    """Return a key without its unit."""
    return key.rsplit("_", 1)[0]
