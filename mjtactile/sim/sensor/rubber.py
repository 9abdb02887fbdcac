"""Neo-Hookean rubber in MuJoCo's flex, which knows no law but St. Venant-Kirchhoff's.

In a plane, a neo-Hookean sheet's stress is S = 2 mu' E + lambda' tr(E) I, St. Venant-Kirchhoff's form, with moduli mu', lambda'
that depend on the strain E (docs/equations.md, Eq. F4). Every triangle gets its own before every step: its force is then the
law's, without error, and the stiffness that the step is implicit in is the secant, which rubber's tangent stays below.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from mjtactile.core.design import Membrane
from mjtactile.core.rubber import shear_modulus, thickness_over_area
from mjtactile.core.types import Array
from mjtactile.sim.sensor.mesh import MembraneMesh

_ROW = 21
"""Numbers of a triangle in `flex_stiffness`; the first six are its matrix's upper triangle, row by row."""
_UPPER = np.triu_indices(3)
_FLATTEST = 1e-2  # least det C: a triangle that collapses keeps a finite stress
_UNSTRAINED = 1e-6  # of tr E: below, the moduli are those of no strain
_LEAST, _MOST = -0.5, 3.0  # lambda' in mu' and in the unstrained one: where tr E vanishes and E does not, it has no limit


class EdgeMatrices:
    """A flex's triangles as MuJoCo sees them: by the squared lengths of their edges, in `flex_elemedge`'s order.

    `ends` (e, 2) vertices of each edge, `edges` (m, 3) those of each triangle, `metric` (m, 3, 3): squared lengths to C_xx,
    C_yy, C_xy of the *mounted* sheet.
    """

    def __init__(self, model: mujoco.MjModel, flex_id: int, mesh: MembraneMesh):
        start, count = int(model.flex_edgeadr[flex_id]), int(model.flex_edgenum[flex_id])
        self.ends = np.asarray(model.flex_edge)[start:start + count].copy()
        first, count = int(model.flex_elemedgeadr[flex_id]), 3 * int(model.flex_elemnum[flex_id])
        self.edges = np.asarray(model.flex_elemedge)[first:first + count].reshape(-1, 3).copy()
        x, y = np.moveaxis((mesh.p_SV[self.ends[:, 1]] - mesh.p_SV[self.ends[:, 0]])[self.edges], -1, 0)[:2]
        self.metric = np.linalg.inv(np.stack([x * x, y * y, 2 * x * y], axis=-1))


def _differences(ends: NDArray[np.int32], count: int) -> csr_matrix:
    """Matrix (e, n) from `count` vertices to the edges between `ends` (e, 2)."""
    rows = np.arange(len(ends))
    return csr_matrix((np.repeat([-1.0, 1.0], len(ends)), (np.tile(rows, 2), ends.T.ravel())), shape=(len(ends), count))


def stiffness_rows(model: mujoco.MjModel, flex_id: int) -> Array:
    """A live view (m, 6) of the flex's stiffness: what (m, 3) squared edge lengths beyond the free ones turn into force over
    length of the edges, N/m."""
    start, count = int(model.flex_stiffnessadr[flex_id]), int(model.flex_elemnum[flex_id])
    return np.asarray(model.flex_stiffness)[start:start + _ROW * count].reshape(count, _ROW)[:, :6]


class Rubber:
    """Keeps one flex's triangles at the moduli of their strain."""

    def __init__(self, model: mujoco.MjModel, flex_id: int, mesh: MembraneMesh, sheet: Membrane):
        self._elements, self._rows = EdgeMatrices(model, flex_id, mesh), stiffness_rows(model, flex_id)
        self._poisson, self._mu = sheet.poisson, shear_modulus(sheet.young, sheet.poisson)
        self._first = 2 * self._mu * sheet.poisson / (1 - sheet.poisson)  # lambda' of no strain
        metric, edges = self._elements.metric, self._elements.edges
        self._along = _differences(self._elements.ends, len(mesh.p_SV))
        # C_xx of all triangles, then C_yy, C_xy, from the squared lengths of all edges
        rows = np.repeat(np.arange(3 * len(edges)), 3)
        self._metric = csr_matrix(((metric * sheet.pre_stretch**2).transpose(1, 0, 2).ravel(), (rows, np.tile(edges.ravel(), 3))),
                                  shape=(3 * len(edges), len(self._elements.ends)))
        # E = (C - I)/2; the sheet's energy is that of its free volume, but MuJoCo's strain is 1/l^2 of E (see add_membrane).
        volume = mesh.triangle_areas * sheet.thickness * sheet.pre_stretch**2 / 2
        trace = metric[:, 0] + metric[:, 1]
        shear = metric.transpose(0, 2, 1) @ np.diag([2.0, 2.0, 4.0]) @ metric
        self._by_lambda, self._by_mu = (
            (volume[:, None] * full[:, _UPPER[0], _UPPER[1]]).T.copy()
            for full in (trace[:, :, None] * trace[:, None, :], shear))

    def update(self, p_SV: Array) -> None:
        """Write the stiffness of the strain that the vertices at `p_SV` (n, 3) m mean; call before every step."""
        mu, first = self.moduli(p_SV)
        self._rows[:] = (mu * self._by_mu + first * self._by_lambda).T

    def moduli(self, p_SV: Array) -> tuple[Array, Array]:
        """Secant moduli mu', lambda' (m,) Pa of the triangles."""
        along = self._along @ p_SV
        along *= along
        xx, yy, xy = (self._metric @ (along[:, 0] + along[:, 1] + along[:, 2])).reshape(3, -1)
        trace = (xx + yy) / 2 - 1
        ratio = thickness_over_area(np.log(np.maximum(xx * yy - xy * xy, _FLATTEST)), self._poisson)
        mu = self._mu * ratio
        unstrained = np.abs(trace) < _UNSTRAINED
        trace[unstrained] = 1.0
        first = (self._mu - mu * (1 + 2 * trace)) / trace
        np.minimum(np.maximum(first, _LEAST * mu, out=first), _MOST * self._first, out=first)
        first[unstrained] = self._first
        return mu, first
