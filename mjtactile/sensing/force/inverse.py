"""Traction on the membrane from its markers by inverse finite elements (level 3; docs/equations.md,
Eq. F9-F12).

Unknown are the tractions at the nodes of a grid. They deform the sheet of
`mjtactile.sensing.force.sheet` from its forward-solved rest shape, so the bulge is not interpolated
but computed; markers see the deformation at their places and, where they stand far apart, its
slopes too. Nothing touches almost everywhere: the prior of `mjtactile.sensing.force.prior` follows
the tractions found before, so that contacts become compact. The amount of gas and the camera's
place may have drifted a little since they were measured; they are unknowns, too. And next to a
sharp edge markers move in ways that the sheet's splines cannot follow: a marker counts the less,
the worse it was explained.

A frame is one Gauss-Newton step, or a few after a sudden change. Stiffness and gains are kept as
long as the shape stays near where they were computed; then the step is back-substitutions only. The
arithmetic is in mjtactile/kernels/inverse.c.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve

from mjtactile.core.bspline import hats
from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array, Markers, Traction
from mjtactile.kernels import kernel
from mjtactile.sensing.force.camera import CameraSeen, known_modes
from mjtactile.sensing.force.doubt import AXES, Doubt, Felt
from mjtactile.sensing.force.drift import CameraBelief, camera_modes, drift_of
from mjtactile.sensing.force.gain import Gain, Shape
from mjtactile.sensing.force.prior import LoadPrior
from mjtactile.sensing.force.rest import InverseRest, MarkedSheet, darker
from mjtactile.sensing.force.sheet import State, Stiffness, product
from mjtactile.sensing.force.slopes import MarkerSlopes
from mjtactile.sensing.settings import (
    DEFAULTS,
    DoubtSettings,
    FiducialSettings,
    InverseSettings,
    PriorSettings,
)

REWEIGHTED = 4  # from a cold start: before, loads and a camera that drifted share what is seen
STEPS_MAX = 8
STEP_LIMIT = 2e-3  # m
SETTLED = 1e-4  # m: a step that ends the iteration
REFINE = 5  # cells of the fine grid, for outlines, to a cell of the traction grid


class InverseMembrane(MarkedSheet):
    """Traction estimator of one sensor; the inner grid lines of its sheet carry the nodes."""

    def __init__(
        self,
        design: SensorDesign,
        settings: InverseSettings = DEFAULTS.inverse,
        prior: PriorSettings = DEFAULTS.prior,
        doubt: DoubtSettings = DEFAULTS.doubt,
        fiducials: FiducialSettings = DEFAULTS.fiducials,
    ):
        super().__init__(design, settings)
        self._known = fiducials
        ax, ay = self.sheet.axes
        self.x = ax.breaks
        self.y = ay.breaks
        hat_x = hats(self.x, ax.points)[0][:, 1:-1]
        hat_y = hats(self.y, ay.points)[0][:, 1:-1]
        load_x, load_y = (
            (a.at(a.points) * a.weights[:, None]).T @ h for a, h in ((ax, hat_x), (ay, hat_y))
        )
        self._hats = (hat_x, hat_y)
        own = product(self.x[1:-1], self.y[1:-1])
        # (J,) m^2 of the sheet's own coordinates, and of the mounted sheet to one of these:
        # kernels have tractions by the former, so that their integrals are products
        self._cells = np.outer(ax.weights @ hat_x, ay.weights @ hat_y).ravel()
        self._density = self.sheet.density(own)
        self.node_area = self._cells * self._density  # (J,) m^2
        self.prior = LoadPrior(self.x[1:-1], self.y[1:-1], prior)
        # nodes in each direction, generalised forces (kx, jx), (ky, jy) of one pascal at each, and
        # the prior's roots
        self._nodes = (
            len(self.x) - 2,
            len(self.y) - 2,
            *map(np.ascontiguousarray, (load_x, load_y, *self.prior.root)),
        )
        self.nodes = self.sheet.places(own)
        self._flat_nodes = np.column_stack([self.nodes, np.zeros(len(self.nodes))])
        self._at_nodes = self.sheet.basis(own)
        self._shared = self._sharing()
        self._doubt = Doubt(design, self.nodes, doubt)
        self._posterior_share = np.array(settings.posterior_share)[AXES]
        fine = [np.linspace(-a.length / 2, a.length / 2, REFINE * a.spans + 1) for a in (ax, ay)]
        self._at_fine = [a.at(g) for a, g in zip((ax, ay), fine, strict=True)]
        self._fine = self.sheet.places(product(*fine)).T.reshape(2, *map(len, fine))
        sparse = design.markers.pitch_x * design.markers.pitch_y > settings.slopes_cell
        self._slopes = (
            MarkerSlopes(self.sheet, self._material, design.camera.distance, settings)
            if sparse
            else None
        )

    def force(self, shape: Shape) -> Array:
        """Net force (3,) N on the sheet."""
        return shape.traction @ self.node_area

    # -- one frame
    # --------------------------------------------------------------------------------

    def estimate(
        self,
        markers: Markers,
        rest: InverseRest,
        start: Shape | None = None,
        *,
        camera: CameraBelief | CameraSeen | None = None,
        lost: bool = False,
    ) -> Shape:
        """Tractions and deformation that explain the markers, starting from the last frame's where
        there is one, with what is known of the `camera` (None: that nobody knocked it since
        `rest`). Where fiducials show it, markers are as they would be without its change. Some of a
        gas that no gauge measures may have been `lost`."""
        camera = camera or CameraBelief.unseen(self.settings)
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
            if isinstance(camera, CameraBelief):
                seen -= gain.modes @ camera.mean
            shape = self._step(c, markers, seen, rest, gain, steps)
            settled = float(np.abs(shape.c - c).max()) < SETTLED
            c = shape.c
            before = shape
            if settled and gain.reweighted >= REWEIGHTED:
                return shape
        return shape  # pyright: ignore[reportPossiblyUnboundVariable] the loop runs at least once

    def _step(
        self, c: Array, markers: Markers, seen: Array, rest: InverseRest, gain: Gain, count: int
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
            c,
            traction,
            pressure,
            float(misfit @ noise) / len(misfit),
            gain,
            count,
            excess,
            drift_of(drift, gain.drift_seen),
            drift[1:],
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
        camera: CameraBelief | CameraSeen,
        lost: bool,
    ) -> Gain:
        state = self._state(c, rest)
        ids = markers.ids
        _, stiffness = self.sheet.linearise(state, rest.gas)
        distrust = self._distrust(ids, before)
        weights, slope_weights, tilts = self._weights(c, markers, distrust)
        prior = self.prior.first() if before is None else self.prior.after(before.traction)
        prior *= np.tile(self._density, 3)
        pressure, load = self._gas_drift(state, rest, self._known.gas_lost if lost else None)
        rows = (3 if tilts is None else 5) * len(ids)
        half = np.empty((rows, 3 * len(self.nodes)))
        changed = darker(markers, rest)
        modes = self._camera_modes(self.positions(c)[ids], changed, camera)
        root = camera.root
        drift = np.zeros((rows, 1 + root.shape[1]))
        # slopes hardly see the camera move
        drift[: 3 * len(ids), 1:] = (weights @ modes @ root).reshape(3 * len(ids), -1)
        bulge_seen = np.empty(rows)
        kernel("inverse_gain")(
            *self._sight(stiffness, ids, weights, tilts),
            *self._nodes,
            prior,
            stiffness.solve(load),
            half,
            bulge_seen,
        )
        drift[:, 0] = bulge_seen
        innovation = half @ half.T + drift @ drift.T
        innovation[np.diag_indices_from(innovation)] += 1.0
        innovation = np.linalg.cholesky(innovation)
        known = drift.T @ cho_solve((innovation, True), drift, check_finite=False)
        seen = np.maximum(np.diagonal(known), 1e-6)
        return Gain(
            c,
            ids,
            stiffness,
            half,
            weights,
            slope_weights,
            tilts,
            distrust,
            drift,
            (pressure, load),
            seen,
            prior,
            innovation,
            0 if before is None else before.gain.reweighted + 1,
            ((rest.gas_sd is not None, rest.gas.constant is None), rest.gas_sd or 0.0),
            changed,
            camera,
            lost,
            modes,
            np.eye(len(known) - 1) - known[1:, 1:],
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
        self, p_SM: Array, changed: Array, camera: CameraBelief | CameraSeen
    ) -> Array:
        """How (m, 3, modes) m markers at `p_SM` (m, 3) move with one sd of the camera's modes."""
        if isinstance(camera, CameraBelief):
            return camera_modes(self.design, p_SM, changed, self.settings)
        return known_modes(self.design, p_SM, changed, self.settings, self._known)

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
            sd = math.hypot(rest.gas_sd, self.settings.dent_share * change * pressure)
            return sd, sd * state.gradient
        dent = self.sheet.state(rest.c).volume - state.volume
        drift = self.settings.drift_gas if lost is None else lost
        share = float(np.hypot(drift, self.settings.dent_share * dent / volume))
        pressure *= share if rest.gas.constant is not None else 0.0
        return pressure, pressure * state.gradient

    # -- what it means
    # --------------------------------------------------------------------------------

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
        felt = Felt(
            force,
            change,
            self.node_area @ moved / (self.node_area.sum() * max(seconds, 1e-3)),
            float(shape.excess[0].mean()),
            air_moved,
            lag,
        )
        cov = self._posterior(shape, positions)
        cov[np.diag_indices(6)] += self._doubt.variance(felt)
        return Traction(self.x, self.y, nodal, wrench, cov, shape.pressure_gauge, method="inverse")

    def _on_grid(self, force: Array) -> Array:
        """Forces (3, J) N of the nodes on the regular grid of `Traction`, (ny, nx, 3): those of a
        node that stands between its lines are shared so that sum and place stay."""
        nodal = np.zeros((len(self.y), len(self.x), 3))
        if self._shared is None:
            inner = force.reshape(3, len(self.x) - 2, len(self.y) - 2)
            nodal[1:-1, 1:-1] = inner.transpose(2, 1, 0)
            return nodal
        for rows, columns, share in self._shared:
            np.add.at(nodal, (rows, columns), share[:, None] * force.T)
        return nodal

    def _sharing(self) -> list[tuple[NDArray[np.int64], NDArray[np.int64], Array]] | None:
        """Rows, columns and shares (J,) of the four grid places around each node; None where nodes
        stand on the grid."""
        if self.design.frame.outline is None:
            return None
        places = []
        for lines, at in zip((self.x, self.y), self.nodes.T, strict=True):
            step = (at - lines[0]) / (lines[1] - lines[0])
            first = np.clip(step.astype(np.int64), 0, len(lines) - 2)
            places.append(((first, 1 - step + first), (first + 1, step - first)))
        return [(row, column, by * bx) for column, bx in places[0] for row, by in places[1]]

    def node_positions(self, c: Array) -> Array:
        """Where the nodes are now, (J, 3) m in S."""
        return self._flat_nodes + self._at_nodes @ c.T

    def fine_positions(self, c: Array) -> Array:
        """Where the points of the fine grid are now, (3, a, b) m in S."""
        moved = self._at_fine[0] @ c.reshape(3, *self.sheet.shape) @ self._at_fine[1].T
        moved[:2] += self._fine
        return moved

    def pressing_at_points(self, shape: Shape) -> Array:
        """Force per cell of the sheet's Gauss points (qx, qy) with which the outside presses, N;
        never negative."""
        hat_x, hat_y = self._hats
        pressure = np.maximum(-shape.traction[2], 0.0) * self._density
        pressure = pressure.reshape(hat_x.shape[1], hat_y.shape[1])
        return self.sheet.cells * (hat_x @ pressure @ hat_y.T)

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
        scale = np.sqrt(self.posterior_share(shape))
        return cov * np.outer(scale, scale)

    def posterior_share(self, shape: Shape) -> Array:
        """Share (6,) of the wrench's predicted variances: more where markers misfit or show
        drift."""
        return np.maximum(max(1.0, shape.misfit) * self._posterior_share, shape.drift - 1)


def _net(force: Array, positions: Array) -> Array:
    """Net force and torque (6,) about the origin of forces (3, J) at `positions` (J, 3)."""
    M = force @ positions
    return np.array([*force.sum(axis=1), M[2, 1] - M[1, 2], M[0, 2] - M[2, 0], M[1, 0] - M[0, 1]])
