"""Circle poses from ellipses: both solutions in closed form, with covariance.

The closed form is the corrected Eq. 3-5 of the paper. Q is the circle's cone in ideal normalized
coordinates (x^T Q x = 0 on the boundary). Its eigenvalues are l1 >= l2 > 0 > l3, its eigenvectors
v1, v3 (v3 away from the camera). With sin psi = sqrt((l1 - l2)/(l1 - l3)) and cos psi = sqrt((l2 -
l3)/(l1 - l3)):

    C = r ( s sqrt(-l3/l1) sin psi v1 + sqrt(-l1/l3) cos psi v3 ),
    n = s sin psi v1 - cos psi v3,   s = +1 or -1

Differences from the paper (docs/theory/circle_pose.md): Q = K^T M K replaces the pixel conic M. The
sign applies to the sine term only. C is the center in space, not only its image. So no sine rule is
needed. The normal n faces the camera.

The arithmetic is in mjtactile/kernels/circles.c. It covers the closed form, the glass's rescaling
of the boundary, and the derivative.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core import geometry, optics
from mjtactile.core.errors import InputError
from mjtactile.core.sensor_parts import CameraDesign
from mjtactile.core.types import Array, CirclePoses, Ellipses
from mjtactile.kernels import kernel

_MIN_TILT = 1e-3  # rad; below it the normal's derivative vanishes and only its bound is left


def estimate_poses(
    ellipses: Ellipses, camera: optics.Camera | CameraDesign, radius: ArrayLike
) -> CirclePoses:
    """Estimate the poses of N circles of `radius` (scalar or (N,)) m from their ellipses in
    distorted pixels. Of the two solutions, `n_C` is the one more face-on to the camera's axis. Lens
    and glass are those of `camera`. Raises InputError for a radius that is not positive or not one
    per ellipse."""
    camera = camera if isinstance(camera, optics.Camera) else optics.Camera.from_design(camera)
    n = len(ellipses)
    r = _radii(radius, len(ellipses))
    uv = np.empty((n, 2))
    poses = np.empty((4, n, 3))
    cov_p = np.empty((n, 3, 3))
    kernel("circle_poses")(n, *_arrays(ellipses), r, camera.parameters, uv, poses, cov_p)
    first_p, first_n, second_p, second_n = poses
    return CirclePoses(uv, first_p, first_n, second_p, second_n, cov_p, ellipses.status)


def pose_covariances(
    ellipses: Ellipses, camera: optics.Camera, p_CM: Array, n_C: Array
) -> tuple[Array, Array]:
    """Return the covariances (N, 3, 3) of centers, m^2, and of unit normals.

    They hold for either of the two poses. `p_CM` (N, 3) and `n_C` (N, 3) are the poses estimated
    from `ellipses`. The derivative of the ellipse by the pose is inverted. Points e of the unit
    circle describe the boundary. A change of either moves it by e . w + e^T V e. The move is in
    units of the local radius.
    """
    n = len(ellipses)
    cov = np.empty((len(ellipses), 5, 5))
    kernel("circle_covariances")(n, *_arrays(ellipses), p_CM, n_C, camera.parameters, cov)
    normals = _tilted(n_C, p_CM)
    # (n_x, n_y) move at fixed n_z; the component along n is not a rotation
    projector = (np.eye(3) - normals[:, :, None] * normals[:, None])[:, :, :2]
    return cov[:, :3, :3], projector @ cov[:, 3:, 3:] @ projector.transpose(0, 2, 1)


def circles_from_cones(Q: Array, radius: Array) -> tuple[Array, Array]:
    """Compute centers and normals, (2, N, 3) each, of circles of `radius` (N,) on the cones `Q` (N,
    3, 3), in closed form. Q has one negative eigenvalue, because it is negative inside the ellipse.
    The eigenvector is within 90 deg of z. Normals point towards the camera."""
    poses = np.empty((4, len(Q), 3))
    kernel("circles_on_cones")(len(Q), Q, radius, poses)
    return poses[:2], poses[2:]


def cones(camera: optics.Camera, center_px: Array, shape: Array) -> Array:
    """Return the cones Q (N, 3, 3) of ellipses in distorted pixels, in ideal normalized
    coordinates, without the glass."""
    Q = np.empty((len(shape), 3, 3))
    kernel("cones")(len(shape), center_px, shape, camera.parameters, Q)
    return Q


def _arrays(ellipses: Ellipses) -> tuple[Array, ...]:
    return ellipses.center_px, ellipses.semi_axes_px, ellipses.angle, ellipses.cov


def _tilted(n: Array, p: Array) -> Array:
    """Return normals (N, 3) with a minimum tilt. The ellipse of a face-on circle does not change
    with the tilt."""
    far = np.sqrt((p * p).sum(axis=1))
    flat = -(n * p).sum(axis=1) > np.cos(_MIN_TILT) * far
    if not flat.any():
        return n
    view = p / far[:, None]
    return np.where(flat[:, None], _MIN_TILT * geometry.tangents(view)[0] - view, n)


def _radii(radius: ArrayLike, count: int) -> Array:
    try:
        r = np.asarray(radius, dtype=float)
    except (TypeError, ValueError):
        raise InputError(
            f"{radius!r} is not a number", source="estimate_poses", field="radius"
        ) from None
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
