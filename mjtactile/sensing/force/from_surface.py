"""Force on an inflated membrane from its measured surface and its pressure alone: for bubbles whose
inside is seen by a depth camera, without markers (docs/theory/membrane_inverse.md, Eq. F24).

With a surface z(x, y) over the gas, outward along z, gauge pressure p and tension T,

    q = p + T div(grad z / sqrt(1 + |grad z|^2))

is the pressure with which the outside presses. Where nothing touches it vanishes, and so the
surface at rest tells T, which changes little from place to place; how much it has grown since then
is told by what is still free. Friction along the sheet does not bend it, and is not seen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjtactile.core.errors import InputError
from mjtactile.core.types import Array

_PRESSED = 0.35  # of the gas's pressure: more is contact
_AROUND = 1.5  # smoothing lengths, that are counted with it: what smoothing has smeared
_AWAY = 3.0  # smoothing lengths from contact, beyond which the sheet is free
_ROUNDS = 3  # of looking for what is free, and of leaving out points that fit no surface
_OUTLIER = 3.0  # sd, at which a point counts half
_FEWEST = 40  # points
_MIN_SEEN = 0.25  # of a cell's usual number of points: less is a hole
_FREE_MIN = 0.2  # of the surface, from which its tension is told


@dataclass(frozen=True, eq=False)
class RestSurface:
    """A membrane that nothing touches, measured as it is when something does.

    Attributes:
        points: (n, 3) m on it.
        pressure: Of its gas above ambient, Pa.
    """

    points: Array
    pressure: float


@dataclass(frozen=True, eq=False)
class SurfaceForce:
    """What presses on a surface.

    Attributes:
        force: (3,) N on the membrane, in the points' frame: a press has a negative z.
        place: (2,) m, its centre of pressure; NaN: nothing touches.
        area: m^2 of contact.
        x: (nx,) m of the grid.
        y: (ny,) m.
        heights: (nx, ny) m of the surface.
        pressing: (nx, ny) Pa, q; NaN where the surface was not seen.
        tension: N/m, the middle of it.
    """

    force: Array
    place: Array
    area: float
    x: Array
    y: Array
    heights: Array
    pressing: Array
    tension: float


def estimate_force_from_surface(
    points: ArrayLike,
    pressure: float,
    outline: ArrayLike,
    membrane: RestSurface,
    *,
    smoothing: float = 4e-3,
) -> SurfaceForce:
    """Find the force on an inflated membrane from its surface and pressure, by statics.

    Args:
        points: (n, 3) m on the membrane, in any order; z is outward, away from the gas, and there
            is one height over each place. Points that are not finite are left out.
        pressure: Of the gas above ambient, Pa.
        outline: (k, 2) m, the polygon in which the surface is known: the frame, or what the camera
            sees.
        membrane: The same membrane with nothing touching, measured alike: what tension it has.
        smoothing: m, over which depths are averaged: a few times the points' distance, and less
            than what touches is wide.

    Returns:
        The force, with the field of pressure that it is the sum of. Friction is not in it.

    Raises:
        InputError: Too few points, a polygon that is none, or a pressure that is not above ambient.
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
    heights, seen = grid.fit(points, "points")
    bent = grid.curvature(heights)
    rest_heights, rest_observed = grid.fit(membrane.points, "membrane")
    seen &= rest_observed
    rest_bent = grid.curvature(rest_heights)
    tension = _tension_of_rest(grid, rest_bent, seen, membrane.pressure)
    # what its smooth tension leaves at rest is the camera's, or a stretch that differs by direction
    held = tension * (bent - rest_bent) + membrane.pressure
    factor = _grown(grid, held, seen, pressure)
    tension = factor * tension
    held = factor * held
    pressing = np.where(seen, pressure - held, np.nan)
    return _summed(grid, heights, pressing, pressure, float(np.median(tension[seen])))


def _tension_of_rest(grid: _Grid, bent: Array, seen: NDArray[np.bool_], pressure: float) -> Array:
    """Tension (nx, ny) N/m that holds a resting surface of curvatures `bent` (nx, ny) 1/m, smooth:
    p over a quadric through them."""
    X, Y = np.meshgrid(grid.x - grid.x.mean(), grid.y - grid.y.mean(), indexing="ij")
    columns = np.stack([np.ones_like(X), X, Y, X * X, X * Y, Y * Y], axis=-1)
    found, *_ = np.linalg.lstsq(columns[seen], bent[seen], rcond=None)
    smooth = columns @ found
    middle = float(np.median(smooth[seen]))
    if middle <= 0:
        raise InputError("bulges inward at rest: z must be outward", field="membrane")
    return pressure / np.clip(smooth, 0.3 * middle, 3.0 * middle)


