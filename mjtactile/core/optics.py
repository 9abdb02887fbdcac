"""Lens and glass optics: mapping from points in the camera frame C to pixels and back. Batched over
points; images are not used.

The projection of a point P beyond the glass has four steps. Refraction at the glass yields a ray in
air through the camera's center. The pinhole projection and the lens (`mjtactile.core.lens`)
follow. The last step maps to pixels, where (0, 0) is the *center* of the top-left pixel.

C has its origin at the camera's center, x right, y down, z forward. The glass is normal to z.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core import camera_file
from mjtactile.core.errors import InputError
from mjtactile.core.sensor_parts import Glass, Pinhole
from mjtactile.core.signature_checks import validated
from mjtactile.core.types import Array

_NEWTON_STEPS = 30


@validated()
@dataclass(frozen=True)
class Camera(Pinhole):
    """Pinhole camera with lens distortion, and the glass in front of it.

    Attributes:
        glass_thickness: Thickness, m; 0: no glass.
        glass_index: Refractive index of the glass.
        glass_distance: Distance from the camera's center to the near face, m.
    """

    glass_thickness: float = 0.0
    glass_index: float = 1.0
    glass_distance: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        values = (
            self.fx,
            self.fy,
            self.cx,
            self.cy,
            *self.distortion,
            self.glass_thickness,
            self.glass_index,
            self.glass_distance,
        )
        if not np.all(np.isfinite(values)) or min(self.fx, self.fy, self.width, self.height) <= 0:
            raise InputError(
                "values must be finite; focal lengths and image size positive", source="Camera"
            )
        if self.glass_thickness < 0 or self.glass_index < 1 or self.glass_distance < 0:
            message = "glass needs a thickness >= 0, a refractive index >= 1 and a distance >= 0"
            raise InputError(message, source="Camera")

    @classmethod
    @validated()
    def from_design(cls, camera: Pinhole, glass: Glass | None = None) -> Camera:
        """Create the camera of a sensor design.

        Args:
            camera: Image size, focal lengths, principal point and distortion, px.
            glass: The glass in front of it; None: there is none.

        Returns:
            The camera.
        """
        return cls(**camera.intrinsics).behind(glass)

    @validated()
    def behind(self, glass: Glass | None) -> Camera:
        """Place a glass in front of this camera.

        Args:
            glass: The glass; None: leave the camera unchanged.

        Returns:
            A new camera.
        """
        if glass is None:
            return self
        return self.behind_glass(glass.thickness, glass.refractive_index, glass.distance)

    def behind_glass(self, thickness: float, refractive_index: float, distance: float) -> Camera:
        """Place a glass in front of this camera, replacing any other.

        Args:
            thickness: Thickness, m.
            refractive_index: Refractive index, at least 1.
            distance: Distance from the camera's center to the near face, m.

        Returns:
            A new camera.

        Raises:
            InputError: The values are invalid.
        """
        return replace(
            self, glass_thickness=thickness, glass_index=refractive_index, glass_distance=distance
        )

    @cached_property
    def parameters(self) -> Array:
        """All parameters of a ray's path, (16,): fx, fy, cx, cy, lens, and thickness, index and
        distance of the glass."""
        return np.array(
            [
                self.fx,
                self.fy,
                self.cx,
                self.cy,
                *self.lens.parameters,
                self.glass_thickness,
                self.glass_index,
                self.glass_distance,
            ]
        )

    @classmethod
    @validated()
    def from_file(cls, path: str | Path, glass: Glass | None = None) -> Camera:
        """Read a camera file of ROS, OpenCV or Kalibr.

        A YAML file may have one field in addition, a glass in front of the camera: `glass:
        {thickness_mm: 5, refractive_index: 1.5, distance_mm: 120}`.

        Args:
            path: The file.
            glass: A glass that replaces the file's.

        Returns:
            The camera.

        Raises:
            InputError: Names the file, the field and the valid choices.
        """
        lens, glass_pane = camera_file.read(Path(path))
        camera = cls(**lens)
        if glass_pane is not None:
            camera = camera.behind_glass(*glass_pane)
        return camera.behind(glass)


def project(camera: Camera, p_CP: ArrayLike) -> Array:
    """Project points `p_CP` (..., 3) m in C to pixels `uv_px` (..., 2), exactly through glass and
    lens.

    Returns NaN for a point behind the camera or not beyond the glass.
    """
    p = np.asarray(p_CP, dtype=float)
    return pixel_from_normalized(camera, camera.lens.distort(refract(camera, p)))


def unproject(camera: Camera, uv_px: ArrayLike) -> Array:
    """Compute unit rays (..., 3) in C, in the air before the glass, for pixels `uv_px` (..., 2).

    NaN where the lens model cannot be inverted (far outside of the image, where it folds over).
    """
    xy = camera.lens.undistort(normalized_from_pixel(camera, uv_px))
    ray = np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)
    return ray / np.sqrt(np.einsum("...i,...i->...", ray, ray))[..., None]


def refract(camera: Camera, p_CP: ArrayLike) -> Array:
    """Compute the normalized coordinates x/z, y/z (..., 2) of the ray before the glass.

    The points `p_CP` (..., 3) lie beyond the glass.

    Here x = tan(theta) of the ray in air. A point has depth Z and distance rho from the axis.
    Snell's law (n sin(theta_glass) = sin(theta)) gives

        rho = (Z - t) x + t x / sqrt(n^2 + (n^2 - 1) x^2),

    solved by Newton's method. The right side is increasing and almost linear in x. Three steps
    therefore reach 1e-16.
    """
    p = np.asarray(p_CP, dtype=float)
    z = p[..., 2]
    t = camera.glass_thickness
    n2 = camera.glass_index**2
    nearest = camera.glass_distance + t if t > 0 else 0.0
    z = np.where(z > nearest, z, np.nan)
    if t == 0 or n2 == 1:
        return p[..., :2] / z[..., None]
    rho = np.hypot(p[..., 0], p[..., 1])
    x = rho / (z - t + t / camera.glass_index)  # the paraxial solution
    for _ in range(_NEWTON_STEPS):
        root = 1 / np.sqrt(n2 + (n2 - 1) * x * x)
        step = ((z - t + t * root) * x - rho) / (z - t + t * n2 * root**3)
        x = x - step
        if not np.any(np.abs(step) > 1e-8 * (1 + x)):  # the last step squares the error
            break
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = np.where(rho > 0, x / rho, 1 / z)
    return p[..., :2] * scale[..., None]


def glass_shift(camera: Camera, rays: ArrayLike) -> Array:
    """Compute the apparent reduction of a point's depth by the glass, (...) m, for `rays` (..., 3)
    in air of any length.

    A pose estimated without the glass becomes p_true = p_apparent + (0, 0, shift).
    """
    ray = np.asarray(rays, dtype=float)
    x = ray[..., 0]
    y = ray[..., 1]
    z = ray[..., 2]
    return glass_displacement(camera, (x * x + y * y) / (z * z))


def glass_displacement(camera: Camera, tan2: ArrayLike) -> Array:
    """Compute `glass_shift` (...) m for rays at an angle theta to the axis with tan(theta)^2 =
    `tan2` (...).

    The shift is t (1 - cos(theta) / sqrt(n^2 - sin^2(theta))) for a glass normal to the axis.
    """
    slower = camera.glass_index**2 - 1
    return camera.glass_thickness * (
        1 - 1 / np.sqrt(slower * np.asarray(tan2, dtype=float) + (slower + 1))
    )


def pixel_from_normalized(camera: Camera, xy: ArrayLike) -> Array:
    """Convert (distorted) normalized coordinates (..., 2) to pixels (..., 2)."""
    return np.asarray(xy, dtype=float) * (camera.fx, camera.fy) + (camera.cx, camera.cy)


def normalized_from_pixel(camera: Camera, uv_px: ArrayLike) -> Array:
    """Convert pixels (..., 2) to (distorted) normalized coordinates (..., 2)."""
    return (np.asarray(uv_px, dtype=float) - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
