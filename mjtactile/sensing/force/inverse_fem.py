"""Traction on the membrane from its markers by inverse finite elements (level 3).

See docs/theory/membrane_inverse.md, Eq. F9-F12.

The unknowns are the tractions at the nodes of a grid. They deform the membrane model of
`mjtactile.sensing.force.spline_fem` from its computed rest shape. So the bulge is not interpolated.
Markers measure the deformation at their positions and, if they are far apart, its slopes. Contacts
cover a small area. So the prior of `mjtactile.sensing.force.prior` follows the earlier tractions,
and contacts become compact. The gas amount and the camera pose may have drifted slightly since they
were measured. They are unknowns, too. Next to a sharp edge, markers move in patterns that the
splines cannot follow. So a marker gets a smaller weight the worse it was explained.

A frame takes one Gauss-Newton step, or a few after a sudden change. Stiffness and gains are kept
while the shape stays near their linearization point. Then a step consists of back-substitutions
only. The arithmetic is in mjtactile/kernels/inverse.c.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array, Markers, Traction
from mjtactile.kernels import kernel
from mjtactile.sensing.force.camera_drift_estimator import CameraDriftEstimate, observed_modes
from mjtactile.sensing.force.camera_drift_model import CameraDriftFilter, camera_modes, drift_of
from mjtactile.sensing.force.linearization import Linearization, PlaneContact, Shape
from mjtactile.sensing.force.model_error import AXES, FitDiagnostics, ModelErrorVariance
from mjtactile.sensing.force.plane_contact import PlaneContactSolver
from mjtactile.sensing.force.prior import LoadPrior
from mjtactile.sensing.force.rest_equilibrium import InverseRest, darker
from mjtactile.sensing.force.slopes import MarkerSlopes
from mjtactile.sensing.force.spline_fem import State, Stiffness
from mjtactile.sensing.force.traction_grid import LoadedMembrane
from mjtactile.sensing.settings import (
    DEFAULTS,
    FiducialSettings,
    InverseSettings,
    ModelErrorSettings,
    PriorSettings,
)

# iterations after a cold start; before them, loads and camera drift both fit the marker motion
REWEIGHTED = 4
STEPS_MAX = 8
STEP_LIMIT = 2e-3  # maximum change of a coefficient per step, m
SETTLED = 1e-4  # step size that ends the iteration, m


class InverseMembrane(LoadedMembrane):
    """Traction estimator of one sensor. `prior` are the settings of the traction prior,
    `model_error` those of the model error added to the wrench covariance, `fiducials` those of a
    camera observed by fiducials."""

    def __init__(
        self,
        design: SensorDesign,
        settings: InverseSettings = DEFAULTS.inverse,
        prior: PriorSettings = DEFAULTS.prior,
        model_error: ModelErrorSettings = DEFAULTS.model_error,
        fiducials: FiducialSettings = DEFAULTS.fiducials,
    ):
        super().__init__(design, settings)
        self._known = fiducials
        self.prior = LoadPrior(self.x[1:-1], self.y[1:-1], prior)
        # nodes in each direction, generalised forces (kx, jx), (ky, jy) of one pascal at each
        loads = map(np.ascontiguousarray, self.node_loads())
        self._grid = (len(self.x) - 2, len(self.y) - 2, *loads)
        self._roots: dict[float, tuple[Array, ...]] = {}
        self._model_error = ModelErrorVariance(design, self.nodes, model_error)
        self._posterior_fraction = np.array(settings.posterior_fraction)[AXES]
        self.planes = PlaneContactSolver(self)
        self._slopes: MarkerSlopes | None = None
        if design.markers.pitch_x * design.markers.pitch_y > settings.slopes_cell:
            distance = design.camera.distance
            self._slopes = MarkerSlopes(self.membrane, self._material, distance, settings)

    def estimate(
        self,
        markers: Markers,
        rest: InverseRest,
        start: Shape | None = None,
        *,
        camera: CameraDriftFilter | CameraDriftEstimate | None = None,
        lost: bool = False,
        correlation: float | None = None,
        mean: PlaneContact | None = None,
    ) -> Shape:
        """Estimate tractions and deformation from the markers, starting from the last frame if
        given.

        `camera` is the prior of the camera drift (None: unchanged since `rest`). With fiducials,
        the markers are already corrected for it. `lost`: True if some gas without a pressure sensor
        may have been lost. `correlation` is the correlation length of the tractions, m (None: as in
        the settings).
        """
        correlation = correlation or self.prior.settings.correlation
        camera = camera or CameraDriftFilter.unseen(self.settings)
        c, before = (rest.c, None) if start is None else (start.c, start)
        gain = None if start is None else start.gain
        for steps in range(1, STEPS_MAX + 1):
            if (
                gain is None
                or gain.reweighted < REWEIGHTED
                or not gain.serves(c, markers, rest, camera, lost, correlation, mean)
            ):
                gain = self._gain(c, markers, rest, before, camera, lost, correlation, mean)
            observed = markers.p_SM - rest.offset[markers.ids]
            if isinstance(camera, CameraDriftFilter):
                observed -= gain.modes @ camera.mean
            shape = self._step(c, markers, observed, rest, gain, steps)
            settled = float(np.abs(shape.c - c).max()) < SETTLED
            c = shape.c
            before = shape
            if settled and gain.reweighted >= REWEIGHTED:
                return shape
        return shape  # pyright: ignore[reportPossiblyUnboundVariable] the loop runs at least once

    def plane_contact(
        self,
        markers: Markers,
        rest: InverseRest,
        camera: CameraDriftFilter | CameraDriftEstimate,
        start: PlaneContact,
        measured: tuple[float, float] | None = None,
    ) -> PlaneContact | None:
        """Fit a plane that the membrane touches to the markers, from `start`; None if that does not
        converge. `measured` are gauge pressure, Pa, and standard deviation of a pressure sensor.
        For the other arguments see `estimate`."""
        ids = markers.ids
        noise = markers.cov_p + np.diag(np.square(self.settings.face_floor))
        weights = np.linalg.inv(np.linalg.cholesky(noise))
        observed = markers.p_SM - rest.offset[ids]
        modes = self._camera_modes(self.positions(start.c)[ids], darker(markers, rest), camera)
        if isinstance(camera, CameraDriftFilter):
            observed -= modes @ camera.mean
        return self.planes.fit(
            markers, observed, weights, modes @ camera.root, rest, start, measured
        )

    def _step(
        self,
        c: Array,
        markers: Markers,
        detected: Array,
        rest: InverseRest,
        gain: Linearization,
        count: int,
    ) -> Shape:
        """Do one Gauss-Newton step from `c`. The membrane relaxes to equilibrium. Tractions and
        drift explain the remaining motion of the markers. `detected` (m, 3), m, are the positions
        observed by the camera as assumed."""
        ids = markers.ids
        slopes_off = None
        data = detected - self._material[ids]
        state = self.state(c, rest)
        pressure, _ = self.membrane.gas_pressure(state, rest.gas)
        if self._slopes is not None:
            weighted = self._slopes.off(markers, c).T * gain.slope_weights
            slopes_off = np.where(gain.slope_weights > 0, weighted, 0.0).T
        change = np.empty_like(c)
        traction = np.empty((3, len(self.nodes)))
        unknowns = gain.drift.shape[1]
        misfit, noise = np.empty((2, len(gain.half)))
        drift = np.empty(unknowns)
        observed = self._observation(gain.stiffness, ids, gain.weights, gain.tilts)
        model = (gain.prior, gain.innovation, unknowns, gain.drift, gain.drift_gas[1])
        residual = self.membrane.residual(state, pressure)
        if gain.mean is not None:
            residual -= gain.mean.load
        point = (c, residual, data, slopes_off)
        results = (change, traction, misfit, noise, drift)
        kernel("inverse_step")(*observed, *self._nodes(gain.correlation), *model, *point, *results)
        c = c + min(1.0, STEP_LIMIT / max(float(np.abs(change).max()), 1e-30)) * change
        pressure += float(drift[0]) * gain.drift_gas[0]
        traction /= self._density
        if gain.mean is not None:
            traction += gain.mean.traction
        return Shape(
            c=c,
            traction=traction,
            gauge_pressure=pressure,
            misfit=float(misfit @ noise) / len(misfit),
            gain=gain,
            steps=count,
            excess=self._excess(ids, noise, gain.distrust),
            drift=drift_of(drift, gain.observed_drift),
            camera=drift[1:],
        )

    def _excess(self, ids: NDArray[np.int64], noise: Array, distrust: Array) -> Array:
        """Return the squares of each marker's misfits (2, n): of its position, of its slope."""
        m = len(ids)
        excess = np.zeros((2, len(self._material)))
        excess[0, ids] = distrust[0] ** 2 * (noise[: 3 * m].reshape(-1, 3) ** 2).mean(axis=1)
        if self._slopes is not None:
            squares = (noise[3 * m :].reshape(-1, 2) ** 2).mean(axis=1)
            excess[1, ids] = distrust[1] ** 2 * squares
        return excess

    def _nodes(self, correlation: float) -> tuple[Any, ...]:
        """Return the kernel arguments for the nodes, with the roots of a prior with this
        correlation length, m."""
        if correlation not in self._roots:
            prior = self.prior
            if correlation != prior.settings.correlation:
                settings = replace(prior.settings, correlation=correlation)
                prior = LoadPrior(self.x[1:-1], self.y[1:-1], settings)
            self._roots[correlation] = tuple(map(np.ascontiguousarray, prior.root))
        return (*self._grid, *self._roots[correlation])

    def _observation(
        self, stiffness: Stiffness, ids: NDArray[np.int64], weights: Array, tilts: Array | None
    ) -> tuple[object, ...]:
        """Return the kernel arguments for the membrane and the detected markers."""
        return (
            *self.membrane.shape,
            self.membrane.constants,
            stiffness.factor,
            stiffness.softened,
            stiffness.fraction,
            (3 if tilts is None else 5) * len(ids),
            len(ids),
            self._seats[ids],
            weights,
            tilts,
        )

    def _gain(
        self,
        c: Array,
        markers: Markers,
        rest: InverseRest,
        before: Shape | None,
        camera: CameraDriftFilter | CameraDriftEstimate,
        lost: bool,
        correlation: float,
        mean: PlaneContact | None = None,
    ) -> Linearization:
        """Linearize at `c` for these markers; `before` is the last estimate."""
        state = self.state(c, rest)
        ids = markers.ids
        _, stiffness = self.membrane.linearise(state, rest.gas)
        distrust = self._distrust(ids, before)
        weights, slope_weights, tilts = self._weights(c, markers, distrust)
        if mean is not None:
            prior = self.prior.around(mean.traction, self.settings.face_fraction)
        elif before is not None:
            prior = self.prior.after(before.traction)
        else:
            prior = self.prior.first()
        prior *= np.tile(self._density, 3)
        pressure, load = self._gas_drift(state, rest, self._known.gas_lost if lost else None)
        changed = darker(markers, rest)
        modes = self._camera_modes(self.positions(c)[ids], changed, camera)
        rows = (3 if tilts is None else 5) * len(ids)
        half = np.empty((rows, 3 * len(self.nodes)))
        gas_observed = np.empty(rows)
        observed = self._observation(stiffness, ids, weights, tilts)
        results = (half, gas_observed)
        nodes = self._nodes(correlation)
        kernel("inverse_gain")(*observed, *nodes, prior, stiffness.solve(load), *results)
        drift = _observed_drift(gas_observed, weights @ modes @ camera.root)
        innovation = _innovation(half, drift)
        whitened = drift.copy()
        kernel("solve_lower")(*whitened.shape, innovation, whitened)
        known = whitened.T @ whitened
        return Linearization(
            c=c,
            ids=ids,
            stiffness=stiffness,
            half=half,
            weights=weights,
            slope_weights=slope_weights,
            tilts=tilts,
            distrust=distrust,
            drift=drift,
            drift_gas=(pressure, load),
            observed_drift=np.maximum(np.diagonal(known), 1e-6),
            prior=prior,
            innovation=innovation,
            reweighted=0 if before is None else before.gain.reweighted + 1,
            gas=((rest.gas_sd is not None, rest.gas.constant is None), rest.gas_sd or 0.0),
            darker=changed,
            camera=camera,
            lost=lost,
            modes=modes,
            left=np.eye(len(known) - 1) - known[1:, 1:],
            correlation=correlation,
            mean=mean,
        )

    def _weights(
        self, c: Array, markers: Markers, distrust: Array
    ) -> tuple[Array, Array, Array | None]:
        """Return the whitening of each marker's position (n, 3, 3) and slope (n,), and the slope
        rows. The slope rows are the whitened derivatives of the slopes by the membrane's tangents;
        None: slopes are not used."""
        noise = markers.cov_p + self.settings.marker_floor**2 * np.eye(3)
        weights = np.linalg.inv(np.linalg.cholesky(noise)) / distrust[0, :, None, None]
        if self._slopes is None:
            return weights, np.zeros(len(markers.ids)), None
        slope_weights = self._slopes.weights(markers, c) / distrust[1]
        rows = self._slopes.rows(c, markers.ids)
        return weights, slope_weights, rows * slope_weights[:, None, None]

    def _distrust(self, ids: NDArray[np.int64], before: Shape | None) -> Array:
        """Return the factor (2, n) on the standard deviation of each marker's position and slope.
        It exceeds 1 if the previous image did not explain the marker."""
        excess = np.zeros((2, len(ids))) if before is None else before.excess[:, ids]
        usual = [[self.settings.excess], [self.settings.slope_excess]]
        return np.sqrt(np.maximum(1.0, excess / usual))

    def _camera_modes(
        self, p_SM: Array, changed: Array, camera: CameraDriftFilter | CameraDriftEstimate
    ) -> Array:
        """Return the motion (m, 3, modes), m, of markers at `p_SM` (m, 3)."""
        if isinstance(camera, CameraDriftFilter):
            return camera_modes(self.design, p_SM, changed, self.settings)
        return observed_modes(self.design, p_SM, changed, self.settings, self._known)

    def _gas_drift(
        self, state: State, rest: InverseRest, lost: float | None
    ) -> tuple[float, Array]:
        """Return one standard deviation of the gas drift. It is given as pressure, Pa, and as a
        load (3, n). `lost` is the standard deviation of the amount if some gas may have been
        lost."""
        chamber = self.design.chamber
        volume = self.design.chamber_volume_flat + state.volume
        pressure = self.membrane.gas_pressure(state, rest.gas)[0] + chamber.ambient
        if rest.gas_sd is not None:
            change = (volume - rest.gas_volume) / volume if rest.gas.constant is not None else 0.0
            sd = math.hypot(rest.gas_sd, self.settings.dent_fraction * change * pressure)
            return sd, sd * state.gradient
        dent = self.membrane.state(rest.c).volume - state.volume
        drift = self.settings.drift_gas if lost is None else lost
        fraction = float(np.hypot(drift, self.settings.dent_fraction * dent / volume))
        pressure *= fraction if rest.gas.constant is not None else 0.0
        return pressure, pressure * state.gradient

    def traction(
        self,
        shape: Shape,
        before: Shape | None = None,
        seconds: float = math.inf,
        air_moved: float = 0.0,
        lag: float = 0.0,
    ) -> Traction:
        """Return nodal forces on the grid, the net wrench and its covariance. The covariance grows
        with the motion since `before`, `seconds` ago. It grows with the gas's own pressure change
        since then, `air_moved`, Pa. It also grows with the `lag`, images, of a camera that blends
        images."""
        force = shape.traction * self.node_area
        positions = self.node_positions(shape.c)
        wrench = _net(force, positions)
        nodal = self._to_regular_grid(force)
        change = wrench  # without a history all of it may have come just now
        moved = np.zeros((len(self.nodes), 3))
        if before is not None:
            change = wrench - _net(before.traction * self.node_area, positions)
            moved = self._at_nodes @ (shape.c - before.c).T
        velocity = self.node_area @ moved / (self.node_area.sum() * max(seconds, 1e-3))
        excess = float(shape.excess[0].mean())
        cov = self._posterior(shape, positions)
        unseen = self.planes.unseen_load(shape.traction, shape.gauge_pressure)
        (measured, _), _ = shape.gain.gas
        fit = FitDiagnostics(force, change, velocity, excess, air_moved, lag, unseen, measured)
        cov.flat[:: len(cov) + 1] += self._model_error.variance(fit)
        return Traction(self.x, self.y, nodal, wrench, cov, shape.gauge_pressure, method="inverse")

    def sharpness(self, shape: Shape) -> Array:
        """Return the part of the wrench variance (6,) due to sharp features that the splines cannot
        follow."""
        force = shape.traction * self.node_area
        return self._model_error.of_sharpness(force, float(shape.excess[0].mean()))

    def detectable_force(self, rest: InverseRest, markers: Markers) -> float:
        """Return the normal force at the center of the face that moves the markers by one standard
        deviation, N.

        It is a property of membrane and camera. The prior of the tractions, which bounds the
        posterior standard deviation of a stiff sensor, is not used.
        """
        state = self.state(rest.c, rest)
        _, stiffness = self.membrane.linearise(state, rest.gas)
        along_x, along_y = self.node_loads()
        x, y = (len(axis) // 2 - 1 for axis in (self.x, self.y))
        area = self.node_area.reshape(len(self.x) - 2, len(self.y) - 2)[x, y]
        load = np.zeros_like(rest.c)
        load[2] = -np.outer(along_x[:, x], along_y[:, y]).ravel() / area
        moved = self.positions(stiffness.solve(load)) - self.positions(np.zeros_like(rest.c))
        noise = markers.cov_p + self.settings.marker_floor**2 * np.eye(3)
        observed = moved[markers.ids]
        information = (observed * np.linalg.solve(noise, observed[..., None])[..., 0]).sum()
        return float(1 / np.sqrt(max(information, 1e-12)))

    def _posterior(self, shape: Shape, positions: Array) -> Array:
        """Return the posterior covariance (6, 6) of the wrench, for nodes at `positions` (J, 3),
        m."""
        gain = shape.gain
        cov = np.empty((6, 6))
        jx, jy, _, _, *roots = self._nodes(gain.correlation)
        nodes = (jx, jy, *roots, gain.prior, positions, self._cells)
        kernel("wrench_posterior")(len(gain.half), *nodes, gain.half, gain.innovation, cov)
        scale = np.sqrt(self.posterior_fraction(shape))
        return cov * np.outer(scale, scale)

    def posterior_fraction(self, shape: Shape) -> Array:
        """Return the factors (6,) on the wrench's predicted variances. They are larger if the
        markers misfit or show drift."""
        return np.maximum(max(1.0, shape.misfit) * self._posterior_fraction, shape.drift - 1)


def _net(force: Array, positions: Array) -> Array:
    """Return net force and torque (6,) about the origin of forces (3, J) at `positions` (J, 3)."""
    M = force @ positions
    return np.array([*force.sum(axis=1), M[2, 1] - M[1, 2], M[0, 2] - M[2, 0], M[1, 0] - M[0, 1]])


def _observed_drift(gas: Array, camera: Array) -> Array:
    """Return the whitened markers' response (r, 1 + modes) to one standard deviation of drift. The
    drift is that of the `gas` (r,) and of the `camera`'s modes (m, 3, modes). Slopes, the rows
    after 3 m, are nearly independent of camera motion."""
    markers, _, modes = camera.shape
    drift = np.zeros((len(gas), 1 + modes))
    drift[:, 0] = gas
    drift[: 3 * markers, 1:] = camera.reshape(3 * markers, modes)
    return drift


def _innovation(half: Array, drift: Array) -> Array:
    """Return the lower factor (r, r) of the whitened markers' covariance, predicted from tractions,
    drift and marker noise."""
    cov = half @ half.T + drift @ drift.T
    cov.flat[:: len(cov) + 1] += 1.0
    return np.linalg.cholesky(cov)
