"""Tangent stiffness of a quasi-static membrane, and patches of sticking contact.

The membrane solution itself is frictionless. Nodes in contact move with their obstacle. All other
nodes go to equilibrium. No parameter is fitted (docs/theory/quasistatic_membrane.md, X7).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array
from mjtactile.kernels import band_stride, kernel
from mjtactile.quasistatic.solution import MembraneSolution

if TYPE_CHECKING:
    from mjtactile.quasistatic.membrane import QuasistaticMembrane


def compliance_of(membrane: QuasistaticMembrane, state: MembraneSolution) -> Array:
    """Return the in-plane compliance (2 inner, 2 inner), m/N, of a membrane with free heights."""
    band = stiffness_band(membrane, state)
    count = 2 * len(band) // 3
    workspace = np.empty(8 * len(band))
    compliance = np.empty((count, count))
    kernel("qs_compliance")(*membrane.grid, band, workspace.size, workspace, compliance)
    return compliance


def stiffness_band(membrane: QuasistaticMembrane, state: MembraneSolution) -> Array:
    """Return the Cholesky factor of the tangent stiffness, as in kernels/band_cholesky_f64.h."""
    columns, rows = membrane.grid
    band = np.empty((3 * (columns - 2) * (rows - 2), band_stride(3 * rows - 1)))
    given = (state.x, state.gauge_pressure, membrane._room.size, membrane._room)
    kernel("qs_stiffness")(membrane._constants, membrane._law, *membrane.grid, *given, band)
    return band


@dataclass(frozen=True, eq=False)
class StuckPatch:
    """Contact patch of one obstacle that sticks completely. SI units, frame S.

    `center` (2,) m is weighted with the forces. `stiffness` (3, 3) are derivatives of force along x
    and y, N, and torque about z, N m, by drag along x and y, m, and rotation, rad. `radius` m, the
    force-weighted mean distance from the center, is the lever arm of friction.
    """

    center: Array
    stiffness: Array
    force_normal: float
    radius: float


def patches_of(x: Array, y: Array, state: MembraneSolution, factor: Array) -> list[StuckPatch]:
    """Return every connected set of nodes in contact, largest force first.

    `factor` is that of `QuasistaticMembrane.stiffness_factor` for this state.
    """
    from scipy.ndimage import label  # takes a while to import

    marked: tuple[Array, int] = label(state.force > 0, np.ones((3, 3)))  # pyright: ignore[reportAssignmentType]
    numbered, count = marked
    found = []
    for number in range(1, count + 1):
        i, j = np.nonzero(numbered == number)
        positions = np.stack([x[i] + state.x[0, i, j], y[j] + state.x[1, i, j]], axis=1)
        inner = (i - 1) * (len(y) - 2) + j - 1
        found.append(_patch_of(positions, inner, state.force[i, j], factor))
    return sorted(found, key=lambda patch: -patch.force_normal)


def _patch_of(positions: Array, inner: NDArray[np.intp], force: Array, factor: Array) -> StuckPatch:
    """Compute the patch of nodes at `positions` (m, 2) m with indices `inner` (m,)."""
    from scipy.linalg import cho_solve_banded  # takes a while to import

    total = float(force.sum())
    center = force @ positions / total
    lever = positions - center
    rows = (3 * inner[:, None] + np.arange(3)).ravel()
    ones = np.zeros((factor.shape[1], len(rows)))
    ones[rows, np.arange(len(rows))] = 1.0
    compliance = cho_solve_banded((factor, True), ones)[rows]
    rigid = np.zeros((len(rows), 3))
    rigid[0::3, 0] = rigid[1::3, 1] = 1.0
    rigid[0::3, 2], rigid[1::3, 2] = -lever[:, 1], lever[:, 0]
    stiffness = rigid.T @ np.linalg.solve(compliance, rigid)
    radius = float(force @ np.hypot(lever[:, 0], lever[:, 1]) / total)
    return StuckPatch(center, (stiffness + stiffness.T) / 2, total, radius)
