"""Camera images and the features detected in them: ellipses, circles, markers, fiducials."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.signature_checks import validated
from mjtactile.core.types.arrays import Array, fixed, freeze

NO_PIXELS = fixed(np.zeros((0, 0), np.uint8))


@validated()
@dataclass(frozen=True, eq=False)
class Image:
    """An image of one camera.

    Attributes:
        pixels: (H, W) uint8 grey levels, indexed [v, u]. Pixel (0, 0) is the centre of the top-left
            pixel.
        time: Of capture, s.
    """

    pixels: NDArray[np.uint8]
    time: float = 0.0

    def __post_init__(self) -> None:
        freeze(self, "pixels", self.pixels, (None, None), np.uint8)


@dataclass(frozen=True, eq=False)
class Ellipses:
    """N ellipses in distorted pixel coordinates: center (N, 2), semi-axes a >= b (N, 2), angle of a
    (N,) rad.

    `cov` (N, 5, 5) is the covariance of (u, v, a, b, angle). `status` (N,) are strings. `darkness`
    (N,) is the logarithm of the grey level inside over that `outside` (N,). `blur_px` (N,) is the
    standard deviation of the edge blur (None: unknown).
    """

    center_px: Array
    semi_axes_px: Array
    angle: Array
    cov: Array
    status: NDArray[np.str_]
    darkness: Array | None = None
    outside: Array | None = None
    blur_px: Array | None = None

    def __post_init__(self) -> None:
        n = len(np.asarray(self.center_px))
        freeze(self, "center_px", self.center_px, (n, 2))
        freeze(self, "semi_axes_px", self.semi_axes_px, (n, 2))
        freeze(self, "angle", self.angle, (n,))
        freeze(self, "cov", self.cov, (n, 5, 5))
        freeze(self, "status", self.status, (n,), np.str_)
        for name in ("darkness", "outside", "blur_px"):
            value = getattr(self, name)
            if value is not None:
                freeze(self, name, value, (n,))

    def __len__(self) -> int:
        return len(self.angle)


@dataclass(frozen=True, eq=False)
class SyntheticEllipses(Image):
    """Replacement for an image without pixels: it holds the `ellipses` that would be detected."""

    ellipses: Ellipses | None = None

    @classmethod
    def of(cls, ellipses: Ellipses, time: float) -> SyntheticEllipses:
        return cls(NO_PIXELS, time, ellipses)


@dataclass(frozen=True, eq=False)
class CirclePoses:
    """Poses of N circles in the camera frame, with two candidate normals.

    `p_CM` (N, 3) m is the center for the unit normals `n_C` (N, 3). `p_CM_alt` is the center for
    `n_C_alt` (N, 3). Normals point towards the camera. `uv_px` (N, 2) is the projected *center*
    (not the ellipse's) in distorted pixels. `cov_p` (N, 3, 3) m^2; `status` (N,) strings.
    """

    uv_px: Array
    p_CM: Array
    n_C: Array
    p_CM_alt: Array
    n_C_alt: Array
    cov_p: Array
    status: NDArray[np.str_]

    def __post_init__(self) -> None:
        n = len(np.asarray(self.uv_px))
        freeze(self, "uv_px", self.uv_px, (n, 2))
        for name in ("p_CM", "n_C", "p_CM_alt", "n_C_alt"):
            freeze(self, name, getattr(self, name), (n, 3))
        freeze(self, "cov_p", self.cov_p, (n, 3, 3))
        freeze(self, "status", self.status, (n,), np.str_)

    def __len__(self) -> int:
        return len(self.uv_px)


@dataclass(frozen=True, eq=False)
class FiducialDetections:
    """Fixed circles detected in an image.

    Attributes:
        ids: Indices (n,) in the sensor file's list, in order.
        center_px: Centers (n, 2) in distorted pixels.
        radius_px: Root of the product of the semi-axes (n,).
        cov: Covariance (n, 3, 3) of (u, v, radius), px^2.
        inside: Grey levels of the circles (n,); NaN: unknown.
        outside: Grey levels of the ground around them (n,).
        blur_px: Standard deviations of their edge blur (n,).
    """

    ids: NDArray[np.int64]
    center_px: Array
    radius_px: Array
    cov: Array
    inside: Array
    outside: Array
    blur_px: Array

    def __post_init__(self) -> None:
        n = len(np.asarray(self.ids))
        freeze(self, "ids", self.ids, (n,), np.int64)
        freeze(self, "center_px", self.center_px, (n, 2))
        freeze(self, "cov", self.cov, (n, 3, 3))
        for name in ("radius_px", "inside", "outside", "blur_px"):
            freeze(self, name, getattr(self, name), (n,))

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def has_levels(self) -> bool:
        """True if grey levels and blur are known, as for detections in an image."""
        return bool(np.isfinite(self.inside + self.outside + self.blur_px).all())


@dataclass(frozen=True, eq=False)
class CameraDrift:
    """Change of a camera since the rest reference, estimated from the fiducials of one image.

    Planar circles hardly separate some modes (a translated or rotated camera; a closer camera or a
    larger scale). The estimate distributes such a change by the modes' prior probability. The total
    change is accurate.

    Attributes:
        shift: Shift of the image center (2,) px.
        turn: Rotation about the camera's axis, rad.
        scale: Relative magnification.
        radius_change_px: Additional increase of the circles' radii: gamma, clipping.
        light: Level of white over that at the reference.
        gamma: Exponent 1/gamma of the current levels; NaN: unknown.
        black: Current level without light; higher than at the reference for fog.
        blur_px: Increase of blur, standard deviation, px; less than 0: sharper.
        seen: Number of fiducials used.
        misfit: Mean square of their residuals over the variance.
    """

    shift: tuple[float, float]
    turn: float
    scale: float
    radius_change_px: float
    light: float
    gamma: float
    black: float
    blur_px: float
    seen: int
    misfit: float


@dataclass(frozen=True, eq=False)
class Markers:
    """Identified markers in the sensor frame.

    `ids` (N,) are indices into the design's layout. `p_SM` and `n_S` (N, 3) are positions and
    normals.

    `darkness` (N,) has the same meaning as in `Ellipses` (None: unknown). `fiducials` are the
    fiducials detected in the same image (None: there are none).
    """

    ids: NDArray[np.int64]
    p_SM: Array
    n_S: Array
    cov_p: Array
    darkness: Array | None = None
    fiducials: FiducialDetections | None = None

    def __post_init__(self) -> None:
        n = len(np.asarray(self.ids))
        freeze(self, "ids", self.ids, (n,), np.int64)
        freeze(self, "p_SM", self.p_SM, (n, 3))
        freeze(self, "n_S", self.n_S, (n, 3))
        freeze(self, "cov_p", self.cov_p, (n, 3, 3))
        if self.darkness is not None:
            freeze(self, "darkness", self.darkness, (n,))

    def __len__(self) -> int:
        return len(self.ids)
