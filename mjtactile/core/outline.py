"""Non-rectangular outlines of openings, and the smooth map from a square to them.

Simulator and sensing use structured grids. One map in two parts transfers these to another outline:

    square [-1, 1]^2 -> disc:  w = u sqrt(1 - v^2 / 2) + i v sqrt(1 - u^2 / 2)
    disc -> opening:           x + i y = sum_n a_n w^n + b_n conj(w)^n

The second map is harmonic. It follows the outline at constant speed along the circle. For a convex
outline such a map is one to one (Rado, Kneser, Choquet; P. Duren, Harmonic Mappings in the Plane,
ch. 3). For a circle a_1 is the radius. For an ellipse, the map is affine. Its a_1 and b_1 are half
the sum and half the difference of the half axes. The grid cells degenerate at four points only.
There the square's corners map to the smooth outline.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array

_HARMONICS = 96  # for rounded corners: the truncation error is 2 um for a 40 mm frame
_SAMPLES = 4096  # samples of its arc for the coefficients
_EDGES = 720  # edges of the polygon that approximates the outline for distances
_NEWTON_STEPS = 40
_CLOSE = 1e-12  # tolerance, as a fraction of the disc's radius
_ROOT2 = np.sqrt(2.0)


class OutlineError(ValueError):
    """Corners that do not form a valid outline. `field` is the key in the sensor file."""

    def __init__(self, field: str, message: str):
        self.field = field
        super().__init__(message)


@dataclass(frozen=True)
class Outline:
    """A convex outline about the origin, by its map from the disc.

    Attributes:
        powers: a_0, a_1, ... m, of w.
        conjugates: b_0 = 0, b_1, ... m, of conj(w).
    """

    powers: tuple[complex, ...]
    conjugates: tuple[complex, ...]

    @classmethod
    def ellipse(cls, half_x: float, half_y: float) -> Outline:
        """Create an ellipse from its half axes along x and y, m."""
        return cls((0j, complex(half_x + half_y) / 2), (0j, complex(half_x - half_y) / 2))

    @classmethod
    def polygon(cls, corners: Sequence[tuple[float, float]], radius: float) -> Outline:
        """Create a polygon with rounded corners of this radius, m.

        The corners (x, y), m, are counter-clockwise around the origin. Raises OutlineError if it is
        not convex about the origin, or its edges are too short for the rounding.
        """
        arc = _sampled(corners, radius)
        found = np.fft.fft(arc) / len(arc)
        powers = found[: _HARMONICS + 1]
        conjugates = np.concatenate([[0.0], found[: -_HARMONICS - 1 : -1]])
        return cls(tuple(powers.tolist()), tuple(conjugates.tolist()))

    # -- the map

    def plane(self, square: Array) -> Array:
        """Map points (N, 2) of the square [-1, 1]^2 to points (N, 2), m, of the opening."""
        z = self._mapped(_to_disc(square))[0]
        return np.column_stack([np.real(z), np.imag(z)])

    def jacobian(self, square: Array) -> Array:
        """Return d(x, y)/d(u, v) (N, 2, 2), m, at points (N, 2) of the square."""
        u, v = square.T
        by_u = np.sqrt(1 - v**2 / 2) - 0.5j * u * v / np.sqrt(1 - u**2 / 2)
        by_v = -0.5 * u * v / np.sqrt(1 - v**2 / 2) + 1j * np.sqrt(1 - u**2 / 2)
        _, by_w, by_conjugate = self._mapped(_to_disc(square))
        columns = [by_w * d + by_conjugate * np.conj(d) for d in (by_u, by_v)]
        return np.stack([np.stack([z.real, z.imag], -1) for z in columns], -1)

    def disc_jacobian(self, disc: Array) -> Array:
        """Return d(x, y)/d(Re w, Im w) (N, 2, 2), m, at points (N, 2) of the unit disc."""
        _, by_w, by_conjugate = self._mapped(disc[:, 0] + 1j * disc[:, 1])
        columns = [by_w + by_conjugate, 1j * (by_w - by_conjugate)]
        return np.stack([np.stack([z.real, z.imag], -1) for z in columns], -1)

    def square(self, plane: Array) -> Array:
        """Map points (N, 2) m of the opening to points (N, 2) of the square. Points outside of the
        opening map to the square's boundary."""
        return _to_square(self._disc(plane))

    def disc(self, plane: Array) -> Array:
        """Map points (N, 2) m of the opening to points (N, 2) of the unit disc. Points outside of
        the opening map to the disc's boundary."""
        w = self._disc(plane)
        return np.column_stack([np.real(w), np.imag(w)])

    def _disc(self, plane: Array) -> NDArray:
        """Return the complex disc coordinates w (N,) of points (N, 2), m."""
        z = plane[:, 0] + 1j * plane[:, 1]
        # initial value from the affine part, which is exact for circles and ellipses
        a = self.powers[1]
        b = self.conjugates[1]
        offset = z - self.powers[0]
        w = (np.conj(a) * offset - b * np.conj(offset)) / (abs(a) ** 2 - abs(b) ** 2)
        w = w / np.maximum(np.abs(w), 1.0)
        for _ in range(_NEWTON_STEPS):
            found, by_w, by_conjugate = self._mapped(w)
            offset = z - found
            det = np.abs(by_w) ** 2 - np.abs(by_conjugate) ** 2
            step = (np.conj(by_w) * offset - by_conjugate * np.conj(offset)) / det
            before = w
            w = w + step / np.maximum(4 * np.abs(step), 1.0)
            w = w / np.maximum(np.abs(w), 1.0)
            if np.abs(w - before).max(initial=0.0) < _CLOSE:
                break
        return w

    def _mapped(self, w: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """Return complex x + i y, m, at points `w` (N,) of the disc, and its derivatives.

        The derivatives are by w and by its conjugate.
        """
        value, by_w = _polynomial(self.powers, w)
        other, by_conjugate = _polynomial(self.conjugates, np.conj(w))
        return value + other, by_w, by_conjugate

    # -- the outline

    @property
    def area(self) -> float:
        """Enclosed area, m^2, by Green's theorem."""
        terms = zip(self.powers, self.conjugates, strict=True)
        return np.pi * sum(n * (abs(a) ** 2 - abs(b) ** 2) for n, (a, b) in enumerate(terms))

    @cached_property
    def length(self) -> float:
        """Perimeter, m."""
        corners = self.points(_SAMPLES)
        return float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).sum())

    def around(self, by: float) -> Array:
        """Return positions (n, 2) m, `by` m outside of the outline, counter-clockwise."""
        middles, normals = self._edges
        return middles + by * normals

    def points(self, count: int) -> Array:
        """Return evenly spaced points (count, 2), m, on the outline, counter-clockwise from the x
        axis."""
        w = np.exp(2j * np.pi * np.arange(count) / count)
        z = self._mapped(w)[0]
        return np.column_stack([np.real(z), np.imag(z)])

    @cached_property
    def half_sizes(self) -> tuple[float, float]:
        """Maximum distances from the origin along x and y, m."""
        x, y = np.abs(self.points(_SAMPLES)).max(axis=0)
        return float(x), float(y)

    def distance(self, plane: Array) -> Array:
        """Compute the distance (N,) m of points (N, 2) m to the outline; positive inside, negative
        outside."""
        middles, normals = self._edges
        offset = middles - plane[:, None]
        nearest = np.square(offset).sum(axis=2).argmin(axis=1)
        return (offset[np.arange(len(plane)), nearest] * normals[nearest]).sum(axis=1)

    @cached_property
    def _edges(self) -> tuple[Array, Array]:
        """Middles and outward normals (n, 2) of a polygon's edges."""
        corners = self.points(_EDGES)
        ends = np.roll(corners, -1, axis=0)
        along = ends - corners
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        return (corners + ends) / 2, np.column_stack([along[:, 1], -along[:, 0]])


