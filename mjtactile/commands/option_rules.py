"""Tables of options that need others, checked before a command runs.

A command's `RULES` lists its options that would otherwise be ignored.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

from mjtactile.commands.arguments import Addable, Argument, Group, OneOf


@dataclass(frozen=True)
class Rule:
    """The `options` have an effect only if `applies`; `needed` is what to give or to leave out."""

    options: tuple[str, ...]
    applies: Callable[[argparse.Namespace], bool]
    needed: str


def check(options: argparse.Namespace, arguments: Iterable[Addable], rules: Sequence[Rule]) -> None:
    """Check the given options of a command.

    Args:
        options: The parsed options.
        arguments: The command's table of arguments.
        rules: The command's rules.

    Raises:
        InputError: A given option has no effect.
    """
    given = {
        name
        for argument in _single(arguments)
        if _is_given(options, argument)
        for name in argument.names
    }
    for rule in rules:
        ignored = [name for name in rule.options if name in given]
        if ignored and not rule.applies(options):
            from mjtactile import InputError  # elsewhere, so that --help stays fast

            raise InputError(f"has no effect {rule.needed}", field=ignored[0])


def replays(options: argparse.Namespace) -> bool:
    """Return True if the rig is a recording."""
    return (options.rig or "").partition(":")[0] == "replay"


def _single(arguments: Iterable[Addable]) -> Iterator[Argument]:
    for argument in arguments:
        if isinstance(argument, (Group, OneOf)):
            yield from _single(argument.arguments)
        elif isinstance(argument, Argument):
            yield argument


def _is_given(options: argparse.Namespace, argument: Argument) -> bool:
    """Return True if the value is not the default; a given default has no effect."""
    settings = argument.settings
    name = settings.get("dest", argument.names[0].lstrip("-").replace("-", "_"))
    is_flag = settings.get("action") == "store_true"
    default = settings.get("default", False if is_flag else None)
    if isinstance(default, str) and "type" in settings:
        default = settings["type"](default)  # as argparse does
    return getattr(options, name) != default
