"""Resolution at one position: sd of force and its position, an edge's, and a ball's radius."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mjtactile.core.errors import InputError
from mjtactile.core.types import Array, Touch
from mjtactile.design_study.virtual_bench import ObstacleAtDepth, VirtualBench
from mjtactile.quasistatic import Obstacle, obstacle
from mjtactile.sensing.contact_shape.fit_state import Data, Prior, Problem
from mjtactile.sensing.contact_shape.forward_model import ForwardModel
from mjtactile.sensing.contact_shape.gauss_newton import Fit
from mjtactile.sensing.contact_shape.jacobian import exact_jacobian
from mjtactile.sensing.contact_shape.primitives import InitialGuess, feasible_half_extents
from mjtactile.sensing.contact_shape.shape_models import FAMILIES, ShapeModel
from mjtactile.sensing.contact_shape.shape_result import reported_covariance

EDGE_RADIUS = 2.5e-3
"""Rounding radius of an edge, m; a sharper edge would separate the membrane from its faces."""
BALL_RADIUS = 4e-3
"""Radius of the indenting ball, m."""
_ROUNDING = 0.5  # rounding radius as a fraction of the membrane's node spacing
_FRAME = 1.5e-3  # distance from the frame at which extended shapes end, m


@dataclass(frozen=True)
class Resolution:
    """Predicted resolution at one position; NaN: not defined there.

    Attributes:
        x: Position in S, m.
        y: Position in S, m.
        force: Indenting force, N.
        estimated: Force estimated by the sensing pipeline, N.
        force_sd: Standard deviation reported by the sensing pipeline, including all model errors,
            N.
        noise: Image-to-image noise of the estimated force from pixel noise alone, N.
        position_sd: Standard deviation of the force's position, the larger of both directions, m.
        edge_sd: Standard deviation of the position of an edge along y or x, the larger of both, m.
        height: Height of the ball's lowest point in S, m. The force's position refers to its plane,
            since a sticking membrane presses straight down.
    """

    x: float
    y: float
    force: float
    estimated: float
    force_sd: float
    noise: float
    position_sd: float
    edge_sd: float
    height: float


class ResolutionPredictor:
    """Predictor of the resolution of the sensor on the `stand`."""

    def __init__(self, stand: VirtualBench):
        self.stand = stand
        self._settings = stand.pipeline.settings
        rest = stand.reference.first
        self._forward = ForwardModel(stand.design, rest, self._settings.contact_shape.spacing)
        self._frame = stand.design.frame
        self._sides = feasible_half_extents(self._frame, _FRAME)

    def at(self, position: Array, force: float, *, edges: bool = True) -> Resolution:
        """Predict the resolution for a ball, or an edge, that is loaded with a force.

        Args:
            position: Position (2,) m in S.
            force: Indenting force, N.
            edges: True if the edge's position is requested.

        Returns:
            The resolution; NaN for loads that the sensor cannot carry or estimate there.
        """
        x, y = (float(v) for v in position)
        unknown = math.nan
        # outside of a frame that is not a rectangle
        if self._frame.inside(position[None])[0] < _FRAME:
            return Resolution(x, y, force, *[unknown] * 6)
        edge_sd = self.edge_sd(position, force) if edges else unknown
        pressed = self.stand.press(ball(position, BALL_RADIUS), force)
        estimated = None if pressed is None else self.stand.estimate_touch(pressed.state)
        if (
            pressed is None
            or estimated is None
            or estimated.touch.traction is None
            or not estimated.ok
        ):
            return Resolution(x, y, force, unknown, unknown, unknown, unknown, edge_sd, unknown)
        wrench = estimated.touch.traction.wrench
        cov = estimated.touch.traction.wrench_cov
        noise = math.sqrt(self.stand.noise(estimated)[2, 2])
        height = pressed.height
        spread = position_sd(wrench, cov, height)
        sd = math.sqrt(cov[2, 2])
        return Resolution(x, y, force, -float(wrench[2]), sd, noise, spread, edge_sd, height)

    def edge_sd(self, position: Array, force: float) -> float:
        """Predict the standard deviation, m, of the position of an edge across the face.

        It is the larger of the values for edges along x and along y.

        Args:
            position: Position (2,) m in S on the edge.
            force: Indenting force, N.

        Returns:
            The standard deviation; NaN where the sensor does not carry the force.
        """
        sds = []
        for across, direction in ((1, 0.0), (0, math.pi / 2)):
            theta = np.array([0.0, 0.0, 0.0, 1 / EDGE_RADIUS, direction, 0.0])
            cov = self._parameter_cov(FAMILIES["cylinder"], theta, position, force)
            if cov is None:
                return math.nan
            sds.append(1e-3 * math.sqrt(cov[across, across]))
        return max(sds)

    def radius_sd(self, radius: float, position: Array, force: float) -> float:
        """Predict the relative standard deviation of a ball's radius.

        Args:
            radius: Radius, m.
            position: Position (2,) m in S.
            force: Indenting force, N.

        Returns:
            The ratio; NaN where the sensor does not carry the force.
        """
        theta = np.array([0.0, 0.0, 0.0, 1 / radius])
        cov = self._parameter_cov(FAMILIES["ball"], theta, position, force)
        return math.nan if cov is None else radius * math.sqrt(cov[3, 3])

    def _parameter_cov(
        self, family: ShapeModel, theta: Array, position: Array, force: float
    ) -> Array | None:
        """Return the covariance (k, k) of a loaded shape's parameters (Eq. F18-F20)."""
        over = self._hint(position, force)

        def obstacle_at(height: float) -> Obstacle:
            return family.build(theta, replace(over, height=height))[0]

        pressed = self.stand.press(obstacle_at, force)
        if pressed is None:
            return None
        hint = replace(over, height=pressed.height)
        markers = self.stand.detect_markers(pressed.state)
        data = self._data(Touch(0.0, 0.0, force, 0.0, True, markers=markers))
        prior = Prior(theta / family.sd, np.eye(len(theta)))
        problem = Problem(self._forward, family, hint, data, prior)
        try:
            at = problem.fit_state(theta, pressed.state)
            if at is None:
                return None
            slopes = exact_jacobian(problem, at)
        except InputError:  # a parameter step reaches the frame
            return None
        s = self._settings.contact_shape
        return reported_covariance(Fit.of(problem, at, slopes), s.noise_min, s)

    def _data(self, touch: Touch) -> Data:
        inverse = self._settings.inverse
        drift = (inverse.drift_gas, inverse.drift_camera)
        raised = np.zeros(self.stand.design.markers.count)
        return Data.of(touch, raised, self._forward.by_gas, self._settings.contact_shape, drift)

    def _hint(self, position: Array, force: float) -> InitialGuess:
        """Return the reference of the shape's parameters, except for its height."""
        rounding = _ROUNDING * self._forward.spacing
        in_round = self._frame.outline is not None
        return InitialGuess(
            position,
            0.0,
            0.0,
            0.0,
            self._sides,
            self._forward.nodes,
            rounding,
            force,
            round=in_round,
        )


def ball(at: Array, radius: float) -> ObstacleAtDepth:
    """Return a ball above a position, as a function of the height of its lowest point.

    Args:
        at: Position (2,) m in S.
        radius: Radius, m.

    Returns:
        The obstacle at a height.
    """
    return lambda height: obstacle("sphere", (radius,), (*at, height + radius))


def position_sd(wrench: Array, cov: Array, height: float) -> float:
    """Compute the standard deviation, m, of a wrench's position on the plane z = `height` m.

    The position is x = (z Fx - My) / Fz and y = (z Fy + Mx) / Fz. The larger of both is returned.

    Args:
        wrench: Wrench (6,) N, N m about the origin of S.
        cov: Covariance (6, 6) of the wrench.
        height: Height of the plane, m.

    Returns:
        The standard deviation.
    """
    normal = wrench[2]
    x = (height * wrench[0] - wrench[4]) / normal
    y = (height * wrench[1] + wrench[3]) / normal
    of_x = np.array([height, 0.0, -x, 0.0, -1.0, 0.0]) / normal
    of_y = np.array([0.0, height, -y, 1.0, 0.0, 0.0]) / normal
    return math.sqrt(max(of_x @ cov @ of_x, of_y @ cov @ of_y))
