"""`mjtactile bench readme-table`: the few numbers that the README shows. See
`benchmarks.results_tables`."""

from __future__ import annotations

from benchmarks.results_tables import headline_table as table
from benchmarks.results_tables import run

__all__ = ["run", "table"]
