"""Force from the membrane's shape, at the paper's two levels and by membrane statics.

Level 1 (`integral_force`): dF = c dA (paper Eq. 11), c calibrated once for each sensor.
Level 2 (`spring_grid_force`): the surface as a grid of springs; the force on a node is the sum of its four springs.
Statics (`MembraneForce`): the net force that equilibrium demands, from the sensor file and the gas law alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from mjtactile.design import SensorDesign
from mjtactile.sensing.deformation import Fields, MembraneModel
from mjtactile.types import Array, Markers, Surface

_TAPER_MARGIN = 1.25


def integral_force(area_change: float, constant: float) -> float:
    """Normal force, N, from the change of membrane area, m^2: dF = c dA (paper Eq. 11). `constant` c in N/m^2."""
    return constant * area_change


def spring_grid_force(surface: Surface, rest: Surface, tension: float) -> Array:
    """Force of the world on each grid node (ny, nx, 3) N: the paper's grid of springs (its Fig. 4), against rest.

    A uniformly stretched sheet of `tension` N/m pulls a node along each of its four springs with the tension times
    the spacing across it. What the springs pull in excess of the rest state must be held by the outside.
    """
    pull = _spring_pull(surface, tension) - _spring_pull(rest, tension)
    return -pull


def _spring_pull(surface: Surface, tension: float) -> Array:
    """Sum of the four spring forces on every inner node, zeros on the rim, (ny, nx, 3) N."""
    x, y, z = surface.x, surface.y, surface.z
    pull = np.zeros((*z.shape, 3))
    across = {0: x[1] - x[0], 1: y[1] - y[0]}  # springs along y (axis 0) stand for a strip of width dx, and so on
    for axis in (0, 1):
        step = np.zeros((*np.diff(z, axis=axis).shape, 3))
        step[..., 1 - axis] = across[1 - axis]
        step[..., 2] = np.diff(z, axis=axis)
        force = tension * across[axis] * step / np.linalg.norm(step, axis=-1, keepdims=True)
        inner = [slice(1, -1), slice(1, -1)]
        ahead, behind = list(inner), list(inner)
        ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
        pull[1:-1, 1:-1] += force[tuple(ahead)] - force[tuple(behind)]
    return pull


@dataclass(frozen=True, eq=False)
class RestState:
    """What the sensor measured of itself with nothing touching: gas `volume` m^3 (chamber and bulge), absolute
    `pressure` Pa, the factor `stiffness_scale` that makes its elastic forces balance the pressure, the remaining
    force `offset` (3,) N, and the sensitivities `jacobian` (3, 3 N) of the force to marker positions."""

    volume: float
    pressure: float
    stiffness_scale: float
    offset: Array
    jacobian: Array


class MembraneForce:
    """Net contact force by the weak form of equilibrium (docs/equations.md, Eq. F5).

    For a test function phi that is 1 over the contact and 0 on the frame, the virtual work of the membrane's stress,
    of the gas and of the contact cancel:  F = int P grad(phi) dX - p int N phi dX.  It needs slopes only where phi
    falls, so noise in curvature does not enter. The pressure follows from the reconstructed volume by p V^gamma.
    """

    def __init__(self, model: MembraneModel):
        self.model, self.design = model, model.design
        markers = self.design.markers
        taper = _TAPER_MARGIN * max(markers.pitch_x, markers.pitch_y)
        self._phi, self._grad_phi = model.plateau(taper)

    def pressure(self, volume: float, rest: RestState) -> float:
        """Absolute gas pressure, Pa, from gas volume, m^3: p V^gamma = constant (Eq. G1)."""
        return rest.pressure * (rest.volume / volume) ** self.design.chamber.heat_ratio

    def gas_volume(self, fields: Fields) -> float:
        return self.design.chamber_volume_flat + self.model.volume(fields)

    def _terms(self, fields: Fields) -> tuple[Array, Array]:
        """Weak-form elastic force (3,) N and the vector area (3,) m^2 that the pressure acts on."""
        w = self.model.weights
        elastic = np.einsum("q,qia,qa->i", w, self.model.first_piola(fields), self._grad_phi)
        return elastic, (w * self._phi) @ fields.normal_area

    def rest_state(self, markers: Markers, pressure_gauge: float) -> RestState:
        """Calibrate on a state with nothing touching and a known gauge pressure, Pa.

        The ratio of pressure force to elastic force absorbs an error of Young's modulus, thickness or pre-stretch. A
        flat membrane (no pressure) carries no information on stiffness: then the design's value stands.
        """
        fields = self.model.fields(self.model.fit(markers.ids, markers.p_SM))
        elastic, vector_area = self._terms(fields)
        push = pressure_gauge * vector_area[2]
        scale = push / elastic[2] if pressure_gauge > 100 and elastic[2] > 0 else 1.0
        offset = scale * elastic - pressure_gauge * vector_area
        rest = RestState(self.gas_volume(fields), self.design.chamber.ambient + pressure_gauge, float(scale), offset,
                         np.zeros((3, 3 * len(markers))))
        jacobian = self._jacobian(markers, rest)
        return RestState(rest.volume, rest.pressure, rest.stiffness_scale, rest.offset, jacobian)

    def _jacobian(self, markers: Markers, rest: RestState) -> Array:
        """dF/dp_SM at rest by central differences over marker coordinates, (3, 3 N); the noise model's only input."""
        step, columns = 1e-5, []
        for index in range(3 * len(markers)):
            shift = np.zeros(3 * len(markers))
            shift[index] = step
            shift = shift.reshape(-1, 3)
            plus = self.force(markers.ids, markers.p_SM + shift, rest)[0]
            minus = self.force(markers.ids, markers.p_SM - shift, rest)[0]
            columns.append((plus - minus) / (2 * step))
        return np.array(columns).T

    def force(self, ids: np.ndarray, p_SM: Array, rest: RestState) -> tuple[Array, float]:
        """Net contact force (3,) N on the membrane in S, and the gauge pressure, Pa."""
        fields = self.model.fields(self.model.fit(ids, p_SM))
        elastic, vector_area = self._terms(fields)
        gauge = self.pressure(self.gas_volume(fields), rest) - self.design.chamber.ambient
        return rest.stiffness_scale * elastic - gauge * vector_area - rest.offset, gauge

    def force_sd(self, markers: Markers, rest: RestState) -> Array:
        """Standard deviation (3,) N that the marker covariances imply."""
        J = rest.jacobian.reshape(3, -1, 3)
        seen = np.minimum(markers.ids, J.shape[1] - 1)
        return np.sqrt(np.einsum("fni,nij,fnj->f", J[:, seen], markers.cov_p, J[:, seen]))


