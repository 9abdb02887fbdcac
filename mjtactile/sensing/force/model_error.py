"""Variance of the wrench due to errors of the membrane model.

The posterior covariance does not contain it (docs/theory/membrane_inverse.md, Eq. F12).

The values are standard deviations of shear, normal force, tilting and spinning torque. Torques are
divided by a lever. They are fractions of the estimated load, plus the drag of a moving membrane.
They were measured on simulated indentations, taps, drags and holds (`bench uncertainty`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.sensor_parts import MarkerLayout
from mjtactile.core.types import Array
from mjtactile.sensing.settings import DEFAULTS, ModelErrorSettings

# Fx, Fy are shear, then the normal force, the torques that tilt, the one that spins
AXES = np.array([0, 0, 1, 2, 2, 3])
# indices of the fractions: `lateral`; `sharp` and `caught`
_LATERAL = 1
_SHARP = slice(2, 4)
_TILTS = AXES == 2


@dataclass(frozen=True, eq=False)
class FitDiagnostics:
    """Inputs of the model error from an estimate.

    `force` (3, J), N, are the nodal forces, and `change` (6,) the change of the wrench since the
    last image. `velocity` (3,), m/s, is the mean velocity of the membrane since then. `excess` is
    the mean over all markers of their squared noise over its standard deviation. `air_moved`, Pa,
    is the gas's own pressure change, and `lag` the delay of the camera, images. `unseen`, N, is the
    possible load between the outermost markers and the frame. `measured` is True with a pressure
    sensor.
    """

    force: Array
    change: Array
    velocity: Array
    excess: float
    air_moved: float = 0.0
    lag: float = 0.0
    unseen: float = 0.0
    measured: bool = False


class ModelErrorVariance:
    """Variance of a wrench due to model error, for one sensor with nodes (J, 2), m."""

    def __init__(
        self,
        design: SensorDesign,
        nodes: Array,
        settings: ModelErrorSettings = DEFAULTS.model_error,
    ):
        layout = design.markers
        membrane = design.membrane
        frame = design.frame
        self._sharp_max = settings.sharp_max
        s = settings
        fractions = [s.sparse, s.lateral, s.sharp, s.caught, s.outside, s.burst]
        self._shares = np.array(fractions, float)[:, AXES]
        self._change = np.array(s.change)[AXES]
        self._lag = s.lag
        self._unseen = s.unseen
        self._outside = _outside(layout, nodes)
        self._sparse = max(1.0, layout.pitch_x * layout.pitch_y / settings.cell)
        self._resistance = settings.drag * frame.area * membrane.young * membrane.thickness
        self._area = frame.area
        self._unit = np.array([1.0, 1.0, 1.0, *np.full(3, settings.lever)])

    def variance(self, estimated: FitDiagnostics) -> Array:
        """Return the variance of force, N^2, and torque, (N m)^2, about the origin of S (6,)."""
        size = float(np.linalg.norm(estimated.force.sum(axis=1)))
        sums = np.abs(estimated.force)
        loads = np.array(
            [
                [size * self._sparse],
                [float(sums[:2].sum())],
                *self._sharp_loads(estimated.force, estimated.excess),
                [float((sums @ self._outside).sum())],
                [_burst(float(np.linalg.norm(estimated.change[:3])), size)],
            ]
        )
        variance = np.square(self._shares * loads).sum(axis=0) + np.square(
            self._change * estimated.change / self._unit
        )
        variance += np.square(self._lag * estimated.lag * estimated.change / self._unit)
        variance[2] += (self._change[2] * self._area * estimated.air_moved) ** 2
        variance[2] += (self._unseen[int(estimated.measured)] * estimated.unseen) ** 2
        variance[:2] += (self._resistance * estimated.velocity[:2]) ** 2
        return self._unit**2 * variance

    def of_sharpness(self, force: Array, excess: float) -> Array:
        """Return the part of `variance` (6,) due to sharp features that the splines cannot follow,
        for nodal forces (3, J), N. For shear and spin it includes the part due to lateral forces
        toward each contact, which may not cancel. For `excess` see `FitDiagnostics`."""
        loads = np.array(self._sharp_loads(force, excess))
        variance = np.square(self._shares[_SHARP] * loads).sum(axis=0)
        from_lateral = np.square(self._shares[_LATERAL] * float(np.abs(force[:2]).sum()))
        return self._unit**2 * (variance + np.where(_TILTS, 0.0, from_lateral))

    def _sharp_loads(self, force: Array, excess: float) -> list[list[float]]:
        excess = min(excess, self._sharp_max)
        size = float(np.linalg.norm(force.sum(axis=1)))
        caught = math.sqrt(max(excess - 1, 0.0))
        return [[size * excess], [float(np.abs(force[:2]).sum()) * caught]]


def _outside(layout: MarkerLayout, nodes: Array) -> Array:
    """Return the degree (J,) to which nodes lie outside the outermost markers. It is 1 from half a
    marker pitch outside, and 0 from half a pitch inside, where markers surround the node."""
    maximum = np.abs(layout.p_SM[:, :2]).max(axis=0)
    beyond = (np.abs(nodes) - maximum) / [layout.pitch_x, layout.pitch_y]
    return np.square(np.clip(beyond + 0.5, 0.0, 1.0).max(axis=1))


def _burst(change: float, size: float) -> float:
    """Return the sudden part of a force `change`, N. It is zero for a change below half of the
    force `size`, N."""
    return change * min(max(2 * change / max(size, 1e-9) - 1, 0.0), 1.0)
