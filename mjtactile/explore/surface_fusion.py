"""Fusion of patches to one surface.

Each shape model is fitted, with a field for the residual. It is weighted by its evidence
(docs/theory/exploration.md, Eq. E3 to E5).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag, cho_factor, cho_solve, solve_triangular
from scipy.optimize import OptimizeResult, least_squares
from scipy.spatial.transform import Rotation

from mjtactile.core.types import Array
from mjtactile.explore import superquadric
from mjtactile.explore.shape_models import FAMILIES, HALF, ObjectFamily
from mjtactile.explore.surface_patch import Patch, group_covariance
from mjtactile.explore.surface_posterior import SurfacePosterior, excess, kernel, unknown

_MM = 1e3
_FIRST_FIELD = (0.05, 8.0)  # mm; a larger field would absorb the errors of outlier patches
_FREE_SD = 0.5  # standard deviation of a free-space residual, mm; neighboring points are correlated
_FREE_MAX = 1.0  # limit of the residual of such a point, mm
_FREE_OUT = 0.3  # distance of free points outside the surface, and its standard deviation, mm
_FREE_SPACING = 2.5  # spacing of such points, mm
_WIDE = 3.0  # residual, in sd, above which the weight of a point decreases
_ALLOWED = 0.1  # tolerated distance of a patch of the correct kind from the shape, mm
# residual, in sd, above which a whole patch may be misplaced: an edge classified as a face
_OUTLIER_SD = 4.0
_FLAG_SD = (1.0, 0.2)  # its displacement in that case, mm and rad
_FLAG_ODDS = np.log(0.1)
_STRAY = 4.5  # residual, in sd, above which a point is an outlier
_STRAY_SD = 1.0  # deviation of an outlier, mm
_STRAY_ODDS = np.log(0.05)
_STRAYS = 0.25  # maximum fraction of outlier points
_ON_END, _END_POINTS = 0.3, 3  # distance from a flat end, mm, and number of points of a touched end
_UNTOUCHED = 1e3  # penalty in log evidence for a flat end that was not touched
_ROUNDS = 40
_FIRST_ROUNDS = 12
_STARTS = 2  # start poses that are refined until convergence
_MAX_CENTERS = 3  # start poses in addition to a known shape
_SCALE = np.array([1.0] * 3 + [0.1] * 3 + [0.05] * 3 + [0.1] * 2 + [0.05] * 3)


def fuse(
    patches: Sequence[Patch], before: Sequence[SurfacePosterior] = ()
) -> list[SurfacePosterior]:
    """Estimate the most likely surface of each shape model from the patches of one object, the most
    likely model first. `before` are earlier estimates without the newest patches, used as start
    values."""
    if not patches:
        return [unknown()]
    data = _Data.of(patches)
    starts = _starts(patches)
    known = {surface.family.name: surface.theta for surface in before if len(surface.points)}
    surfaces = [_of_family(data, family, starts, known.get(family.name)) for family in FAMILIES]
    return sorted(surfaces, key=lambda surface: -surface.log_evidence)


def shares(surfaces: Sequence[SurfacePosterior]) -> Array:
    """Return the probability (N,) of each surface, with equal prior probabilities."""
    log = np.array([surface.log_evidence for surface in surfaces])
    weight = np.exp(log - log.max())
    return weight / weight.sum()


def _of_family(
    data: _Data, family: ObjectFamily, centers: Sequence[Array], known: Array | None
) -> SurfacePosterior:
    """Estimate the most likely shape of a model, with its residual field."""
    starts = []
    if known is not None:
        starts, centers = [known], centers[:_MAX_CENTERS]
    for center, exponents in itertools.product(centers, family.starts):
        starts.append(np.concatenate([center, exponents, family.mean[11:]]))
        if family.cut:  # at either end
            starts.append(starts[-1].copy())
            starts[-1][3:6] = _upside_down(center[3:6])
    fits = sorted((_robust(data, family, start, _FIRST_ROUNDS) for start in starts), key=_cost)
    theta = min((_robust(data, family, fit.x, _ROUNDS) for fit in fits[:_STARTS]), key=_cost).x
    stated = data.noise
    data = data.with_uncertainty(theta).with_free(theta)
    theta = _solve(data, family, _FIRST_FIELD, theta).x
    fields = [_with_field(data, family, theta, field) for field in family.fields]
    field = max(fields, key=lambda surface: surface.log_evidence).field
    theta = _solve(data, family, field, theta).x
    surface = _with_field(data, family, theta, field)
    expected = _expected(data, family, theta)
    inflation = excess(surface.factor, expected, data.noise, stated, data.parts)
    surface = replace(surface, excess=inflation)
    if family.cut and not _ends_flat(data, theta):
        return replace(surface, log_evidence=surface.log_evidence - _UNTOUCHED)
    return surface


def _ends_flat(data: _Data, theta: Array) -> bool:
    """Return True if the flat end of a shape was touched. Without a touch, the end may as well be
    round."""
    touched = data.points[: data.parts[-1].stop]
    beyond = superquadric.beyond_cut(theta[None], touched)[0]
    return bool((np.abs(beyond) < _ON_END).sum() >= _END_POINTS)


def _upside_down(turn: Array) -> Array:
    """Return the rotation vector (3,) of the shape turned upside down about its x axis."""
    return (Rotation.from_rotvec(turn) * Rotation.from_euler("x", np.pi)).as_rotvec()


def _cost(found: OptimizeResult) -> float:
    return float(found.cost)


@dataclass(frozen=True, eq=False)
class _Data:
    """Data of the fit. Points are in mm. Their distances outside, mm, have a covariance, mm^2.
    Further data are free-space points, the points of each patch, and the log odds of all
    outliers."""

    points: Array
    outside: Array
    noise: Array
    free: Array
    parts: tuple[slice, ...]
    odds: float = 0.0

    @classmethod
    def of(cls, patches: Sequence[Patch]) -> _Data:
        points = _MM * np.concatenate([patch.points for patch in patches])
        noise: Array = np.asarray(block_diag(*(_MM**2 * patch.covariance() for patch in patches)))
        if any(patch.group for patch in patches):
            blocks = [[group_covariance(one, other) for other in patches] for one in patches]
            noise += _MM**2 * np.block(blocks)
        free = _thinned(_MM * np.concatenate([patch.free for patch in patches]))
        ends = np.cumsum([len(patch.points) for patch in patches])
        parts = tuple(slice(end - len(p.points), end) for end, p in zip(ends, patches, strict=True))
        return cls(points, np.zeros(len(points)), noise, free, parts)

    def left(self, theta: Array) -> Array:
        """Return the residuals of a shape at the points, mm."""
        return self.outside - superquadric.distance(theta, self.points)

    def with_uncertainty(self, theta: Array) -> _Data:
        """Inflate the covariance of patches, then of points, that contradict a shape. Causes are an
        edge mistaken for a face, or an overestimated patch width. Each outlier reduces the log
        odds."""
        left = self.left(theta)
        noise = self.noise.copy()
        odds = self.odds
        for part in self.parts:
            sd = np.sqrt(noise[part, part].diagonal().min() + _ALLOWED**2)
            if np.median(np.abs(left[part])) < _OUTLIER_SD * sd:
                continue
            odds += _FLAG_ODDS
            centered = self.points[part] - self.points[part].mean(axis=0)
            height, tilt = _FLAG_SD
            noise[part, part] += height**2 + tilt**2 * centered @ centered.T
        field = kernel(self.points, self.points, *_FIRST_FIELD)
        for _ in range(int(_STRAYS * len(left))):
            inverse = np.linalg.inv(field + noise)
            centered = np.abs(inverse @ left) / np.sqrt(np.diag(inverse))
            worst = int(centered.argmax())
            if centered[worst] < _STRAY:
                break
            noise[worst, worst] += _STRAY_SD**2
            odds += _STRAY_ODDS
        return replace(self, noise=noise, odds=odds)

    def with_free(self, theta: Array) -> _Data:
        """Add free-space points inside the shape as points slightly outside it."""
        inside = superquadric.distance(theta, self.free)
        chosen: list[Array] = []
        for index in np.argsort(inside)[: np.count_nonzero(inside < 0)]:
            free = self.free[index]
            if all(np.linalg.norm(free - other) > _FREE_SPACING for other in chosen):
                chosen.append(free)
        if not chosen:
            return self
        count = len(chosen)
        noise = np.asarray(block_diag(self.noise, _FREE_OUT**2 * np.eye(count)))
        outside = np.append(self.outside, np.full(count, _FREE_OUT))
        return replace(
            self, points=np.concatenate([self.points, chosen]), outside=outside, noise=noise
        )


def _thinned(points: Array) -> Array:
    """Return one of the points in each cell as wide as their minimum distance."""
    cells = np.floor(points / _FREE_SPACING).astype(int)
    return points[np.unique(cells, axis=0, return_index=True)[1]]


def _least_squares(
    residuals: Callable[[Array], Array], slopes: Any, start: Array, rounds: int
) -> OptimizeResult:
    start = np.clip(start, superquadric.LOW + 1e-6, superquadric.HIGH - 1e-6)
    bounds = (superquadric.LOW, superquadric.HIGH)
    return least_squares(residuals, start, slopes, bounds=bounds, x_scale=_SCALE, max_nfev=rounds)


def _free_and_prior(data: _Data, family: ObjectFamily, theta: Array) -> list[Array]:
    free = np.clip(superquadric.distance(theta, data.free), -_FREE_MAX, 0.0) / _FREE_SD
    return [free, family.root @ (theta - family.mean)]


def _slopes(data: _Data, family: ObjectFamily, theta: Array) -> tuple[Array, list[Array]]:
    """Return derivatives with respect to the shape parameters. They are those of the distances at
    the points, of the free-space residuals and of the prior."""
    inside = superquadric.distance(theta, data.free)
    pulls = np.flatnonzero((inside < 0) & (inside > -_FREE_MAX))
    rows = superquadric.jacobian(theta, np.concatenate([data.points, data.free[pulls]]))
    count = len(data.points)
    free = np.zeros((len(data.free), superquadric.COUNT))
    free[pulls] = rows[count:] / _FREE_SD
    return rows[:count], [free, family.root]


def _robust(data: _Data, family: ObjectFamily, start: Array, rounds: int) -> OptimizeResult:
    """Fit a shape to the majority of points, each on its own. Distant points have less weight
    (Cauchy's loss)."""
    sd = np.sqrt(np.diag(data.noise) + _ALLOWED**2)
    for part in data.parts:
        sd[part] *= np.sqrt(max(part.stop - part.start, 4) / 4)

    def soft(residual: Array) -> Array:
        return np.sign(residual) * _WIDE * np.sqrt(np.log1p((residual / _WIDE) ** 2))

    def left(theta: Array) -> Array:
        touched = soft(data.left(theta) / sd)
        return np.concatenate([touched, *_free_and_prior(data, family, theta)])

    def slopes(theta: Array) -> Array:
        residual = data.left(theta) / sd
        near = np.abs(residual) < 1e-6
        ratio = np.divide(residual, soft(residual), out=np.ones_like(residual), where=~near)
        by_off = ratio / (1 + (residual / _WIDE) ** 2)
        touched, others = _slopes(data, family, theta)
        return np.concatenate([-(by_off / sd)[:, None] * touched, *others])

    return _least_squares(left, slopes, start, rounds)


def _solve(
    data: _Data, family: ObjectFamily, field: tuple[float, float], start: Array
) -> OptimizeResult:
    """Compute the most likely shape from a start value."""
    root = np.linalg.cholesky(kernel(data.points, data.points, *field) + data.noise)

    def left(theta: Array) -> Array:
        touched = solve_triangular(root, data.left(theta), lower=True)
        return np.concatenate([touched, *_free_and_prior(data, family, theta)])

    def slopes(theta: Array) -> Array:
        touched, others = _slopes(data, family, theta)
        return np.concatenate([-solve_triangular(root, touched, lower=True), *others])

    return _least_squares(left, slopes, start, _ROUNDS)


def _expected(data: _Data, family: ObjectFamily, theta: Array) -> Array:
    """Return the residuals at the points for the model's mean shape, mm, to first order."""
    rows = superquadric.jacobian(theta, data.points)
    return data.left(theta) - rows @ (family.mean - theta)


def _with_field(
    data: _Data, family: ObjectFamily, theta: Array, field: tuple[float, float]
) -> SurfacePosterior:
    """Compute the posterior of field and shape parameters about `theta` (Eq. E3). It includes the
    evidence (Eq. E5)."""
    rows = superquadric.jacobian(theta, data.points)
    field_cov = kernel(data.points, data.points, *field) + data.noise
    cov = rows @ family.cov @ rows.T + field_cov
    factor = cho_factor(cov, lower=True)
    expected = _expected(data, family, theta)
    evidence = -0.5 * float(expected @ cho_solve(factor, expected)) - float(
        np.log(np.diag(factor[0])).sum()
    )
    free = _free_and_prior(data, family, theta)[0]
    evidence += data.odds - 0.5 * float(free @ free)
    # at the most likely shape the parameter correction is zero, so the field explains the residual
    weights = cho_solve(cho_factor(field_cov, lower=True), data.left(theta))
    return SurfacePosterior(family, theta, field, data.points, weights, factor, evidence)


def _starts(patches: Sequence[Patch]) -> list[Array]:
    """Return start vectors (9,) of position, rotation and sizes. The position is near the
    intersection of the patches' normals. The sizes are those of a ball. The rotations are likely
    ones."""
    centers = _MM * np.stack([patch.center for patch in patches])
    normals = np.stack([patch.normal for patch in patches])
    center, radius = _fit_sphere(centers, normals)
    sizes = np.full(3, np.log(radius))
    turns = Rotation.from_matrix(np.stack(_rotations(normals))).as_rotvec()
    return [np.concatenate([center, rotation, sizes]) for rotation in turns]


def _fit_sphere(centers: Array, normals: Array) -> tuple[Array, float]:
    """Fit center and radius of a sphere to the patches, mm. The prior radius is 15 mm."""
    rows = np.concatenate([np.tile(np.eye(3), (len(centers), 1)), np.zeros((1, 3))])
    rows = np.column_stack([rows, np.append(normals.ravel(), 0.0)])
    rows[-1, 3] = 0.5
    goal = np.append(centers.ravel(), 0.5 * HALF)
    sphere = np.linalg.lstsq(rows, goal, rcond=None)[0]
    return sphere[:3], float(np.clip(sphere[3], 5.0, 40.0))


def _rotations(normals: Array) -> list[Array]:
    """Return candidate rotations (3, 3) of the shape: bases from the normals, in three axis
    orders."""
    bases = [np.linalg.eigh(normals.T @ normals + 1e-6 * np.diag([3.0, 2.0, 1.0]))[1]]
    for i, j in itertools.combinations(range(len(normals)), 2):
        if abs(normals[i] @ normals[j]) < 0.2 and len(bases) < 3:
            third = np.cross(normals[i], normals[j])
            third /= np.linalg.norm(third)
            bases.append(np.column_stack([normals[i], np.cross(third, normals[i]), third]))
    right_handed = [basis * np.sign(np.linalg.det(basis)) for basis in bases]
    return [np.roll(basis, shift, axis=1) for basis in right_handed for shift in range(3)]
