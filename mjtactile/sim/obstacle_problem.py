"""Shape of a stretched membrane on an obstacle under pressure.

It is finer than the simulation mesh. The model membrane has the uniform tension T estimated near
the contact. It has the gas pressure p and a height w over the frame:

    div(grad w / sqrt(1 + |grad w|^2)) = (q - p) / T,
    w <= obstacle,   q >= 0,   q = 0 where it does not touch.

It leaves smooth objects without a kink and edges with one. The depth of the obstacle follows from
the force. The model carries the same force as the simulated membrane. The solution uses five-point
differences and active sets (Hintermueller, Ito, Kunisch 2003).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from mjtactile.core.types import Array

_ROUNDS = 60
_FREE_ROUNDS = 4
_TINY = 1e-9  # tolerance: relative, of a cell's pressure; of heights, m


@dataclass(frozen=True, eq=False)
class ObstacleContact:
    """Solution: heights `w` (nx, ny) m on `obstacle` (nx, ny) m, contact fraction `fraction` and
    `force` N of each cell of `spacing` m.

    `settled` is True if the active set converged.
    """

    w: Array
    obstacle: Array
    fraction: Array
    force: Array
    spacing: float
    settled: bool

    @property
    def area(self) -> float:
        """Area of the membrane in contact, m^2. Its slopes are at most those of the obstacle."""
        squares = [
            np.minimum(np.abs(slope), _steepest(self.obstacle, self.spacing, axis)) ** 2
            for axis, slope in enumerate(np.gradient(self.w, self.spacing))
        ]
        return float((self.fraction * np.sqrt(1 + squares[0] + squares[1])).sum()) * self.spacing**2


def _steepest(obstacle: Array, spacing: float, axis: int) -> Array:
    """Return the larger slope (nx, ny) between a node and its neighbors along `axis`; 0 without any
    on the obstacle."""
    solid = np.isfinite(obstacle)
    heights = np.where(solid, obstacle, 0.0)
    both = np.logical_and(*_pairs(solid, axis))
    slopes = np.where(both, np.abs(np.diff(heights, axis=axis)) / spacing, 0.0)
    edge = np.zeros_like(heights.take([0], axis=axis))
    return np.maximum(*_pairs(np.concatenate([edge, slopes, edge], axis=axis), axis))


def _pairs(field: NDArray[Any], axis: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return each node's value and that of its successor along `axis`, without the last node."""
    along = np.moveaxis(field, axis, 0)
    return np.moveaxis(along[:-1], 0, axis), np.moveaxis(along[1:], 0, axis)


def solve_contact(
    obstacle: Array,
    inside: NDArray[np.bool_],
    spacing: float,
    *,
    pressure: float,
    tension: float,
    force: float,
) -> ObstacleContact:
    """Solve for the membrane that carries `force` N on `obstacle` (nx, ny) m, defined up to a
    shift.

    The obstacle is inf where there is none. `inside` (nx, ny) are the free nodes.
    """
    psi = obstacle[inside]
    load = np.full(int(inside.sum()), pressure * spacing**2 / tension)
    here = np.isfinite(psi)
    w = np.zeros(len(psi))
    q = np.zeros(len(psi))
    for _ in range(_FREE_ROUNDS):  # without the obstacle, to find where it touches first
        w = splu(_stiffness(inside, w, spacing)).solve(load)
    gap = np.where(here, psi - w, np.inf)
    first = int(np.clip(force / (2 * max(pressure, 1.0) * spacing**2), 1, here.sum()))
    touching = gap <= np.partition(gap, first - 1)[first - 1]
    settled = False
    for _ in range(_ROUNDS):
        stiffness = _stiffness(inside, w, spacing)
        w, shift = _carry(stiffness, np.where(here, psi, 0.0), touching, load, force / tension)
        q = np.where(touching, load - stiffness @ w, 0.0)
        before = touching
        touching = here & np.where(touching, q > -_TINY * load, w > psi + shift + _TINY)
        settled = bool((touching == before).all())
        if settled:
            break
    # it ran
    fraction = np.where(q > 0, _fraction(stiffness, psi, q, load), 0.0)  # pyright: ignore[reportPossiblyUnboundVariable]
    fields = np.zeros((3, *inside.shape))
    fields[:, inside] = w, fraction, tension * q
    return ObstacleContact(fields[0], obstacle, fields[1], fields[2], spacing, settled)


def _carry(
    stiffness: csc_array, psi: Array, touching: NDArray[np.bool_], load: Array, force: float
) -> tuple[Array, float]:
    """Return the heights of the membrane, which lies on `psi` + shift where `touching`, and the
    shift.

    With this shift the contact carries `force` (N over N/m).
    """
    free = ~touching
    solve = splu(stiffness[free][:, free]).solve
    onto = stiffness[free][:, touching]
    parts = np.zeros((2, len(psi)))
    parts[0, touching] = psi[touching]
    parts[1, touching] = 1.0
    parts[0, free] = solve(load[free] - onto @ psi[touching])
    parts[1, free] = solve(-(onto @ np.ones(int(touching.sum()))))
    at_none = load[touching].sum() - (stiffness @ parts[0])[touching].sum()
    per_shift = -(stiffness @ parts[1])[touching].sum()
    shift = float((force - at_none) / per_shift)
    return parts[0] + shift * parts[1], shift


def _fraction(stiffness: csc_array, psi: Array, q: Array, load: Array) -> Array:
    """Return the contact fraction of each cell: its force over that with full contact."""
    here = np.isfinite(psi)
    total = load - stiffness @ np.where(here, psi, 0.0)
    at_edge = (abs(stiffness) @ (~here).astype(float)) > 0
    return np.where(
        at_edge | (total <= 0), 1.0, np.clip(q / np.where(total > 0, total, 1.0), 0.0, 1.0)
    )


def _stiffness(inside: NDArray[np.bool_], w: Array, spacing: float) -> csc_array:
    """Return the matrix of -div(k grad) over the free nodes, times spacing^2 (k of the
    docstring)."""
    height = np.zeros(inside.shape)
    index = np.full(inside.shape, -1)
    height[inside] = w
    index[inside] = np.arange(len(w))
    slopes = np.gradient(height, spacing)
    k = 1 / np.sqrt(1 + slopes[0] ** 2 + slopes[1] ** 2)
    rows = []
    columns = []
    values = []
    for a, b in ((np.s_[:-1, :], np.s_[1:, :]), (np.s_[:, :-1], np.s_[:, 1:])):
        i = index[a].ravel()
        j = index[b].ravel()
        between = ((k[a] + k[b]) / 2).ravel()
        for one, other in ((i, j), (j, i)):
            mine = one >= 0
            both = (one >= 0) & (other >= 0)
            rows += [one[mine], one[both]]
            columns += [one[mine], other[both]]
            values += [between[mine], -between[both]]
    return csc_array(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))),
        shape=(len(w), len(w)),
    )
