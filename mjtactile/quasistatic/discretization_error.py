"""Discretization error of the quasi-static membrane for narrow obstacles, and sufficient grids.

The force of a contact narrower than a few cells depends on its position between the nodes. Edged
obstacles are slightly too soft. The table comes from balls, rods, pins and blades of 0.4 to 16 mm
at random poses, compared with membranes of 81 x 61 and 121 x 91 nodes and with the independent
membrane model. For its accuracy see docs/validation/benchmarks/quasistatic.md.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mjtactile.core.types import Array
from mjtactile.quasistatic.obstacles import KINDS, Obstacle

REFINED = (1.0, 1.5, 2.0, 3.0, 4.0)  # refinement factors of the candidate grids
SPACING = 2e-3  # grid spacing of the table, m; the error is proportional to the spacing
_CONE, _QUADRIC = KINDS["cone"][0], KINDS["quadric"][0]
_EDGED = {KINDS[kind][0] for kind in ("box", "cylinder", "disc", "wedge", "mesh")}
_TIP, _AT_EDGES = 0.4, 0.07
# Minimum width over spacing, and the relative error not exceeded by 9 of 10 forces.
_SHARES = ((8.0, 0.03), (4.0, 0.06), (3.0, 0.07), (2.0, 0.14), (0.0, 0.25))
# The same by the minimum number of nodes in contact, on any grid.
_FEW = ((8, 0.0), (5, 0.04), (3, 0.08), (2, 0.14), (0, 0.3))
# Area error by the contact's width in nodes, for faces and for round obstacles.
_FACES = ((2.5, 0.15), (1.6, 0.2), (1.2, 0.3), (0.0, 0.8))
_ROUND = ((2.6, 0.12), (2.1, 0.5))
_FLAT = 1e-5  # height tolerance of the lowest corners, m
_UPRIGHT = 0.9998  # cosine; half a millimetre over 25
_LEVEL = 1e-6  # of a cylinder's end
_SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])


def relative_force_error(obstacles: Sequence[Obstacle], spacing: float) -> float:
    """Return the relative force error not exceeded in 9 of 10 cases, from the narrowest obstacle.

    Tips and edges of a mesh or of triangles are not detected.
    """
    return row_error([obstacle.parameters for obstacle in obstacles], spacing)


def row_error(rows: Sequence[Array] | Array, spacing: float) -> float:
    """Return the same error for obstacle rows (k, NUMBERS) in the kernel's format."""
    return max((_fraction(row, spacing) for row in rows), default=0.0) * (spacing / SPACING)


def error_of_few_nodes(nodes: int) -> float:
    """Return the same error from the number of nodes in contact, for any obstacle width."""
    return next(fraction for minimum, fraction in _FEW if nodes >= minimum)


def gap_error(gap: float, force: float, tension: float) -> float:
    """Return the relative force error of a lowest point `gap` m behind the membrane, at most 1.

    This happens for a tip between nodes, which a real membrane under `tension` N/m would stop.
    """
    return min(max(gap, 0.0) * tension / force, 1.0)


def area_error(obstacles: Sequence[Obstacle], width: float, spacing: float) -> float:
    """Return the relative area error not exceeded in 9 of 10 cases.

    `width` is the number of nodes in contact over that along the contact's longer side. The error
    is infinite if the contact is a point or a line on this grid: for edges and tips, for round
    obstacles below two nodes of width, and for faces thinner than half a spacing.
    """
    if all(_is_face(obstacle) for obstacle in obstacles):
        thin = (
            min((obstacle.parameters[18] for obstacle in obstacles), default=np.inf) < spacing / 2
        )
        fractions = _FACES[:-1] if thin else _FACES
    elif any(
        obstacle.parameters[0] in _EDGED or obstacle.parameters[0] == _CONE
        for obstacle in obstacles
    ):
        fractions = ()
    else:
        fractions = _ROUND
    return next((fraction for minimum, fraction in fractions if width >= minimum), float("inf"))


def _is_face(body: Obstacle) -> bool:
    """Return True if the obstacle touches the membrane with a flat face."""
    up = np.abs(body.parameters[10:13])
    if body.kind in ("cylinder", "disc"):
        return bool(up[2] > _UPRIGHT)
    return body.kind == "plane" or (body.kind == "box" and bool(up.max() > _UPRIGHT))


def lowest_point(body: Obstacle) -> Array | None:
    """Return the lowest point (3,) m of an obstacle; None for planes and height fields."""
    row = body.parameters
    R, position, sizes = row[4:13].reshape(3, 3), row[13:16], row[1:4]
    up = R[2]  # z of S in the obstacle's frame
    if body.kind in ("plane", "heights"):
        return None
    if body.kind in ("cone", "quadric"):
        return position  # a tip, or a pole, that points down
    if body.corners is not None or body.kind in ("triangles", "box"):
        return _lowest_of(_ends(body), R) + position
    if body.kind == "ellipsoid":
        return position - R @ (sizes**2 * up) / np.linalg.norm(sizes * up)
    axial = np.array([0.0, 0.0, -np.sign(up[2])])
    if body.kind == "sphere":
        return position - np.array([0.0, 0.0, sizes[0]])
    if body.kind == "capsule":
        return position + R @ (sizes[1] * axial) - np.array([0.0, 0.0, sizes[0]])
    rounded = sizes[2] if body.kind == "disc" else 0.0  # else a cylinder
    across = np.array([up[0], up[1], 0.0])
    lean = float(np.linalg.norm(across))
    rim = (rounded - sizes[0]) * across / lean if lean > _LEVEL else np.zeros(3)
    return position + R @ ((sizes[1] - rounded) * axial + rim) - np.array([0.0, 0.0, rounded])


def _ends(body: Obstacle) -> Array:
    if body.corners is not None:
        return body.corners
    if body.kind == "triangles":
        return body.pool.reshape(-1, 3)
    return body.parameters[1:4] * _SIGNS


def _lowest_of(corners: Array, R: Array) -> Array:
    """Return the mean of the lowest `corners` (n, 3), in S, relative to the obstacle's origin."""
    at = corners @ R.T
    return at[at[:, 2] < at[:, 2].min() + _FLAT].mean(axis=0)


def _fraction(row: Array, spacing: float) -> float:
    if row[0] == _CONE:
        return _TIP
    wide = _width(row) / spacing
    fraction = next(fraction for minimum, fraction in _SHARES if wide >= minimum)
    return max(fraction, _AT_EDGES) if row[0] in _EDGED else fraction


def _width(row: Array) -> float:
    """Return the minimum width of an obstacle, m; for a quadric twice its minimum radius."""
    if row[0] != _QUADRIC:
        return float(row[18])
    curvature = float(np.max(row[1:3]))
    return 2 / curvature if curvature > 0 else np.inf
