"""Empty figures for image files.

matplotlib is optional. Without it only the figures are missing.
"""

from __future__ import annotations

import sys
from typing import Any


def new_figure(name: str, size: tuple[float, float], dpi: int = 110) -> Any:
    """Create a figure of `size` inches; None, with a warning, without matplotlib."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        sys.stderr.write(
            f"mjtactile: warning: {name} was not plotted: pip install 'mjtactile[plots]'\n"
        )
        return None
    figure = Figure(figsize=size, dpi=dpi, layout="constrained")
    FigureCanvasAgg(figure)
    return figure
