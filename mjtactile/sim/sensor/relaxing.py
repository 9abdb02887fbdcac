"""Rubber that relaxes, in MuJoCo's flex: what `mjtactile.core.relaxation` says, one state a term
and triangle.

The flex carries the quick stress, (1 + sum a_i) S: its stiffness rows are those of the lasting
rubber times a factor, and implicit in the step. What has faded, sum r_i, is taken away by forces on
the vertices, which change no faster than the terms do. Between steps a term follows the mean of the
stresses at both ends exactly,

    r_i <- e r_i + (1 - e) a_i (S_before + S) / 2,    e = exp(-h / tau_i),

which neither grows for any step nor any tau_i, since 0 < e < 1 and each r_i stays between the
stresses that it has seen.
"""

from __future__ import annotations

import numpy as np

from mjtactile.core.relaxation import Relaxation
from mjtactile.core.rubber import shear_modulus
from mjtactile.core.sensor_parts import Membrane
from mjtactile.core.types import Array
from mjtactile.kernels import bound
from mjtactile.sim.sensor.mesh import MembraneMesh

_STILL = 1e-4
"""Share of the shear modulus by which any term is off its end below which a sheet counts as at
rest: 0.6 um of a bulge of 3 mm."""


class Relaxing:
    """What one sheet remembers. It begins as one that has been mounted, flat, for ever."""

    def __init__(self, mesh: MembraneMesh, sheet: Membrane, relaxation: Relaxation):
        self._relaxation = relaxation
        self._shares = relaxation.shares
        self._kept = np.zeros(len(self._shares))
        self._shear = shear_modulus(sheet.young, sheet.poisson)
        self._interior = mesh.interior
        self._p_SV = mesh.p_SV.copy()
        self._memory = np.zeros((len(mesh.triangles), len(self._shares) + 1, 3))
        self._scale = np.empty(len(mesh.triangles))
        self._forces = np.empty_like(self._p_SV)
        self._remember = bound(
            "rubber_remembers",
            len(mesh.triangles),
            np.ascontiguousarray(mesh.triangles),
            len(self._p_SV),
            self._p_SV,
            np.ascontiguousarray(mesh.inverse_edges),
            mesh.triangle_areas * sheet.thickness,
            np.array(
                [
                    self._shear,
                    sheet.poisson,
                    sheet.pre_stretch**2,
                    relaxation.softening,
                    relaxation.softening_energy,
                ]
            ),
            len(self._shares),
            self._shares,
            self._kept,
            self._memory,
            np.zeros(len(mesh.triangles)),
            self._scale,
            self._forces,
        )
        self.settle(mesh.p_SV)

    def settle(self, p_SV: Array) -> None:
        """Forget all but a shape (n, 3) m that has been there for ever."""
        for _ in range(2):  # the first tells the stress, the second what it has faded by
            self._advance(p_SV, np.inf)

    def update(self, p_SV: Array, elapsed: float, rows: Array, forces: Array) -> None:
        """Follow the sheet to `p_SV` (n, 3) m, `elapsed` s later; before every step.

        Args:
            p_SV: The vertices, m in S.
            elapsed: Since the last call, s.
            rows: The lasting rubber's stiffness (m, 6), which becomes the present one's.
            forces: Generalised forces (3 k,) N of the interior vertices, to which those are added
                that take the faded stress away.
        """
        self._advance(p_SV, elapsed)
        rows *= self._scale[:, None]
        forces += self._forces[self._interior].ravel()

    @property
    def is_still(self) -> bool:
        """Whether all terms have come to their ends."""
        stress = self._memory[:, :1]
        off = stress * self._shares[:, None] - self._memory[:, 1:]
        return bool(np.abs(off).max(initial=0.0) < _STILL * self._shear)

    def _advance(self, p_SV: Array, elapsed: float) -> None:
        self._p_SV[:] = p_SV
        self._kept[:] = self._relaxation.kept(elapsed)
        self._remember()
