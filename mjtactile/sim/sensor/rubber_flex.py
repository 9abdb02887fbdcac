"""Neo-Hookean rubber and its stress relaxation in MuJoCo's St. Venant-Kirchhoff flex.

In plane stress, a neo-Hookean membrane has S = 2 mu' E + lambda' tr(E) I. This is the St.
Venant-Kirchhoff form, with moduli that depend on the strain E (docs/theory/membrane_inverse.md, Eq.
F4). Every triangle gets its own moduli before every step. The implicit step uses the secant
stiffness, which is above rubber's tangent stiffness. Relaxation (`mjtactile.core.relaxation`) has
one state per term and triangle. The flex carries the instantaneous stress, (1 + sum a_i) S. Forces
on the vertices subtract the relaxed part, sum r_i. Between steps a term follows the mean of the
stresses at both ends exactly,

    r_i <- e r_i + (1 - e) a_i (S_before + S) / 2,    e = exp(-h / tau_i),

which is stable for any step and any tau_i.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from mjtactile.core.neo_hookean import shear_modulus
from mjtactile.core.relaxation import Relaxation
from mjtactile.core.sensor_parts import Membrane
from mjtactile.core.types import Array
from mjtactile.kernels import bound
from mjtactile.sim.sensor.mesh import MembraneMesh

_ROW = 21
"""Number of values per triangle in `flex_stiffness`. Six are the upper triangle of its matrix."""
_UPPER = np.triu_indices(3)
# lambda' in mu' and in the unstrained one: where tr E vanishes and E does not, it has no limit
_MIN_LAMBDA = -0.5
_MAX_LAMBDA = 3.0


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
    """Return a live view (m, 21) of all stored parameters of each triangle."""
    start = int(model.flex_stiffnessadr[flex_id])
    count = int(model.flex_elemnum[flex_id])
    return np.asarray(model.flex_stiffness)[start : start + _ROW * count].reshape(count, _ROW)


class Rubber:
    """Keeps one flex's triangles at the moduli of their strain."""

    def __init__(self, model: mujoco.MjModel, flex_id: int, mesh: MembraneMesh, membrane: Membrane):
        elements = EdgeMatrices(model, flex_id, mesh)
        mu = shear_modulus(membrane.young, membrane.poisson)
        unstrained = 2 * mu * membrane.poisson / (1 - membrane.poisson)  # lambda' of no strain
        # E = (C - I)/2; the membrane's energy is that of its free volume, but MuJoCo's strain is
        # 1/l^2 of E (see add_membrane).
        volume = mesh.triangle_areas * membrane.thickness * membrane.pre_stretch**2 / 2
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
        # conversion of squared lengths to C relative to the free membrane
        metric = elements.metric * membrane.pre_stretch**2
        law = np.array([mu, membrane.poisson, unstrained, _MIN_LAMBDA, _MAX_LAMBDA])
        arrays = (len(edges), edges, len(ends), ends, len(self._p_SV), self._p_SV)
        factors = (metric, law, by_mu, by_lambda)
        rows = all_rows(model, flex_id)
        self._write = bound("rubber_stiffness", *arrays, *factors, self.thin, rows)

    def update(self, p_SV: Array) -> None:
        """Write the secant stiffness for the strain of the vertices `p_SV` (n, 3) m, before every
        step."""
        self._p_SV[:] = p_SV
        self._write()


_STILL = 1e-4
"""Tolerance for equilibrium: deviation of any term from its limit over the shear modulus."""


class RelaxingMesh:
    """Relaxation state of one membrane. It starts fully relaxed in the flat, mounted shape."""

    def __init__(self, mesh: MembraneMesh, membrane: Membrane, relaxation: Relaxation):
        count = len(mesh.triangles)
        self._relaxation = relaxation
        self._fractions = relaxation.fractions
        self._elapsed = np.nan
        self._kept = np.zeros(len(self._fractions))
        self._shear = shear_modulus(membrane.young, membrane.poisson)
        self._p_SV = mesh.p_SV.copy()
        # long-term stress, then the relaxed part of each term: S_xx, S_yy, S_xy of each triangle
        self._memory = np.zeros((len(self._fractions) + 1, 3, count))
        softening = (relaxation.softening, relaxation.softening_energy)
        law = np.array([self._shear, membrane.poisson, membrane.pre_stretch**2, *softening])
        vertices = (len(self._p_SV), self._p_SV)
        flat = (np.ascontiguousarray(mesh.inverse_edges), mesh.triangle_areas * membrane.thickness)
        self._membrane = (count, np.ascontiguousarray(mesh.triangles), *vertices, *flat, law)
        terms = (len(self._fractions), self._fractions, self._kept, self._memory)
        workspace = (np.zeros(count), np.empty(12 * count + 3 * len(self._p_SV)))
        interior = np.ascontiguousarray(mesh.interior, np.int64)
        self._state = (*terms, *workspace, len(interior), interior)
        unused = np.zeros(3 * len(interior))
        self._remember = bound(
            "viscoelastic_forces", *self._membrane, None, *self._state, None, unused
        )
        self._act = self._remember
        self.settle(mesh.p_SV)

    def carry(self, thin: Array, rows: Array, forces: Array) -> None:
        """Set the arrays that `update` reads and changes, permanently.

        `thin` (m,) is `Rubber.thin`, updated first. `rows` (m, 21) are the stiffness of the
        long-term rubber, replaced by the present one. Relaxed forces are added to `forces` (3 k,)
        N.
        """
        self._act = bound("viscoelastic_forces", *self._membrane, thin, *self._state, rows, forces)

    def settle(self, p_SV: Array) -> None:
        """Relax the rubber completely in the shape `p_SV` (n, 3), m."""
        for _ in range(2):  # the first pass sets the stress, the second its relaxed part
            self._advance(p_SV, np.inf)

    def update(self, p_SV: Array, elapsed: float) -> None:
        """Advance the relaxation to `p_SV` (n, 3) m, `elapsed` s later, after the long-term
        rubber."""
        self._come_to(p_SV, elapsed)
        self._act()

    @property
    def is_still(self) -> bool:
        """True if all terms have reached their limits."""
        remaining = self._memory[0] * self._fractions[:, None, None] - self._memory[1:]
        return bool(np.abs(remaining).max(initial=0.0) < _STILL * self._shear)

    def _advance(self, p_SV: Array, elapsed: float) -> None:
        """Update the state only, without writing stiffness or forces."""
        self._come_to(p_SV, elapsed)
        self._remember()

    def _come_to(self, p_SV: Array, elapsed: float) -> None:
        self._p_SV[:] = p_SV
        # steps are alike but for the rounding of the clock
        if not math.isclose(elapsed, self._elapsed, rel_tol=1e-9):
            self._elapsed = elapsed
            self._kept[:] = self._relaxation.kept(elapsed)
