"""Choice between the two poses of a circle, with the probability of the choice.

One image of one circle allows two poses that fit the image equally. The preference comes from other
information:

- Typical target orientation. Tilts from 0 to 90 degrees are assumed equally likely. The density per
  solid angle is 1/sin of the tilt against the camera's axis. So the less tilted pose is slightly
  likelier.
- The neighboring circles. If their centers lie on a smooth surface, its normal is one of the two.

Circles need not lie on a surface. The fraction that does, w, is estimated from the image itself. It
is the weight of a mixture whose other component is the prior of tilts. The fit uses
expectation-maximization. With q_i the two densities of a circle's normals,

    q_i = w N(n_i - n_surface; cov_i + cov_surface) + (1 - w) prior(n_i),
    P(first) = q_1/(q_1 + q_2).

Normals of one image share errors of radius, blur, glare and gamma. These are common to all circles,
so that they do not count against any of them. Their standard deviation is the likeliest one of a
few. The surface's normal is that of a plane (inverse depth linear in the image). The plane passes
through the circle and its nearest neighbors. Its covariance follows from their scatter about the
plane. Circles at independent depths scatter so much that the plane carries no information. Touch
sensing has a known membrane and does not use this module (`identity.identify`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import KDTree

from mjtactile.core import geometry
from mjtactile.core.types import Array, CirclePoses
from mjtactile.sensing.settings import DEFAULTS, PoseDisambiguationSettings

_ROUNDS = 30
_PLANE_ROUNDS = 3
_PLANE_OUTLIER = 4.0  # deviation at which a circle's weight in a plane decreases, in scatters
_SHARED_SDS = 6  # compared standard deviations of an error that all normals share


def prefer(
    poses: CirclePoses,
    cov_p_alt: Array,
    cov_n: Array,
    s: PoseDisambiguationSettings = DEFAULTS.pose_disambiguation,
    *,
    depth_sd: Array | None = None,
) -> tuple[CirclePoses, Array, Array]:
    """Return `poses` with the likelier pose of each circle first, and its probability. The second
    result is the covariance (N, 3, 3) m^2 of the other pose's center. The third is the probability
    (N,) that the first pose is right. `cov_p_alt` (N, 3, 3) m^2 belongs to the second centers of
    `poses`, `cov_n` (2, N, 3, 3) to both normals. `depth_sd` (N,), m: standard deviations of
    depths relative to each other, NaN for circles off the surface; without them, those of the
    centers."""
    if not len(poses):
        return poses, cov_p_alt, np.zeros(0)
    n = np.stack([poses.n_C, poses.n_C_alt])
    first = _probability(poses, n, cov_n, depth_sd, s)
    second = first < 0.5
    swap = second[:, None]
    wide = swap[..., None]
    better = replace(
        poses,
        p_CM=np.where(swap, poses.p_CM_alt, poses.p_CM),
        n_C=np.where(swap, n[1], n[0]),
        p_CM_alt=np.where(swap, poses.p_CM, poses.p_CM_alt),
        n_C_alt=np.where(swap, n[0], n[1]),
        cov_p=np.where(wide, cov_p_alt, poses.cov_p),
    )
    return better, np.where(wide, poses.cov_p, cov_p_alt), np.where(second, 1 - first, first)


def _probability(
    poses: CirclePoses,
    n: Array,
    cov_n: Array,
    depth_sd: Array | None,
    s: PoseDisambiguationSettings,
) -> Array:
    """Return P(first) (N,) of the normals `n` (2, N, 3)."""
    prior = _tilt_prior(n, cov_n, s)
    found = _surface_normals(poses, depth_sd, s)
    if found is None:
        return prior[0] / prior.sum(axis=0)
    surface, cov, known = found
    ok = known & (poses.status == "ok")
    best = -np.inf
    q = prior
    for spread in _densities(n, surface, _bounded(cov_n, s) + cov, _shared_sds(s)):
        density = np.where(known, spread, 0.0)
        fraction, evidence = _share_on_surface(density[:, ok], prior[:, ok], s)
        if evidence > best:
            best = evidence
            q = np.where(known, fraction * density + (1 - fraction) * prior, prior)
    return q[0] / q.sum(axis=0)


def _shared_sds(s: PoseDisambiguationSettings) -> Array:
    """Return the standard deviations of normals, rad, to compare."""
    return np.geomspace(s.min_surface_sd, max(s.max_normal_sd, s.min_surface_sd), _SHARED_SDS)


def _share_on_surface(
    density: Array, prior: Array, s: PoseDisambiguationSettings
) -> tuple[float, float]:
    """Estimate the fraction of circles on the surface, and the logarithm of its likelihood.
    `density` and `prior` (2, N) are the densities of their normals."""
    of_surface = density.sum(axis=0)
    of_prior = prior.sum(axis=0)
    fraction = 0.5
    for _ in range(_ROUNDS if len(of_prior) else 0):
        on = fraction * of_surface
        # prior counts of circles on and off the surface, so that a few that agree by chance do not
        # decide for all
        fraction = (1 + (on / (on + (1 - fraction) * of_prior)).sum()) / (
            1 + s.free_circles_prior + len(of_prior)
        )
    likelihood = np.log(fraction * of_surface + (1 - fraction) * of_prior).sum()
    return fraction, float(likelihood + s.free_circles_prior * np.log(1 - fraction))


def _tilt_prior(n: Array, cov_n: Array, s: PoseDisambiguationSettings) -> Array:
    """Return the density (2, N), 1/sr, of the normals for uniformly distributed tilts, blurred by
    their own standard deviations."""
    variance = np.trace(_bounded(cov_n, s), axis1=2, axis2=3) / 2
    sine = np.sqrt(n[..., 0] ** 2 + n[..., 1] ** 2 + variance)
    return 1 / (np.pi**2 * sine)


def _bounded(cov_n: Array, s: PoseDisambiguationSettings) -> Array:
    """Return covariances (2, N, 3, 3) of normals, limited to the validity range of a linear
    model."""
    return (
        cov_n
        * np.minimum(1, 2 * s.max_normal_sd**2 / np.trace(cov_n, axis1=2, axis2=3))[..., None, None]
    )


def _densities(n: Array, mean: Array, cov: Array, minima: Array) -> Array:
    """Compute the normal densities (m, 2, N) per steradian of unit vectors `n` (2, N, 3). The mean
    is `mean` (N, 3). The covariance is `cov` (2, N, 3, 3) plus the square of each of `minima` (m,),
    rad."""
    T = np.stack(geometry.tangents(mean), axis=1)  # shape (N, 2, 3)
    d0, d1 = np.einsum("nij,knj->ikn", T, n - mean)
    S = T @ cov @ T.transpose(0, 2, 1)
    S00, S11 = (S[..., i, i] + minima[:, None, None] ** 2 for i in range(2))
    S01 = S[..., 0, 1]
    det = S00 * S11 - S01**2
    far = (d0**2 * S11 - 2 * d0 * d1 * S01 + d1**2 * S00) / det
    behind = np.einsum("kni,ni->kn", n, mean) < 0
    return np.where(behind, 0.0, np.exp(-0.5 * far) / (2 * np.pi * np.sqrt(det)))


def _surface_normals(
    poses: CirclePoses, depth_sd: Array | None, s: PoseDisambiguationSettings
) -> tuple[Array, Array, Array] | None:
    """Return normals (N, 3) of local planes, their covariance (N, 3, 3), and a validity mask (N,).

    The result is None if there are too few circles. The inverse depth of a plane, w = (n/d) . (x,
    y, 1), is linear in the image. It is fitted by robust least squares to the nearest circles. The
    covariance comes from their scatter, which is assumed to be at least the standard deviation of
    the depths.
    """
    if depth_sd is None:
        depth_sd = np.sqrt(poses.cov_p[:, 2, 2])
    ok = np.flatnonzero((poses.status == "ok") & (poses.p_CM[:, 2] > 0) & np.isfinite(depth_sd))
    if len(ok) < s.min_circles:
        return None
    # unknown: where the lens model cannot be inverted
    ray = np.nan_to_num(poses.p_CM / poses.p_CM[:, 2:])
    w = 1 / poses.p_CM[ok, 2]
    sd = depth_sd[ok] / poses.p_CM[ok, 2] ** 2
    # indices (N, k) into `ok`
    near = KDTree(ray[ok, :2]).query(ray[:, :2], min(s.plane_circles, len(ok)))[1]
    A = ray[ok][near]
    b = w[near]
    weight = np.ones_like(b)
    for _ in range(_PLANE_ROUNDS):
        left = _fit_planes(A, b, weight)[2]
        # a circle of another size, or off the surface, has no effect on its neighbors' plane
        scale = np.maximum(np.median(np.abs(left), axis=1, keepdims=True) / 0.6745, sd[near])
        weight = 1 / (1 + (left / (_PLANE_OUTLIER * scale)) ** 4)
    plane, inverse, left, known = _fit_planes(A, b, weight)
    freedom = np.maximum(weight.sum(axis=1) - 3, 1)
    variance = np.maximum(
        (weight * left**2).sum(axis=1) / freedom,
        (weight * sd[near] ** 2).sum(axis=1) / weight.sum(axis=1),
    )
    length = np.linalg.norm(plane, axis=1)
    n = -plane / length[:, None]
    projector = (np.eye(3) - n[:, :, None] * n[:, None]) / length[:, None, None]
    cov = projector @ inverse @ projector * variance[:, None, None]
    return n, cov, known & (np.trace(cov, axis1=1, axis2=2) < 2 * s.max_surface_sd**2)


def _fit_planes(A: Array, b: Array, weight: Array) -> tuple[Array, Array, Array, Array]:
    """Fit planes (N, 3) to the inverse depths `b` (N, k) along the rays `A` (N, k, 3). Also return
    the inverse normal matrices (N, 3, 3), the residuals (N, k) and a validity mask (N,)."""
    At = A.transpose(0, 2, 1) * weight[:, None]
    normal = At @ A
    eigenvalues = np.linalg.eigvalsh(normal)
    known = eigenvalues[:, 0] > 1e-12 * eigenvalues[:, -1]  # circles in one row have no plane
    normal[~known] = np.eye(3)
    inverse = np.linalg.inv(normal)
    plane = (inverse @ (At @ b[..., None]))[..., 0]
    return plane, inverse, b - (A @ plane[..., None])[..., 0], known
