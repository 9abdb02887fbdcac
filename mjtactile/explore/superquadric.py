"""Base shape of an explored surface: a tapered superquadric with fourteen parameters.

Ellipsoid, box with round edges, cylinder and truncated cone are exact or nearly so. The remaining
deviation is modeled by the additional field (docs/theory/exploration.md, Eq. E1 and E2).
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from mjtactile.core.types import Array

COUNT = 14
"""Number of parameters: position in mm (3), rotation vector (3), logarithms of half sizes in mm
(3), exponents (2; 1: round, 0: sharp) along and across its axis z, tapers (2), the relative
increase of the width at its upper end, and cut, the remaining fraction of its lower half up to a
flat end."""
UNCUT = 1.3  # cut of a shape without a flat end
LOW = np.array([-200.0] * 3 + [-7.0] * 3 + [0.7] * 3 + [0.05] * 2 + [-0.8] * 2 + [0.2])
HIGH = np.array([200.0] * 3 + [7.0] * 3 + [4.2] * 3 + [1.5] * 2 + [0.8] * 2 + [UNCUT + 0.2])
STEP = np.array([1e-3] * 3 + [1e-4] * 11)  # step of finite differences
_TINY = 1e-9


def distance(theta: Array, p: Array) -> Array:
    """Return the first-order distance (N,), mm, of points (N, 3), mm, outside a shape (14,), or (K,
    N) outside several shapes (K, 14). It is negative inside, and exact next to a flat face (Eq.
    E2)."""
    many = np.atleast_2d(theta)
    level, slope = _level(many, p)
    out = (level - 1) / np.maximum(np.linalg.norm(slope, axis=-1), _TINY)
    out = np.maximum(out, beyond_cut(many, p))
    return out[0] if theta.ndim == 1 else out


def beyond_cut(theta: Array, p: Array) -> Array:
    """Return the distance (K, N), mm, of points (N, 3), mm, below the flat ends of shapes (K, 14);
    negative above."""
    axes = Rotation.from_rotvec(theta[:, 3:6]).as_matrix()[:, :, 2]
    up = np.einsum("kni,ki->kn", p[None] - theta[:, None, :3], axes)
    return -up - (theta[:, 13] * np.exp(theta[:, 8]))[:, None]


def _level(theta: Array, p: Array) -> tuple[Array, Array]:
    """Return the scale factor at which each shape (K, 14) reaches each point (Eq. E1), (K, N). The
    second result is its gradient, (K, N, 3), 1/mm, in the axes of the shape."""
    R = Rotation.from_rotvec(theta[:, 3:6]).as_matrix()
    q = (p[None] - theta[:, None, :3]) @ R
    a, b, c = np.moveaxis(np.exp(theta[:, 6:9]), 1, 0)[..., None]
    along, across = np.moveaxis(2 / theta[:, 9:11], 1, 0)[..., None]
    tapers = np.moveaxis(theta[:, 11:13], 1, 0)[..., None]
    w = q[..., 2] / c
    # the taper is constant beyond the ends
    inside = np.abs(w) < 1
    held = np.clip(w, -1, 1)
    x_by, y_by = 1 + tapers * held
    u = q[..., 0] / (a * x_by)
    v = q[..., 1] / (b * y_by)
    ring, ring_u, ring_v = _norm(u, v, across)
    level, by_ring, by_w = _norm(ring, w, along)
    slope_w = by_w - by_ring * inside * (
        ring_u * u * tapers[0] / x_by + ring_v * v * tapers[1] / y_by
    )
    slope = np.stack(
        [by_ring * ring_u / (a * x_by), by_ring * ring_v / (b * y_by), slope_w / c], axis=-1
    )
    return level, slope


def _norm(x: Array, y: Array, power: Array) -> tuple[Array, Array, Array]:
    """Return (|x|^p + |y|^p)^(1/p), and its derivatives."""
    maximum = np.maximum(np.maximum(np.abs(x), np.abs(y)), _TINY)
    sides = np.abs(x) / maximum, np.abs(y) / maximum
    total = np.maximum(sides[0] ** power + sides[1] ** power, _TINY)
    fraction = total ** (1 / power - 1)
    return (
        maximum * total ** (1 / power),
        np.sign(x) * sides[0] ** (power - 1) * fraction,
        np.sign(y) * sides[1] ** (power - 1) * fraction,
    )


def jacobian(theta: Array, p: Array) -> Array:
    """Compute the derivatives (N, 14) of `distance` with respect to the shape parameters."""
    steps = np.diag(STEP)
    moved = distance(np.concatenate([theta + steps, theta - steps]), p)
    return ((moved[:COUNT] - moved[COUNT:]) / (2 * STEP[:, None])).T
