"""Lens models: the mapping from ideal to distorted normalized coordinates, its inverse and its
derivative.

Ideal coordinates (x, y) are x/z and y/z of a ray. Every model scales them by a function of r^2 =
x^2 + y^2. The polynomial models add the tangential terms of a decentered lens. The definitions are
those of OpenCV and ROS (`sensor_msgs/distortion_models.hpp`); `MODELS` lists them. The kernels have
the same functions (`mjtactile/kernels/optics.c`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core.errors import InputError
from mjtactile.core.types import Array

COEFFICIENTS_MAX = 8
"""Maximum number of coefficients of a model; the size of the kernels' array."""
_NEWTON_STEPS = 30
# normalized image plane: one more Newton step from here is exact to about 1e-13
_NEAR = 1e-7
_ANGLE_STEPS = 10
_ANGLE_MAX = 1.5  # rad; start of the inverse of a fisheye
_ON_AXIS = 1e-16  # r^2 below which a fisheye is its own tangent to 1e-16

Coefficients = tuple[float, ...]
_Radial = Callable[[Coefficients, Array], tuple[Array, Array]]


@dataclass(frozen=True)
class LensModel:
    """Definition of a lens model.

    Attributes:
        name: Its name in sensor files and in ROS.
        code: Its number in the kernels.
        coefficients: Names of the coefficients, in the order of ROS and OpenCV.
        radial: Function of the coefficients and r^2. It returns the scale of (x, y) and its slope:
            the derivative of the scale by x is slope times x.
        tangential: True if the third and the fourth coefficient are p1 and p2.
        foxglove: Name in messages of Foxglove.
        others: Its names in camera files of other software.
        start: Function of the coefficients and of the distorted radius. It returns the approximate
            ratio of ideal and distorted coordinates; None: they are nearly equal.
    """

    name: str
    code: int
    coefficients: tuple[str, ...]
    radial: _Radial
    tangential: bool
    foxglove: str
    others: tuple[str, ...] = ()
    start: Callable[[Coefficients, Array], Array] | None = None


def _plumb_bob(k: Coefficients, r2: Array) -> tuple[Array, Array]:
    """Return 1 + k1 r^2 + k2 r^4 + k3 r^6, and its slope."""
    k1, k2, _, _, k3 = k[:5]
    scale = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return scale, 2 * k1 + r2 * (4 * k2 + 6 * k3 * r2)


def _rational(k: Coefficients, r2: Array) -> tuple[Array, Array]:
    """Return (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6), and its slope."""
    k4, k5, k6 = k[5:]
    above, above_slope = _plumb_bob(k, r2)
    below, below_slope = _plumb_bob((k4, k5, 0.0, 0.0, k6), r2)
    scale = above / below
    return scale, (above_slope - scale * below_slope) / below


def _equidistant(k: Coefficients, r2: Array) -> tuple[Array, Array]:
    """Return theta (1 + k1 theta^2 + ... + k4 theta^8) / r with theta = atan(r), and its slope."""
    axis = r2 < _ON_AXIS
    r2 = np.where(axis, 1.0, r2)
    r = np.sqrt(r2)
    angle, by_theta = _distorted_angle(k, np.arctan(r))
    scale = angle / r
    slope = (by_theta / (1 + r2) - scale) / r2
    return np.where(axis, 1.0, scale), np.where(axis, 2 * (k[0] - 1 / 3), slope)


def _distorted_angle(k: Coefficients, theta: Array) -> tuple[Array, Array]:
    """Return a fisheye's image radius of a ray at `theta` to the axis, and its derivative."""
    k1, k2, k3, k4 = k
    t2 = theta * theta
    angle = theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
    return angle, 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))


def _equidistant_start(k: Coefficients, r_d: Array) -> Array:
    """Return tan(theta) / r_d of the ray whose image is at the radius `r_d`."""
    theta = np.minimum(r_d, _ANGLE_MAX)
    for _ in range(_ANGLE_STEPS):
        now, by_theta = _distorted_angle(k, theta)
        theta = np.clip(theta - (now - r_d) / by_theta, 0.0, _ANGLE_MAX)
    return np.where(r_d > 0, np.tan(theta) / r_d, 1.0)


_RADIAL_TANGENTIAL = ("k1", "k2", "p1", "p2", "k3")
PLUMB_BOB = "plumb_bob"
MODELS: dict[str, LensModel] = {
    model.name: model
    for model in (
        LensModel(
            PLUMB_BOB, 0, _RADIAL_TANGENTIAL, _plumb_bob, True, "plumb_bob", ("radtan", "none", "")
        ),
        LensModel(
            "rational_polynomial",
            1,
            (*_RADIAL_TANGENTIAL, "k4", "k5", "k6"),
            _rational,
            True,
            "rational_polynomial",
        ),
        LensModel(
            "equidistant",
            2,
            ("k1", "k2", "k3", "k4"),
            _equidistant,
            False,
            "kannala_brandt",
            ("equi", "fisheye", "kannala_brandt"),
            _equidistant_start,
        ),
    )
}
"""The lens models by name. A new one needs a line here and its function in the kernels."""


