"""`mjtactile bench command-page`: the table of the fields of `Command`, from their contract."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mjtactile.core.types.command import COMMAND_FIELDS, command_table


def run(out: Path, quick: bool = False) -> dict[str, Any]:
    """Return the names of the fields."""
    return {"fields": list(COMMAND_FIELDS)}


def table(result: Mapping[str, Any]) -> str:
    """Return the fields as a table in Markdown."""
    return command_table()
