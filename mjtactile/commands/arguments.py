"""Command arguments as a table: a tuple of values that each can be added to a parser.

A command's `ARGUMENTS` lists its arguments in the order of its `--help`. Each help text ends with
the default, unless it has none or the text mentions it already.
"""

from __future__ import annotations

import argparse
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol


class Addable(Protocol):
    """A row of the table."""

    def add_to(self, parser: Any) -> None:
        """Join `parser`, or a group of one."""


@dataclass(frozen=True)
class Argument:
    """Argument with its names and the settings for argparse."""

    names: tuple[str, ...]
    settings: dict[str, Any]

    def add_to(self, parser: Any) -> None:
        parser.add_argument(*self.names, **self.settings)


@dataclass(frozen=True)
class Group:
    """Arguments under a title of their own in the help."""

    title: str
    arguments: tuple[Addable, ...]

    def add_to(self, parser: argparse.ArgumentParser) -> None:
        add(parser.add_argument_group(self.title), self.arguments)


@dataclass(frozen=True)
class OneOf:
    """Arguments that exclude each other."""

    arguments: tuple[Addable, ...]

    def add_to(self, parser: argparse.ArgumentParser) -> None:
        add(parser.add_mutually_exclusive_group(), self.arguments)


def add(parser: Any, arguments: Iterable[Addable]) -> None:
    """Add a table to a parser, or to a group of one."""
    for argument in arguments:
        argument.add_to(parser)


def positional(name: str, metavar: str, help: str, **settings: Any) -> Argument:
    """A value without a name; `nargs="?"` where it may be left out."""
    return Argument((name,), {"metavar": metavar, "help": help} | settings)


def option(names: str, metavar: Any, help: str, default: Any = None, **settings: Any) -> Argument:
    """Return the option `--name VALUE`.

    Args:
        names: `--name`, or several names separated by blanks.
        metavar: Name of the value in the help.
        help: Description of the option.
        default: Value if the option is not given.
        settings: Further argparse settings: type, dest, required, nargs.
    """
    told = {"metavar": metavar, "help": _with_default(help, default), "default": default}
    return Argument(tuple(names.split()), told | settings)


def repeated(name: str, metavar: str | None, help: str, **settings: Any) -> Argument:
    """`--name VALUE`, which may be given again and again: a list, empty where it is not given."""
    told = {"metavar": metavar, "help": help, "action": "append", "default": []}
    return Argument((name,), told | settings)


def choice(
    name: str, choices: Collection[str], help: str, default: Any = None, **settings: Any
) -> Argument:
    """`--name {a,b}`: one of few words."""
    told = {"choices": choices, "help": _with_default(help, default), "default": default}
    return Argument((name,), told | settings)


def flag(name: str, help: str, **settings: Any) -> Argument:
    """`--name`, which is given or not."""
    return Argument((name,), {"action": "store_true", "help": help} | settings)


def sensor(help: str = "the sensor", default: str | None = "dense", **settings: Any) -> Argument:
    """`--sensor`, a shipped name or a file."""
    return option("--sensor", "NAME|FILE.toml", help, default, **settings)


def out(help: str, metavar: str = "DIR", **settings: Any) -> Argument:
    """`--out`, where results go."""
    return option("--out", metavar, help, type=Path, **settings)


def _with_default(help: str, default: Any) -> str:
    if default in (None, "") or "default" in help:
        return help
    said = f"{default:g}" if isinstance(default, float) else default
    return f"{help} (default: {said})"
