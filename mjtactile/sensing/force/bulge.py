"""Is the membrane at rest the bulge that the sensor file predicts, or does something touch it?
(docs/equations.md, Eq. F16)

Whatever touches makes the membrane look stiffer, which a fit of the stiffness would swallow; but it
also changes the bulge's shape. What the markers' heights leave of the best-fitting bulge is weighed
with all that may be wrong of them while nothing touches: noise, the model's own discretisation, and
the lens. A lens that was not measured makes heights wrong by a share that varies smoothly over the
picture; and the worse it is, the more the flat membrane's markers were off their layout.
"""

from __future__ import annotations

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array, Markers
from mjtactile.sensing.settings import DEFAULTS, ReferenceSettings


def misfit(
    design: SensorDesign,
    markers: Markers,
    z: Array,
    flat_px: float,
    *,
    lens_measured: bool,
    s: ReferenceSettings = DEFAULTS.reference,
) -> float:
    """Mean square misfit of the markers' heights to the best-fitting bulge's `z` (n,) m, over its
    variance. `flat_px` is the rms residual of the flat reference."""
    x, y = (markers.p_SM[:, :2] / (design.frame.length / 2, design.frame.width / 2)).T
    share = s.lens_share_measured if lens_measured else s.lens_share
    modes = share * z[:, None] * np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    own = (
        markers.cov_p[:, 2, 2]
        + s.bulge_floor**2
        + ((s.lens_rest + s.lens_rest_per_px * flat_px) * z) ** 2
    )
    off = markers.p_SM[:, 2] - z
    return float(off @ np.linalg.solve(modes @ modes.T + np.diag(own), off)) / len(off)