@dataclass(frozen=True)
class Lens:
    """Lens model with its coefficients.

    Attributes:
        model: Name of the model, of `MODELS`.
        coefficients: Its coefficients; empty: all zero.
    """

    model: str = PLUMB_BOB
    coefficients: Coefficients = ()

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            message = f"{self.model!r} is unknown"
            raise InputError(message, source="Camera", field="distortion_model", choices=MODELS)
        names = self.definition.coefficients
        if not self.coefficients:
            object.__setattr__(self, "coefficients", (0.0,) * len(names))
        if len(self.coefficients) != len(names):
            raise InputError(
                f"{len(self.coefficients)} coefficients",
                source="Camera",
                field="distortion",
                choices=[f"{len(names)} numbers: {', '.join(names)}"],
            )

    @property
    def definition(self) -> LensModel:
        """The definition of the model."""
        return MODELS[self.model]

    @cached_property
    def is_ideal(self) -> bool:
        """True if ideal and distorted coordinates are equal."""
        return self.definition.tangential and not any(self.coefficients)

    @cached_property
    def parameters(self) -> Array:
        """Code of the model and its coefficients (9,), for the kernels."""
        padding = COEFFICIENTS_MAX - len(self.coefficients)
        return np.array([self.definition.code, *self.coefficients, *(0.0,) * padding])

    def distort(self, xy: ArrayLike) -> Array:
        """Return the distorted coordinates (..., 2) of ideal ones `xy` (..., 2)."""
        xy = np.asarray(xy, dtype=float)
        if self.is_ideal:
            return xy
        return np.stack(self._evaluate(xy[..., 0], xy[..., 1])[:2], axis=-1)

    def undistort(self, xy_distorted: ArrayLike) -> Array:
        """Return the ideal coordinates (..., 2) of distorted ones, to about 1e-13.

        Newton's method uses the exact Jacobian. The result is NaN where it does not converge to a
        point on the near side of the fold.
        """
        target = np.asarray(xy_distorted, dtype=float)
        if self.is_ideal:
            return target.copy()
        x_d, y_d = np.moveaxis(target, -1, 0).copy()
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            x, y = self._start(x_d, y_d)
            for _ in range(_NEWTON_STEPS):
                x_now, y_now, xx, xy, yy = self._evaluate(x, y)
                x_off = x_now - x_d
                y_off = y_now - y_d
                det = xx * yy - xy * xy
                x = x - (yy * x_off - xy * y_off) / det
                y = y - (xx * y_off - xy * x_off) / det
                residual = np.maximum(np.abs(x_off), np.abs(y_off))
                if not np.any(residual > _NEAR):  # the last step squares the error
                    break
            good = np.logical_and(residual <= _NEAR, det > 0)
        return np.where(good[..., None], np.stack([x, y], axis=-1), np.nan)

    def jacobian(self, xy: ArrayLike) -> Array:
        """Return the derivative (..., 2, 2) of `distort` at ideal coordinates `xy` (..., 2)."""
        xy = np.asarray(xy, dtype=float)
        J = np.empty((*xy.shape, 2))
        _, _, J[..., 0, 0], J[..., 0, 1], J[..., 1, 1] = self._evaluate(xy[..., 0], xy[..., 1])
        J[..., 1, 0] = J[..., 0, 1]
        return J

    def _start(self, x_d: Array, y_d: Array) -> tuple[Array, Array]:
        """Return ideal coordinates near those of distorted ones."""
        start = self.definition.start
        if start is None:  # one step of the fixed-point iteration
            x, y, *_ = self._evaluate(x_d, y_d)
            return 2 * x_d - x, 2 * y_d - y
        scale = start(self.coefficients, np.hypot(x_d, y_d))
        return x_d * scale, y_d * scale

    def _evaluate(self, x: Array, y: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Return the distorted x and y (...) of ideal ones, and the derivatives dx/dx, dx/dy =
        dy/dx, dy/dy."""
        x2 = x * x
        y2 = y * y
        xy = x * y
        r2 = x2 + y2
        scale, slope = self.definition.radial(self.coefficients, r2)
        x_d = x * scale
        y_d = y * scale
        xx = scale + slope * x2
        xy_ = slope * xy
        yy = scale + slope * y2
        if not self.definition.tangential:
            return x_d, y_d, xx, xy_, yy
        p1, p2 = self.coefficients[2:4]
        if p1 or p2:
            x_d = x_d + 2 * p1 * xy + p2 * (r2 + 2 * x2)
            y_d = y_d + p1 * (r2 + 2 * y2) + 2 * p2 * xy
            xx = xx + 2 * p1 * y + 6 * p2 * x
            xy_ = xy_ + 2 * p1 * x + 2 * p2 * y
            yy = yy + 6 * p1 * y + 2 * p2 * x
        return x_d, y_d, xx, xy_, yy


def model_named(name: Any) -> LensModel | None:
    """Return the model of this name in a camera file; None if it is unknown."""
    for model in MODELS.values():
        if name == model.name or name in model.others:
            return model
    return None


def trimmed(coefficients: Sequence[float], count: int) -> Coefficients | None:
    """Return coefficients of any length as `count`: padded by zeros, or without further zeros.

    None if a coefficient beyond `count` is not zero.
    """
    if any(coefficients[count:]):
        return None
    return (*map(float, coefficients[:count]), *(0.0,) * (count - len(coefficients)))
