"""`mjtactile bench headline`: the few numbers that the README shows. See `benchmarks.numbers`."""

from __future__ import annotations

from benchmarks.numbers import headline_table as table
from benchmarks.numbers import run

__all__ = ["run", "table"]
