"""One surface out of patches: a body of few numbers and, on top, a field of what it leaves over
(docs/equations.md, Eq. E1 to E4)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, cho_factor, cho_solve, solve_triangular
from scipy.optimize import least_squares
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from mjtactile.core.types import Array
from mjtactile.explore import body
from mjtactile.explore.patch import Patch, between

_MM = 1e3
_HALF = 15.0
"""mm: half size of what a hand explores, before it is touched."""
_PLACE_SD = 15.0  # mm
_SIZE_SD = 0.6  # of the logarithm of all sizes together, and of each alone
_ASPECT_SD = 0.4
_ROUND = (0.8, 0.5)  # exponents, and sd
_TAPER_SD = 0.15
_TURN_SD = 2.0  # rad
_FIELDS = ((0.0, 10.0), (0.15, 8.0), (0.5, 8.0), (1.2, 8.0), (0.5, 14.0), (1.5, 14.0))
"""mm: sd and length of what a body of few numbers leaves over, of which the likeliest is taken."""
_FIRST_FIELD = (0.3, 8.0)
_FREE_SD = 0.5  # mm: how sharply what was free is outside; neighbours tell the same
_FREE_MOST = 1.0  # mm: no further does one such point pull
_FREE_OUT = 0.3  # mm: what was free is so far outside, give or take the same
_FREE_APART = 2.5  # mm between such points
_STRAY = 4.5  # sd, from which on a point does not belong
_STRAYS = 0.1  # of all points, at most
_ROUNDS = 60
_STARTS = 3  # that are followed to the end


@dataclass(frozen=True, eq=False)
class Surface:
    """What is believed of an object's surface.

    Attributes:
        theta: (13,) The body's numbers (`mjtactile.explore.body.NAMES`).
        field: mm, sd and length of the field on top.
        points: (N, 3) mm, that were touched.
        weights: (N,) 1/mm, of the field's covariances with the points.
        factor: Of the covariance of the points' distances, with the body's numbers unknown.
        log_evidence: Of the field.
    """

    theta: Array
    field: tuple[float, float]
    points: Array
    weights: Array
    factor: tuple[Array, bool]
    log_evidence: float

    def distance(self, p: Array) -> Array:
        """How far points (N, 3) m are outside, (N,) m; 0 on the surface."""
        across = kernel(_MM * p, self.points, *self.field)
        return (body.distance(self.theta, _MM * p) + across @ self.weights) / _MM

    def distance_sd(self, p: Array) -> Array:
        """Its standard deviation, (N,) m."""
        p_mm = _MM * p
        across = self._across(p_mm)
        rows = body.by_numbers(self.theta, p_mm)
        before = np.einsum("ni,ij,nj->n", rows, _PRIOR_COV, rows) + self.field[0] ** 2
        told = np.einsum("nm,mn->n", across, cho_solve(self.factor, across.T))
        return np.sqrt(np.maximum(before - told, 1e-8)) / _MM

    def _across(self, p_mm: Array) -> Array:
        """Covariance (N, M) mm^2 of the distances at points with those that were touched."""
        own = body.by_numbers(self.theta, p_mm)
        theirs = body.by_numbers(self.theta, self.points)
        return own @ _PRIOR_COV @ theirs.T + kernel(p_mm, self.points, *self.field)


def kernel(p: Array, q: Array, sd: float, length: float) -> Array:
    """Covariance (N, M) of the field at points; Matern of order 5/2."""
    if sd == 0:
        return np.zeros((len(p), len(q)))
    r = np.sqrt(5) * cdist(p, q) / length
    return sd**2 * (1 + r + r**2 / 3) * np.exp(-r)


def _prior_covariance() -> Array:
    size = np.full((3, 3), _SIZE_SD**2) + _ASPECT_SD**2 * np.eye(3)
    cov = np.diag(
        [_PLACE_SD**2] * 3
        + [_TURN_SD**2] * 3
        + [0.0] * 3
        + [_ROUND[1] ** 2] * 2
        + [_TAPER_SD**2] * 2
    )
    cov[6:9, 6:9] = size
    return cov


_PRIOR = np.array([0.0] * 6 + [np.log(_HALF)] * 3 + [_ROUND[0]] * 2 + [0.0] * 2)
_PRIOR_COV = _prior_covariance()
_PRIOR_ROOT = np.linalg.inv(np.linalg.cholesky(_PRIOR_COV))


def unknown() -> Surface:
    """Before the first touch: a ball about the holder's origin, half of it give or take."""
    none = np.zeros((0, 3))
    empty = (np.zeros((0, 0)), True)
    theta = _PRIOR.copy()
    theta[9:11] = 1.0
    return Surface(theta, _FIRST_FIELD, none, np.zeros(0), empty, 0.0)


