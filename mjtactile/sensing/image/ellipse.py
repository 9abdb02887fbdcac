"""Ellipses as (center, symmetric shape matrix S): the points c + S (cos t, sin t).

The functions are batched, and not singular for circles. `shape` is (N, 3): the entries p, q, s of S
= [[p, q], [q, s]], positive definite, in pixels. The five parameters (u, v, p, q, s) move the
boundary along its outward normal m. The move is m . dc + m . dS e, with e = (cos t, sin t). This is
smooth everywhere. Semi-axes and angle are not (the angle of a circle is undefined). So they are
used only at the interfaces.
"""

from __future__ import annotations

import numpy as np

from mjtactile.core.types import Array

_ROUND = 1e-6  # below this (a - b)/a the angle is meaningless; the floor keeps its variance finite


def upper_median(values: Array) -> float:
    """Return the upper median of all `values`, at a fifth of np.median's cost."""
    flat = values.ravel()
    return float(np.partition(flat, flat.size // 2)[flat.size // 2])


def inverse_shape(shape: Array) -> Array:
    """Return the entries (N, 3) of S^-1."""
    p, q, s = shape.T
    return np.array([s, -q, p]).T / (p * s - q * q)[:, None]


def shape_from_moments(second: Array) -> Array:
    """Return S (N, 3) of the ellipses with central second moments (xx, xy, yy) `second` (N, 3): S^2
    = 4 moments. The square root of a 2x2 matrix M is (M + sqrt(det M) I)/sqrt(trace M + 2 sqrt(det
    M))."""
    xx, xy, yy = (4 * second).T
    root = np.sqrt(np.maximum(xx * yy - xy * xy, 0.0))
    scale = 1 / np.sqrt(np.maximum(xx + yy + 2 * root, 1e-12))
    return np.array([(xx + root) * scale, xy * scale, (yy + root) * scale]).T


def axes_from_shape(shape: Array) -> tuple[Array, Array]:
    """Return the semi-axes a >= b (N, 2), and the angle (N,) of a from +u towards +v, rad in
    (-pi/2, pi/2]."""
    p, q, s = shape.T
    mean = (p + s) / 2
    half = np.hypot((p - s) / 2, q)
    return np.array([mean + half, mean - half]).T, 0.5 * np.arctan2(2 * q, p - s)


def shape_from_axes(semi_axes: Array, angle: Array) -> Array:
    """Return S (N, 3) for semi-axes (N, 2) and angles (N,)."""
    c = np.cos(angle)
    s = np.sin(angle)
    a, b = semi_axes.T
    return np.array([a * c * c + b * s * s, (a - b) * c * s, a * s * s + b * c * c]).T


def axes_difference(a: Array, b: Array) -> Array:
    """Return a - b (N,), with a lower bound that keeps the angle's variance finite."""
    return np.maximum(a - b, _ROUND * a)


def axes_jacobian(semi_axes: Array, angle: Array) -> Array:
    """Return the derivative (N, 5, 5) of (u, v, p, q, s) with respect to (u, v, a, b, angle)."""
    c = np.cos(angle)
    s = np.sin(angle)
    a, b = semi_axes.T
    difference = axes_difference(a, b)
    J = np.zeros((len(angle), 5, 5))
    J[:, 0, 0] = J[:, 1, 1] = 1.0
    J[:, 2:, 2] = np.array([c * c, c * s, s * s]).T
    J[:, 2:, 3] = np.array([s * s, -c * s, c * c]).T
    J[:, 2:, 4] = difference[:, None] * np.array([-2 * c * s, c * c - s * s, 2 * c * s]).T
    return J


def covariance_of_axes(cov: Array, semi_axes: Array, angle: Array) -> Array:
    """Transform the covariance (N, 5, 5) of (u, v, p, q, s) to that of (u, v, a, b, angle)."""
    c = np.cos(angle)
    s = np.sin(angle)
    a, b = semi_axes.T
    difference = axes_difference(a, b)
    J = np.zeros((len(angle), 5, 5))
    J[:, 0, 0] = J[:, 1, 1] = 1.0
    J[:, 2, 2:] = np.array([c * c, 2 * c * s, s * s]).T
    J[:, 3, 2:] = np.array([s * s, -2 * c * s, c * c]).T
    J[:, 4, 2:] = np.array([-c * s, c * c - s * s, c * s]).T / difference[:, None]
    return J @ cov @ J.transpose(0, 2, 1)


def covariance_of_shape(cov: Array, semi_axes: Array, angle: Array) -> Array:
    """Return the covariance (N, 5, 5) of (u, v, p, q, s) from that of (u, v, a, b, angle)."""
    J = axes_jacobian(semi_axes, angle)
    return J @ cov @ J.transpose(0, 2, 1)


def boundary(center: Array, shape: Array, count: int) -> tuple[Array, Array]:
    """Return `count` points (N, count, 2) around each ellipse, and their unit-circle parameters e
    (count, 2)."""
    t = 2 * np.pi * np.arange(count) / count
    e = np.array([np.cos(t), np.sin(t)]).T
    p, q, s = (column[:, None] for column in shape.T)
    offset = np.stack([p * e[:, 0] + q * e[:, 1], q * e[:, 0] + s * e[:, 1]], axis=-1)
    return center[:, None] + offset, e


def moved(center: Array, shape: Array, move: Array) -> tuple[Array, Array]:
    """Return the ellipses after a `move` (N, 5) = (w, V) with V = [[V0, V1], [V1, V2]]. The move is
    in units of the local radius (clipped at 0.4). The center is c + S w. The square of the new
    shape is that of S (I + V)."""
    w0, w1, v0, v1, v2 = np.minimum(np.maximum(move.T.astype(float), -0.4), 0.4)
    p, q, s = shape.T
    a = 1 + v0
    c = 1 + v2
    # rows of M = S (I + V); its square is M M^T
    m00 = p * a + q * v1
    m01 = p * v1 + q * c
    m10 = q * a + s * v1
    m11 = q * v1 + s * c
    squared = np.array([m00 * m00 + m01 * m01, m00 * m10 + m01 * m11, m10 * m10 + m11 * m11]).T
    shift = np.array([p * w0 + q * w1, q * w0 + s * w1]).T
    return center + shift, shape_from_moments(squared / 4)
