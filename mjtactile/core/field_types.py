"""The kinds of entries that files have: how each is read, and written."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjtactile.core.lens import MODELS, PLUMB_BOB
from mjtactile.core.toml import Section


@dataclass(frozen=True, kw_only=True)
class Entry:
    """Entry of a field in a file: its `key` and its description `about`.

    `only_if` holds the name and values of another field, read before. The entry is read only if
    that field has one of these values. `required`: the file must contain it, even if the class has
    a default. `group` is the section of a variation file that may randomize it.
    """

    key: str
    about: str = ""
    required: bool = False
    only_if: tuple[str, tuple[str, ...]] | None = None
    group: str = ""

    def applies(self, values: Mapping[str, Any]) -> bool:
        """Return True if the values of the other fields permit this one."""
        return self.only_if is None or values[self.only_if[0]] in self.only_if[1]

    def read(self, section: Section, default: Any) -> Any:
        """Return the section's value, SI; `default` if the key is missing (`...`: an error)."""
        raise NotImplementedError

    def write(self, value: Any) -> dict[str, Any]:
        """Return the file's entry for an SI value; infinity is left out, since files cannot contain
        it."""
        return {self.key: value}


def in_unit(value: float, unit: float) -> float:
    """Convert an SI value to a file's `unit`, so that reading it gives the same bits."""
    found = value / unit
    for candidate in (found, math.nextafter(found, math.inf), math.nextafter(found, -math.inf)):
        if candidate * unit == value:
            return candidate
    return found


@dataclass(frozen=True, kw_only=True)
class Number(Entry):
    """Number within [low, high] of the file's `unit` (SI units in one of it)."""

    low: float
    high: float
    unit: float = 1.0
    integer: bool = False

    def read(self, section: Section, default: Any) -> Any:
        if self.integer:
            return section.integer(self.key, int(self.low), int(self.high), default)
        return section.number(self.key, self.low, self.high, self.unit, default)

    def write(self, value: Any) -> dict[str, Any]:
        if value is None or self.integer:
            return {self.key: value}
        return {} if math.isinf(value) else {self.key: in_unit(value, self.unit)}


@dataclass(frozen=True, kw_only=True)
class Numbers(Number):
    """List with one number for each of `names`; without names, integers of any count."""

    names: Sequence[str] = ()

    def read(self, section: Section, default: Any) -> Any:
        low = self.low
        high = self.high
        if self.names:
            return section.numbers(
                self.key, self.names, low, high, self.unit, default, integer=self.integer
            )
        return section.wholes(self.key, int(low), int(high), default)

    def write(self, value: Any) -> dict[str, Any]:
        items = [item if self.integer else in_unit(item, self.unit) for item in value]
        return {self.key: items}


@dataclass(frozen=True, kw_only=True)
class LensCoefficients(Number):
    """List of the coefficients of the lens model that the same section names."""

    def read(self, section: Section, default: Any) -> Any:
        model = section.text("distortion_model", MODELS, PLUMB_BOB)
        names = MODELS[model].coefficients
        return section.numbers(self.key, names, self.low, self.high, self.unit, default)

    def write(self, value: Any) -> dict[str, Any]:
        return {self.key: list(value)}


@dataclass(frozen=True, kw_only=True)
class Span(Number):
    """Two keys, a lowest value (0 where it is left out) and a highest above it."""

    low_key: str

    def read(self, section: Section, default: Any) -> tuple[float, float]:
        low = section.number(self.low_key, self.low, self.high, self.unit, default=0.0)
        high = section.number(self.key, self.low, self.high, self.unit)
        if high <= low:
            message = f"{high / self.unit:g} is not above {self.low_key} = {low / self.unit:g}"
            raise section.fail(self.key, message)
        return low, high

    def write(self, value: Any) -> dict[str, Any]:
        return {self.low_key: value[0] / self.unit, self.key: value[1] / self.unit}


@dataclass(frozen=True, kw_only=True)
class Pairs(Entry):
    """A list of pairs, each of two units."""

    units: tuple[float, float]

    def read(self, section: Section, default: Any) -> Any:
        a, b = self.units
        return tuple((first * a, second * b) for first, second in section.pairs(self.key))

    def write(self, value: Any) -> dict[str, Any]:
        a, b = self.units
        return {self.key: [[first / a, second / b] for first, second in value]}


@dataclass(frozen=True, kw_only=True)
class NumberArray(Entry):
    """Nested lists of numbers of this `shape` (None: any length), as a read-only array."""

    shape: tuple[int | None, ...]
    unit: float = 1.0

    def read(self, section: Section, default: Any) -> Any:
        found = section.array(self.key, self.shape) * self.unit
        found.flags.writeable = False
        return found

    def write(self, value: Any) -> dict[str, Any]:
        return {self.key: (np.asarray(value) / self.unit).tolist()}


@dataclass(frozen=True, kw_only=True)
class Text(Entry):
    """Text, one of `choices` where there are any."""

    choices: tuple[str, ...] | None = None

    def read(self, section: Section, default: Any) -> Any:
        return section.text(self.key, self.choices, default)


@dataclass(frozen=True, kw_only=True)
class Texts(Entry):
    """A list of texts."""

    def read(self, section: Section, default: Any) -> Any:
        return section.texts(self.key, default)

    def write(self, value: Any) -> dict[str, Any]:
        return {self.key: list(value)}


@dataclass(frozen=True, kw_only=True)
class Flag(Entry):
    """True or false."""

    def read(self, section: Section, default: Any) -> Any:
        return section.flag(self.key, default)


@dataclass(frozen=True, kw_only=True)
class FilePath(Entry):
    """Another file, relative to the folder of this one. With `shipped`, as text: the name of one
    that ships, or else a file that ends in .toml."""

    shipped: bool = False

    def read(self, section: Section, default: Any) -> Any:
        name = section.text(self.key, default=default)
        if name is None or name is default:
            return name
        if not self.shipped:
            return section.folder / name
        return str(section.folder / name) if name.endswith(".toml") else name

    def write(self, value: Any) -> dict[str, Any]:
        return {self.key: None if value is None else str(value)}


@dataclass(frozen=True, kw_only=True)
class Table(Entry):
    """A table with unchecked content."""

    def read(self, section: Section, default: Any) -> Any:
        return section.table(self.key)

    def write(self, value: Any) -> dict[str, Any]:
        return {self.key: dict(value)}
