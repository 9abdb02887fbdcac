"""Figure with one part of an image under each fault."""

from __future__ import annotations

from pathlib import Path

from benchmarks.camera_faults.fault_kinds import ALWAYS, TABLES, Kind, label
from benchmarks.camera_faults.replay import Grasp
from mjtactile.report.figures import new_figure
from mjtactile.sim.rendering.image_faults import FaultyImage

_COLUMNS = 8
_PART = (slice(150, 330), slice(230, 410))


def render(grasp: Grasp, path: Path) -> None:
    """Render the figure: a part of the last of three images under each fault."""
    rows = -(-len(TABLES) // _COLUMNS)
    figure = new_figure(path.name, (1.7 * _COLUMNS, 1.95 * rows))
    if figure is None:
        return
    center = len(grasp.images) // 2
    for number, (name, table, _) in enumerate(TABLES):
        camera = FaultyImage(Kind(name, table, ALWAYS, 5).faults, 5)
        shown = [camera(image) for image in grasp.images[center - 2 : center + 1]][-1]
        axes = figure.add_subplot(rows, _COLUMNS, number + 1)
        axes.imshow(shown.pixels[_PART], cmap="gray", vmin=0, vmax=255)
        axes.set_title(label(name), fontsize=6)
        axes.set_axis_off()
    figure.savefig(path)
