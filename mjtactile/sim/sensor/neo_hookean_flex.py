"""Neo-Hookean rubber in MuJoCo's flex, which supports only the St. Venant-Kirchhoff law.

In plane stress, a neo-Hookean membrane has S = 2 mu' E + lambda' tr(E) I. This is the St.
Venant-Kirchhoff form, with moduli mu', lambda' that depend on the strain E
(docs/theory/membrane_inverse.md, Eq. F4). Every triangle gets its own moduli before every step, so
that its force follows the law without error. The implicit step uses the secant stiffness, which is
above rubber's tangent stiffness.
"""

from __future__ import annotations

import mujoco
import numpy as np

from mjtactile.core.neo_hookean import shear_modulus
from mjtactile.core.sensor_parts import Membrane
from mjtactile.core.types import Array
from mjtactile.kernels import bound
from mjtactile.sim.sensor.mesh import MembraneMesh

_ROW = 21
"""Number of values per triangle in `flex_stiffness`; six are the upper triangle of its matrix."""
_UPPER = np.triu_indices(3)
# lambda' in mu' and in the unstrained one: where tr E vanishes and E does not, it has no limit
_LEAST = -0.5
_MOST = 3.0


class EdgeMatrices:
    """A flex's triangles in MuJoCo's form: squared edge lengths in the order of `flex_elemedge`.

    `ends` (e, 2) are the vertices of each edge, `edges` (m, 3) the edges of each triangle. `metric`
    (m, 3, 3) maps squared lengths to C_xx, C_yy, C_xy of the *mounted* membrane.
    """

    def __init__(self, model: mujoco.MjModel, flex_id: int, mesh: MembraneMesh):
        start = int(model.flex_edgeadr[flex_id])
        count = int(model.flex_edgenum[flex_id])
        self.ends = np.asarray(model.flex_edge)[start : start + count].copy()
        first = int(model.flex_elemedgeadr[flex_id])
        count = 3 * int(model.flex_elemnum[flex_id])
        self.edges = np.asarray(model.flex_elemedge)[first : first + count].reshape(-1, 3).copy()
        x, y = np.moveaxis(
            (mesh.p_SV[self.ends[:, 1]] - mesh.p_SV[self.ends[:, 0]])[self.edges], -1, 0
        )[:2]
        self.metric = np.linalg.inv(np.stack([x * x, y * y, 2 * x * y], axis=-1))


def stiffness_rows(model: mujoco.MjModel, flex_id: int) -> Array:
    """Return a live view (m, 6) of the upper triangle of each element's matrix.

    It maps the increase of squared edge lengths (3,) to force over length of the edges, N/m.
    """
    return all_rows(model, flex_id)[:, :6]


def all_rows(model: mujoco.MjModel, flex_id: int) -> Array:
    """A live view (m, 21) of all that the flex keeps of a triangle."""
    start = int(model.flex_stiffnessadr[flex_id])
    count = int(model.flex_elemnum[flex_id])
    return np.asarray(model.flex_stiffness)[start : start + _ROW * count].reshape(count, _ROW)


class Rubber:
    """Keeps one flex's triangles at the moduli of their strain."""

    def __init__(self, model: mujoco.MjModel, flex_id: int, mesh: MembraneMesh, sheet: Membrane):
        elements = EdgeMatrices(model, flex_id, mesh)
        mu = shear_modulus(sheet.young, sheet.poisson)
        unstrained = 2 * mu * sheet.poisson / (1 - sheet.poisson)  # lambda' of no strain
        # E = (C - I)/2; the membrane's energy is that of its free volume, but MuJoCo's strain is
        # 1/l^2 of E (see add_membrane).
        volume = mesh.triangle_areas * sheet.thickness * sheet.pre_stretch**2 / 2
        trace = elements.metric[:, 0] + elements.metric[:, 1]
        shear = elements.metric.transpose(0, 2, 1) @ np.diag([2.0, 2.0, 4.0]) @ elements.metric
        by_lambda, by_mu = (
            np.ascontiguousarray(volume[:, None] * full[:, _UPPER[0], _UPPER[1]])
            for full in (trace[:, :, None] * trace[:, None, :], shear)
        )
        self._p_SV = mesh.p_SV.copy()
        edges = elements.edges.astype(np.int64)
        ends = elements.ends.astype(np.int64)
        self.thin = np.ones(len(edges))
        """Square of the thickness's stretch over that of the area, (m,), at the last update."""
        self._write = bound(
            "rubber_stiffness",
            len(edges),
            edges,
            len(ends),
            ends,
            len(self._p_SV),
            self._p_SV,
            # conversion of squared lengths to C relative to the free membrane
            elements.metric * sheet.pre_stretch**2,
            np.array([mu, sheet.poisson, unstrained, _LEAST, _MOST]),
            by_mu,
            by_lambda,
            self.thin,
            all_rows(model, flex_id),
        )

    def update(self, p_SV: Array) -> None:
        """Write the secant stiffness for the strain of the vertices `p_SV` (n, 3) m, before every
        step."""
        self._p_SV[:] = p_SV
        self._write()
