"""Virtual test bench of a sensor file: quasi-static membrane, exact view, sensing pipeline."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag, cho_solve

from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.status import OK
from mjtactile.core.types import Array, Markers, SyntheticEllipses, Touch
from mjtactile.quasistatic import MembraneSolution, Obstacle, QuasistaticMembrane
from mjtactile.quasistatic.interpolation import interpolation_matrix_with_gradient
from mjtactile.sensing.force.inverse_fem import InverseMembrane
from mjtactile.sensing.force.linearization import Shape
from mjtactile.sensing.pipeline import SensingPipeline
from mjtactile.sensing.pipeline_state import PipelineState, Reference
from mjtactile.sim.rendering.synthetic_ellipses import EllipseSampler

_SPACING = 1.3e-3  # node spacing of the membrane, m, as in the contact shape models
_STEP = 2.5e-4  # step of lowering an obstacle until the requested force, m
_SHORTEST = 8  # maximum division of a step where the solver does not converge
_HALVINGS = 12
_OFF = 0.02  # maximum relative force error where the force does not converge
_DEEPEST = 0.05  # maximum depth, m
_IMAGE = 1 / 30  # image period, s


@dataclass(frozen=True, eq=False)
class IndentedMembrane:
    """Equilibrium `state` of the membrane on an obstacle at `height` m."""

    state: MembraneSolution
    height: float


ObstacleAtDepth = Callable[[float], Obstacle]
"""Obstacle as a function of the height of its reference point, m in S."""


@dataclass(frozen=True, eq=False)
class PredictedTouch:
    """`touch` of an image of the equilibrium, and the pipeline's `state` after it."""

    touch: Touch
    state: PipelineState

    @property
    def shape(self) -> Shape:
        """Estimated shape; only if the touch is "ok"."""
        assert self.state.shape is not None
        return self.state.shape

    @property
    def ok(self) -> bool:
        """True if the sensing pipeline estimated the force."""
        return self.touch.status == OK and self.touch.traction is not None