def fuse(patches: Sequence[Patch], before: Surface | None = None) -> Surface:
    """The surface that patches lie on.

    Args:
        patches: Of one object.
        before: What was believed without the newest of them: a start.

    Returns:
        The surface.
    """
    if not patches:
        return unknown()
    data = _Data.of(patches)
    starts = _starts(patches)
    if before is not None and len(before.points):
        starts.insert(0, before.theta)
    theta = _best(data, data.whitened(_FIRST_FIELD), starts)
    data = data.without_strays(theta).with_free(theta)
    theta = _best(data, data.whitened(_FIRST_FIELD), [theta, *starts])
    fields = [_with_field(data, theta, field) for field in _FIELDS]
    likeliest = max(fields, key=lambda one: one.log_evidence)
    again = _solve(data, data.whitened(likeliest.field), theta, rounds=_ROUNDS)
    return _with_field(data, again.x, likeliest.field)


def _best(data: _Data, root: Array, starts: Sequence[Array]) -> Array:
    """The likeliest body from any of some starts, of which the most promising are followed."""
    tried = sorted((_solve(data, root, start, rounds=8) for start in starts), key=_cost)
    return min((_solve(data, root, one.x, rounds=_ROUNDS) for one in tried[:_STARTS]), key=_cost).x


def _cost(found) -> float:
    return float(found.cost)


@dataclass(frozen=True, eq=False)
class _Data:
    """Points in mm, how far each is outside, mm, with its covariance mm^2; and what is free."""

    points: Array
    outside: Array
    noise: Array
    free: Array

    @classmethod
    def of(cls, patches: Sequence[Patch]) -> _Data:
        points = _MM * np.concatenate([patch.points for patch in patches])
        noise: Array = np.asarray(block_diag(*(_MM**2 * patch.covariance() for patch in patches)))
        if any(patch.group for patch in patches):
            noise += _MM**2 * np.block(
                [[between(one, other) for other in patches] for one in patches]
            )
        free = _MM * np.concatenate([patch.free for patch in patches])
        return cls(points, np.zeros(len(points)), noise, free)

    def whitened(self, field: tuple[float, float]) -> Array:
        """Lower triangular root of the covariance of heights over the body."""
        return np.linalg.cholesky(kernel(self.points, self.points, *field) + self.noise)

    def left(self, theta: Array) -> Array:
        """What a body leaves unexplained at the points, mm."""
        return self.outside - body.distance(theta, self.points)

    def without_strays(self, theta: Array) -> _Data:
        """Without points that all others, body and field together, say are elsewhere: where a
        patch was taken to be wider than it is."""
        keep = np.ones(len(self.points), bool)
        for _ in range(int(_STRAYS * len(keep))):
            kept = np.flatnonzero(keep)
            points = self.points[kept]
            cov = kernel(points, points, *_FIRST_FIELD) + self.noise[np.ix_(kept, kept)]
            inverse = np.linalg.inv(cov)
            own = np.diag(inverse)
            off = np.abs(inverse @ self.left(theta)[kept]) / np.sqrt(own)
            if off.max() < _STRAY:
                break
            keep[kept[int(off.argmax())]] = False
        kept = np.flatnonzero(keep)
        return _Data(
            self.points[kept], self.outside[kept], self.noise[np.ix_(kept, kept)], self.free
        )

    def with_free(self, theta: Array) -> _Data:
        """With some of what was free, where the body would be there: as points a little outside."""
        inside = body.distance(theta, self.free)
        worst = [index for index in np.argsort(inside) if inside[index] < 0]
        chosen: list[Array] = []
        for index in worst:
            place = self.free[index]
            if all(np.linalg.norm(place - other) > _FREE_APART for other in chosen):
                chosen.append(place)
        if not chosen:
            return self
        count = len(chosen)
        return _Data(
            np.concatenate([self.points, chosen]),
            np.append(self.outside, np.full(count, _FREE_OUT)),
            np.asarray(block_diag(self.noise, _FREE_OUT**2 * np.eye(count))),
            self.free,
        )