def _grown(grid: _Grid, held: Array, seen: NDArray[np.bool_], pressure: float) -> float:
    """Factor on the pressure `held` (nx, ny) Pa by the sheet's curvature, with which nothing
    presses where the surface is free."""
    factor = 1.0
    for _ in range(_ROUNDS):
        contact = seen & (np.abs(pressure - factor * held) > _PRESSED * pressure)
        free = seen & ~grid.grown(contact, _AWAY)
        if free.sum() < _FREE_MIN * seen.sum():
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
        # a spot as small as what is smoothed is the camera's
        sizes = np.bincount(numbered.ravel())[1:]
        large = sizes * grid.spacing**2 > grid.smoothing**2
        contact = np.isin(numbered, 1 + np.flatnonzero(large & (sums > 0)))
    counted = grid.grown(contact, _AROUND) & np.isfinite(pressing)
    by_x, by_y = np.gradient(heights, grid.spacing)
    q = np.where(counted, known, 0.0) * grid.spacing**2
    force = np.array([(q * by_x).sum(), (q * by_y).sum(), -q.sum()])
    X, Y = np.meshgrid(grid.x, grid.y, indexing="ij")
    place = np.full(2, np.nan)
    if contact.any():
        place = np.array([(q * X).sum(), (q * Y).sum()]) / q.sum()
    area = float(contact.sum()) * grid.spacing**2
    return SurfaceForce(force, place, area, grid.x, grid.y, heights, pressing, tension)


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
        places = np.stack(np.meshgrid(self.x, self.y, indexing="ij"), axis=-1)
        self.inside = _within(places, outline)

    def fit(self, points: ArrayLike, field: str) -> tuple[Array, NDArray[np.bool_]]:
        """Heights (nx, ny) m, and where (nx, ny) they were seen: the surface of least bending
        that goes through the points as `smoothing` lets it, by least squares that leave out what
        fits no surface."""
        from scipy import sparse
        from scipy.sparse.linalg import splu

        given = np.asarray(points, float).reshape(-1, 3)
        low = np.array([self.x[0], self.y[0]])
        last = np.array([self.x[-1], self.y[-1]])
        on = (given[:, :2] > low) & (given[:, :2] < last)
        given = given[np.isfinite(given).all(axis=1) & on.all(axis=1)]
        if len(given) < _FEWEST:
            raise InputError(
                f"has {len(given)} points over the outline, at least {_FEWEST}", field=field
            )
        looks = self._interpolation(given[:, :2])
        each = np.asarray(looks.sum(axis=0)).ravel()
        usual = float(np.median(each[each > 0]))
        stiff = usual * (self.smoothing / self.spacing) ** 4 * self._bending()
        weight = np.ones(len(given))
        heights = np.empty(looks.shape[1])
        for _ in range(_ROUNDS):
            normal = looks.T @ sparse.diags_array(weight) @ looks + stiff
            heights = splu(normal.tocsc()).solve(looks.T @ (weight * given[:, 2]))
            off = given[:, 2] - looks @ heights
            spread = 1.48 * float(np.median(np.abs(off))) + 1e-9
            weight = 1 / (1 + (off / (_OUTLIER * spread)) ** 2)
        shape = self.inside.shape
        seen = each.reshape(shape) > _MIN_SEEN * usual
        return heights.reshape(shape), self.inside & ~self.grown(~seen | ~self.inside, 1.0)

    def _interpolation(self, places: Array) -> Any:
        """Bilinear, (n, nx ny), sparse."""
        from scipy import sparse

        at = (places - [self.x[0], self.y[0]]) / self.spacing
        cell = np.minimum(at.astype(int), np.array(self.inside.shape) - 2)
        u, v = (at - cell).T
        rows = np.arange(len(places))
        shape = (len(places), self.inside.size)
        corners = (
            (0, 0, (1 - u) * (1 - v)),
            (1, 0, u * (1 - v)),
            (0, 1, (1 - u) * v),
            (1, 1, u * v),
        )
        looks = sparse.csr_array(shape)
        for i, j, share in corners:
            column = (cell[:, 0] + i) * self.inside.shape[1] + cell[:, 1] + j
            looks = looks + sparse.csr_array((share, (rows, column)), shape=shape)
        return looks

    def _bending(self) -> Any:
        """The sum of squares of second differences, (nx ny, nx ny), sparse."""
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
        """Sum (nx, ny) of the principal curvatures, 1/m, positive where it bulges outward."""
        by_x, by_y = np.gradient(heights, self.spacing)
        longer = np.sqrt(1 + by_x**2 + by_y**2)
        bent = np.gradient(by_x / longer, self.spacing, axis=0)
        bent = bent + np.gradient(by_y / longer, self.spacing, axis=1)
        return -bent

    def grown(self, marked: NDArray[np.bool_], lengths: float) -> NDArray[np.bool_]:
        """`marked` (nx, ny) and what is within so many smoothing lengths of it."""
        from scipy.ndimage import binary_dilation

        times = round(lengths * self.smoothing / self.spacing)
        return np.asarray(binary_dilation(marked, iterations=times), bool)


def _within(places: Array, outline: Array) -> NDArray[np.bool_]:
    """Which places (..., 2) lie within a polygon (k, 2): a ray to +x crosses it an odd number of
    times."""
    odd = np.zeros(places.shape[:-1], bool)
    for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        if a[1] == b[1]:
            continue
        between = (places[..., 1] >= min(a[1], b[1])) & (places[..., 1] < max(a[1], b[1]))
        crossing = a[0] + (places[..., 1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
        odd ^= between & (places[..., 0] < crossing)
    return odd
