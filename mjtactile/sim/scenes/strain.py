"""Strain and pose of a soft object from its tetrahedra, for scoring alone.

MuJoCo's interpolated elements are linear in the stretch that remains after removal of a cell's
rotation (Biot's strain U - 1), from the singular values of the deformation gradient.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array

# Fraction of the volume that must exceed a reported stress. Values of single elements at cut
# corners of the lattice depend on the lattice. For a raspberry rotated about z, the energy of the
# worst hundredth varied sevenfold, that of the worst twentieth by a quarter.
_WORST = 0.05
_SAFE = 1e-3  # singular values of an element that is turned inside out


@dataclass(frozen=True)
class Strain:
    """Strain state of a soft object: von Mises `stress` Pa, `energy_density` J/m^3, `compression`.

    These are values exceeded in the worst twentieth of the volume. `energy` J is the total.
    """

    stress: float
    energy_density: float
    compression: float
    energy: float


class SoftSolid:
    """Volumetric flex number `flex` of a model, measured against the model's initial pose."""

    def __init__(self, model: mujoco.MjModel, flex: int, young: float, poisson: float):
        first = int(model.flex_vertadr[flex])
        count = int(model.flex_vertnum[flex])
        start = int(model.flex_elemdataadr[flex])
        element_count = int(model.flex_elemnum[flex])
        self._vertices = slice(first, first + count)
        self._elements = (
            model.flex_elem[start : start + 4 * element_count].reshape(-1, 4).astype(np.int64)
        )
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        self._rest = data.flexvert_xpos[self._vertices].copy()
        edges = _edges(self._rest, self._elements)
        self._inverse = np.linalg.inv(edges)
        self._volumes = np.abs(np.linalg.det(edges)) / 6
        self._mu = young / (2 * (1 + poisson))
        self._lame = young * poisson / ((1 + poisson) * (1 - 2 * poisson))
        weights = np.zeros(count)  # each corner represents a quarter of its elements
        np.add.at(weights, self._elements.ravel(), np.repeat(self._volumes / 4, 4))
        self._weights = weights / weights.sum()

    def strain(self, data: mujoco.MjData) -> Strain:
        """Return the strain at the start of the last step."""
        F = _edges(data.flexvert_xpos[self._vertices], self._elements) @ self._inverse
        squares = np.linalg.eigvalsh(F.transpose(0, 2, 1) @ F)
        stretches = np.sqrt(np.maximum(squares, _SAFE**2))  # shape (m, 3), ascending
        strain = stretches - 1
        trace = strain.sum(axis=1)
        energy = self._mu * (strain**2).sum(axis=1) + self._lame / 2 * trace**2
        biot = 2 * self._mu * strain + self._lame * trace[:, None]
        cauchy = biot * stretches / stretches.prod(axis=1, keepdims=True)
        mises = np.sqrt(((cauchy - np.roll(cauchy, 1, axis=1)) ** 2).sum(axis=1) / 2)
        return Strain(
            self._worst(mises),
            self._worst(energy),
            self._worst(-strain[:, 0]),
            float(energy @ self._volumes),
        )

    def pose(self, data: mujoco.MjData) -> tuple[Array, Array]:
        """Return the center of volume (3,) m, frame W, and the rotation (3, 3) since the start."""
        now = data.flexvert_xpos[self._vertices]
        center = self._weights @ now
        before = self._weights @ self._rest
        U, _, Vt = np.linalg.svd(
            (now - center).T @ (self._weights[:, None] * (self._rest - before))
        )
        signs = np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
        return center, U @ signs @ Vt

    @property
    def rest_center(self) -> Array:
        """Center of volume (3,) m at the initial pose, frame W."""
        return self._weights @ self._rest

    def _worst(self, values: Array) -> float:
        order = np.argsort(values)[::-1]
        beyond = np.cumsum(self._volumes[order])
        return float(values[order[np.searchsorted(beyond, _WORST * beyond[-1])]])


def soft_flex(model: mujoco.MjModel, prefix: str = "") -> int:
    """Return the index of the first volumetric flex with name prefix `prefix`; -1 without one."""
    names = [
        mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_FLEX, f) or "" for f in range(model.nflex)
    ]
    return next(
        (f for f, name in enumerate(names) if model.flex_dim[f] == 3 and name.startswith(prefix)),
        -1,
    )


def _edges(points: Array, elements: NDArray[np.int64]) -> Array:
    """Return the edges (m, 3, 3) from each element's first corner, as columns."""
    corners = points[elements]
    return (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
