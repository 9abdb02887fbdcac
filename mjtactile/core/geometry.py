"""Rotations, rigid transforms and unit normals as small functions on arrays.

The last axis holds x, y, z.

Monogram notation (docs/reference/conventions.md): `X_AB` = (`R_AB`, `p_AB`) is B's pose in A. It
maps `p_BP` to `p_AP`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core.types import Array

_AHEAD = np.array([1, 2, 0])
_BACK = np.array([2, 0, 1])


def unit(v: ArrayLike) -> Array:
    """Scale vectors (..., 3) to length 1; a zero vector becomes NaN."""
    v = np.asarray(v, dtype=float)
    length = np.sqrt(np.einsum("...i,...i->...", v, v))[..., None]
    with np.errstate(invalid="ignore", divide="ignore"):
        return v / length


def cross(a: Array, b: Array) -> Array:
    """Return the cross product a x b of vectors (..., 3), with broadcasting.

    The result is bit-identical to `numpy.cross`, in a fifth to a half of its time.
    """
    return a.take(_AHEAD, -1) * b.take(_BACK, -1) - a.take(_BACK, -1) * b.take(_AHEAD, -1)


def normal_from_slope(z_x: ArrayLike, z_y: ArrayLike) -> Array:
    """Return the unit normals (..., 3) of the surface z(x, y) with slopes dz/dx, dz/dy.

    They point towards -z: in frame S towards the camera, the side of the printed markers.
    """
    z_x, z_y = np.broadcast_arrays(np.asarray(z_x, dtype=float), np.asarray(z_y, dtype=float))
    scale = 1 / np.sqrt(1 + z_x * z_x + z_y * z_y)
    n = np.empty((*scale.shape, 3))
    n[..., 0] = z_x * scale
    n[..., 1] = z_y * scale
    n[..., 2] = -scale
    return n


def slope_from_normal(n: ArrayLike) -> Array:
    """Return the slopes (dz/dx, dz/dy) (..., 2) of planes with normals `n` (..., 3); NaN if
    vertical."""
    n = np.asarray(n, dtype=float)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(n[..., 2:] != 0, -n[..., :2] / n[..., 2:], np.nan)


def tangents(n: ArrayLike) -> tuple[Array, Array]:
    """Return two unit vectors a, b (..., 3) that complete unit normals `n` (..., 3) to right-handed
    orthonormal triads (a, b, n).

    Source: Duff et al., "Building an Orthonormal Basis, Revisited", J. Computer Graphics Techniques
    6(1), 2017; continuous everywhere but at n_z = 0.
    """
    x, y, z = np.moveaxis(np.asarray(n, dtype=float), -1, 0)
    sign = np.copysign(1.0, z)
    a = -1 / (sign + z)
    b = x * y * a
    return (
        np.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=-1),
        np.stack([b, sign + y * y * a, -y], axis=-1),
    )


def rotation_from_vector(w: ArrayLike) -> Array:
    """Return the rotation matrices (..., 3, 3) by |w| rad about the axes `w` (..., 3), by
    Rodrigues' formula."""
    w = np.asarray(w, dtype=float)
    if w.ndim == 1:
        return _one_rotation(*w.tolist())
    angle = np.sqrt(np.einsum("...i,...i->...", w, w))[..., None, None]
    W = np.zeros((*w.shape, 3))
    W[..., 0, 1] = -w[..., 2]
    W[..., 0, 2] = w[..., 1]
    W[..., 1, 2] = -w[..., 0]
    W -= np.swapaxes(W, -1, -2)
    # sinc(x) = sin(pi x)/(pi x) is exact at 0; (1 - cos a)/a^2 = sinc^2(a / 2 pi)/2 has no
    # cancellation
    return (
        np.eye(3) + np.sinc(angle / np.pi) * W + 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * (W @ W)
    )


def _one_rotation(x: float, y: float, z: float) -> Array:
    """Return the rotation matrix (3, 3) of one rotation vector, 20 times as fast as with arrays."""
    angle = math.sqrt(x * x + y * y + z * z)
    half = angle / 2
    # both are exact at 0 and have no cancellation
    a = math.sin(angle) / angle if angle > 0 else 1.0
    b = 0.5 * (math.sin(half) / half) ** 2 if half > 0 else 0.5
    return np.array(
        [
            [1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y],
            [b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x],
            [b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)],
        ]
    )


def transform(R_AB: ArrayLike, p_AB: ArrayLike, p_BP: ArrayLike) -> Array:
    """Transform points from frame B to A: `p_AP` (..., 3) = R_AB p_BP + p_AB."""
    return np.asarray(p_BP, dtype=float) @ np.swapaxes(
        np.asarray(R_AB, dtype=float), -1, -2
    ) + np.asarray(p_AB)