def _polynomial(coefficients: Sequence[complex], w: NDArray) -> tuple[NDArray, NDArray]:
    """Return value and derivative of a polynomial at `w`, by Horner's scheme."""
    value = np.zeros_like(w)
    slope = np.zeros_like(w)
    for coefficient in reversed(coefficients):
        slope = slope * w + value
        value = value * w + coefficient
    return value, slope


def _to_disc(square: Array) -> NDArray:
    u, v = np.asarray(square, dtype=float).T
    return u * np.sqrt(1 - v**2 / 2) + 1j * v * np.sqrt(1 - u**2 / 2)


def _to_square(w: NDArray) -> Array:
    """Map the unit disc to the square; the inverse of `_to_disc`."""

    def along(first: Array, second: Array) -> Array:
        rest = 2 + first**2 - second**2
        return 0.5 * (
            np.sqrt(np.maximum(rest + 2 * _ROOT2 * first, 0))
            - np.sqrt(np.maximum(rest - 2 * _ROOT2 * first, 0))
        )

    x = np.real(w)
    y = np.imag(w)
    return np.clip(np.column_stack([along(x, y), along(y, x)]), -1.0, 1.0)


def _sampled(corners: Sequence[tuple[float, float]], radius: float) -> NDArray:
    """Return evenly spaced points (n,), x + i y, m, on a polygon with rounded corners, from the x
    axis."""
    p = np.array([complex(*corner) for corner in corners])
    edges = np.roll(p, -1) - p
    if len(p) < 3 or (np.imag(np.conj(p) * np.roll(p, -1)) <= 0).any():
        raise OutlineError("corners_mm", "are not counter-clockwise around the center")
    turns = np.angle(edges / np.roll(edges, 1))
    if (turns <= 1e-6).any():
        raise OutlineError("corners_mm", "do not form a convex polygon")
    cut = radius * np.tan(turns / 2)
    if (cut + np.roll(cut, -1) > np.abs(edges) * (1 + 1e-9)).any():
        message = f"{1e3 * radius:g} does not fit between two corners"
        raise OutlineError("corner_radius_mm", message)
    heading = edges / np.abs(edges)
    before = np.roll(heading, 1)
    # arc k, from p_k - cut_k before_k on, then the straight part of edge k
    lengths = np.column_stack([radius * turns, np.abs(edges) - cut - np.roll(cut, -1)]).ravel()
    starts = np.concatenate([[0.0], np.cumsum(lengths)])

    def at(s: Array) -> NDArray:
        part = np.clip(np.searchsorted(starts, s, side="right") - 1, 0, len(lengths) - 1)
        k = part // 2
        straight = part % 2 == 1
        rest = s - starts[part]
        center = p[k] + (-cut[k] + 1j * radius) * before[k]
        arc = center - 1j * radius * before[k] * np.exp(1j * rest / max(radius, 1e-12))
        return np.where(straight, p[k] + (cut[k] + rest) * heading[k], arc)

    total = starts[-1]
    fine = at(np.linspace(0.0, total, 8 * _SAMPLES, endpoint=False))
    first = int(np.abs(np.angle(fine)).argmin()) / len(fine) * total
    return at((first + np.arange(_SAMPLES) * total / _SAMPLES) % total)
