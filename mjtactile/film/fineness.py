"""How far a force may be off where what presses a film is narrow for its grid, and how fine a grid
would do.

A contact narrower than a few cells hangs on where it lies between the nodes; what has edges is a
little too soft. By how much is a table: of balls, rods, pins and blades of 0.4 to 16 mm at random
places and angles against films of 81 x 61 and 121 x 91 nodes, and of the presses of the independent
sheet. How well it does on bodies that it was not made of: docs/benchmarks.md, "The film".
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mjtactile.core.types import Array
from mjtactile.film.bodies import KINDS, Obstacle

REFINED = (1.0, 1.5, 2.0, 3.0, 4.0)  # times as fine, of grids that are tried
SPACING = 2e-3  # m, of the grid that the table is of; on finer ones it falls in proportion
_CONE, _QUADRIC = KINDS["cone"][0], KINDS["quadric"][0]
_EDGED = {KINDS[kind][0] for kind in ("box", "cylinder", "disc", "wedge", "mesh")}
_TIP, _AT_EDGES = 0.4, 0.07
# Widths over spacing, from which on 9 of 10 forces are within a share.
_SHARES = ((8.0, 0.03), (4.0, 0.06), (3.0, 0.07), (2.0, 0.14), (0.0, 0.25))
# The same of contacts by the number of nodes that touch, on any grid.
_FEW = ((8, 0.0), (5, 0.04), (3, 0.08), (0, 0.14))


def doubt(obstacles: Sequence[Obstacle], spacing: float) -> float:
    """Share of the force within which 9 of 10 are, by the narrowest of the bodies.

    Args:
        obstacles: Bodies that press; what a mesh or triangles have of tips and edges is not seen.
        spacing: m, of the grid.

    Returns:
        The share; of no bodies 0.
    """
    return doubt_of_rows([one.numbers for one in obstacles], spacing)


def doubt_of_rows(rows: Sequence[Array] | Array, spacing: float) -> float:
    """The same of bodies' numbers (k, NUMBERS) as the kernel takes them."""
    return max((_share(row, spacing) for row in rows), default=0.0) * (spacing / SPACING)


def doubt_of_few(nodes: int) -> float:
    """The same share because so few nodes touch, however wide the body is."""
    return next(share for least, share in _FEW if nodes >= least)


def _share(row: Array, spacing: float) -> float:
    if row[0] == _CONE:
        return _TIP
    wide = _width(row) / spacing
    share = next(share for least, share in _SHARES if wide >= least)
    return max(share, _AT_EDGES) if row[0] in _EDGED else share


def _width(row: Array) -> float:
    """How wide, m, a body is where it is thinnest; of a bowl, twice its least radius."""
    if row[0] != _QUADRIC:
        return float(row[18])
    curvature = float(np.max(row[1:3]))
    return 2 / curvature if curvature > 0 else np.inf
