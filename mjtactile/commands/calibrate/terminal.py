"""Terminal input and output of the calibrations: instructions, prompts, results."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mjtactile import InputError
from mjtactile.commands.output import print_json, print_result
from mjtactile.core import foreign_file


def notify(text: str) -> None:
    """Print a message or instruction to stderr; stdout is reserved for the result."""
    print(text, file=sys.stderr, flush=True)


def finish(options: argparse.Namespace, path: Path, result: dict, lines: list[str]) -> int:
    """Print the result; the exit code is 0 for a good calibration and 1 for a refused one."""
    refused = [f"  REFUSED: {reason}" for reason in result["reasons"]]
    text = "\n".join([*lines, *refused, f"  {result['verdict']}; written to {path}"])
    print_result(options, {**result, "file": path}, text)
    return 0 if result["verdict"] == "good" else 1


def finish_all(
    options: argparse.Namespace, results: Mapping[str, tuple[Path, dict[str, Any], list[str]]]
) -> int:
    """Finish the calibration of one or several fingers and return the exit code.

    `results` holds the file, the result and the text lines of each finger. The code is 1 if any
    result was refused.
    """
    if options.json and len(results) > 1:
        reasons = [
            f"{finger}: {reason}"
            for finger, (_, result, _) in results.items()
            for reason in result["reasons"]
        ]
        print_json(
            {
                "verdict": "refused" if reasons else "good",
                "reasons": reasons,
                "fingers": {
                    finger: {**result, "file": path}
                    for finger, (path, result, _) in results.items()
                },
            }
        )
        return 1 if reasons else 0
    return max(
        finish(options, path, result, [f"{finger}:", *lines])
        for finger, (path, result, lines) in results.items()
    )


def _line(prompt: str) -> str:
    print(prompt, end="" if sys.stdin.isatty() else "\n", file=sys.stderr, flush=True)
    line = sys.stdin.readline()
    if not line:
        raise InputError(
            "the terminal input ended; give the readings in a CSV file instead (see --help)"
        )
    return line


def confirm(text: str) -> None:
    """Wait until the user confirms the action in `text`. Raises InputError if the input ends."""
    _line(f"{text}, then press Enter ")


def ask(text: str) -> float | None:
    """Ask for a number on the terminal; an empty line skips. Raises InputError if the input
    ends."""
    while True:
        line = _line(f"{text} [empty: skip]: ")
        if not line.strip():
            return None
        try:
            return float(line.replace(",", "."))
        except ValueError:
            notify(f"{line.strip()!r} is not a number")


def check_folder(path: Path, field: str = "--out") -> Path:
    """Raise InputError if the folder of an output file does not exist, before any work."""
    if not foreign_file.is_dir(path.parent):
        raise InputError("the folder does not exist", source=path.parent, field=field)
    return path
