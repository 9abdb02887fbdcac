"""In-plane stiffness of the flat mounted membrane at an inner node: nine-point stencil (X3)."""

from __future__ import annotations

import numpy as np

from mjtactile.core.types import Array
from mjtactile.quasistatic.membrane import QuasistaticMembrane

_STEP = 1e-6  # difference of displacements, m


def plane_stencil(membrane: QuasistaticMembrane) -> Array:
    """Return the stencil (9,), N/m: xx at the node, along x, along y, diagonal; yy; xy diagonal."""
    dx = float(membrane.x[1] - membrane.x[0])
    dy = float(membrane.y[1] - membrane.y[0])
    blocks = np.zeros((3, 3, 2, 2))
    for i in range(3):
        for j in range(3):
            for c in range(2):
                moved = np.zeros((3, 3, 2))
                moved[i, j, c] = _STEP
                both = [_force(membrane, dx, dy, sign * moved) for sign in (1, -1)]
                blocks[i, j, :, c] = -(both[0] - both[1]) / (2 * _STEP)
    xx, yy = blocks[..., 0, 0], blocks[..., 1, 1]
    straight = [part[at] for part in (xx, yy) for at in ((1, 1), (2, 1), (1, 2), (2, 2))]
    return np.array([*straight, blocks[2, 2, 0, 1]])


def _force(membrane: QuasistaticMembrane, dx: float, dy: float, moved: Array) -> Array:
    """Return the in-plane force (2,) on the middle node of 3 x 3, from the corners of its cells."""
    flat = np.meshgrid([-dx, 0.0, dx], [-dy, 0.0, dy], indexing="ij")
    x = np.stack(flat, axis=-1) + moved
    force = np.zeros(2)
    for i in range(3):
        for j in range(3):
            for si in (-1, 1):
                for sj in (-1, 1):
                    a, b = i + si, j + sj
                    if not (0 <= a < 3 and 0 <= b < 3):
                        continue
                    tangents = np.stack(
                        [(x[a, j] - x[i, j]) * si / dx, (x[i, b] - x[i, j]) * sj / dy], axis=1
                    )
                    load = tangents @ stress(membrane, tangents) * dx * dy / 4
                    for node, sign, axis in (
                        ((i, j), -1, 0),
                        ((a, j), 1, 0),
                        ((i, j), -1, 1),
                        ((i, b), 1, 1),
                    ):
                        if node == (1, 1):
                            force -= sign * load[:, axis] * ((si / dx) if axis == 0 else (sj / dy))
    return force


def stress(membrane: QuasistaticMembrane, tangents: Array) -> Array:
    """Return the second Piola-Kirchhoff stress (2, 2) times thickness, N/m (X2)."""
    stretch, kind, modulus, poisson, middle, per_unit = membrane._constants[4:10]
    C = stretch * tangents.T @ tangents
    if not kind:
        E = (C - np.eye(2)) / 2
        return modulus * ((1 - poisson) * E + poisson * np.trace(E) * np.eye(2))
    root = 1 / np.sqrt(np.linalg.det(C))
    q = np.polynomial.polynomial.polyval((root - middle) * per_unit, membrane._law)
    return modulus * (np.eye(2) - q * (np.trace(C) * np.eye(2) - C))
