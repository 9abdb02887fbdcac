"""Prior of the tractions on a grid of nodes before a frame is evaluated.

See docs/theory/membrane_inverse.md, Eq. F11.

Contacts are compact: the variance of a node follows the last estimated pressure there. The pressure
is smoothed over part of the grid spacing. It is limited to the load capacity of a membrane.
Pressures of neighboring nodes are correlated. Shear is proportional to pressure by friction.
Tractions are (3, J) Pa, component by component, J = jx * jy nodes with y fastest.
"""

from __future__ import annotations

import numpy as np

from mjtactile.core.types import Array
from mjtactile.sensing.settings import DEFAULTS, PriorSettings

_JITTER = 1e-6  # keeps the correlation's factor finite


class LoadPrior:
    """Prior covariance S C S of nodal tractions. S holds the standard deviations of the nodes. C is
    a Gaussian correlation over the grid lines `x` (jx,) and `y` (jy,), m. It is the same for each
    component. `root` are the lower factors of C along x and along y."""

    def __init__(self, x: Array, y: Array, settings: PriorSettings = DEFAULTS.prior):
        self.settings = settings
        self._shape = (len(x), len(y))
        self.root = tuple(
            np.linalg.cholesky(_kernel(v, self.settings.correlation) + _JITTER * np.eye(len(v)))
            for v in (x, y)
        )
        self._soften = tuple(
            k / k.sum(axis=1, keepdims=True)
            for k in (_kernel(v, self.settings.softening) for v in (x, y))
        )

    def first(self) -> Array:
        """Return the standard deviations (3 J,), Pa, before any traction estimate."""
        count = self._shape[0] * self._shape[1]
        return self.settings.pressure_sd * np.repeat(
            [self.settings.friction, self.settings.friction, 1.0], count
        )

    def after(self, traction: Array) -> Array:
        """Return the standard deviations (3 J,), Pa, after the estimate `traction` (3, J). Tension
        counts as zero."""
        return self._scaled(self._pressing(traction), 1.0)

    def around(self, traction: Array, fraction: float) -> Array:
        """Return the standard deviations (3 J,), Pa, of the deviation from a predicted `traction`
        (3, J). `fraction` is that of the normal part relative to the prediction."""
        return self._scaled(self._pressing(traction), fraction)

    def _pressing(self, traction: Array) -> Array:
        """Return the smoothed and limited contact pressure (J,), Pa, of `traction` (3, J)."""
        by_x, by_y = self._soften
        pressing = (by_x @ np.maximum(-traction[2], 0.0).reshape(self._shape) @ by_y.T).ravel()
        return pressing / np.hypot(1.0, pressing / self.settings.pressure_limit)

    def _scaled(self, pressing: Array, fraction: float) -> Array:
        background = self.settings.background * self.settings.pressure_sd
        shear = np.hypot(self.settings.friction * pressing, background / 2)
        return np.concatenate([shear, shear, np.hypot(fraction * pressing, background)])


def _kernel(x: Array, length: float) -> Array:
    return np.exp(-0.5 * (np.subtract.outer(x, x) / length) ** 2)
