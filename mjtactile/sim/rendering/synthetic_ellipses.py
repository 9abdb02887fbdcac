"""Marker ellipses with the errors of the image stages, simulated without rendering an image.

The ellipse of a circle is that of its boundary, projected exactly through glass and lens. Its error
is sampled from the Cramer-Rao bound of an edge. The edge has contrast C, blur s px and noise sigma.
The blur is a standard deviation and includes the pixel's own. The edge's information on a shift
along its normal is

    dI/dl = C^2 / (2 sqrt(pi) s sigma^2)      per px of edge,

summed over the boundary for center and shape. The result is multiplied by the loss of the image
stages relative to the bound. `bench no-images` compares the two. Like the renderer, this module
shares no code with `sensing`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core import optics
from mjtactile.core.design import SensorDesign
from mjtactile.core.optics import Camera
from mjtactile.core.types import Array, Ellipses, SyntheticEllipses
from mjtactile.kernels import kernel
from mjtactile.sim.rendering.fiducials import FiducialRenderer
from mjtactile.sim.rendering.led_illumination import Light

_POINTS = 12  # points on a boundary: lens and glass add few harmonics; 1e-12 px
_ROUNDING = 1 / 12  # px^2 of a pixel's square, DN^2 of a rounded grey level


LOSS = np.array([1.17, 1.17, 1.04, 1.0, 1.04])
LOSS_BY_BLUR = np.array([0.0, 0.0, 6.2, 0.0, 6.2])
"""Ratio of the standard deviations of (u, v, p, q, s) to the bound.

