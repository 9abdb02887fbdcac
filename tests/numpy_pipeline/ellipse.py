"""Functions of ellipses that only the references need."""

from __future__ import annotations

import numpy as np

from mjtactile.core.types import Array
from mjtactile.sensing.image.ellipse import inverse_shape


def conic_from_shape(center: Array, shape: Array) -> Array:
    """Return conic matrices (N, 3, 3): x^T M x = |S^-1 (x - c)|^2 - 1, negative inside (paper Eq.
    2)."""
    p, q, s = inverse_shape(shape).T
    A = np.empty((len(center), 2, 2))
    A[:, 0, 0] = p * p + q * q
    A[:, 1, 1] = q * q + s * s
    A[:, 0, 1] = A[:, 1, 0] = q * (p + s)
    Ac = np.einsum("nij,nj->ni", A, center)
    M = np.empty((len(center), 3, 3))
    M[:, :2, :2] = A
    M[:, :2, 2] = M[:, 2, :2] = -Ac
    M[:, 2, 2] = np.einsum("ni,ni->n", Ac, center) - 1
    return M


def covariance_of_moves(cov: Array, shape: Array) -> Array:
    """Compute the covariance (N, 5, 5) of (u, v, p, q, s) from that of (w, V).

    The relations are dc = S w and S^-1 dS + dS S^-1 = 2 V. The second has the solution dS = (det(S)
    V + S V S)/trace(S).
    """
    p, q, s = shape.T
    over = 1 / (p + s)
    det = p * s - q * q
    L = np.zeros((len(shape), 5, 5))
    L[:, 0, 0] = p
    L[:, 1, 1] = s
    L[:, 0, 1] = L[:, 1, 0] = q
    qq = q * q * over
    pq = p * q * over
    qs = q * s * over
    L[:, 2, 2] = (det + p * p) * over
    L[:, 2, 3] = 2 * pq
    L[:, 2, 4] = qq
    L[:, 3, 2] = pq
    L[:, 3, 3] = (det + p * s) * over + qq
    L[:, 3, 4] = qs
    L[:, 4, 2] = qq
    L[:, 4, 3] = 2 * qs
    L[:, 4, 4] = (det + s * s) * over
    return L @ cov @ L.transpose(0, 2, 1)
