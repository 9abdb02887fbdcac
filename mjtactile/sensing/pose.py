"""From ellipses to circle poses: the corrected closed form of the paper's Eq. 3-5, both solutions, with covariance.

With Q the circle's cone in ideal normalised coordinates (x^T Q x = 0 on the boundary), eigenvalues l1 >= l2 > 0 > l3,
eigenvectors v1, v3 (v3 away from the camera), sin psi = sqrt((l1 - l2)/(l1 - l3)), cos psi = sqrt((l2 - l3)/(l1 - l3)):

    C = r ( s sqrt(-l3/l1) sin psi v1 + sqrt(-l1/l3) cos psi v3 ),   n = s sin psi v1 - cos psi v3,   s = +1 or -1

Departures from the paper (docs/equations.md): Q = K^T M K instead of the pixel conic M; the sign belongs to the sine
term alone; C is the centre in space, not only its image, so that no sine rule is needed; n faces the camera.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mjtactile import optics
from mjtactile.design import CameraDesign
from mjtactile.errors import InputError
from mjtactile.sensing import ellipse
from mjtactile.types import Array, CirclePoses, Ellipses

_SAMPLES = 16  # boundary points that carry an ellipse through lens and glass
_FEW = 8  # boundary points that carry derivatives; five are the least
_LEAST_TILT = 1e-3  # rad; below it the normal's derivative vanishes and only its bound is left


def estimate_poses(ellipses: Ellipses, camera: optics.Camera | CameraDesign, radius: ArrayLike) -> CirclePoses:
    """Poses of N circles of `radius` (scalar or (N,)) m from their ellipses in distorted pixels.

    Of the two solutions, `n_C` is the one more face-on to the camera's axis. Lens and pane are those of `camera`.
    Raises InputError for a radius that is not positive or not one per ellipse.
    """
    camera = camera if isinstance(camera, optics.Camera) else optics.Camera.from_design(camera)
    r = _radii(radius, len(ellipses))
    if not len(ellipses):
        none = np.zeros((0, 3))
        return CirclePoses(none[:, :2], none, none, none, none, np.zeros((0, 3, 3)), ellipses.status)
    shape = ellipse.shape_from_axes(ellipses.semi_axes_px, ellipses.angle)
    p, n = _both(camera, ellipses.center_px, shape, r)
    first = (n[1, :, 2] < n[0, :, 2]).astype(int)
    each = np.arange(len(ellipses))
    p_first, n_first = p[first, each], n[first, each]
    uv = optics.project(camera, p_first)
    cov = ellipse.covariance_of_shape(ellipses.cov, ellipses.semi_axes_px, ellipses.angle)
    cov_p = _covariance(camera, p_first, n_first, r, shape, cov)
    return CirclePoses(uv, p_first, n_first, p[1 - first, each], n[1 - first, each], cov_p, ellipses.status)


def circles_from_cones(Q: Array, radius: Array) -> tuple[Array, Array]:
    """The closed form: centres and normals, each (2, N, 3), of circles of `radius` (N,) on the cones `Q` (N, 3, 3).

    Q has one negative eigenvalue (the inside of the ellipse is negative). Normals point towards the camera.
    """
    values, vectors = np.linalg.eigh(Q)
    l3, l2, l1 = np.maximum(values.T, [[-np.inf], [1e-300], [1e-300]])
    v3, v1 = vectors[:, :, 0], vectors[:, :, 2]
    v3 = v3 * np.where(v3[:, 2] < 0, -1.0, 1.0)[:, None]
    sine = np.sqrt(np.maximum(l1 - l2, 0) / (l1 - l3))
    cosine = np.sqrt((l2 - l3) / (l1 - l3))
    along1 = (radius * np.sqrt(-l3 / l1) * sine)[:, None] * v1
    along3 = (radius * np.sqrt(-l1 / l3) * cosine)[:, None] * v3
    n1, n3 = sine[:, None] * v1, cosine[:, None] * v3
    return np.stack([along3 + along1, along3 - along1]), np.stack([n1 - n3, -n1 - n3])


def cones(camera: optics.Camera, center_px: Array, shape: Array) -> Array:
    """Cones Q (N, 3, 3) in ideal normalised coordinates of ellipses in distorted pixels, without the pane."""
    if not any(camera.distortion):
        K = camera.K
        return K.T @ ellipse.conic_from_shape(center_px, shape) @ K
    points, _ = ellipse.boundary(center_px, shape, _SAMPLES)
    xy = optics.undistort(camera, optics.normalized_from_pixel(camera, points))
    return fit_cones(xy)


def fit_cones(xy: Array) -> Array:
    """Cones Q (N, 3, 3) by least squares through boundary points `xy` (N, K, 2) that lie on conics almost exactly.

    Points are first mapped to near the unit circle by their own moments, where the algebraic distance is the
    geometric one to first order.
    """
    middle = xy.mean(axis=1)
    d = xy - middle[:, None]
    second = np.stack([(d[..., 0] ** 2).mean(1), (d[..., 0] * d[..., 1]).mean(1), (d[..., 1] ** 2).mean(1)], axis=1)
    p, q, s = ellipse.inverse_shape(ellipse.shape_from_moments(second / 2)).T[..., None]
    x, y = p * d[..., 0] + q * d[..., 1], q * d[..., 0] + s * d[..., 1]
    A = np.stack([x * x, 2 * x * y, y * y, 2 * x, 2 * y], axis=-1)
    At = A.transpose(0, 2, 1)
    a, b, c, e, f = np.linalg.solve(At @ A, At.sum(axis=2)[..., None])[..., 0].T
    local = np.stack([np.stack([a, b, e], -1), np.stack([b, c, f], -1), np.stack([e, f, -np.ones_like(a)], -1)], axis=1)
    T = np.zeros_like(local)  # normalised -> unit-circle coordinates
    T[:, 0, 0], T[:, 1, 1], T[:, 2, 2] = p[:, 0], s[:, 0], 1.0
    T[:, 0, 1] = T[:, 1, 0] = q[:, 0]
    T[:, :2, 2] = -np.einsum("nij,nj->ni", T[:, :2, :2], middle)
    return T.transpose(0, 2, 1) @ local @ T


def _both(camera: optics.Camera, center_px: Array, shape: Array, r: Array) -> tuple[Array, Array]:
    """Both solutions (2, N, 3) through lens and pane."""
    p, n = circles_from_cones(cones(camera, center_px, shape), r)
    if camera.glass_thickness == 0:
        return p, n
    # The pane shifts every ray along z by its own amount; seen from the shifted centre that belongs to the marker's
    # middle, each boundary point is rescaled by the ratio of its depths. Its depth comes from the first estimate.
    points, _ = ellipse.boundary(center_px, shape, _SAMPLES)
    xy = optics.undistort(camera, optics.normalized_from_pixel(camera, points))
    rays = np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)
    shift = optics.glass_shift(camera, rays)
    middle = shift.mean(axis=1)
    solutions = []
    for k in range(2):
        depth = np.einsum("ni,ni->n", n[k], p[k])[:, None] / np.einsum("ni,nki->nk", n[k], rays)
        scale = 1 + (middle[:, None] - shift) / depth
        # a point seen along a ray that starts at `shift`, as seen from `middle`: x (Z - shift)/(Z - middle)
        both = circles_from_cones(fit_cones(xy * scale[..., None]), r)
        # the eigenvectors' signs are free, so the refit may return the two solutions in the other order
        same = np.argmax(np.einsum("kni,ni->kn", both[1], n[k]), axis=0)
        each = np.arange(len(r))
        solutions.append((both[0][same, each] + middle[:, None] * [0, 0, 1], both[1][same, each]))
    return np.stack([s[0] for s in solutions]), np.stack([s[1] for s in solutions])


def _covariance(camera: optics.Camera, p: Array, n: Array, r: Array, shape: Array, cov: Array) -> Array:
    """Covariance (N, 3, 3) m^2 of the centres: the pose's five derivatives of the ellipse's five parameters, inverted.

    Both are compared by the boundary's motion along its normal at `_FEW` points, in distorted pixels; the lens
    enters by its derivative at the marker's centre.
    """
    n = _tilted(n, p)
    e1 = np.cross(n, [0.0, 1.0, 0.0])
    e1 /= np.linalg.norm(e1, axis=1)[:, None]
    e2 = np.cross(n, e1)
    t = 2 * np.pi * np.arange(_FEW) / _FEW
    cos, sin = np.cos(t)[:, None], np.sin(t)[:, None]
    arm = r[:, None, None] * (e1[:, None] * cos + e2[:, None] * sin)
    P = p[:, None] + arm
    P[..., 2] -= optics.glass_shift(camera, p)[:, None] if camera.glass_thickness else 0.0
    xy = P[..., :2] / P[..., 2:]
    lens = optics.distortion_jacobian(camera, xy.mean(axis=1)) * np.array([[camera.fx], [camera.fy]])
    offset = (xy - xy.mean(axis=1)[:, None]) @ lens.transpose(0, 2, 1)
    sp, sq, ss = ellipse.inverse_shape(shape).T[..., None]
    ex, ey = sp * offset[..., 0] + sq * offset[..., 1], sq * offset[..., 0] + ss * offset[..., 1]
    mx, my = sp * ex + sq * ey, sq * ex + ss * ey
    length = np.hypot(mx, my)
    mx, my = mx / length, my / length
    T = np.stack([mx, my, mx * ex, mx * ey + my * ex, my * ey], axis=-1)
    m = (np.stack([mx, my], axis=-1) @ lens) / P[..., 2:]
    m = np.concatenate([m, -(m * xy).sum(axis=2, keepdims=True)], axis=-1)  # d(normal motion)/dP
    along = (m @ n[..., None])[..., 0] * r[:, None]
    D = np.concatenate([m, (along * cos.T)[..., None], (along * sin.T)[..., None]], axis=-1)
    Tt = T.transpose(0, 2, 1)
    # scaled to r, so that the 5 x 5 system has comparable columns
    D[..., :3] *= r[:, None, None]
    G = np.linalg.solve(Tt @ D, Tt @ T)
    return (G @ cov @ G.transpose(0, 2, 1))[:, :3, :3] * (r * r)[:, None, None]


def _tilted(n: Array, p: Array) -> Array:
    """Normals (N, 3), pushed away from exactly face-on, where the ellipse does not change with the tilt."""
    view = p / np.linalg.norm(p, axis=1)[:, None]
    across = n + view * -np.einsum("ni,ni->n", n, view)[:, None]
    size = np.linalg.norm(across, axis=1)
    flat = size < _LEAST_TILT
    if not flat.any():
        return n
    sideways = np.cross(view, [0.0, 1.0, 0.0])
    pushed = -view + _LEAST_TILT * sideways / np.linalg.norm(sideways, axis=1)[:, None]
    return np.where(flat[:, None], pushed / np.linalg.norm(pushed, axis=1)[:, None], n)


def _radii(radius: ArrayLike, count: int) -> Array:
    r = np.asarray(radius, dtype=float)
    if r.ndim > 1 or (r.ndim == 1 and len(r) != count):
        raise InputError(f"shape {r.shape}", source="estimate_poses", field="radius", choices=("one", f"({count},)"))
    if not (np.isfinite(r) & (r > 0)).all():
        raise InputError("must be positive and finite", source="estimate_poses", field="radius")
    return np.broadcast_to(r, (count,))
