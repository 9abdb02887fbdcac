"""How far a force may be off where what presses a film is narrow for its grid, and how fine a grid
would do.

A contact narrower than a few cells hangs on where it lies between the nodes; what has edges is a
little too soft. By how much is a table: of balls, rods, pins and blades of 0.4 to 16 mm at random
places and angles against films of 81 x 61 and 121 x 91 nodes, and of the presses of the independent
sheet. How well it does on bodies that it was not made of: docs/validation/benchmarks.md, "The
film".
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mjtactile.core.types import Array
from mjtactile.quasistatic.obstacles import KINDS, Obstacle

REFINED = (1.0, 1.5, 2.0, 3.0, 4.0)  # times as fine, of grids that are tried
SPACING = 2e-3  # m, of the grid that the table is of; on finer ones it falls in proportion
_CONE, _QUADRIC = KINDS["cone"][0], KINDS["quadric"][0]
_EDGED = {KINDS[kind][0] for kind in ("box", "cylinder", "disc", "wedge", "mesh")}
_TIP, _AT_EDGES = 0.4, 0.07
# Widths over spacing, from which on 9 of 10 forces are within a share.
_SHARES = ((8.0, 0.03), (4.0, 0.06), (3.0, 0.07), (2.0, 0.14), (0.0, 0.25))
# The same of contacts by the number of nodes that touch, on any grid.
_FEW = ((8, 0.0), (5, 0.04), (3, 0.08), (2, 0.14), (0, 0.3))
# Of an area, by the contact's width in nodes: of faces, and of what is round.
_FACES = ((2.5, 0.15), (1.6, 0.2), (1.2, 0.3), (0.0, 0.8))
_ROUND = ((2.6, 0.12), (2.1, 0.5))
_FLAT = 1e-5  # m, of corners that are as low
_UPRIGHT = 0.9998  # cosine; half a millimetre over 25
_LEVEL = 1e-6  # of a cylinder's end
_SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])


def doubt(obstacles: Sequence[Obstacle], spacing: float) -> float:
    """Share of the force within which 9 of 10 are, by the narrowest of the bodies.

    Args:
        obstacles: Bodies that press; what a mesh or triangles have of tips and edges is not seen.
        spacing: m, of the grid.

    Returns:
        The share; of no bodies 0.
    """
    return row_error([one.numbers for one in obstacles], spacing)


def row_error(rows: Sequence[Array] | Array, spacing: float) -> float:
    """The same of bodies' numbers (k, NUMBERS) as the kernel takes them."""
    return max((_share(row, spacing) for row in rows), default=0.0) * (spacing / SPACING)


def error_of_few_nodes(nodes: int) -> float:
    """The same share because so few nodes touch, however wide the body is."""
    return next(share for least, share in _FEW if nodes >= least)


def gap_error(gap: float, force: float, tension: float) -> float:
    """The same share because the lowest place of a body is behind the sheet: a tip between nodes,
    which a sheet under tension `tension` would not let through.

    Args:
        gap: m, how far.
        force: N, of the state.
        tension: N/m.

    Returns:
        The share, 1 at most.
    """
    return min(max(gap, 0.0) * tension / force, 1.0)


def area_error(obstacles: Sequence[Obstacle], width: float, spacing: float) -> float:
    """Share of the contact area within which 9 of 10 are, by how wide the contact is.

    Args:
        obstacles: What presses.
        width: Nodes that touch over those along the contact's longer side.
        spacing: m, of the grid.

    Returns:
        The share; infinite where the contact is a point or a line for this grid: of edges and tips,
        of what is round until it is two nodes wide, of a face that is thinner than half a spacing.
    """
    if all(_is_face(one) for one in obstacles):
        thin = min((one.numbers[18] for one in obstacles), default=np.inf) < spacing / 2
        shares = _FACES[:-1] if thin else _FACES
    elif any(one.numbers[0] in _EDGED or one.numbers[0] == _CONE for one in obstacles):
        shares = ()
    else:
        shares = _ROUND
    return next((share for least, share in shares if width >= least), float("inf"))


def _is_face(body: Obstacle) -> bool:
    """Whether it lies on the sheet with a flat face."""
    up = np.abs(body.numbers[10:13])
    if body.kind in ("cylinder", "disc"):
        return bool(up[2] > _UPRIGHT)
    return body.kind == "plane" or (body.kind == "box" and bool(up.max() > _UPRIGHT))


def lowest_place(body: Obstacle) -> Array | None:
    """Where a body is lowest, (3,) m in S; None for what has no such place of its own (planes,
    heights over nodes)."""
    row = body.numbers
    R, place, sizes = row[4:13].reshape(3, 3), row[13:16], row[1:4]
    up = R[2]  # S's z, in the body's frame
    if body.kind in ("plane", "heights"):
        return None
    if body.kind in ("cone", "quadric"):
        return place  # a tip, or a pole, that points down
    if body.corners is not None or body.kind in ("triangles", "box"):
        return _lowest_of(_ends(body), R) + place
    if body.kind == "ellipsoid":
        return place - R @ (sizes**2 * up) / np.linalg.norm(sizes * up)
    axial = np.array([0.0, 0.0, -np.sign(up[2])])
    if body.kind == "sphere":
        return place - np.array([0.0, 0.0, sizes[0]])
    if body.kind == "capsule":
        return place + R @ (sizes[1] * axial) - np.array([0.0, 0.0, sizes[0]])
    rounded = sizes[2] if body.kind == "disc" else 0.0  # else a cylinder
    across = np.array([up[0], up[1], 0.0])
    lean = float(np.linalg.norm(across))
    rim = (rounded - sizes[0]) * across / lean if lean > _LEVEL else np.zeros(3)
    return place + R @ ((sizes[1] - rounded) * axial + rim) - np.array([0.0, 0.0, rounded])


def _ends(body: Obstacle) -> Array:
    if body.corners is not None:
        return body.corners
    if body.kind == "triangles":
        return body.pool.reshape(-1, 3)
    return body.numbers[1:4] * _SIGNS


def _lowest_of(corners: Array, R: Array) -> Array:
    """Of corners (n, 3) in a body's frame, in S about its place: the middle of those that are as
    low as the lowest."""
    at = corners @ R.T
    return at[at[:, 2] < at[:, 2].min() + _FLAT].mean(axis=0)


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
