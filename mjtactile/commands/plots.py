"""Pictures that the commands write; matplotlib is an optional dependency and only its pictures are lost without it."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any


def save(path: Path, draw: Callable[[Any], None], size: tuple[float, float] = (7.0, 4.6)) -> None:
    """Let `draw` fill a figure of `size` inches and write it to `path`; without matplotlib say so on stderr."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        print(f"mjtactile: warning: {path.name} was not drawn: pip install 'mjtactile[plots]'", file=sys.stderr)
        return
    figure = Figure(figsize=size, dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    draw(figure)
    figure.savefig(path)
