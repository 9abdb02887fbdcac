"""Ellipses by least squares on the pixels along their edges, in numpy: `fit_edges` and
`gamma_equations` of the kernels."""

from __future__ import annotations

import numpy as np

from mjtactile.sensing.image import edge_fit
from mjtactile.sensing.image.edge_bands import Pixels
from mjtactile.sensing.image.edge_fit import PARAMETERS
from mjtactile.sensing.settings import EdgeSettings
from tests.numpy_pipeline.edge_model import model

_DIAGONAL = np.arange(PARAMETERS)


def fit_pixels(pixels, theta, blur, steps, small, s: EdgeSettings):
    """Fit as `edge_fit.fit_pixels`, with the same number of steps for all markers."""
    stride = max(1, int(pixels.counts.mean()) // edge_fit._PIXELS_FIRST)
    some = _every(pixels, stride)
    J = np.empty((PARAMETERS, len(some.x)), np.float32)
    for k in range(steps):
        residual = some.observed - model(some, theta, J, small)
        weight = _robust(some, residual, theta, s) if k else np.ones_like(residual)
        old = theta.copy()
        theta[:] = _step(theta, *_normal(some, theta, J, residual, weight, blur))
        if k and np.abs(theta - old)[:, :5].max() < edge_fit._CONVERGED:
            break
    J = np.empty((PARAMETERS, len(pixels.x)), np.float32)
    for _ in range(2):
        residual = pixels.observed - model(pixels, theta, J, small)
        weight = _robust(pixels, residual, theta, s)
        H, right = _normal(pixels, theta, J, residual, weight, blur)
        old = theta.copy()
        theta[:] = _step(theta, H, right)
    sums = [pixels.sums(weight * residual**k) for k in range(3)]
    return H, np.stack([*sums, np.abs(theta - old)[:, :5].max(axis=1)], axis=1)


def gamma_equations(pixels, theta, gamma, *, robust):
    """Return the equations of `gamma.equations`. Gray levels relative to 128 keep light of order
    one."""
    edge = theta[:, 5:7] / 128
    linear = theta.copy()
    linear[:, 5:7] = edge**gamma
    J = np.empty((PARAMETERS, len(pixels.x)), np.float32)
    light = np.maximum(model(pixels, linear, J, small=True), 1e-6).astype(np.float32)
    level = light ** np.float32(1 / gamma)
    J *= np.float32(128 / gamma) * level / light
    by_gamma = np.float32(-128 / gamma) * level * np.log(light)
    for column, e in ((5, edge[:, 0]), (6, edge[:, 1])):
        by_gamma += J[column] * pixels.spread(gamma * e**gamma * np.log(e))
        J[column] *= pixels.spread(gamma * e ** (gamma - 1) / 128)
    residual = pixels.observed - 128 * level
    scale = 4 * np.sqrt(pixels.sums(residual * residual) / pixels.counts)
    weight = 1 / (1 + (residual / pixels.spread(scale)) ** 4) if robust else np.ones_like(residual)
    columns = [residual * J, by_gamma * J]
    sums = [pixels.sums(weight * column) for column in columns]
    slope = J[0] ** 2 + J[1] ** 2
    slope /= pixels.spread(np.maximum.reduceat(slope, pixels.starts))
    squares = [by_gamma**2, by_gamma * residual, residual**2, np.ones_like(residual)]
    squares += [slope * residual**2, slope]
    sums += [pixels.sums(weight * square)[None] for square in squares]
    return normal_matrix(pixels, J, weight), np.concatenate(sums).T


def normal_matrix(pixels, J, weight):
    """Return J^T W J (n, 10, 10) of each marker."""
    H = np.empty((PARAMETERS, PARAMETERS, len(pixels.counts)))
    WJ = J * weight
    for i in range(PARAMETERS):
        H[i, i:] = H[i:, i] = pixels.sums(WJ[i] * J[i:])
    return H.transpose(2, 0, 1).copy()


def _every(pixels, stride):
    """Select every `stride`-th pixel of each marker."""
    counts = -(-pixels.counts // stride)
    starts = np.cumsum(counts) - counts
    index = (np.arange(counts.sum()) - np.repeat(starts, counts)) * stride + np.repeat(
        pixels.starts, counts
    )
    return Pixels(pixels.x[index], pixels.y[index], pixels.observed[index], counts)


def _normal(pixels: Pixels, theta, J, residual, weight, blur):
    H = normal_matrix(pixels, J, weight)
    right = pixels.sums(J * (weight * residual)).T
    pull = blur.weight * pixels.sums(weight * residual * residual) / pixels.counts
    H[:, -1, -1] += pull
    right[:, -1] += pull * (blur.sigma - theta[:, -1])
    return H, right


def _robust(pixels: Pixels, residual, theta, s: EdgeSettings):
    """Return weights 1/(1 + (r/c)^4). c is a multiple of the marker's rms residual, but at least a
    fraction of its contrast: effects of the lens that the model omits are no outliers."""
    scale = np.maximum(
        s.outlier_residuals * np.sqrt(pixels.sums(residual * residual) / pixels.counts),
        s.outlier_fraction * np.abs(theta[:, 5] - theta[:, 6]),
    )
    return 1 / (1 + (residual * pixels.spread(1 / np.maximum(scale, 1e-3))) ** 4)


def _step(theta, H, gradient):
    damped = H.copy()
    damped[:, _DIAGONAL, _DIAGONAL] = damped[:, _DIAGONAL, _DIAGONAL] * (1 + 1e-6) + 1e-9
    step = np.linalg.solve(damped, gradient[..., None])[..., 0]
    step[:, :5] = np.clip(step[:, :5], -1.5, 1.5)
    new = theta + step
    new[:, 9] = np.clip(new[:, 9], 0.3, 8.0)
    small = np.linalg.norm(theta[:, 2:5], axis=1) * 0.2
    bad = ~np.isfinite(new).all(axis=1) | (new[:, 2] * new[:, 4] - new[:, 3] ** 2 <= small**2 * 0.1)
    bad |= (new[:, 2] <= 0) | (new[:, 4] <= 0)
    return np.where(bad[:, None], theta, new)
