"""Check that the membrane at rest has the predicted bulge, or detect a contact.

See docs/theory/membrane_inverse.md, Eq. F16.

A contact makes the membrane appear stiffer, which a stiffness fit would absorb. But it also changes
the shape of the bulge. The residual heights are relative to the best-fitting bulge. They are
compared with all errors possible without contact: noise, discretization of the model, and the lens.
An uncalibrated lens scales heights by an error that varies smoothly over the image. This error
grows with the flat membrane's marker deviations from their layout.
"""

from __future__ import annotations

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import DeviceError
from mjtactile.core.types import Array, Markers
from mjtactile.sensing.force.rest_equilibrium import InverseRest
from mjtactile.sensing.settings import DEFAULTS, ReferenceSettings, Settings


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
    share = s.lens_fraction_measured if lens_measured else s.lens_fraction
    modes = share * z[:, None] * np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    own = (
        markers.cov_p[:, 2, 2]
        + s.bulge_floor**2
        + ((s.lens_rest + s.lens_rest_per_px * flat_px) * z) ** 2
    )
    off = markers.p_SM[:, 2] - z
    return float(off @ np.linalg.solve(modes @ modes.T + np.diag(own), off)) / len(off)


def require_bulge(
    design: SensorDesign,
    markers: Markers,
    z: Array,
    rest: InverseRest,
    flat_px: float,
    *,
    lens_measured: bool,
    settings: Settings = DEFAULTS,
) -> None:
    """Raise DeviceError if the rest state is not the bulge of the sensor file, in height or shape.
    `z` (n,), m, are the marker heights of the best-fitting bulge, and `flat_px` is the rms residual
    of the flat reference."""
    gauge_pressure = rest.gas.gauge
    maximum = settings.reference.stiffness_off_max
    if not 1 / maximum < rest.stiffness_scale < maximum:
        height = 1e3 * float(np.abs(markers.p_SM[:, 2]).max())
        raise DeviceError(
            f"sensor {design.name}: at {gauge_pressure:.0f} Pa the markers are at most "
            f"{height:.2f} mm high, as if the membrane were {rest.stiffness_scale:.1f} times "
            "as stiff as in the sensor file; check that the valve moves, and young_MPa and "
            "thickness_mm of the membrane"
        )
    # hardly a bulge, and no stiffness was fitted to it
    if gauge_pressure <= settings.inverse.informative_pressure:
        return
    squares = misfit(design, markers, z, flat_px, lens_measured=lens_measured, s=settings.reference)
    if squares > settings.reference.bulge_misfit_max:
        off = 1e3 * float(np.abs(markers.p_SM[:, 2] - z).max())
        raise DeviceError(
            f"sensor {design.name}: at rest the membrane does not have the bulge expected at "
            f"{gauge_pressure:.0f} Pa: markers deviate by up to {off:.2f} mm "
            f"({np.sqrt(squares):.1f} standard deviations, rms); remove any contact, else "
            "measure the lens: `mjtactile calibrate camera`"
        )
