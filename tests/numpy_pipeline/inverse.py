"""The traction estimator by dense matrices: sensing/force/inverse_fem.py in numpy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, solve_triangular

from mjtactile.core.bspline import hats
from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array, Markers
from mjtactile.sensing.force.camera_drift_model import CameraDriftFilter, camera_modes, drift_of
from mjtactile.sensing.force.inverse_fem import STEP_LIMIT, InverseMembrane
from mjtactile.sensing.force.linearization import NEAR, PlaneContact, Shape
from mjtactile.sensing.force.prior import LoadPrior
from mjtactile.sensing.force.rest_equilibrium import InverseRest
from tests.numpy_pipeline.spline_membrane import SplineMembrane, State


@dataclass(frozen=True, eq=False)
class _Gain:
    """Dense version of the gain in sensing/force, with the markers' motion (r, 3 n) and their
    response (r, 3 J)."""

    c: Array
    ids: NDArray[np.int64]
    stiffness: tuple[Array, bool]
    moved: Array
    response: Array
    half: Array
    weights: Array
    slope_weights: Array
    distrust: Array
    drift: Array
    drift_gas: tuple[float, Array]
    observed_drift: Array
    prior: Array
    innovation: Array
    reweighted: int
    modes: Array
    gas: tuple[tuple[bool, bool], float]
    mean: PlaneContact | None = None

    def serves(
        self,
        c: Array,
        markers: Markers,
        rest: InverseRest,
        camera: CameraDriftFilter,
        lost: bool,
        correlation: float,
        mean: PlaneContact | None = None,
    ) -> bool:
        """Return True if the gain is valid near `c` for these markers."""
        return np.array_equal(self.ids, markers.ids) and bool(np.abs(c - self.c).max() < NEAR)


class DenseInverse(InverseMembrane):
    """Dense version of its base class; it takes only the basis from the base's `SplineMembrane`."""

    def __init__(self, design: SensorDesign):
        super().__init__(design)
        self._dense = SplineMembrane(design, self.settings.spans)
        ax, ay = self.membrane.axes
        hat_x = hats(self.x, ax.points)[0][:, 1:-1]
        hat_y = hats(self.y, ay.points)[0][:, 1:-1]
        load_x, load_y = (
            (a.at(a.points) * a.weights[:, None]).T @ h for a, h in ((ax, hat_x), (ay, hat_y))
        )
        self._load = np.kron(load_x, load_y)  # (n, J): generalised force of one pascal at each node
        (bx, dx), (by, dy) = (
            [a.at(at, k) for k in (0, 1)]
            for a, at in zip((ax, ay), self._material[:, :2].T, strict=True)
        )
        self._along_x, self._along_y = (
            (a[:, :, None] * b[:, None]).reshape(len(bx), -1) for a, b in ((dx, by), (bx, dy))
        )

    def _times(self, vector: Array, sd: Array) -> Array:
        """Return the prior covariance times a vector (3 J,)."""
        by_x, by_y = self.prior.root
        half = by_x.T @ (vector * sd).reshape(3, len(by_x), len(by_y)) @ by_y
        return sd * (by_x @ half @ by_y.T).ravel()

    def _posterior(self, shape: Shape, positions: Array) -> Array:
        gain = shape.gain
        L = half_of(self.prior, moments(self, shape.c), gain.prior)
        half = solve_triangular(gain.innovation, gain.half @ L.T, lower=True, check_finite=False)
        scale = np.sqrt(self.posterior_fraction(shape))
        return (L @ L.T - half.T @ half) * np.outer(scale, scale)

    def _step(
        self, c: Array, markers: Markers, seen: Array, rest: InverseRest, gain: _Gain, count: int
    ) -> Shape:
        """Take one Gauss-Newton step from `c`: the membrane relaxes, and tractions and drift
        explain the remaining marker offsets."""
        data = seen - self._material[markers.ids]
        state = self._dense.state(c, rest.stiffness_scale)
        pressure, _ = self._dense.gas_pressure(state, rest.gas)
        residual = self._dense.residual(state, pressure)
        # against the state without tractions, u - K^-1 r
        misfit = _whiten(gain.weights, data - self._at_markers[markers.ids] @ c.T)
        if self._slopes is not None:
            off = np.where(
                gain.slope_weights > 0, self._slopes.off(markers, c).T * gain.slope_weights, 0.0
            )
            misfit = np.concatenate([misfit, off.T.ravel()])
        misfit = misfit + gain.moved @ residual.ravel()
        # residual attributed to the noise of the whitened markers
        noise = cho_solve((gain.innovation, True), misfit, check_finite=False)
        traction = self._times(noise @ gain.response, gain.prior).reshape(3, -1)
        drift = noise @ gain.drift  # in sd
        load = traction @ self._load.T + drift[0] * gain.drift_gas[1]
        change = cho_solve(gain.stiffness, (load - residual).ravel(), check_finite=False).reshape(
            3, -1
        )
        c = c + min(1.0, STEP_LIMIT / max(float(np.abs(change).max()), 1e-30)) * change
        pressure += float(drift[0]) * gain.drift_gas[0]
        count_p = 3 * len(markers)
        excess = np.zeros((2, len(self._material)))
        excess[0, markers.ids] = gain.distrust[0] ** 2 * (noise[:count_p].reshape(-1, 3) ** 2).mean(
            axis=1
        )
        if self._slopes is not None:
            excess[1, markers.ids] = gain.distrust[1] ** 2 * (
                noise[count_p:].reshape(-1, 2) ** 2
            ).mean(axis=1)
        return Shape(
            c,
            traction,
            pressure,
            float(misfit @ noise) / len(misfit),
            cast(Any, gain),  # of the base's type, for callers that check it
            count,
            excess,
            drift_of(drift, gain.observed_drift),
            drift[1:],
        )

    def _gain(
        self,
        c: Array,
        markers: Markers,
        rest: InverseRest,
        before: Shape | None,
        camera: CameraDriftFilter,
        lost: bool,
        correlation: float,
        mean: PlaneContact | None = None,
    ) -> _Gain:
        state = self._dense.state(c, rest.stiffness_scale)
        _, stiffness = self._dense.linearise(state, rest.gas)
        rows = self._at_markers[markers.ids]
        excess = np.zeros((2, len(rows))) if before is None else before.excess[:, markers.ids]
        distrust = np.sqrt(
            np.maximum(1.0, excess / [[self.settings.excess], [self.settings.slope_excess]])
        )
        noise = markers.cov_p + self.settings.marker_floor**2 * np.eye(3)
        weights = np.linalg.inv(np.linalg.cholesky(noise)) / distrust[0, :, None, None]
        # unit forces along the whitened axes of each marker, (3 n, 3 m)
        unit = (weights.transpose(2, 0, 1)[:, None] * rows.T[None, :, :, None]).reshape(
            3 * self.membrane.count, -1
        )
        slope_weights = np.zeros(len(rows))
        if self._slopes is not None:
            slope_weights = self._slopes.weights(markers, c) / distrust[1]
            by_x, by_y = self._slopes.rows(c, markers.ids) * slope_weights[:, None, None]
            along_x, along_y = (
                along[markers.ids, None, None] for along in (self._along_x, self._along_y)
            )
            tilting = by_x[..., None] * along_x + by_y[..., None] * along_y
            unit = np.concatenate([unit, tilting.reshape(2 * len(rows), -1).T], axis=1)
        modes = camera_modes(
            self.design, self.positions(c)[markers.ids], np.zeros(len(rows)), self.settings
        )
        drift, drift_gas = self._drift(modes @ camera.root, state, rest, stiffness, weights, unit)
        moved = cho_solve(stiffness, unit, check_finite=False).T
        response = (moved.reshape(-1, self.membrane.count) @ self._load).reshape(len(moved), -1)
        prior = self.prior.first() if before is None else self.prior.after(before.traction)
        half = half_of(self.prior, response, prior)
        innovation = half @ half.T + drift @ drift.T
        innovation[np.diag_indices_from(innovation)] += 1.0
        innovation = np.linalg.cholesky(innovation)
        observed = np.maximum(
            (drift * cho_solve((innovation, True), drift, check_finite=False)).sum(axis=0), 1e-6
        )
        return _Gain(
            c,
            markers.ids,
            stiffness,
            moved,
            response,
            half,
            weights,
            slope_weights,
            distrust,
            drift,
            drift_gas,
            observed,
            prior,
            innovation,
            0 if before is None else before.gain.reweighted + 1,
            modes,
            ((rest.gas_sd is not None, rest.gas.constant is None), rest.gas_sd or 0.0),
        )

    def _drift(
        self,
        camera: Array,
        state: State,
        rest: InverseRest,
        stiffness: tuple[Array, bool],
        weights: Array,
        unit: Array,
    ) -> tuple[Array, tuple[float, Array]]:
        """Compute the effect of one standard deviation of drift: on the whitened markers (r, 1 +
        modes), and through the gas, as pressure and as a load."""
        volume = self.design.chamber_volume_flat + state.volume
        dent = self._dense.state(rest.c).volume - state.volume
        pressure = self._dense.gas_pressure(state, rest.gas)[0] + self.design.chamber.ambient
        fraction = float(
            np.hypot(self.settings.drift_gas, self.settings.dent_fraction * dent / volume)
        )
        pressure *= fraction if rest.gas.constant is not None else 0.0
        load = pressure * self._dense.volume_gradient(state)
        bulge = cho_solve(stiffness, load.ravel(), check_finite=False)
        drift = np.zeros((unit.shape[1], 1 + camera.shape[2]))
        drift[:, 0] = bulge @ unit
        # slopes hardly see the camera move
        drift[: 3 * len(weights), 1:] = (weights @ camera).reshape(3 * len(weights), -1)
        return drift, (pressure, load)


def half_of(prior: LoadPrior, rows: Array, sd: Array) -> Array:
    """Multiply `rows` (m, 3 J) by the covariance's root: half half^T is the covariance of their
    values."""
    by_x, by_y = prior.root
    return (by_x.T @ (rows * sd).reshape(-1, len(by_x), len(by_y)) @ by_y).reshape(rows.shape)


def moments(estimator: InverseMembrane, c: Array) -> Array:
    """Return the matrix (6, 3 J) that sums tractions (3, J) to force and torque about the origin of
    S."""
    x, y, z = estimator.node_positions(c).T
    one = np.ones_like(x)
    zero = np.zeros_like(x)
    rows = np.stack(
        [
            np.r_[one, zero, zero],
            np.r_[zero, one, zero],
            np.r_[zero, zero, one],
            np.r_[zero, -z, y],
            np.r_[z, zero, -x],
            np.r_[-y, x, zero],
        ]
    )
    return rows * np.tile(estimator.node_area, 3)


def _whiten(weights: Array, values: Array) -> Array:
    return np.einsum("mai,mi->ma", weights, values).ravel()
