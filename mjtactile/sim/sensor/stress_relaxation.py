"""Stress relaxation in MuJoCo's flex by the law of `mjtactile.core.relaxation`.

There is one state per term and triangle. The flex carries the instantaneous stress, (1 + sum a_i)
S. Its stiffness rows are those of the long-term rubber times a factor, and implicit in the step.
Forces on the vertices subtract the relaxed part, sum r_i. They change no faster than the terms do.
Between steps a term follows the mean of the stresses at both ends exactly,

    r_i <- e r_i + (1 - e) a_i (S_before + S) / 2,    e = exp(-h / tau_i),

which is stable for any step and any tau_i. Since 0 < e < 1, each r_i stays within the range of
previous stresses.
"""

from __future__ import annotations

import math

import numpy as np

from mjtactile.core.neo_hookean import shear_modulus
from mjtactile.core.relaxation import Relaxation
from mjtactile.core.sensor_parts import Membrane
from mjtactile.core.types import Array
from mjtactile.kernels import bound
from mjtactile.sim.sensor.mesh import MembraneMesh

_STILL = 1e-4
"""Tolerance for equilibrium: deviation of any term from its limit over the shear modulus."""


class RelaxingMesh:
    """Relaxation state of one membrane. It starts fully relaxed in the flat, mounted shape."""

    def __init__(self, mesh: MembraneMesh, sheet: Membrane, relaxation: Relaxation):
        count = len(mesh.triangles)
        self._relaxation = relaxation
        self._shares = relaxation.shares
        self._elapsed = np.nan
        self._kept = np.zeros(len(self._shares))
        self._shear = shear_modulus(sheet.young, sheet.poisson)
        self._p_SV = mesh.p_SV.copy()
        # long-term stress, then the relaxed part of each term: S_xx, S_yy, S_xy of each triangle
        self._memory = np.zeros((len(self._shares) + 1, 3, count))
        law = [
            self._shear,
            sheet.poisson,
            sheet.pre_stretch**2,
            relaxation.softening,
            relaxation.softening_energy,
        ]
        self._sheet = (
            count,
            np.ascontiguousarray(mesh.triangles),
            len(self._p_SV),
            self._p_SV,
            np.ascontiguousarray(mesh.inverse_edges),
            mesh.triangle_areas * sheet.thickness,
            np.array(law),
        )
        self._state = (
            len(self._shares),
            self._shares,
            self._kept,
            self._memory,
            np.zeros(count),
            np.empty(12 * count + 3 * len(self._p_SV)),
            len(mesh.interior),
            np.ascontiguousarray(mesh.interior, np.int64),
        )
        aside = np.zeros(3 * len(mesh.interior))
        self._remember = bound("rubber_remembers", *self._sheet, None, *self._state, None, aside)
        self._act = self._remember
        self.settle(mesh.p_SV)

    def carry(self, thin: Array, rows: Array, forces: Array) -> None:
        """Set the arrays that `update` reads and changes, permanently.

        `thin` (m,) is `Rubber.thin`, updated first. `rows` (m, 21) are the stiffness of the
        long-term rubber, replaced by the present one. Relaxed forces are added to `forces` (3 k,)
        N.
        """
        self._act = bound("rubber_remembers", *self._sheet, thin, *self._state, rows, forces)

    def settle(self, p_SV: Array) -> None:
        """Forget all but a shape (n, 3) m that has been there for ever."""
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
        off = self._memory[0] * self._shares[:, None, None] - self._memory[1:]
        return bool(np.abs(off).max(initial=0.0) < _STILL * self._shear)

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
