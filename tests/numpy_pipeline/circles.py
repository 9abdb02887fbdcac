"""Reference in numpy for mjtactile/kernels/circles.c: the corrected closed form of the paper's Eq.
3-5, with covariance.

Q is the circle's cone in ideal normalized coordinates (x^T Q x = 0 on the boundary). Its
eigenvalues are l1 >= l2 > 0 > l3, with eigenvectors v1, v3 (v3 away from the camera). With sin psi
= sqrt((l1 - l2)/(l1 - l3)) and cos psi = sqrt((l2 - l3)/(l1 - l3)):

    C = r ( s sqrt(-l3/l1) sin psi v1 + sqrt(-l1/l3) cos psi v3 ),
    n = s sin psi v1 - cos psi v3,   s = +1 or -1

Departures from the paper (docs/theory/circle_pose.md): Q = K^T M K instead of the pixel conic M.
The sign belongs to the sine term alone. C is the center in space, not only its image, so that no
sine rule is needed. n faces the camera.

Arrays inside have the markers on their last axis: every step is one pass over contiguous memory.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core import geometry, optics
from mjtactile.core.errors import InputError
from mjtactile.core.sensor_parts import CameraDesign
from mjtactile.core.types import Array, CirclePoses, Ellipses
from mjtactile.sensing.image import ellipse

# points on an ellipse's boundary: at least five; lens and glass add few harmonics
_POINTS = 8
_MIN_TILT = 1e-3  # rad; below it the normal's derivative vanishes and only its bound is left
# largest number of steps for a conic's coefficients; a step below the tolerance leaves 1e-10
_FIT_STEPS = 30
_FIT_TOLERANCE = 1e-8
_E = np.stack(
    [
        np.cos(2 * np.pi * np.arange(_POINTS) / _POINTS),
        np.sin(2 * np.pi * np.arange(_POINTS) / _POINTS),
    ]
)
_TO_AFFINE = np.concatenate([np.full((1, _POINTS), 1 / _POINTS), _E * (2 / _POINTS)])
_TO_CONIC = np.linalg.pinv(
    np.stack([_E[0] ** 2, 2 * _E[0] * _E[1], _E[1] ** 2, 2 * _E[0], 2 * _E[1]], axis=1)
)
_TO_MOTION = np.linalg.pinv(
    np.stack([_E[0], _E[1], _E[0] ** 2, _E[1] ** 2, 2 * _E[0] * _E[1]], axis=1)
)


def estimate_poses(
    ellipses: Ellipses, camera: optics.Camera | CameraDesign, radius: ArrayLike
) -> CirclePoses:
    """Estimate poses of N circles of `radius` (scalar or (N,)) m from their ellipses in distorted
    pixels.

    Of the two solutions, `n_C` is the more face-on one to the camera axis. Lens and glass are those
    of `camera`. Raises InputError for a radius that is not positive or not one per ellipse.
    """
    camera = camera if isinstance(camera, optics.Camera) else optics.Camera.from_design(camera)
    r = _radii(radius, len(ellipses))
    if not len(ellipses):
        none = np.zeros((0, 3))
        return CirclePoses(
            none[:, :2], none, none, none, none, np.zeros((0, 3, 3)), ellipses.status
        )
    a, b = ellipses.semi_axes_px.T
    cos = np.cos(ellipses.angle)
    sin = np.sin(ellipses.angle)
    xy, affine, Q = _cones(
        camera, ellipses.center_px, np.array([[a * cos, -b * sin], [a * sin, b * cos]])
    )
    p, n = circles_from_cones(Q, r)
    if camera.glass_thickness:
        p, n = _through_glass(camera, xy, p, n, r)
    first = np.where(n[1, :, 2] < n[0, :, 2], 1, 0)
    each = np.arange(len(r))
    p_first = p[first, each]
    n_first = n[first, each]
    G = _derivative(camera, ellipses, xy, affine[:, 0], p_first, _tilted(n_first, p_first), parts=3)
    return CirclePoses(
        optics.project(camera, p_first),
        p_first,
        n_first,
        p[1 - first, each],
        n[1 - first, each],
        G @ ellipses.cov @ G.transpose(0, 2, 1),
        ellipses.status,
    )


def pose_covariances(
    ellipses: Ellipses, camera: optics.Camera, p_CM: Array, n_C: Array
) -> tuple[Array, Array]:
    """Compute covariances (N, 3, 3) of the centers `p_CM` (N, 3), m^2, and of the unit normals
    `n_C` (N, 3) estimated from `ellipses`. The pose may be either of a circle's two poses."""
    if not len(ellipses):
        return np.zeros((0, 3, 3)), np.zeros((0, 3, 3))
    a, b = ellipses.semi_axes_px.T
    cos = np.cos(ellipses.angle)
    sin = np.sin(ellipses.angle)
    xy, affine, _ = _cones(
        camera, ellipses.center_px, np.array([[a * cos, -b * sin], [a * sin, b * cos]])
    )
    n = _tilted(n_C, p_CM)
    G = _derivative(camera, ellipses, xy, affine[:, 0], p_CM, n, parts=5)
    cov = G @ ellipses.cov @ G.transpose(0, 2, 1)
    # (n_x, n_y) move at fixed n_z; the component along n is not a rotation
    projector = (np.eye(3) - n[:, :, None] * n[:, None])[:, :, :2]
    return cov[:, :3, :3], projector @ cov[:, 3:, 3:] @ projector.transpose(0, 2, 1)


