"""`mjtactile bench flags-page`: the table of all flags, from their registry."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mjtactile.core import flags


def run(out: Path, quick: bool = False) -> dict[str, Any]:
    """Return the names of the flags."""
    return {"flags": list(flags.FLAGS)}


def table(result: Mapping[str, Any]) -> str:
    """Return the registry as a table in Markdown."""
    return flags.table()
