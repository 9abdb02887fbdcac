"""As-built membranes of many worlds: one design with a factor on its shear modulus.

The kernels share one design. A membrane with another stiffness, thickness and pre-stretch is
replaced by that design with the modulus that gives the same rest volume: the height at which an
object meets it is then the same, and its tension nearly.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import PchipInterpolator, RectBivariateSpline

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array
from mjtactile.sim.sensor.quasistatic_geoms import membrane_of

_NODES = 5  # nodes of each interpolation over stiffness and pre-stretch
_FACTORS = 15
# margins of the interpolation: a factor of the stiffness, an offset of the pre-stretch
_MARGIN = 1.02
_OFFSET = 1e-3


def match_membranes(
    design: SensorDesign, grid: tuple[int, int], stiffness: Array, pre_stretch: Array
) -> tuple[Array, Array]:
    """Return factors of the modulus (n,) and rest volumes (n,), m^3, of as-built membranes.

    Args:
        design: Design of the sensor file.
        grid: Number of nodes along x and y.
        stiffness: Young's modulus times thickness over that of the design (n,).
        pre_stretch: Offset of the pre-stretch (n,).

    Returns:
        Factors and volumes; 1 and that of the design where nothing differs.
    """
    volume = float(membrane_of(design, grid).rest.volume)
    if np.all(stiffness == 1) and not np.any(pre_stretch):
        return np.ones(len(stiffness)), np.full(len(stiffness), volume)
    low, high = float(stiffness.min()) / _MARGIN, float(stiffness.max()) * _MARGIN
    across = np.linspace(low, high, _NODES)
    along = np.linspace(pre_stretch.min() - _OFFSET, pre_stretch.max() + _OFFSET, _NODES)
    table = [[_rest_volume(design, grid, s, offset) for offset in along] for s in across]
    volumes = RectBivariateSpline(across, along, np.log(table))(stiffness, pre_stretch, grid=False)
    tension = design.membrane.pretension
    stretched = [_changed(design, 1.0, offset).membrane.pretension / tension for offset in along]
    factors = np.geomspace(low * min(stretched) / 1.2, high * max(stretched) * 1.2, _FACTORS)
    log_volumes = np.log([_rest_volume(design, grid, factor, 0.0) for factor in factors])
    inverse = PchipInterpolator(log_volumes[::-1], np.log(factors)[::-1])
    return np.exp(inverse(volumes)), np.exp(volumes)


def _rest_volume(
    design: SensorDesign, grid: tuple[int, int], stiffness: float, pre_stretch: float
) -> float:
    return float(membrane_of(_changed(design, stiffness, pre_stretch), grid).rest.volume)


def _changed(design: SensorDesign, stiffness: float, pre_stretch: float) -> SensorDesign:
    membrane = design.membrane
    return replace(
        design,
        membrane=replace(
            membrane,
            young=stiffness * membrane.young,
            pre_stretch=membrane.pre_stretch + pre_stretch,
        ),
    )
