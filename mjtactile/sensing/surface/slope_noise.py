"""Uncertainty of surface slopes measured from marker ellipses."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core.types import Array

_ASPECT_PER_DEPTH = np.sqrt(8 / 3)
"""Ratio of the axis ratio's standard deviation to the relative one of the depth. The outline is
assumed to have independent radial errors. The axis ratio is 1 - 2 c / r with c the second harmonic.
Its standard deviation is sqrt(8) times the relative one of the mean radius. For the depth, whose
tilt is fitted too, the factor is sqrt(3). Normals measured on rendered images have 0.8 to 0.9 of
the resulting standard deviation."""


def slope_sd(n: Array, p_CM: Array, variance: Array) -> Array:
    """Return the standard deviation (N,) of slopes measured at markers; see `slope_sd_of`. The
    markers have unit normals `n` and positions `p_CM` (N, 3), m, from the camera. `variance` (N,),
    m^2, is that of their depths."""
    far = np.sqrt(np.einsum("ni,ni->n", p_CM, p_CM))
    return slope_sd_of(n, p_CM / far[:, None], _ASPECT_PER_DEPTH * np.sqrt(variance) / far)


def slope_sd_of(n: ArrayLike, view: ArrayLike, aspect_sd: ArrayLike) -> Array:
    """Return the standard deviation (N,) of the slopes of markers with unit normals `n`.

    The markers are observed along unit rays `view` (N, 3). The tilt t against the line of sight
    comes from the ellipse's axis ratio cos(t). The standard deviation of this ratio is `aspect_sd`
    (N,). So d t = aspect_sd / sin(t), and for a face-on marker at most sqrt(aspect_sd). The tilt
    direction comes from the ellipse's axes, with the noise of the same second harmonic. So sin(t)
    d(angle) = aspect_sd sin(t) / (2 (1 - cos(t))), equal within 5 % up to 35 degrees. A slope is
    tan of an angle to the axis: d tan = d t / n_z^2.
    """
    n = np.asarray(n, dtype=float)
    aspect_sd = np.asarray(aspect_sd, dtype=float)
    sine2 = 1 - np.einsum("ni,ni->n", n, np.asarray(view, dtype=float)) ** 2
    return (
        aspect_sd
        / np.sqrt(np.maximum(sine2, np.maximum(aspect_sd, 1e-12)))
        / np.maximum(n[:, 2] ** 2, 1e-6)
    )
