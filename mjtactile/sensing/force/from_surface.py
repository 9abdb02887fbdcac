"""Force on an inflated membrane from its measured surface and pressure only.

For bubble sensors with a depth camera inside and without markers (docs/theory/membrane_inverse.md,
Eq. F24). With a surface z(x, y) over the gas, outward along z, gauge pressure p and tension T,

    q = p + T div(grad z / sqrt(1 + |grad z|^2))

is the contact pressure from outside. It vanishes without contact. So the surface at rest gives T,
which varies little over the membrane. The free part of the surface gives its increase since then.
Friction along the membrane does not bend it and is not measured.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjtactile.core.errors import InputError
from mjtactile.core.signature_checks import FINITE, validated
from mjtactile.core.types import Array
from mjtactile.core.types.arrays import freeze

_PRESSED = 0.35  # fraction of the gas pressure above which a point is in contact
_AROUND = 1.5  # contact margin, in smoothing lengths: counts pressure smeared by smoothing
_AWAY = 3.0  # distance from contact, in smoothing lengths, above which the membrane is free
_ROUNDS = 3  # iterations of the free-surface search and of the outlier rejection
_OUTLIER = 3.0  # residual, in sd, at which a point has half its weight
_FEWEST = 40  # points
_MIN_SEEN = 0.25  # minimum ratio of a cell's point count to the usual one: less is a hole
_FREE_MIN = 0.2  # minimum free fraction of the surface for a tension estimate


@validated(pressure=FINITE)
@dataclass(frozen=True, eq=False)
class RestSurface:
    """Membrane without contact, measured in the same way as with contact.

    Attributes:
        points: Points on the membrane (n, 3), m.
        pressure: Gauge pressure of its gas, Pa.
    """

    points: Array
    pressure: float

    def __post_init__(self) -> None:
        freeze(self, "points", self.points, (None, 3))


@dataclass(frozen=True, eq=False)
class SurfaceForce:
    """Contact force on a surface.

    Attributes:
        force: Force on the membrane (3,), N, frame of the points. Z is negative in contact.
        center: Center of pressure (2,), m; NaN: no contact.
        area: Contact area, m^2.
        x: Grid coordinates (nx,), m.
        y: Grid coordinates (ny,), m.
        heights: Surface heights (nx, ny), m.
        pressing: Contact pressure q (nx, ny), Pa; NaN where the surface was not measured.
        tension: Median tension, N/m.
    """

    force: Array
    center: Array
    area: float
    x: Array
    y: Array
    heights: Array
    pressing: Array
    tension: float


@validated()
def estimate_force_from_surface(
    points: ArrayLike,
    pressure: float,
    outline: ArrayLike,
    membrane: RestSurface,
    *,
    smoothing: float = 4e-3,
) -> SurfaceForce:
    """Estimate the force on an inflated membrane from its surface and pressure, by statics.

    Args:
        points: Points on the membrane (n, 3), m, in any order. Z is outward, away from the gas, and
            each position has one height. Non-finite points are ignored.
        pressure: Gauge pressure of the gas, Pa.
        outline: Polygon in which the surface is measured (k, 2), m: the frame, or the camera's
            field of view.
        membrane: The same membrane without contact, measured in the same way. It gives the tension.
        smoothing: Averaging length of the depths, m: a few times the point distance, and less than
            the width of the contact.

    Returns:
        The force, with the pressure field that it sums up. Friction is not included.

    Raises:
        InputError: Too few points, an invalid polygon, or a pressure not above ambient.
    """
    corners = np.asarray(outline, float)
    if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
        raise InputError(f"has shape {corners.shape}, not (k, 2) with k >= 3", field="outline")
    if not (math.isfinite(pressure) and pressure > 0):
        raise InputError(f"{pressure!r} Pa is not above ambient", field="pressure")
    if not 0 < smoothing < np.ptp(corners, axis=0).min() / 4:
        raise InputError(
            f"{smoothing!r} m is not between 0 and a quarter of the outline", field="smoothing"
        )
    grid = _Grid(corners, smoothing)
    heights, observed = grid.fit(points, "points")
    bent = grid.curvature(heights)
    rest_heights, rest_observed = grid.fit(membrane.points, "membrane")
    observed &= rest_observed
    rest_bent = grid.curvature(rest_heights)
    tension = _tension_of_rest(grid, rest_bent, observed, membrane.pressure)
    # residual of the smooth tension at rest: camera error, or stretch that differs by direction
    held = tension * (bent - rest_bent) + membrane.pressure
    factor = _curvature_factor(grid, held, observed, pressure)
    tension = factor * tension
    held = factor * held
    pressing = np.where(observed, pressure - held, np.nan)
    return _summed(grid, heights, pressing, pressure, float(np.median(tension[observed])))


def _tension_of_rest(
    grid: _Grid, bent: Array, observed: NDArray[np.bool_], pressure: float
) -> Array:
    """Compute the smooth tension (nx, ny), N/m, of a resting surface. It is the pressure divided by
    a quadric fitted to the curvatures `bent` (nx, ny), 1/m."""
    X, Y = np.meshgrid(grid.x - grid.x.mean(), grid.y - grid.y.mean(), indexing="ij")
    columns = np.stack([np.ones_like(X), X, Y, X * X, X * Y, Y * Y], axis=-1)
    found, *_ = np.linalg.lstsq(columns[observed], bent[observed], rcond=None)
    smooth = columns @ found
    median = float(np.median(smooth[observed]))
    if median <= 0:
        raise InputError("bulges inward at rest: z must point outward", field="membrane")
    return pressure / np.clip(smooth, 0.3 * median, 3.0 * median)


def _curvature_factor(
    grid: _Grid, held: Array, observed: NDArray[np.bool_], pressure: float
) -> float:
    """Return a factor on the curvature pressure `held` (nx, ny), Pa. It makes the contact pressure
    zero on the free surface."""
    factor = 1.0
    for _ in range(_ROUNDS):
        contact = observed & (np.abs(pressure - factor * held) > _PRESSED * pressure)
        free = observed & ~grid.grown(contact, _AWAY)
        if free.sum() < _FREE_MIN * observed.sum():
            break
        factor = pressure / float(held[free].mean())
    return factor


def _summed(
    grid: _Grid, heights: Array, pressing: Array, pressure: float, tension: float
) -> SurfaceForce:
    from scipy.ndimage import label  # takes a while to import

    known = np.nan_to_num(pressing)
    marked: tuple[Array, int] = label(known > _PRESSED * pressure)  # pyright: ignore[reportAssignmentType]
    numbered, count = marked
    contact = np.zeros(known.shape, bool)
    if count:
        sums = np.bincount(numbered.ravel(), known.ravel())[1:]
        # spots as small as the smoothing length are camera noise
        sizes = np.bincount(numbered.ravel())[1:]
        large = sizes * grid.spacing**2 > grid.smoothing**2
        contact = np.isin(numbered, 1 + np.flatnonzero(large & (sums > 0)))
    counted = grid.grown(contact, _AROUND) & np.isfinite(pressing)
    by_x, by_y = np.gradient(heights, grid.spacing)
    q = np.where(counted, known, 0.0) * grid.spacing**2
    force = np.array([(q * by_x).sum(), (q * by_y).sum(), -q.sum()])
    X, Y = np.meshgrid(grid.x, grid.y, indexing="ij")
    center = np.full(2, np.nan)
    if contact.any():
        center = np.array([(q * X).sum(), (q * Y).sum()]) / q.sum()
    area = float(contact.sum()) * grid.spacing**2
    return SurfaceForce(force, center, area, grid.x, grid.y, heights, pressing, tension)


class _Grid:
    """A regular grid over an outline, and the smooth surface through points over it."""

    def __init__(self, outline: Array, smoothing: float):
        self.smoothing = smoothing
        self.spacing = smoothing / 2
        low = outline.min(axis=0)
        high = outline.max(axis=0)
        self.x, self.y = (
            np.arange(a, b + self.spacing, self.spacing) for a, b in zip(low, high, strict=True)
        )
        nodes = np.stack(np.meshgrid(self.x, self.y, indexing="ij"), axis=-1)
        self.inside = _inside_polygon(nodes, outline)

    def fit(self, points: ArrayLike, field: str) -> tuple[Array, NDArray[np.bool_]]:
        """Return heights (nx, ny), m, and a mask (nx, ny) of where they were measured. The surface
        has minimum bending and fits the points within `smoothing`. Robust least squares rejects
        outliers."""
        from scipy import sparse
        from scipy.sparse.linalg import splu

        given = np.asarray(points, float)
        if given.ndim != 2 or given.shape[1] != 3:
            raise InputError(f"shape {given.shape} does not match (n, 3)", field=field)
        low = np.array([self.x[0], self.y[0]])
        last = np.array([self.x[-1], self.y[-1]])
        on = (given[:, :2] > low) & (given[:, :2] < last)
        given = given[np.isfinite(given).all(axis=1) & on.all(axis=1)]
        if len(given) < _FEWEST:
            raise InputError(
                f"has {len(given)} points over the outline; at least {_FEWEST} are needed",
                field=field,
            )
        interpolation = self._interpolation(given[:, :2])
        each = np.asarray(interpolation.sum(axis=0)).ravel()
        usual = float(np.median(each[each > 0]))
        stiff = usual * (self.smoothing / self.spacing) ** 4 * self._bending()
        weight = np.ones(len(given))
        heights = np.empty(interpolation.shape[1])
        for _ in range(_ROUNDS):
            normal = interpolation.T @ sparse.diags_array(weight) @ interpolation + stiff
            heights = splu(normal.tocsc()).solve(interpolation.T @ (weight * given[:, 2]))
            residual = given[:, 2] - interpolation @ heights
            spread = 1.48 * float(np.median(np.abs(residual))) + 1e-9
            weight = 1 / (1 + (residual / (_OUTLIER * spread)) ** 2)
        shape = self.inside.shape
        observed = each.reshape(shape) > _MIN_SEEN * usual
        return heights.reshape(shape), self.inside & ~self.grown(~observed | ~self.inside, 1.0)

    def _interpolation(self, positions: Array) -> Any:
        """Return the bilinear interpolation matrix (n, nx ny), sparse."""
        from scipy import sparse

        at = (positions - [self.x[0], self.y[0]]) / self.spacing
        cell = np.minimum(at.astype(int), np.array(self.inside.shape) - 2)
        u, v = (at - cell).T
        rows = np.arange(len(positions))
        shape = (len(positions), self.inside.size)
        corners = (
            (0, 0, (1 - u) * (1 - v)),
            (1, 0, u * (1 - v)),
            (0, 1, (1 - u) * v),
            (1, 1, u * v),
        )
        interpolation = sparse.csr_array(shape)
        for i, j, fraction in corners:
            column = (cell[:, 0] + i) * self.inside.shape[1] + cell[:, 1] + j
            interpolation = interpolation + sparse.csr_array(
                (fraction, (rows, column)), shape=shape
            )
        return interpolation

    def _bending(self) -> Any:
        """Return the matrix (nx ny, nx ny) of the sum of squared second differences, sparse."""
        from scipy import sparse

        same = [sparse.eye_array(count) for count in self.inside.shape]
        slope = [sparse.csr_array(np.diff(np.eye(count), axis=0)) for count in self.inside.shape]
        bent = [sparse.csr_array(np.diff(np.eye(count), 2, axis=0)) for count in self.inside.shape]
        rows = sparse.vstack(
            [
                sparse.kron(bent[0], same[1]),
                sparse.kron(same[0], bent[1]),
                math.sqrt(2) * sparse.kron(slope[0], slope[1]),
            ]
        )
        return rows.T @ rows

    def curvature(self, heights: Array) -> Array:
        """Return the sum (nx, ny) of the principal curvatures, 1/m, positive for an outward
        bulge."""
        by_x, by_y = np.gradient(heights, self.spacing)
        longer = np.sqrt(1 + by_x**2 + by_y**2)
        bent = np.gradient(by_x / longer, self.spacing, axis=0)
        bent = bent + np.gradient(by_y / longer, self.spacing, axis=1)
        return -bent

    def grown(self, marked: NDArray[np.bool_], lengths: float) -> NDArray[np.bool_]:
        """Return `marked` (nx, ny) dilated by a number of smoothing lengths."""
        from scipy.ndimage import binary_dilation

        times = round(lengths * self.smoothing / self.spacing)
        return np.asarray(binary_dilation(marked, iterations=times), bool)


def _inside_polygon(positions: Array, outline: Array) -> NDArray[np.bool_]:
    """Return a mask of the positions (..., 2) inside a polygon (k, 2). A ray toward +x crosses the
    polygon an odd number of times from there."""
    odd = np.zeros(positions.shape[:-1], bool)
    for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        if a[1] == b[1]:
            continue
        between = (positions[..., 1] >= min(a[1], b[1])) & (positions[..., 1] < max(a[1], b[1]))
        crossing = a[0] + (positions[..., 1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
        odd ^= between & (positions[..., 0] < crossing)
    return odd
