"""Mapping of dataclasses to files.

Key, unit, range, default and meaning are defined once, on the field.

    @dataclass(frozen=True)
    class Glass:
        thickness: float = number("thickness_mm", 0, 50, MM, about="0: none")
        index: float = number("refractive_index", 1, 3, default=1.5, about="glass 1.52")

    glass = read(Glass, section)   # SI, or an InputError that names file, field and value
    write(glass)                   # {"thickness_mm": 2.0, "refractive_index": 1.5}

This module reads sensor files, rig files, as-built files, variations, calibrations and settings. A
method `validate(self, section)` of the class checks constraints between fields. Some classes have
fields that do not correspond to single keys. Such a class implements `from_section(section)` and
`to_table(self)`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from mjtactile.core.field_types import Entry, FilePath, Flag, Number, Numbers, Text
from mjtactile.core.toml import Section

# SI units in one unit of a file
MM = 1e-3
MS = 1e-3
KPA = 1e3
ML = 1e-6
ML_S_KPA = 1e-9
PERCENT = 1e-2
DEGREE = math.pi / 180

_REQUIRED: Any = ...

T = TypeVar("T")
_FILE = "file"


@dataclass(frozen=True, kw_only=True)
class SectionEntry(Entry):
    """Section for a nested dataclass, or a list of `count` (minimum, maximum) such sections."""

    kind: type
    count: tuple[int, int] | None = None

    def read(self, section: Section, default: Any) -> Any:
        if self.count is not None:
            found = section.sections(self.key, *self.count)
            return tuple(read(self.kind, own) for own in found)
        own = section.section(self.key) if default is ... else section.optional(self.key)
        return default if own is None else read(self.kind, own)

    def write(self, value: Any) -> dict[str, Any]:
        if self.count is not None:
            return {self.key: [write(item) for item in value]}
        return {self.key: None if value is None else write(value)}


# -- fields of a dataclass


def entry(
    found: Entry, default: Any = _REQUIRED, *, more: Mapping[str, Any] | None = None, **options: Any
) -> Any:
    """Return a dataclass field that is stored in files according to `found`.

    Without a `default` (SI) the file must contain it. `more` is additional metadata, `options` are
    those of `dataclasses.field`.
    """
    if default is not _REQUIRED:
        options["default"] = default
    return dataclasses.field(metadata={_FILE: found, **(more or {})}, **options)


def number(
    key: str, low: float, high: float, unit: float = 1.0, *, default: Any = _REQUIRED, **more: Any
) -> Any:
    """Return a numeric field within [`low`, `high`] of the file's unit, which has `unit` SI units.

    `key` is its name in the file, with the unit. Without a `default` (SI) the file must contain it.
    `more` are `about`, `required`, `only_if` and `group` of `Entry`.
    """
    return entry(Number(key=key, low=low, high=high, unit=unit, **more), default)


def integer(key: str, low: int, high: int, *, default: Any = _REQUIRED, **more: Any) -> Any:
    """Return an integer field; see `number`."""
    return entry(Number(key=key, low=low, high=high, integer=True, **more), default)


def numbers(
    key: str,
    names: Sequence[str],
    low: float,
    high: float,
    unit: float = 1.0,
    *,
    default: Any = _REQUIRED,
    **more: Any,
) -> Any:
    """Return a field that is a tuple of numbers, one for each of `names`; see `number`."""
    found = Numbers(key=key, names=names, low=low, high=high, unit=unit, **more)
    return entry(found, default)


def text(
    key: str, choices: Sequence[str] | None = None, *, default: Any = _REQUIRED, **more: Any
) -> Any:
    """Return a text field, restricted to `choices` if given; see `number`."""
    chosen = None if choices is None else tuple(choices)
    return entry(Text(key=key, choices=chosen, **more), default)


def flag(key: str, *, default: bool, about: str = "") -> Any:
    """Return a field that is true or false."""
    return entry(Flag(key=key, about=about), default)


def file_path(key: str, *, shipped: bool = False, compare: bool = True) -> Any:
    """Return a field that names another file; None if the key is missing; see `FilePath`."""
    return entry(FilePath(key=key, shipped=shipped), None, compare=compare)


def part(key: str, kind: type, *, default: Any = _REQUIRED, about: str = "") -> Any:
    """Return a field that is a separate section."""
    return entry(SectionEntry(key=key, kind=kind, about=about), default)


def parts(key: str, kind: type, low: int = 1, high: int = 2) -> Any:
    """Return a field that is a tuple of `low` to `high` sections."""
    return entry(SectionEntry(key=key, kind=kind, count=(low, high)))


def given() -> Any:
    """Return a field that is not in files; the caller of `read` passes its value."""
    return dataclasses.field()


# -- reading and writing


def entries(kind: type) -> dict[str, Any]:
    """Return the `Entry` of each dataclass field stored in files, by the field's name."""
    return {
        field.name: field.metadata[_FILE]
        for field in dataclasses.fields(kind)
        if _FILE in field.metadata
    }


def default_of(kind: type, name: str) -> Any:
    """Return the default of a dataclass field; `...` if it has none."""
    value = kind.__dataclass_fields__[name].default
    return ... if value is dataclasses.MISSING else value


def scalars(kind: type) -> Iterator[tuple[str, str, str, Number]]:
    """Yield "section.key" of the file, attribute of the section, attribute in it, and entry of each
    single number of a class whose fields are sections."""
    for owner, section in entries(kind).items():
        if not isinstance(section, SectionEntry):
            continue
        for name, found in entries(section.kind).items():
            if type(found) is Number:
                yield f"{section.key}.{found.key}", owner, name, found


def read(kind: type[T], section: Section, **given: Any) -> T:
    """Read a dataclass from a section of a file, SI. On return, all keys have been checked.

    Fields without an `Entry` keep their defaults. Those in `given` (SI) are not read. Raises
    InputError that names file, field and value if one is missing, unknown, of the wrong type, out
    of range, or inconsistent.
    """
    if not given and hasattr(kind, "from_section"):
        value = kind.from_section(section)  # type: ignore[attr-defined]
    else:
        value = kind(**read_fields(kind, section, **given))
    section.done()
    if hasattr(value, "validate"):
        value.validate(section)  # type: ignore[attr-defined]
    return value


def read_fields(kind: type, section: Section, **given: Any) -> dict[str, Any]:
    """Return the fields of `kind` in the section by name, in addition to those in `given`; see
    `read`."""
    values = dict(given)
    for name, found in entries(kind).items():
        if name in values or not found.applies(values):
            continue
        default = ... if found.required else default_of(kind, name)
        values[name] = found.read(section, default)
    return values


def write(value: Any) -> dict[str, Any]:
    """Return a dataclass as a file's table: keys with values in the file's units."""
    if hasattr(value, "to_table"):
        return value.to_table()
    return write_fields(value)


def write_fields(value: Any) -> dict[str, Any]:
    """Return the fields that have an entry as a file's table; see `write`."""
    table: dict[str, Any] = {}
    for name, found in entries(type(value)).items():
        if found.applies(vars(value)):
            table |= found.write(getattr(value, name))
    return table


def from_table(kind: type[T], table: Mapping[str, Any], source: str, **given: Any) -> T:
    """Read a dataclass from the table of a parsed file; see `read`."""
    return read(kind, Section(table, "", source), **given)