`LOSS_BY_BLUR` is its increase per square of blur over radius. `bench no-images` measures it at 0.7
to 2 px of blur, flat to 39 degrees steep.
"""


class EllipseSampler:
    """Sampler of the ellipses in images of `design`'s camera; arguments as for `Renderer`."""

    def __init__(
        self,
        design: SensorDesign,
        *,
        radius: ArrayLike | None = None,
        seed: int = 0,
        pose: tuple[Array, Array] | None = None,
    ):
        self.design = design
        self._R_SC, self._p_SC = (np.eye(3), design.camera.p_SC) if pose is None else pose
        self.camera = Camera.from_design(design.camera, design.glass)
        self._radius = np.broadcast_to(
            np.asarray(design.markers.radius if radius is None else radius, float),
            (design.markers.count,),
        )
        self._fixed = FiducialRenderer.of(design)
        if self._fixed is not None:
            fixed = np.full(len(self._fixed.p_SF), self._fixed.radius)
            self._radius = np.concatenate([self._radius, fixed])
        self._light = Light(design, self.camera)
        self.reseed(seed)

    def reseed(self, seed: int) -> None:
        """Set the generator of the ellipse errors."""
        self._rng = np.random.default_rng(seed)

    def sample(
        self, p_SM: Array, n_S: Array, time: float = 0.0, *, errors: bool = True
    ) -> SyntheticEllipses:
        """Return the ellipses of visible markers, `p_SM`, `n_S` (N, 3) in S, and of the fiducials.

        Without `errors` the ellipses are exact, but carry the same covariance.
        """
        if self._fixed is not None:
            p_SM = np.concatenate([p_SM, self._fixed.p_SF])
            n_S = np.concatenate([n_S, self._fixed.n_S])
        center, shape = self._true(p_SM, n_S)
        keep = self._is_seen(center, shape)
        center = center[keep]
        shape = shape[keep]
        loss = (
            LOSS
            + LOSS_BY_BLUR * (self.design.camera.blur_px**2 / (shape[:, 0] * shape[:, 2]))[:, None]
        )
        spread = loss[:, :, None] * loss[:, None] * self._bound(shape, p_SM[keep])
        found = np.concatenate([center, shape], axis=1)
        if errors:
            noise = self._rng.standard_normal((len(center), 5))
            found += np.einsum("nij,nj->ni", np.linalg.cholesky(spread), noise)
        n = len(found)
        shape = np.ascontiguousarray(found[:, 2:])
        axes = np.empty((n, 2))
        angle = np.empty(n)
        cov = np.empty((n, 5, 5))
        kernel("ellipse_axes")(n, shape, spread, axes, angle, cov)
        return SyntheticEllipses.of(
            Ellipses(found[:, :2], axes, angle, cov, np.full(n, "ok")), time
        )

    def _true(self, p_SM: Array, n_S: Array) -> tuple[Array, Array]:
        """Return centres (N, 2) px and shapes (N, 3) of the projected circles; NaN if missing.

        S^2 = 4 times the second moments of the area, by Green's theorem from the boundary.
        """
        p = (p_SM - self._p_SC) @ self._R_SC
        n = n_S @ self._R_SC
        across = np.cross(n, np.where(np.abs(n[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]]))
        across /= np.linalg.norm(across, axis=1)[:, None]
        along = np.cross(n, across)
        offset = _COS[:, None] * across[:, None] + _SIN[:, None] * along[:, None]
        uv = optics.project(self.camera, p[:, None] + self._radius[:, None, None] * offset)
        center = uv.mean(axis=1)
        x, y = np.moveaxis(uv - center[:, None], 2, 0)
        dy = y @ _DERIVATIVE.T
        area = (x * dy).sum(axis=1)
        area[area == 0] = np.nan  # a marker that is missing
        cx = (x * x * dy).sum(axis=1) / (2 * area)
        cy = (x * y * dy).sum(axis=1) / area
        x = x - cx[:, None]
        y = y - cy[:, None]
        xx, yy, xy = (
            (power * dy).sum(axis=1) / area for power in (x**3 / 3, x * y * y, x * x * y / 2)
        )
        xx = 4 * xx
        xy = 4 * xy
        yy = 4 * yy
        root = np.sqrt(np.maximum(xx * yy - xy * xy, 0.0))
        scale = 1 / np.sqrt(np.maximum(xx + yy + 2 * root, 1e-12))
        return center + np.column_stack([cx, cy]), np.column_stack(
            [xx + root, xy, yy + root]
        ) * scale[:, None]

    def _is_seen(self, center: Array, shape: Array) -> Array:
        """Return a mask (N,) of the markers that exist and are completely in the image."""
        extent = np.hypot(shape[:, :2], shape[:, 1:]).max(axis=1) + 2 * self.design.camera.blur_px
        size = np.array([self.camera.width, self.camera.height])
        inside = ((center - extent[:, None] > -0.5) & (center + extent[:, None] < size - 0.5)).all(
            axis=1
        )
        return inside & (self._radius > 0) & np.isfinite(shape).all(axis=1)

    def _bound(self, shape: Array, p_SM: Array) -> Array:
        """Return the covariance (N, 5, 5) of (u, v, p, q, s), px^2."""
        camera = self.design.camera
        leds = self.design.leds
        contrast = (leds.membrane_dn - leds.marker_dn) * self._light.at(p_SM)
        blur = np.sqrt(camera.blur_px**2 + _ROUNDING)
        noise2 = camera.noise_dn**2 + _ROUNDING
        p, q, s = shape.T[:, :, None]
        nx = s * _COS - q * _SIN
        ny = p * _SIN - q * _COS
        size = np.hypot(nx, ny)
        nx = nx / size
        ny = ny / size
        length = np.hypot(q * _COS - p * _SIN, s * _COS - q * _SIN) * (2 * np.pi / _POINTS)
        moved = np.stack([nx, ny, nx * _COS, nx * _SIN + ny * _COS, ny * _SIN], axis=1)
        information = contrast**2 / (2 * np.sqrt(np.pi) * blur * noise2)
        return np.linalg.inv(
            np.einsum("nik,njk->nij", moved * length[:, None], moved) * information[:, None, None]
        )


_ANGLE = 2 * np.pi * np.arange(_POINTS) / _POINTS
_COS = np.cos(_ANGLE)
_SIN = np.sin(_ANGLE)
_DERIVATIVE = np.real(
    np.fft.ifft(
        np.fft.fft(np.eye(_POINTS), axis=0)
        * (
            1j
            * np.where(np.arange(_POINTS) == _POINTS // 2, 0, np.fft.fftfreq(_POINTS, 1 / _POINTS))
        )[:, None],
        axis=0,
    )
)
"""Derivative matrix (K, K) with respect to the angle, for K samples around the circle."""
