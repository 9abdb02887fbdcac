"""Command arguments as a table: a tuple of values that each can be added to a parser.

A command's `ARGUMENTS` lists its arguments in the order of its `--help`. Each help text ends with
the default, unless it has none or the text mentions it already.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

MAX_STEPS = 10_000


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
        settings = self.settings
        if settings.get("type") is Path:
            settings = settings | {"type": path}
        elif (
            settings.get("type", str) is str
            and settings.get("action", "append") == "append"
            and "choices" not in settings
        ):
            settings = settings | {"type": text}
        parser.add_argument(*self.names, **settings)


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
    """Return an argument without a name; with `nargs="?"` it is optional."""
    return Argument((name,), {"metavar": metavar, "help": help} | settings)


def option(usage: str, help: str, default: Any = None, **settings: Any) -> Argument:
    """Return the option `--name VALUE`, or `--name --other VALUE` with several names.

    `usage` is its form in the help, `default` the value if it is not given. `settings` are further
    settings for argparse: type, dest, required, nargs.
    """
    names, metavar = _split(usage)
    named = {"metavar": metavar, "help": _with_default(help, default), "default": default}
    return Argument(names, named | settings)


def repeated(usage: str, help: str, **settings: Any) -> Argument:
    """Return an option that may be given several times: a list, empty without it."""
    names, metavar = _split(usage)
    named = {"metavar": metavar, "help": help, "action": "append", "default": []}
    return Argument(names, named | settings)


def _split(usage: str) -> tuple[tuple[str, ...], Any]:
    """Split "--name VALUE" into its names and the name of its value, or those of several."""
    words = usage.split()
    names = tuple(word for word in words if word.startswith("--"))
    values = tuple(words[len(names) :])
    return names, values if len(values) > 1 else values[0] if values else None


def choice(
    name: str, choices: Collection[str], help: str, default: Any = None, **settings: Any
) -> Argument:
    """Return the option `--name {a,b}` with one of few words."""
    named = {"choices": choices, "help": _with_default(help, default), "default": default}
    return Argument((name,), named | settings)


def flag(name: str, help: str, **settings: Any) -> Argument:
    """Return the switch `--name`."""
    return Argument((name,), {"action": "store_true", "help": help} | settings)


def sensor(help: str = "the sensor", default: str | None = "dense", **settings: Any) -> Argument:
    """Return the option `--sensor`, a shipped name or a file."""
    return option("--sensor NAME|FILE.toml", help, default, **settings)


def out(help: str, metavar: str = "DIR", **settings: Any) -> Argument:
    """Return the option `--out`, the destination of results."""
    return option(f"--out {metavar}", help, type=Path, **settings)


def _with_default(help: str, default: Any) -> str:
    if default in (None, "") or "default" in help:
        return help
    value = f"{default:g}" if isinstance(default, float) else default
    return f"{help} (default: {value})"


# -- readers of values: each takes the text of an option, and raises argparse's error


def number(
    low: float = -math.inf, high: float = math.inf, *, above: bool = False
) -> Callable[[str], float]:
    """Return a reader of a finite number from `low` to `high`; with `above`, without `low`."""
    return _reader(float, low, high, above)


def integer(low: int, high: float = math.inf) -> Callable[[str], int]:
    """Return a reader of an integer from `low` to `high`."""
    return _reader(int, low, high, False)


def _reader(convert: Callable[[str], Any], low: float, high: float, above: bool) -> Any:
    limits = f"above {low:g}" if above else f"of at least {low:g}"
    if math.isfinite(high):
        limits = f"above {low:g}, up to {high:g}" if above else f"from {low:g} to {high:g}"
    kind = "an integer" if convert is int else "a number"
    expected = f"{kind} {limits}" if math.isfinite(low) else "a finite number"

    def read(text: str) -> Any:
        try:
            value = convert(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value) or not low <= value <= high or (above and value == low):
            raise argparse.ArgumentTypeError(f"{text!r} is not {expected}")
        return value

    return read


POSITIVE = number(0, above=True)


def path(text: str) -> Path:
    """Read a path; an empty one, such as that of an unset shell variable, is the working folder."""
    if not text:
        raise argparse.ArgumentTypeError("is empty, not a path")
    if "\0" in text:
        raise argparse.ArgumentTypeError(f"{text!r} contains a null character")
    return Path(text)


def text(written: str) -> str:
    """Read a text; an empty one, such as that of an unset shell variable, is no value."""
    if not written:
        raise argparse.ArgumentTypeError("is empty; leave the option out for its default")
    return written


def pair(text: str) -> tuple[float, float]:
    """Read "X,Y"."""
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        x = y = math.nan
    if not (math.isfinite(x) and math.isfinite(y)):
        raise argparse.ArgumentTypeError(f"{text!r} is not a pair of numbers X,Y")
    return x, y


def mesh(text: str) -> tuple[int, int]:
    """Read "NXxNY"."""
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.isascii() and part.isdigit() for part in parts):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of vertices NXxNY")
    counts = [int(part[:6]) for part in parts]
    if not all(5 <= count <= 101 for count in counts):
        raise argparse.ArgumentTypeError(f"{text!r}: each side has 5 to 101 vertices")
    return counts[0], counts[1]


def values(text: str) -> list[float]:
    """Read "2", or the range "0:4:0.5" (both ends included)."""
    try:
        parsed = [float(part) for part in text.split(":")]
    except ValueError:
        parsed = []
    if len(parsed) not in (1, 3) or not all(map(math.isfinite, parsed)):
        raise argparse.ArgumentTypeError(f"{text!r} is neither a number nor a range A:B:STEP")
    if len(parsed) == 1:
        return parsed
    start, stop, step = parsed
    if step == 0 or (stop - start) / step < 0:
        raise argparse.ArgumentTypeError(
            f"{text!r}: the step {step:g} does not lead from {start:g} to {stop:g}"
        )
    count = math.floor((stop - start) / step + 1e-9) + 1
    if count > MAX_STEPS:
        raise argparse.ArgumentTypeError(
            f"{text!r} has {count} steps; at most {MAX_STEPS} are allowed"
        )
    return [start + i * step for i in range(count)]