def circles_from_cones(Q: Array, radius: Array) -> tuple[Array, Array]:
    """Return the closed form: centres and normals, each (2, N, 3), of circles of `radius` (N,) on
    the cones `Q` (N, 3, 3).

    Q has one negative eigenvalue (the inside of the ellipse is negative), its eigenvector within 90
    deg of z. Normals point towards the camera.

    l3 by the trigonometric solution of the cubic (Smith, Comm. ACM 4(4), 1961), exact for the
    eigenvalue that stands alone; l1 and l2, which are equal for a circle seen face-on, from the 2 x
    2 problem across v3.
    """
    (a, b, d), (_, c, e), (_, _, f) = np.ascontiguousarray(Q.transpose(1, 2, 0))
    third = (a + c + f) / 3
    A = a - third
    C = c - third
    F = f - third
    size = np.sqrt((A * A + C * C + F * F + 2 * (b * b + d * d + e * e)) / 6)
    half_det = (A * (C * F - e * e) - b * (b * F - d * e) + d * (b * e - d * C)) / (2 * size**3)
    angle = np.arccos(np.minimum(np.maximum(half_det, -1.0), 1.0)) / 3
    l3 = third + 2 * size * np.cos(angle + 2 * np.pi / 3)
    A = a - l3
    C = c - l3
    x = b * e - d * C
    y = b * d - A * e
    z = A * C - b * b
    over = 1 / np.sqrt(x * x + y * y + z * z)
    x = x * over
    y = y * over
    z = z * over
    # Rayleigh
    off = A * x * x + C * y * y + (f - l3) * z * z + 2 * (b * x * y + d * x * z + e * y * z)
    l3 = l3 + off
    A = A - off
    C = C - off
    # u, w across v3 (geometry.tangents). Q - l3 I vanishes along v3: its block [[A, b], [b, C]]
    # acts on (u_x, u_y) - (u_z/z) (x, y). This is (1, 0) + h x (x, y), and (0, 1) + h y (x, y) for
    # w
    h = 1 / (z * (1 + z))
    g = 1 + h * x * x
    hh = h * x * y
    k = 1 + h * y * y
    t = A * g + b * hh
    s = A * hh + b * k
    v = b * hh + C * k
    uu = g * t + hh * (b * g + C * hh)
    uw = g * s + hh * v
    ww = hh * s + k * v
    mean = (uu + ww) / 2
    half = (uu - ww) / 2
    spread = np.sqrt(half * half + uw * uw)
    l1 = mean + spread + l3
    sine = np.sqrt(2 * spread / (mean + spread))
    cosine = np.sqrt((mean - spread) / (mean + spread))
    phi = 0.5 * np.arctan2(uw, half)
    cu = np.cos(phi)
    cw = np.sin(phi)
    j = -(cu * x + cw * y) / (1 + z)
    v1 = np.array([cu + j * x, cw + j * y, -(cu * x + cw * y)]).T
    v3 = np.array([x, y, z]).T
    ratio = np.sqrt(-l3 / l1)
    along1 = (radius * ratio * sine)[:, None] * v1
    along3 = (radius / ratio * cosine)[:, None] * v3
    n1 = sine[:, None] * v1
    n3 = cosine[:, None] * v3
    return np.array([along3 + along1, along3 - along1]), np.array([n1 - n3, -n1 - n3])


