"""Traction on the membrane from its markers by inverse finite elements (level 3;
docs/theory/membrane_inverse.md, Eq. F9-F12).

Unknown are the tractions at the nodes of a grid. They deform the sheet of
`mjtactile.sensing.force.spline_fem` from its forward-solved rest shape, so the bulge is not
interpolated but computed; markers see the deformation at their places and, where they stand far
apart, its slopes too. Nothing touches almost everywhere: the prior of
`mjtactile.sensing.force.prior` follows the tractions found before, so that contacts become compact.
The amount of gas and the camera's place may have drifted a little since they were measured; they
are unknowns, too. And next to a sharp edge markers move in ways that the sheet's splines cannot
follow: a marker counts the less, the worse it was explained.

A frame is one Gauss-Newton step, or a few after a sudden change. Stiffness and gains are kept as
long as the shape stays near where they were computed; then the step is back-substitutions only. The
arithmetic is in mjtactile/kernels/inverse.c.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array, Markers, Traction
from mjtactile.kernels import kernel
from mjtactile.sensing.force.camera_drift_estimator import CameraDriftEstimate, observed_modes
from mjtactile.sensing.force.camera_drift_model import CameraDriftFilter, camera_modes, drift_of
from mjtactile.sensing.force.linearization import Linearization, Shape
from mjtactile.sensing.force.model_error import AXES, FitDiagnostics, ModelErrorVariance
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

REWEIGHTED = 4  # from a cold start: before, loads and a camera that drifted share what is seen
STEPS_MAX = 8
STEP_LIMIT = 2e-3  # m
SETTLED = 1e-4  # m: a step that ends the iteration


class InverseMembrane(LoadedMembrane):
    """Traction estimator of one sensor.

    Args:
        design: The sensor's values.
        settings: Of the fit.
        prior: What is believed of tractions.
        doubt: What is added to the wrench's covariance.
        fiducials: Of a camera that fiducials show.
    """

    def __init__(
        self,
        design: SensorDesign,
        settings: InverseSettings = DEFAULTS.inverse,
        prior: PriorSettings = DEFAULTS.prior,
        doubt: ModelErrorSettings = DEFAULTS.doubt,
        fiducials: FiducialSettings = DEFAULTS.fiducials,
    ):
        super().__init__(design, settings)
        self._known = fiducials
        self.prior = LoadPrior(self.x[1:-1], self.y[1:-1], prior)
        # nodes in each direction, generalised forces (kx, jx), (ky, jy) of one pascal at each, and
        # the prior's roots
        self._nodes = (
            len(self.x) - 2,
            len(self.y) - 2,
            *map(np.ascontiguousarray, (*self.node_loads(), *self.prior.root)),
        )
        self._doubt = ModelErrorVariance(design, self.nodes, doubt)
        self._posterior_fraction = np.array(settings.posterior_fraction)[AXES]
        self._slopes: MarkerSlopes | None = None
        if design.markers.pitch_x * design.markers.pitch_y > settings.slopes_cell:
            distance = design.camera.distance
            self._slopes = MarkerSlopes(self.sheet, self._material, distance, settings)

    # -- one frame

    def estimate(
        self,
        markers: Markers,
        rest: InverseRest,
        start: Shape | None = None,
        *,
        camera: CameraDriftFilter | CameraDriftEstimate | None = None,
        lost: bool = False,
    ) -> Shape:
        """Tractions and deformation that explain the markers, starting from the last frame's where
        there is one, with what is known of the `camera` (None: that nobody knocked it since
        `rest`). Where fiducials show it, markers are as they would be without its change. Some of a
        gas that no gauge measures may have been `lost`."""
        camera = camera or CameraDriftFilter.unseen(self.settings)
        c, before = (rest.c, None) if start is None else (start.c, start)
        gain = None if start is None else start.gain
        for steps in range(1, STEPS_MAX + 1):
            if (
                gain is None
                or gain.reweighted < REWEIGHTED
                or not gain.serves(c, markers, rest, camera, lost)
            ):
                gain = self._gain(c, markers, rest, before, camera, lost)
            seen = markers.p_SM - rest.offset[markers.ids]
            if isinstance(camera, CameraDriftFilter):
                seen -= gain.modes @ camera.mean
            shape = self._step(c, markers, seen, rest, gain, steps)
            settled = float(np.abs(shape.c - c).max()) < SETTLED
            c = shape.c
            before = shape
            if settled and gain.reweighted >= REWEIGHTED:
                return shape
        return shape  # pyright: ignore[reportPossiblyUnboundVariable] the loop runs at least once

    def _step(
        self,
        c: Array,
        markers: Markers,
        seen: Array,
        rest: InverseRest,
        gain: Linearization,
        count: int,
    ) -> Shape:
        """One Gauss-Newton step from `c`: the sheet relaxes, tractions and drift explain what
        markers, `seen` (m, 3) m by a camera as is believed, show beyond that."""
        ids = markers.ids
        m = len(markers)
        slopes_off = None
        data = seen - self._material[ids]
        state = self._state(c, rest)
        pressure, _ = self.sheet.gas_pressure(state, rest.gas)
        if self._slopes is not None:
            slopes_off = np.where(
                gain.slope_weights > 0, self._slopes.off(markers, c).T * gain.slope_weights, 0.0
            ).T
        change = np.empty_like(c)
        traction = np.empty((3, len(self.nodes)))
        unknowns = gain.drift.shape[1]
        misfit, noise = np.empty((2, len(gain.half)))
        drift = np.empty(unknowns)
        kernel("inverse_step")(
            *self._sight(gain.stiffness, ids, gain.weights, gain.tilts),
            *self._nodes,
            gain.prior,
            gain.innovation,
            unknowns,
            gain.drift,
            gain.drift_gas[1],
            c,
            self.sheet.residual(state, pressure),
            data,
            slopes_off,
            change,
            traction,
            misfit,
            noise,
            drift,
        )
        c = c + min(1.0, STEP_LIMIT / max(float(np.abs(change).max()), 1e-30)) * change
        pressure += float(drift[0]) * gain.drift_gas[0]
        traction /= self._density
        excess = np.zeros((2, len(self._material)))
        excess[0, ids] = gain.distrust[0] ** 2 * (noise[: 3 * m].reshape(-1, 3) ** 2).mean(axis=1)
        if self._slopes is not None:
            excess[1, ids] = gain.distrust[1] ** 2 * (noise[3 * m :].reshape(-1, 2) ** 2).mean(
                axis=1
            )
        return Shape(
            c=c,
            traction=traction,
            gauge_pressure=pressure,
            misfit=float(misfit @ noise) / len(misfit),
            gain=gain,
            steps=count,
            excess=excess,
            drift=drift_of(drift, gain.observed_drift),
            camera=drift[1:],
        )

    def _sight(
        self, stiffness: Stiffness, ids: NDArray[np.int64], weights: Array, tilts: Array | None
    ) -> tuple[object, ...]:
        """What both kernels are told of the sheet and of the markers that see it."""
        return (
            *self.sheet.shape,
            self.sheet.numbers,
            stiffness.factor,
            stiffness.softened,
            stiffness.share,
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
    ) -> Linearization:
        """The linearisation at `c` for these markers; `before` is what was found last."""
        state = self._state(c, rest)
        ids = markers.ids
        _, stiffness = self.sheet.linearise(state, rest.gas)
        distrust = self._distrust(ids, before)
        weights, slope_weights, tilts = self._weights(c, markers, distrust)
        prior = self.prior.first() if before is None else self.prior.after(before.traction)
        prior *= np.tile(self._density, 3)
        pressure, load = self._gas_drift(state, rest, self._known.gas_lost if lost else None)
        changed = darker(markers, rest)
        modes = self._camera_modes(self.positions(c)[ids], changed, camera)
        rows = (3 if tilts is None else 5) * len(ids)
        half = np.empty((rows, 3 * len(self.nodes)))
        gas_observed = np.empty(rows)
        kernel("inverse_gain")(
            *self._sight(stiffness, ids, weights, tilts),
            *self._nodes,
            prior,
            stiffness.solve(load),
            half,
            gas_observed,
        )
        drift = _observed_drift(gas_observed, weights @ modes @ camera.root)
        innovation = _innovation(half, drift)
        seen = drift.copy()
        kernel("solve_lower")(*seen.shape, innovation, seen)
        known = seen.T @ seen
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
        )

    def _weights(
        self, c: Array, markers: Markers, distrust: Array
    ) -> tuple[Array, Array, Array | None]:
        """One over the sd of each marker's place (n, 3, 3) and slope (n,), and what the slopes tell
        of the sheet, so weighted; None: they are not looked at."""
        noise = markers.cov_p + self.settings.marker_floor**2 * np.eye(3)
        weights = np.linalg.inv(np.linalg.cholesky(noise)) / distrust[0, :, None, None]
        if self._slopes is None:
            return weights, np.zeros(len(markers.ids)), None
        slope_weights = self._slopes.weights(markers, c) / distrust[1]
        rows = self._slopes.rows(c, markers.ids)
        return weights, slope_weights, rows * slope_weights[:, None, None]

    def _distrust(self, ids: NDArray[np.int64], before: Shape | None) -> Array:
        """By how much the sd of each marker's place and slope is raised (2, n), where the image
        before did not explain them."""
        excess = np.zeros((2, len(ids))) if before is None else before.excess[:, ids]
        usual = [[self.settings.excess], [self.settings.slope_excess]]
        return np.sqrt(np.maximum(1.0, excess / usual))

    def _camera_modes(
        self, p_SM: Array, changed: Array, camera: CameraDriftFilter | CameraDriftEstimate
    ) -> Array:
        """How (m, 3, modes) m markers at `p_SM` (m, 3) move with one sd of the camera's modes."""
        if isinstance(camera, CameraDriftFilter):
            return camera_modes(self.design, p_SM, changed, self.settings)
        return observed_modes(self.design, p_SM, changed, self.settings, self._known)

    def _gas_drift(
        self, state: State, rest: InverseRest, lost: float | None
    ) -> tuple[float, Array]:
        """One sd of the gas's drift, as pressure, Pa, and as a load (3, n); that of its amount is
        `lost` where some may have been."""
        chamber = self.design.chamber
        volume = self.design.chamber_volume_flat + state.volume
        pressure = self.sheet.gas_pressure(state, rest.gas)[0] + chamber.ambient
        if rest.gas_sd is not None:
            change = (volume - rest.gas_volume) / volume if rest.gas.constant is not None else 0.0
            sd = math.hypot(rest.gas_sd, self.settings.dent_fraction * change * pressure)
            return sd, sd * state.gradient
        dent = self.sheet.state(rest.c).volume - state.volume
        drift = self.settings.drift_gas if lost is None else lost
        share = float(np.hypot(drift, self.settings.dent_fraction * dent / volume))
        pressure *= share if rest.gas.constant is not None else 0.0
        return pressure, pressure * state.gradient

    # -- what it means

    def traction(
        self,
        shape: Shape,
        before: Shape | None = None,
        seconds: float = math.inf,
        air_moved: float = 0.0,
        lag: float = 0.0,
    ) -> Traction:
        """Nodal forces on the grid, net wrench and its covariance, which grows with the motion
        since `before`, `seconds` ago, and with the gas's own change of pressure since then,
        `air_moved` Pa, and with the `lag`, images, of a camera that blends them."""
        force = shape.traction * self.node_area
        positions = self.node_positions(shape.c)
        wrench = _net(force, positions)
        nodal = self._on_grid(force)
        change = wrench  # without a history all of it may have come just now
        moved = np.zeros((len(self.nodes), 3))
        if before is not None:
            change = wrench - _net(before.traction * self.node_area, positions)
            moved = self._at_nodes @ (shape.c - before.c).T
        felt = FitDiagnostics(
            force,
            change,
            self.node_area @ moved / (self.node_area.sum() * max(seconds, 1e-3)),
            float(shape.excess[0].mean()),
            air_moved,
            lag,
        )
        cov = self._posterior(shape, positions)
        cov.flat[:: len(cov) + 1] += self._doubt.variance(felt)
        return Traction(self.x, self.y, nodal, wrench, cov, shape.gauge_pressure, method="inverse")

    def sharpness(self, shape: Shape) -> Array:
        """The part of the wrench's variance, (6,), that is there since the sheet's splines do not
        follow what is sharp."""
        force = shape.traction * self.node_area
        return self._doubt.of_sharpness(force, float(shape.excess[0].mean()))

    def _posterior(self, shape: Shape, positions: Array) -> Array:
        """Posterior covariance (6, 6) of the wrench of tractions on nodes at `positions` (J, 3) m:
        what the prior leaves open between markers, and their noise."""
        gain = shape.gain
        cov = np.empty((6, 6))
        jx, jy, _, _, *roots = self._nodes
        kernel("wrench_posterior")(
            len(gain.half),
            jx,
            jy,
            *roots,
            gain.prior,
            positions,
            self._cells,
            gain.half,
            gain.innovation,
            cov,
        )
        scale = np.sqrt(self.posterior_fraction(shape))
        return cov * np.outer(scale, scale)

    def posterior_fraction(self, shape: Shape) -> Array:
        """Share (6,) of the wrench's predicted variances: more where markers misfit or show
        drift."""
        return np.maximum(max(1.0, shape.misfit) * self._posterior_fraction, shape.drift - 1)


def _net(force: Array, positions: Array) -> Array:
    """Net force and torque (6,) about the origin of forces (3, J) at `positions` (J, 3)."""
    M = force @ positions
    return np.array([*force.sum(axis=1), M[2, 1] - M[1, 2], M[0, 2] - M[2, 0], M[1, 0] - M[0, 1]])


def _observed_drift(gas: Array, camera: Array) -> Array:
    """The whitened markers' response (r, 1 + modes) to one sd of drift: of the `gas` (r,), and of
    the `camera`'s modes (m, 3, modes). Slopes, the rows after 3 m, hardly see the camera move."""
    markers, _, modes = camera.shape
    drift = np.zeros((len(gas), 1 + modes))
    drift[:, 0] = gas
    drift[: 3 * markers, 1:] = camera.reshape(3 * markers, modes)
    return drift


def _innovation(half: Array, drift: Array) -> Array:
    """Lower factor (r, r) of the whitened markers' covariance, as tractions, drift and their own
    noise predict it."""
    cov = half @ half.T + drift @ drift.T
    cov.flat[:: len(cov) + 1] += 1.0
    return np.linalg.cholesky(cov)