class GridForce:
    """Contact force on each node of a Cartesian grid: the same weak form, tested with the grid's bilinear hats.

    The hats of the inner nodes sum to one away from the frame, so the nodal forces add up to the net force of a
    contact that does not reach the outermost ring of cells.
    """

    def __init__(self, estimator: MembraneForce, x: Array, y: Array):
        self._estimator, self.x, self.y = estimator, x, y
        model = estimator.model
        hx, sx = _hats(x, model.X[:, 0])
        hy, sy = _hats(y, model.X[:, 1])
        w = model.weights[:, None]
        self._hat, self._hat_1, self._hat_2 = (
            csr_matrix((w * (b[:, :, None] * a[:, None, :]).reshape(len(w), -1)).T)
            for a, b in ((hx, hy), (sx, hy), (hx, sy)))

    def forces(self, fields: Fields, gauge: float, rest: RestState) -> Array:
        """Nodal forces (ny, nx, 3) N of the outside on the membrane, S; zero on the frame's own nodes."""
        P = rest.stiffness_scale * self._estimator.model.first_piola(fields)
        nodal = self._hat_1 @ P[:, :, 0] + self._hat_2 @ P[:, :, 1] - gauge * (self._hat @ fields.normal_area)
        nodal = nodal.reshape(len(self.y), len(self.x), 3)
        nodal[[0, -1]] = 0.0
        nodal[:, [0, -1]] = 0.0
        return nodal


def _hats(knots: Array, at: Array) -> tuple[Array, Array]:
    """Values and slopes (len(at), len(knots)) of the piecewise linear hats on `knots`."""
    step = knots[1] - knots[0]
    distance = (at[:, None] - knots) / step
    inside = np.abs(distance) < 1
    return np.where(inside, 1 - np.abs(distance), 0.0), np.where(inside, -np.sign(distance) / step, 0.0)