def _solve(data: _Data, root: Array, start: Array, *, rounds: int):
    """The body that is likeliest, from a start."""
    start = np.clip(start, body.LOW + 1e-6, body.HIGH - 1e-6)

    def left(theta: Array) -> Array:
        touched = solve_triangular(root, data.left(theta), lower=True)
        free = np.clip(body.distance(theta, data.free), -_FREE_MOST, 0.0) / _FREE_SD
        return np.concatenate([touched, free, _PRIOR_ROOT @ (theta - _PRIOR)])

    return least_squares(
        left, start, bounds=(body.LOW, body.HIGH), x_scale=_SCALE, max_nfev=rounds, method="trf"
    )


_SCALE = np.array([1.0] * 3 + [0.1] * 3 + [0.05] * 3 + [0.1] * 2 + [0.05] * 2)


def _with_field(data: _Data, theta: Array, field: tuple[float, float]) -> Surface:
    """The field and the body's numbers about `theta`, from what was touched (Eq. E3)."""
    rows = body.by_numbers(theta, data.points)
    cov = rows @ _PRIOR_COV @ rows.T + kernel(data.points, data.points, *field) + data.noise
    factor = cho_factor(cov, lower=True)
    expected = data.left(theta) - rows @ (_PRIOR - theta)
    evidence = -0.5 * float(expected @ cho_solve(factor, expected)) - float(
        np.log(np.diag(factor[0])).sum()
    )
    # at the likeliest body its own share of what is left over is nothing
    own = cho_factor(kernel(data.points, data.points, *field) + data.noise, lower=True)
    weights = cho_solve(own, data.left(theta))
    return Surface(theta, field, data.points, weights, factor, evidence)


def _starts(patches: Sequence[Patch]) -> list[Array]:
    """Bodies to start from: about the place where the patches' normals meet, of a ball's size, in
    likely turns, round, like a cylinder, like a box."""
    middles = _MM * np.stack([patch.middle for patch in patches])
    normals = np.stack([patch.normal for patch in patches])
    centre, radius = _meeting(middles, normals)
    sizes = np.full(3, np.log(radius))
    starts = []
    for R in _turns(middles, normals):
        turn = Rotation.from_matrix(R).as_rotvec()
        for exponents in ((1.0, 1.0), (0.25, 1.0), (0.25, 0.25)):
            starts.append(np.concatenate([centre, turn, sizes, exponents, [0.0, 0.0]]))
    return starts


def _meeting(middles: Array, normals: Array) -> tuple[Array, float]:
    """Centre and radius, mm, of the ball that the patches are on, as far as they say, else of 15
    mm."""
    rows = np.concatenate([np.tile(np.eye(3), (len(middles), 1)), np.zeros((1, 3))])
    rows = np.column_stack([rows, np.append(normals.ravel(), 0.0)])
    rows[-1, 3] = 0.5
    goal = np.append(middles.ravel(), 0.5 * _HALF)
    found = np.linalg.lstsq(rows, goal, rcond=None)[0]
    return found[:3], float(np.clip(found[3], 5.0, 40.0))


def _turns(middles: Array, normals: Array) -> list[Array]:
    """Rotations (3, 3) whose axes may be the body's: those of its normals, in three orders."""
    bases = [np.linalg.eigh(normals.T @ normals + 1e-6 * np.diag([3.0, 2.0, 1.0]))[1]]
    for i, j in itertools.combinations(range(len(normals)), 2):
        if abs(normals[i] @ normals[j]) < 0.2 and len(bases) < 3:
            third = np.cross(normals[i], normals[j])
            third /= np.linalg.norm(third)
            bases.append(np.column_stack([normals[i], np.cross(third, normals[i]), third]))
    turns = []
    for basis in bases:
        right = basis * np.sign(np.linalg.det(basis))
        turns += [np.roll(right, shift, axis=1) for shift in range(3)]
    return turns
