"""Option values may start with a minus: numbers, pairs, ranges, effects to switch off.

A parser that takes `-3.2,1.7` for an option reports "expected one argument". Other errors (of a
value that is invalid there) come from the command.
"""

import argparse

import pytest

from mjtactile.cli import _UsageError, build_parser
from mjtactile.commands import COMMANDS


def subparsers(parser, words=()):
    """Yield every command and subcommand with its arguments."""
    nested = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
    if not nested:
        yield words, parser
    for action in nested:
        for name, sub in action.choices.items():
            yield from subparsers(sub, (*words, name))


PARSER = build_parser(*COMMANDS)
OPTIONS = [
    (words, action.option_strings[0], action.nargs or 1)
    for words, parser in subparsers(PARSER)
    for action in parser._actions
    if action.option_strings and action.nargs != 0
]


@pytest.mark.parametrize("value", ["-3.2,1.7", "-2:2:0.5", "-1", "-.5", "-1e-3", "-latency"])
def test_an_option_takes_a_value_with_a_leading_minus(value):
    assert len(OPTIONS) > 50  # of all commands
    for words, option, count in OPTIONS:
        try:
            PARSER.parse_args([*words, option, *[value] * (count if isinstance(count, int) else 1)])
        except _UsageError as error:
            assert "expected" not in str(error), (words, option)


@pytest.mark.parametrize(
    ("words", "name", "value"),
    [
        (
            ["press", "--indenter", "sphere:8", "--position-mm", "-3.2,1.7"],
            "position_mm",
            (-3.2, 1.7),
        ),
        (
            ["press", "--indenter", "sphere:8", "--depth-mm", "-0.5:1:0.5"],
            "depths",
            [-0.5, 0.0, 0.5, 1.0],
        ),
        (["press", "--indenter", "sphere:8", "--tilt-deg", "-10"], "tilt_deg", -10.0),
        (["grasp", "--effects", "-latency,+shadows"], "effects", "-latency,+shadows"),
        (["grasp", "--effects", "-follower pressure"], "effects", "-follower pressure"),
    ],
)
def test_the_value_equals_the_written_text(words, name, value):
    assert getattr(PARSER.parse_args(words), name) == value


def test_an_empty_path_is_refused():
    """An unset shell variable gives an empty path, which would be the working folder."""
    with pytest.raises(_UsageError, match="--out: is empty, not a path"):
        PARSER.parse_args(["grasp", "--out", ""])


def test_the_help_names_each_default():
    silent = [
        (words, action.dest)
        for words, parser in subparsers(PARSER)
        for action in parser._actions
        if action.default not in (None, "", False, [], argparse.SUPPRESS)
        and "default" not in (action.help or "")
    ]
    assert silent == []
