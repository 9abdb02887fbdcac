"""Membrane deformation x(X) from marker positions, and its elastic statics in weak form.

Markers are material points. Identified markers therefore give the deformation itself, not only a
surface. It is a tensor-product cubic B-spline u(X) = x - X over the mounted flat membrane (material
coordinates X, frame S), with u = 0 on the frame. The operators depend on the layout alone and are
computed once for each sensor. A camera frame then costs one small solve and one matrix product.
Elasticity is the membrane's law in plane stress with the pre-stretch, as in the sensor file
(docs/theory/membrane_inverse.md, Eq. F3-F6).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from mjtactile.core import geometry
from mjtactile.core.bspline import Cubic
from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array
from mjtactile.sensing.constitutive_law import ConstitutiveLaw

# nodes in each interval of the spline: integrands vary over markers, several intervals wide
_GAUSS = 2


@dataclass(frozen=True, eq=False)
class Fields:
    """The deformation at Q quadrature points: positions `x` (Q, 3) and gradient `F` (Q, 3, 2) =
    dx/dX, frame S."""

    x: Array
    F: Array

    @property
    def normal_area(self) -> Array:
        """Outward normal times area ratio, x_,1 cross x_,2, (Q, 3)."""
        return geometry.cross(self.F[:, :, 0], self.F[:, :, 1])


class MembraneModel:
    """Precomputed operators of a membrane: from marker positions to deformation, strain and
    weak-form forces.

    `material` (N, 2) are the markers' positions on the flat membrane, m in S (the design's layout
    unless measured). The displacement is the smoothest field (minimum integral of squared second
    derivatives) that fits the markers within their noise. It is a smoothing spline in kernel form,
    u(X) = sum_i g(X, X_i) alpha_i. One product with a fixed matrix gives all fields, and missing
    markers drop out (Eq. F3). `smoothing` is the squared ratio of marker noise to bending
    amplitude. Below 1e-3 it has no effect on the force.
    """

    def __init__(
        self,
        design: SensorDesign,
        material: Array | None = None,
        *,
        spans: int = 16,
        smoothing: float = 1e-4,
    ):
        self.design = design
        self.material = np.asarray(
            design.markers.p_SM[:, :2] if material is None else material, float
        )
        self._law = ConstitutiveLaw(design.membrane)
        frame = design.frame
        ax, ay = self._axes = (
            Cubic(frame.length, spans, _GAUSS),
            Cubic(frame.width, spans, _GAUSS),
        )
        self.X = np.column_stack(
            [g.ravel() for g in np.meshgrid(ax.points, ay.points, indexing="ij")]
        )
        self.weights = np.outer(ax.weights, ay.weights).ravel()
        self._kernel = np.linalg.solve(self._bending(), self.basis(self.material).T)  # (K, N)
        self._gram = self.basis(self.material) @ self._kernel
        self._gram[np.diag_indices_from(self._gram)] += smoothing
        value = [a.at(a.points) for a in (ax, ay)]
        slope = [a.at(a.points, 1) for a in (ax, ay)]
        self._operator = np.concatenate(
            [
                np.kron(value[0], value[1]) @ self._kernel,
                np.kron(slope[0], value[1]) @ self._kernel,
                np.kron(value[0], slope[1]) @ self._kernel,
            ]
        )  # (3 Q, N)

    @property
    def knots(self) -> tuple[Array, Array]:
        """Grid lines x, y (m) between which the spline is one polynomial."""
        ax, ay = self._axes
        return ax.breaks, ay.breaks

    def basis(self, X: Array) -> Array:
        """Evaluate the spline basis (N, K) at material points X (N, 2)."""
        a, b = (axis.at(x) for axis, x in zip(self._axes, X.T, strict=True))
        return (a[:, :, None] * b[:, None, :]).reshape(len(X), -1)

    def _bending(self) -> Array:
        """Return the integral of u,11^2 + 2 u,12^2 + u,22^2 as a quadratic form (K, K).

        It is scaled by the area per marker.
        """
        ax, ay = self._axes
        gram = [
            [(a.at(a.points, d).T * a.weights) @ a.at(a.points, d) for d in range(3)]
            for a in (ax, ay)
        ]
        form = (
            np.kron(gram[0][2], gram[1][0])
            + 2 * np.kron(gram[0][1], gram[1][1])
            + np.kron(gram[0][0], gram[1][2])
        )
        return form * self.design.markers.pitch_x * self.design.markers.pitch_y

    def fit(self, ids: NDArray[np.int64], p_SM: Array) -> Array:
        """Fit kernel weights alpha (N, 3) to identified markers at `p_SM` (n, 3), m in S.

        The weights of missing markers are zero.
        """
        displacement = p_SM.copy()
        displacement[:, :2] -= self.material[ids]
        alpha = np.zeros((len(self.material), 3))
        alpha[ids] = cho_solve(cho_factor(self._gram[np.ix_(ids, ids)]), displacement)
        return alpha

    def fields(self, alpha: Array) -> Fields:
        """Return positions and deformation gradients at the quadrature points."""
        x, along_1, along_2 = (self._operator @ alpha).reshape(3, -1, 3)
        x[:, :2] += self.X
        F = np.stack([along_1, along_2], axis=2)
        F[:, 0, 0] += 1
        F[:, 1, 1] += 1
        return Fields(x, F)

    def displacement(self, alpha: Array, X: Array) -> Array:
        """Return the displacement (n, 3), m, of material points X (n, 2)."""
        return self.basis(X) @ (self._kernel @ alpha)

    def first_piola(self, fields: Fields) -> Array:
        """Compute the membrane force per mounted length P = h F S, (Q, 3, 2), N/m.

        Plane stress with pre-stretch. With F0 = lambda I from the free to the mounted membrane, C =
        lambda^2 F^T F; S by the membrane's law, per mounted length and free thickness (Eq. F4).
        """
        C = self.design.membrane.pre_stretch**2 * np.einsum("qia,qib->abq", fields.F, fields.F)
        S11, S22, S12 = self._law.stress(C[0, 0], C[1, 1], C[0, 1])
        S = np.stack([np.stack([S11, S12], axis=-1), np.stack([S12, S22], axis=-1)], axis=-2)
        return np.einsum("qia,qab->qib", fields.F, S)

    def area(self, fields: Fields) -> float:
        """Return the area of the deformed membrane, m^2."""
        return float(self.weights @ np.linalg.norm(fields.normal_area, axis=1))

    def volume(self, fields: Fields) -> float:
        """Return the signed volume between the membrane and the frame's plane, m^3.

        It is the integral of z N_z (divergence theorem).
        """
        return float(self.weights @ (fields.x[:, 2] * fields.normal_area[:, 2]))

    def plateau(self, taper: float) -> tuple[Array, Array]:
        """Return the test function phi (Q,) and its gradient (Q, 2).

        phi is 1 away from the frame and falls to 0 over `taper` m.
        """
        values = []
        slopes = []
        for axis, coordinate in zip(self._axes, self.X.T, strict=True):
            length_of_taper = min(taper, axis.length / 3)
            s = np.clip((axis.length / 2 - np.abs(coordinate)) / length_of_taper, 0, 1)
            values.append(s * s * (3 - 2 * s))
            slopes.append(-np.sign(coordinate) * 6 * s * (1 - s) / length_of_taper)
        phi = values[0] * values[1]
        return phi, np.column_stack([slopes[0] * values[1], values[0] * slopes[1]])
