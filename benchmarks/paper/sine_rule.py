"""The paper's own method from an ellipse to a circle's centre (Eq. 4-10), kept for comparison.

The sensor uses `mjtactile.sensing.pose.circles`. Here, Eq. 4-5 give the image of the centre. Two
corrections make it a projection: Q = K^T M K instead of M, and the sign on the sine term alone. The
sine rule then gives the distance from a chord of the ellipse through that point. The rule is exact
but redundant: the same eigenvalues already give the distance. It uses two short arcs instead, which
amplify an error of the chord's ends, most strongly along the minor axis.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from mjtactile.core import optics
from mjtactile.core.types import Array, Ellipses
from mjtactile.sensing.image import ellipse
from mjtactile.sensing.pose import circles


def centre_distance(radius: Array, phi: Array, omega: Array) -> Array:
    """Compute the distance CD (N,), m, of the midpoint D of a chord AB of length 2 `radius`.

    C sees the halves of the chord under the angles `phi` = ACD and `omega` = DCB, rad. This is Eq.
    6-10 without the detour through nu and its cotangents:

        CD = r sin(phi + omega)/sqrt(sin^2 phi + sin^2 omega - 2 sin phi sin omega cos(phi + omega))

    Derivation: by Eq. 6-7 CA/CB = sin(omega)/sin(phi). Triangle ABC is then similar to one with
    sides sin(omega), sin(phi) and the angle phi + omega between them. The law of cosines gives its
    third side, and the median's length follows.
    """
    a = np.sin(phi)
    b = np.sin(omega)
    both = phi + omega
    return (
        radius
        * np.sin(both)
        / np.sqrt(np.maximum(a * a + b * b - 2 * a * b * np.cos(both), 1e-300))
    )


def centre_distance_as_printed(radius: Array, phi: Array, omega: Array) -> Array:
    """Compute the distance CD (N,), m, by Eq. 9 and 10 as printed.

    cot nu = sin(phi)/(sin(omega) sin(rho)) + cot(rho), with rho = pi - phi - omega.
    """
    rho = np.pi - phi - omega
    cot_nu = np.sin(phi) / (np.sin(omega) * np.sin(rho)) + 1 / np.tan(rho)
    return radius * np.sin(np.arctan2(1.0, cot_nu)) / np.sin(omega)


def centres_by_sine_rule(
    ellipses: Ellipses,
    camera: optics.Camera,
    radius: float | Array,
    chord: Literal["major", "minor"] = "major",
    end_error_px: Array | None = None,
) -> Array:
    """Compute the centres (2, N, 3), m, of both solutions by Eq. 4-10.

    The chord is parallel to the major axis, as the paper suggests. `end_error_px` (2, N) adds an
    error along the chord, px, to each of its ends, to measure the effect. There is no glass. A lens
    is handled as in `circles.cones`.
    """
    shape = ellipse.shape_from_axes(ellipses.semi_axes_px, ellipses.angle)
    Q = circles.cones(camera, ellipses.center_px, shape)
    r = np.broadcast_to(np.asarray(radius, dtype=float), (len(ellipses),))
    along = np.stack([np.cos(ellipses.angle), np.sin(ellipses.angle)], axis=1) / (
        camera.fx,
        camera.fy,
    )
    if chord == "minor":
        along = np.stack([-np.sin(ellipses.angle), np.cos(ellipses.angle)], axis=1) / (
            camera.fx,
            camera.fy,
        )
    centres = []
    for d in _centre_images(Q):
        # d + t along lies on the cone: (along Q along) t^2 + 2 (along Q d) t + d Q d = 0
        step = np.concatenate([along, np.zeros((len(d), 1))], axis=1)
        A, B, C = (np.einsum("ni,nij,nj->n", x, Q, y) for x, y in ((step, step), (step, d), (d, d)))
        root = np.sqrt(np.maximum(B * B - A * C, 0))
        off = np.zeros((2, len(d))) if end_error_px is None else end_error_px
        ends = [
            d + ((-B + sign * root) / A + error)[:, None] * step
            for sign, error in zip((1, -1), off, strict=True)
        ]
        phi, omega = (_angle(end, d) for end in ends)
        centres.append(
            d / np.linalg.norm(d, axis=1)[:, None] * centre_distance(r, phi, omega)[:, None]
        )
    return np.stack(centres)


def _centre_images(Q: Array) -> tuple[Array, Array]:
    """Compute both images (N, 3) of the center by Eq. 4-5.

    Coordinates are normalized and homogeneous, with third entry 1.
    """
    values, vectors = np.linalg.eigh(Q)
    l3, l2, l1 = values.T
    v3 = vectors[:, :, 0]
    v1 = vectors[:, :, 2]
    psi = np.arccos(np.sqrt(np.clip((l2 - l3) / (l1 - l3), 0, 1)))
    axial = (np.sqrt(-l1 / l3) * np.cos(psi))[:, None] * v3
    lateral = (np.sqrt(-l3 / l1) * np.sin(psi))[:, None] * v1
    axial = axial * np.where(axial[:, 2] < 0, -1.0, 1.0)[:, None]
    images = [axial + lateral, axial - lateral]
    return images[0] / images[0][:, 2:], images[1] / images[1][:, 2:]


def _angle(a: Array, b: Array) -> Array:
    """Return the angle (N,), rad, between vectors, by atan2.

    The arccos of a product of unit vectors would lose half of the digits.
    """
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ni,ni->n", a, b))
