"""Figures written by the commands. They require matplotlib, which is optional; without it only the
figures are missing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from mjtactile.report.figures import new_figure


def save(path: Path, draw: Callable[[Any], None], size: tuple[float, float] = (7.0, 4.6)) -> None:
    """Plot with `draw` into a figure of `size` inches and write it to `path`. Without matplotlib,
    print a message to stderr."""
    if (figure := new_figure(path.name, size)) is not None:
        draw(figure)
        figure.savefig(path)
