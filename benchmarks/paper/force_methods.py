"""Force from the membrane's shape, at the paper's two levels and by membrane statics.

Level 1 (`mjtactile.calibrate.force.AreaCalibration`): dF = c dA (paper Eq. 11), c
calibrated once for each sensor. Level 2 (`spring_grid_force`): the surface as a grid of springs;
the force on a node is the sum of its four springs. Statics (`MembraneForce`): the net force that
equilibrium demands, from the sensor file and the gas law alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.paper.deformation import Fields, MembraneModel
from benchmarks.paper.settings import DEFAULTS, PaperSettings
from mjtactile.core.types import Array, Markers, Surface


def spring_grid_force(surface: Surface, rest: Surface, tension: float) -> Array:
    """Compute the external force on each grid node (ny, nx, 3), N, relative to rest.

    This is the paper's grid of springs (its Fig. 4). In a uniformly stretched membrane of `tension`
    N/m, each of the four springs of a node pulls with the tension times the spacing across it. The
    change of the spring forces from the rest state is balanced by the external force.
    """
    pull = _spring_pull(surface, tension) - _spring_pull(rest, tension)
    return -pull


def _spring_pull(surface: Surface, tension: float) -> Array:
    """Return the sum of the four spring forces on every inner node, (ny, nx, 3), N.

    Nodes on the rim have zeros.
    """
    x = surface.x
    y = surface.y
    z = surface.z
    pull = np.zeros((*z.shape, 3))
    # springs along y (axis 0) stand for a strip of width dx, and so on
    across = {0: x[1] - x[0], 1: y[1] - y[0]}
    for axis in (0, 1):
        step = np.zeros((*np.diff(z, axis=axis).shape, 3))
        step[..., 1 - axis] = across[1 - axis]
        step[..., 2] = np.diff(z, axis=axis)
        force = tension * across[axis] * step / np.linalg.norm(step, axis=-1, keepdims=True)
        inner = [slice(1, -1), slice(1, -1)]
        ahead = list(inner)
        behind = list(inner)
        ahead[axis] = slice(1, None)
        behind[axis] = slice(None, -1)
        pull[1:-1, 1:-1] += force[tuple(ahead)] - force[tuple(behind)]
    return pull


@dataclass(frozen=True, eq=False)
class RestState:
    """Calibration of the sensor from a state without contact.

    Gas `volume`, m^3 (chamber and bulge), and absolute `pressure`, Pa. The factor `stiffness_scale`
    makes the elastic forces balance the pressure. `offset` (6,) is the remaining wrench, `jacobian`
    (6, N, 3) the sensitivity of the wrench to marker positions. `sealed`: the amount of gas is
    constant; otherwise the valve keeps the pressure constant.
    """

    volume: float
    pressure: float
    stiffness_scale: float
    offset: Array
    jacobian: Array
    sealed: bool = True


class MembraneForce:
    """Net contact wrench by the weak form of equilibrium (docs/theory/membrane_inverse.md, Eq. F5,
    F6).

    Let the test function phi be 1 over the contact and 0 on the frame. Then the virtual work of the
    membrane stress, the gas and the contact cancel:

        F = int P grad(phi) dX - p int phi N dX

    The torque follows with x cross both integrands. The formula needs slopes only where phi falls,
    so curvature noise has no effect. With p V^gamma = constant, the reconstructed volume gives the
    pressure.
    """

    def __init__(self, model: MembraneModel, settings: PaperSettings = DEFAULTS):
        self.model = model
        self.design = model.design
        self.settings = settings
        markers = self.design.markers
        self._phi, self._grad_phi = model.plateau(
            settings.taper * max(markers.pitch_x, markers.pitch_y)
        )

    def gauge_pressure(self, fields: Fields, rest: RestState) -> float:
        """Return the gauge pressure, Pa, from the gas volume under the membrane (Eq. G1)."""
        if not rest.sealed:
            return rest.pressure - self.design.chamber.ambient
        ratio = rest.volume / self.gas_volume(fields)
        return (
            rest.pressure * ratio**self.design.chamber.polytropic_exponent
            - self.design.chamber.ambient
        )

    def gas_volume(self, fields: Fields) -> float:
        """Return the gas volume of chamber and bulge, m^3."""
        return self.design.chamber_volume_flat + self.model.volume(fields)

    def _terms(self, fields: Fields) -> tuple[Array, Array]:
        """Return the elastic wrench (6,), and the wrench (6,) per pascal of pressure."""
        w = self.model.weights
        stress = np.einsum("qia,qa->qi", self.model.first_piola(fields), self._grad_phi)
        area = self._phi[:, None] * fields.normal_area
        return (
            np.concatenate([w @ stress, w @ np.cross(fields.x, stress)]),
            np.concatenate([w @ area, w @ np.cross(fields.x, area)]),
        )

    def rest_state(
        self, markers: Markers, gauge_pressure: float, *, sealed: bool = True
    ) -> RestState:
        """Calibrate without contact at a known gauge pressure, Pa.

        The ratio of pressure force to elastic force absorbs an error of Young's modulus, thickness
        or pre-stretch. A flat membrane (no pressure) carries no information on stiffness: then the
        design's value stands.
        """
        fields = self._fields(markers.ids, markers.p_SM)
        elastic, push = self._terms(fields)
        informative = gauge_pressure > self.settings.informative_pressure and elastic[2] > 0
        scale = float(gauge_pressure * push[2] / elastic[2]) if informative else 1.0
        rest = RestState(
            self.gas_volume(fields),
            self.design.chamber.ambient + gauge_pressure,
            scale,
            scale * elastic - gauge_pressure * push,
            np.zeros((6, 0, 3)),
            sealed,
        )
        return replace(rest, jacobian=self._jacobian(markers, rest))

    def _jacobian(self, markers: Markers, rest: RestState) -> Array:
        """Return d(wrench)/d(p_SM) (6, N, 3) at rest for all markers, by central differences."""
        step = 1e-5
        jacobian = np.zeros((6, self.design.markers.count, 3))
        for row, marker in enumerate(markers.ids):
            for axis in range(3):
                shift = np.zeros_like(markers.p_SM)
                shift[row, axis] = step
                plus, minus = (
                    self.wrench(markers.ids, markers.p_SM + s * shift, rest)[0] for s in (1, -1)
                )
                jacobian[:, marker, axis] = (plus - minus) / (2 * step)
        return jacobian

    def _fields(self, ids: NDArray[np.int64], p_SM: Array) -> Fields:
        return self.model.fields(self.model.fit(ids, p_SM))

    def wrench(self, ids: NDArray[np.int64], p_SM: Array, rest: RestState) -> tuple[Array, float]:
        """Compute the contact wrench (6,) on the membrane in S, N and N m, from marker positions.

        Returns:
            The net wrench, and the gauge pressure, Pa.
        """
        return self.wrench_of(self._fields(ids, p_SM), rest)

    def wrench_of(self, fields: Fields, rest: RestState) -> tuple[Array, float]:
        """Compute the contact wrench (6,) on the membrane in S, N and N m, from the deformation.

        Returns:
            The net wrench, and the gauge pressure, Pa.
        """
        elastic, push = self._terms(fields)
        gauge = self.gauge_pressure(fields, rest)
        return rest.stiffness_scale * elastic - gauge * push - rest.offset, gauge

    def wrench_cov(self, markers: Markers, rest: RestState) -> Array:
        """Return the wrench covariance (6, 6) that follows from the marker covariances."""
        J = rest.jacobian[:, markers.ids]
        return np.einsum("fni,nij,gnj->fg", J, markers.cov_p, J, optimize=True)
