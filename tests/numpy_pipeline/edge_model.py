"""Image model of a blurred ellipse edge, with derivatives, for `edges`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array
from mjtactile.sensing.image.edge_bands import Pixels

_HERMITE = (
    (0.0, 8 / 15),
    (1.3556262, 0.22207592),
    (-1.3556262, 0.22207592),
    (2.8569700, 0.01125741),
    (-2.8569700, 0.01125741),
)


def model(pixels: Pixels, theta: Array, J: NDArray, small: bool) -> NDArray:
    """Return the model image (P,) for parameters `theta` (n, 10), and fill J (10, P) with
    derivatives. `small`: True for markers whose curvature matters beyond first order, see
    `_blurred_disc`. To first order, blur shifts a curved edge by kappa sigma^2/2."""
    cu, cv, ip, iq, js, det2, step, outside, gx, gy, sharp, sigma = pixels.spread(_numbers(theta))
    dx = pixels.x - cu
    dy = pixels.y - cv
    # on the unit circle at the edge
    ex = ip * dx + iq * dy
    ey = iq * dx + js * dy
    # half the gradient of |e|^2
    mx = ip * ex + iq * ey
    my = iq * ex + js * ey
    B2 = mx * mx + my * my
    B2 += np.float32(1e-12)
    inverse = 1 / np.sqrt(B2)
    mx *= inverse
    my *= inverse
    fx = ip * mx + iq * my
    fy = iq * mx + js * my
    A = fx * fx + fy * fy
    rho2 = ex * ex + ey * ey
    root = np.sqrt(np.maximum(B2 - A * (rho2 - 1), 0))
    root += B2 * inverse
    n = (rho2 - 1) / root  # distance to the edge along the gradient: |e - n f| = 1
    kappa = det2 * inverse * inverse * inverse * rho2 * np.sqrt(rho2)  # 1/(det(S)^2 |S^-1 e|^3)
    if small:  # the tangent (-m_y, m_x) in unit-circle coordinates: S^-1 t
        F, phi = _blurred_disc(
            (ex, ey), (fx, fy), (iq * mx - ip * my, js * mx - iq * my), sigma, sharp
        )
    else:
        F, phi = _normal_tail(n * sharp + 0.5 * kappa * sigma)
    tail = n * sharp - 0.5 * kappa * sigma  # dF/d(ln sigma) over -dF/dz
    ex -= n * fx
    ey -= n * fy
    light = 1 + gx * dx + gy * dy
    flat = outside + step * F
    slope = light * step
    slope *= phi
    slope *= sharp
    _fill(J, slope, (mx, my), (ex, ey), F, light, flat, (dx, dy), tail)
    return light * flat


def _numbers(theta: Array) -> Array:
    """Return the values common to all pixels of a marker (12, n). The first are center, inverse
    shape and its squared determinant. Then follow step height of the edge and outside level. The
    last are gradient of the light, inverse blur and blur."""
    cu, cv, p, q, s, inside, outside, gx, gy, sigma = theta.T
    det = 1 / (p * s - q * q)
    shape = (s * det, -q * det, p * det, det * det)
    return np.stack([cu, cv, *shape, inside - outside, outside, gx, gy, 1 / sigma, sigma])


def _fill(
    J: NDArray,
    slope: NDArray,
    m: tuple[NDArray, NDArray],
    e: tuple[NDArray, NDArray],
    F: NDArray,
    light: NDArray,
    flat: NDArray,
    d: tuple[NDArray, NDArray],
    tail: NDArray,
) -> None:
    """Fill the derivatives J (10, P) of the image in the order of the parameters. Position and
    shape of the edge, the two levels, gradient of the light, blur."""
    np.multiply(slope, m[0], out=J[0])
    np.multiply(slope, m[1], out=J[1])
    np.multiply(J[0], e[0], out=J[2])
    np.multiply(J[0], e[1], out=J[3])
    J[3] += J[1] * e[0]
    np.multiply(J[1], e[1], out=J[4])
    np.multiply(light, F, out=J[5])
    np.subtract(light, J[5], out=J[6])
    np.multiply(flat, d[0], out=J[7])
    np.multiply(flat, d[1], out=J[8])
    np.multiply(slope, tail, out=J[9])


def _blurred_disc(
    e: tuple[NDArray, NDArray],
    f: tuple[NDArray, NDArray],
    d: tuple[NDArray, NDArray],
    sigma: NDArray,
    sharp: NDArray,
) -> tuple[NDArray, NDArray]:
    """Compute the filled ellipse blurred by a Gaussian of standard deviation `sigma`.

    Also return its slope across the edge times sigma. Pixels are at `e`. Moves along the normal and
    the tangent are `f` and `d`. All are in unit-circle coordinates. Across the edge the blur is an
    exact integral over a chord. It is Phi at the near end minus Phi at the far end. Along the edge
    it is the five-point Gauss-Hermite mean of such chords. The mean is exact to ninth order in the
    offset.
    """
    A = f[0] * f[0] + f[1] * f[1] + np.float32(1e-9)
    F = np.zeros_like(A)
    phi = np.zeros_like(A)
    for offset, fraction in _HERMITE:
        if offset:
            step = np.float32(offset) * sigma
            x = e[0] + step * d[0]
            y = e[1] + step * d[1]
        else:
            x, y = e
        B = x * f[0] + y * f[1]
        under = B * B - A * (x * x + y * y - 1)
        root = np.sqrt(np.maximum(under, 0))
        near, slope = _normal_tail((B - root) / A * sharp)
        hit = np.float32(fraction) * (under > 0)
        F = F + hit * (near - _normal_tail((B + root) / A * sharp)[0])
        phi = phi + hit * slope
    return F, phi


def _normal_tail(z: NDArray) -> tuple[NDArray, NDArray]:
    """Return Phi(-z) and the normal density, float32. Abramowitz & Stegun 26.2.17, error below
    8e-8. Unlike erf, it uses the same exponential as the density."""
    z = np.clip(z, -12, 12)
    size = np.abs(z)
    density = np.exp(-0.5 * z * z)
    density *= np.float32(0.3989422804)
    t = 1 / (1 + np.float32(0.2316419) * size)
    tail = np.float32(1.330274429) * t
    for coefficient in (-1.821255978, 1.781477937, -0.356563782, 0.319381530):
        tail += np.float32(coefficient)
        tail *= t
    tail *= density
    return np.where(z < 0, 1 - tail, tail), density