def cones(camera: optics.Camera, center_px: Array, shape: Array) -> Array:
    """Compute cones Q (N, 3, 3) in ideal normalized coordinates of ellipses in distorted pixels,
    without the glass."""
    p, q, s = shape.T
    return _cones(camera, center_px, np.array([[p, q], [q, s]]))[2]


def _cones(camera: optics.Camera, center_px: Array, axes: Array) -> tuple[Array, Array, Array]:
    """Compute boundary points (2, K, N), ideal, of the ellipses `center_px` (N, 2) + `axes` (2, 2,
    N) e. Also return their approximate affine map (2, 3, N) of (1, e), and the cones Q (N, 3,
    3)."""
    if camera.lens.is_ideal:
        scale = np.array([[1 / camera.fx], [1 / camera.fy]])
        affine = np.empty((2, 3, len(center_px)))
        affine[:, 0] = optics.normalized_from_pixel(camera, center_px).T
        affine[:, 1:] = axes * scale[..., None]
        circle = np.zeros((5, 1))
        circle[[0, 2]] = 1.0
        return (
            affine[:, :1] + np.einsum("ijn,jk->ikn", affine[:, 1:], _E),
            affine,
            _cone(affine, circle),
        )
    points = center_px.T[:, None] + np.einsum("ijn,jk->ikn", axes, _E)
    xy = camera.lens.undistort(optics.normalized_from_pixel(camera, points.transpose(1, 2, 0)))
    xy = np.ascontiguousarray(xy.transpose(2, 0, 1))
    return xy, *_fit(xy)


def _fit(xy: Array) -> tuple[Array, Array]:
    """Fit the affine map (2, 3, N) and cones (N, 3, 3) to boundary points `xy` (2, K, N).

    In the coordinates of the affine map the points are close to the unit circle. The conic's least
    squares then uses the *circle's* pseudo-inverse, repeated on the residual. It converges like
    (distance)^k.
    """
    affine = _TO_AFFINE @ xy
    (x0, xa, xb), (y0, ya, yb) = affine
    over = 1 / (xa * yb - xb * ya)
    dx = xy[0] - x0
    dy = xy[1] - y0
    u = (yb * over) * dx - (xb * over) * dy
    v = (xa * over) * dy - (ya * over) * dx
    terms = np.array([u * u, 2 * u * v, v * v, 2 * u, 2 * v])
    conic = np.zeros((5, len(x0)))
    conic[[0, 2]] = 1.0
    for _ in range(_FIT_STEPS):
        step = _TO_CONIC @ (np.einsum("ikn,in->kn", terms, conic) - 1)
        conic -= step
        if not (np.abs(step) > _FIT_TOLERANCE).any():
            break
    return affine, _cone(affine, conic)


def _cone(affine: Array, conic: Array) -> Array:
    """Compute Q (N, 3, 3) of the conic (a, b, c, e, f) (5, N or 1).

    The conic is a u^2 + 2 b u v + c v^2 + 2 e u + 2 f v = 1. `affine` (2, 3, N) maps its
    coordinates (u, v) to ideal ones.
    """
    (x0, xa, xb), (y0, ya, yb) = affine
    a, b, c, e, f = conic
    over = 1 / (xa * yb - xb * ya)
    ux = yb * over
    uy = -xb * over
    vx = -ya * over
    vy = xa * over
    u0 = -(ux * x0 + uy * y0)
    v0 = -(vx * x0 + vy * y0)
    T = np.array([[ux, uy, u0], [vx, vy, v0]])  # (2, 3, N): u, v of (x, y, 1)
    au = a * T[0] + b * T[1]
    cv = b * T[0] + c * T[1]
    Q = T[0][:, None] * au + T[1][:, None] * cv
    linear = e * T[0] + f * T[1]
    Q[:, 2] += linear
    Q[2] += linear
    Q[2, 2] -= 1
    return Q.transpose(2, 0, 1)