class VirtualBench:
    """One sensor at rest, with exact references.

    Args:
        design: The sensor.

    Raises:
        InputError: The membrane has no rest equilibrium, markers are outside of the image, or the
            sensing pipeline rejects the sensor.
    """

    def __init__(self, design: SensorDesign):
        self.design = design
        sides = (design.frame.length, design.frame.width)
        columns, rows = (max(round(side / _SPACING) + 1, 9) for side in sides)
        self.membrane = QuasistaticMembrane(design, (columns, rows))
        self.pipeline = SensingPipeline(design)
        self._by_node = interpolation_matrix_with_gradient(
            self.membrane, design.markers.p_SM[:, :2]
        )
        self._sampler = EllipseSampler(design)
        flat = self._sampler.sample(*self.poses(np.zeros_like(self.membrane.rest.x)), errors=False)
        self._require_all(flat, "flat")
        rest = self.sample(self.membrane.rest)
        self._require_all(rest, "inflated")
        state = self.pipeline.measure_flat_reference(self.pipeline.initial_state(), [flat])
        self.state = self.pipeline.measure_rest_reference(
            state, [rest], self.membrane.gauge_pressure
        )

    def _require_all(self, rendered: SyntheticEllipses, state: str) -> None:
        """Raise InputError if not all markers are in the image."""
        found = 0 if rendered.ellipses is None else len(rendered.ellipses)
        if found < self.circles:
            count = f"only {found} of {self.circles} circles"
            message = f"{count} lie completely in the image while the membrane is {state}"
            raise InputError(message, source=self.design.name, field="camera.fx_px")

    @property
    def circles(self) -> int:
        """Number of circles in the image: markers and fiducials."""
        fixed = self.design.fiducials
        return self.design.markers.count + (0 if fixed is None else fixed.count)

    @property
    def reference(self) -> Reference:
        """Rest reference measured by the sensing pipeline."""
        assert self.state.reference is not None
        return self.state.reference

    # -- indentation

    def press(self, obstacle: ObstacleAtDepth, force: float) -> IndentedMembrane | None:
        """Lower an obstacle until it indents the membrane with a force.

        Args:
            obstacle: Obstacle as a function of its height, m in S.
            force: Indenting force, N.

        Returns:
            The indented membrane; None: it does not carry the force.
        """
        low = high = self.first_touch(obstacle)
        state = None
        step = _STEP
        while state is None or state.force_normal < force:
            further = self._solve(obstacle(low - step), state)
            if further is None:
                step /= 2
                if step < _STEP / _SHORTEST:
                    return None
                continue
            state = further
            high = low
            low -= step
            if low < -_DEEPEST:
                return None
        above = None
        for _ in range(_HALVINGS):
            midpoint = (low + high) / 2
            found = self._solve(obstacle(midpoint), state if above is None else above)
            if found is None:
                break
            if found.force_normal < force:
                high = midpoint
                above = found
            else:
                low = midpoint
                state = found
        force_error = abs(state.force_normal - force)
        return IndentedMembrane(state, low) if force_error < _OFF * force else None

    def indent(self, obstacle: ObstacleAtDepth, depth: float) -> IndentedMembrane | None:
        """Lower an obstacle to a depth below first contact.

        Args:
            obstacle: Obstacle as a function of its height, m in S.
            depth: Depth, m.

        Returns:
            The indented membrane; None: it has no solution there.
        """
        start = self.first_touch(obstacle)
        state = None
        for part in np.linspace(0.0, depth, math.ceil(depth / _STEP) + 1)[1:].tolist():
            state = self._solve(obstacle(start - part), state)
            if state is None:
                return None
        return None if state is None else IndentedMembrane(state, start - depth)

    def _solve(self, obstacle: Obstacle, start: MembraneSolution | None) -> MembraneSolution | None:
        """Solve on an obstacle from `start`, without its trend, or from rest; None: no state."""
        starts = [start] if start is None else [start, replace(start, trend=None), None]
        for initial in starts:
            try:
                state = self.membrane.solve(obstacle, initial)
            except InputError:  # contact with frame or glass, or an inverted membrane
                continue
            if state.converged:
                return state
        return None

    def first_touch(self, obstacle: ObstacleAtDepth) -> float:
        """Return the obstacle's height at first contact with the membrane at rest, m."""
        x, y = np.meshgrid(self.membrane.x, self.membrane.y, indexing="ij")
        nodes = np.column_stack([x.ravel(), y.ravel()])
        under = self.membrane.obstacle_heights(obstacle(0.0), nodes)
        return float((self.membrane.rest.heights.ravel() - under).max())

    # -- markers and tactile estimates

    def poses(self, x: Array) -> tuple[Array, Array]:
        """Return the markers' positions and normals, (N, 3) in S, displaced by `x` (3, nx, ny)."""
        moved, by_x, by_y = self._by_node @ x.reshape(3, -1).T
        normal = np.cross(by_x + [1.0, 0.0, 0.0], by_y + [0.0, 1.0, 0.0])
        p_SM = self.design.markers.p_SM + moved
        return p_SM, normal / np.linalg.norm(normal, axis=1)[:, None]

    def heights(self, x: Array) -> Array:
        """Return the markers' heights (n, N), m, for displacements `x` (n, 3, nx, ny)."""
        return x[:, 2].reshape(len(x), -1) @ self._by_node[0].T

    def sample(self, membrane: MembraneSolution, time: float = 0.0) -> SyntheticEllipses:
        """Compute the exact ellipses in the camera image of a membrane solution."""
        return self._sampler.sample(*self.poses(membrane.x), time, errors=False)

    def detect_markers(self, membrane: MembraneSolution) -> Markers:
        """Compute the markers detected by the sensing pipeline, with their covariance."""
        return self.pipeline.detect_markers(self.state, self.sample(membrane))[0]

    def estimate_touch(self, membrane: MembraneSolution) -> PredictedTouch:
        """Run the sensing pipeline on a membrane in equilibrium.

        The second image is evaluated, since the covariance after a sudden load change is inflated.
        """
        state = self.state
        for image in (1, 2):
            time = image * _IMAGE
            touch, state = self.pipeline.step(state, self.sample(membrane, time), time)
        return PredictedTouch(touch, state)  # pyright: ignore[reportPossiblyUnboundVariable] the loop runs

    def noise(self, estimated: PredictedTouch) -> Array:
        """Return the covariance (3, 3) N^2 of the force from pixel noise: image to image.

        The pipeline's tractions are linear in the whitened markers: traction = P^(1/2) half^T
        innovation^-1 y (docs/theory/membrane_inverse.md, Eq. F12). The covariance of y is the
        camera's error bound for the markers, whitened in the same manner. It applies to a single
        image. The pipeline's memory of the camera from earlier images reduces it by up to half.
        """
        assert estimated.touch.markers is not None
        gain = estimated.shape.gain
        to_force = net_force(self.pipeline.inverse, gain.prior) @ gain.half.T
        by_marker = cho_solve((gain.innovation, True), to_force.T).T
        noise_cov = gain.weights @ estimated.touch.markers.cov_p @ gain.weights.transpose(0, 2, 1)
        slopes = len(gain.half) - 3 * len(noise_cov)  # whitened: unit variances
        noise = block_diag(*noise_cov, np.eye(slopes)) if slopes else block_diag(*noise_cov)
        return by_marker @ noise @ by_marker.T

    def level_noise(self) -> float:
        """Return the sd, N, of the running force level that detects light contacts."""
        blend = self.pipeline.settings.zero.blend
        sd = math.sqrt(self.noise(self.estimate_touch(self.membrane.rest))[2, 2])
        return sd * math.sqrt(blend / (2 - blend))


def net_force(inverse: InverseMembrane, prior: Array) -> Array:
    """Return the matrix (3, 3 J) from normalized nodal tractions to the net force.

    The tractions are normalized by the root of their prior.
    """
    root = np.kron(*inverse.prior.root)
    nodes = len(inverse.node_area)
    loads = (inverse.node_area * prior.reshape(3, nodes)) @ root
    rows = np.zeros((3, 3, nodes))
    rows[range(3), range(3)] = loads
    return rows.reshape(3, -1)