def _through_glass(
    camera: optics.Camera, xy: Array, p: Array, n: Array, r: Array
) -> tuple[Array, Array]:
    """Compute both solutions (2, N, 3) behind the glass, from those `p`, `n` without it and
    boundary points `xy` (2, K, N).

    The glass shifts every ray along z by its own amount. Seen from the shifted center of the
    marker's central ray, each boundary point is rescaled by the ratio of its depths. Its depth
    comes from the first estimate.
    """
    x, y = xy
    shift = optics.glass_displacement(camera, x * x + y * y)
    mean = shift.mean(axis=0)
    away = (n * p).sum(axis=2)
    nx, ny, nz = n.transpose(2, 0, 1)[:, :, None]
    # point on a ray that starts at `shift`, seen from `middle`: x (Z - shift)/(Z - middle)
    scale = 1 + (mean - shift) * ((nx * x + ny * y + nz) / away[:, None])  # (2, K, N)
    observed = (xy[:, None] * scale).transpose(0, 2, 1, 3).reshape(2, _POINTS, -1)
    both_p, both_n = circles_from_cones(_fit(observed)[1], np.tile(r, 2))
    both_p = both_p.reshape(2, 2, -1, 3)
    both_n = both_n.reshape(2, 2, -1, 3)
    # the eigenvectors' signs are free, so the refit may return the two solutions in the other order
    match = (both_n * n).sum(axis=3).argmax(axis=0), np.array([[0], [1]]), np.arange(len(r))
    p = both_p[match]
    p[..., 2] += mean
    return p, both_n[match]


def _derivative(
    camera: optics.Camera,
    ellipses: Ellipses,
    xy: Array,
    middle: Array,
    p: Array,
    n: Array,
    parts: int,
) -> Array:
    """Compute derivatives (N, parts, 5) of the pose by the ellipse's five parameters: those of the
    ellipse by the pose, inverted.

    The pose is the center, m, and n_x, n_y at fixed n_z; the result has the first `parts` of these
    five. Let e be the unit circle's points and R diag(a, b) e the boundary's offsets in distorted
    pixels. An ellipse's change moves the boundary, in units of the local radius, by e . w + e^T V
    e. So does a change of the pose. `xy` (2, K, N) are the ideal boundary points. The lens enters
    by its derivative at the `middle` (2, N).
    """
    x, y = xy
    nx, ny, nz = n.T
    px, py, pz = p.T
    if camera.glass_thickness:
        pz = pz - optics.glass_shift(camera, p)
    a, b = ellipses.semi_axes_px.T
    cos = np.cos(ellipses.angle)
    sin = np.sin(ellipses.angle)
    # of e: (u, v) change by one pixel
    du = np.array([cos / a, -sin / b]), np.array([sin / a, cos / b])
    lens = camera.lens.jacobian(middle.T)
    mx, my = (
        _E.T @ (camera.fx * lens[:, 0, i] * du[0] + camera.fy * lens[:, 1, i] * du[1])
        for i in (0, 1)
    )
    # 1/depth of the boundary's points
    over = (nx * x + ny * y + nz) / (nx * px + ny * py + nz * pz)
    mz = -(mx * x + my * y)
    # boundary's motion, over depth, as a point moves along the normal
    along = mx * nx + my * ny + mz * nz
    D = np.array(
        [mx * over, my * over, mz * over, along * (x - px * over), along * (y - py * over)]
    )
    D = (_TO_MOTION @ D).transpose(2, 1, 0)  # (N, 5 of (w, V), 5 of the pose)
    lateral = np.zeros((len(a), 5, 5))  # (w, V) of (u, v, a, b, angle)
    lateral[:, :2, 0] = du[0].T
    lateral[:, :2, 1] = du[1].T
    lateral[:, 2, 2] = 1 / a
    lateral[:, 3, 3] = 1 / b
    lateral[:, 4, 4] = ellipse.axes_difference(a, b) * (a + b) / (2 * a * b)
    requested = np.broadcast_to(np.eye(5)[:, :parts], (len(a), 5, parts))
    # only these rows of D^-1
    return np.linalg.solve(D.transpose(0, 2, 1), requested).transpose(0, 2, 1) @ lateral


def _tilted(n: Array, p: Array) -> Array:
    """Return normals (N, 3), pushed away from exactly face-on, where the ellipse does not change
    with the tilt."""
    far = np.sqrt((p * p).sum(axis=1))
    flat = -(n * p).sum(axis=1) > np.cos(_MIN_TILT) * far
    if not flat.any():
        return n
    view = p / far[:, None]
    return np.where(flat[:, None], _MIN_TILT * geometry.tangents(view)[0] - view, n)


def _radii(radius: ArrayLike, count: int) -> Array:
    r = np.asarray(radius, dtype=float)
    if r.ndim > 1 or (r.ndim == 1 and len(r) != count):
        raise InputError(
            f"shape {r.shape}",
            source="estimate_poses",
            field="radius",
            choices=("one", f"({count},)"),
        )
    if not (np.isfinite(r) & (r > 0)).all():
        raise InputError("must be positive and finite", source="estimate_poses", field="radius")
    return np.broadcast_to(r, (count,))
