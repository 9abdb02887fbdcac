"""Contact area between the membrane and an estimated shape (docs/theory/contact_shape.md, Eq.
F20)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mjtactile.core.normal_distribution import normal_cdf_of
from mjtactile.core.types import Array
from mjtactile.quasistatic import MembraneSolution
from mjtactile.quasistatic.solution import TENSION
from mjtactile.sensing.contact_shape.forward_model import SUM_AREA, ForwardModel
from mjtactile.sensing.contact_shape.gauss_newton import Fit
from mjtactile.sensing.contact_shape.primitives import InitialGuess
from mjtactile.sensing.contact_shape.shape_filter import touching
from mjtactile.sensing.contact_shape.shape_models import ShapeModel, face_of
from mjtactile.sensing.settings import ContactShapeSettings

_INTERVAL = (0.16, 0.84)
_INTERVAL_SD = 0.9944579  # their distance from the mean, standard deviations
_LIKELY = 1e-3  # minimum probability of a family that contributes to an interval
FACES = ("disc", "block")
# Relative growth of a fitted face with a sharp rim, and with one as round as a superquadric's;
# standard deviation of both
_GROWTH = (-0.06, 0.09, 0.05)
_ROUND_LOG_ODDS = -1.7  # before the growth is known: 15 %
_ROUND_SD = 0.1  # relative, of the contact area with a round rim
_CERTAIN = 20.0
_WHOLE = 0.9  # minimum area of a face that touches as a whole, over its nominal area
_SLOPES = (0.02, 1.2)  # slope of the membrane at a rim: minimum, maximum
_FINE = 1.5  # ratio of the vertex spacing to that of the calibration up to which all are resolved
_CELLS = 15  # minimum cells of a coarse simulated mesh in a contact whose kind is resolved
_FACE_MIN = 0.5  # minimum fraction of an estimated face area that remains after the rim correction


def areas(forward: ForwardModel, found: Fit, s: ContactShapeSettings) -> list[float]:
    """Return the contact area of each part of the shape, m^2."""
    family = found.family
    if not family.parts:
        return [state_area(forward, found.state, family, found.theta, found.hint, s)]
    carried = shares(forward, found)
    thetas = family.split(found.theta)
    return [
        state_area(forward, found.state, part, theta, hint, s, fraction)
        for part, theta, hint, fraction in zip(
            family.parts, thetas, found.hint.parts, carried, strict=True
        )
    ]


def shares(forward: ForwardModel, found: Fit) -> list[float]:
    """Return the fraction of the force on each part of a shape."""
    return found.once("shares", lambda: _shares(forward, found))


def _shares(forward: ForwardModel, found: Fit) -> list[float]:
    force = found.state.contact_forces
    nearest = nearest_part(forward, found)
    total = max(float(force.sum()), 1e-9)
    count = len(found.family.parts)
    return [float(force[nearest == part].sum()) / total for part in range(count)]


def nearest_part(forward: ForwardModel, found: Fit) -> Array:
    """Return the index of the nearest part for each node (nx, ny)."""
    return found.once("nearest", lambda: _nearest_part(forward, found))


def _nearest_part(forward: ForwardModel, found: Fit) -> Array:
    x, y = _positions(forward, found)
    middles = [
        hint.position + 1e-3 * theta[:2]
        for theta, hint in zip(found.family.split(found.theta), found.hint.parts, strict=True)
    ]
    return np.argmin([np.hypot(x - at[0], y - at[1]) for at in middles], axis=0)


def _positions(forward: ForwardModel, found: Fit) -> tuple[Array, Array]:
    moved = found.state.displacements
    return forward.nodes[0] + moved[0], forward.nodes[1] + moved[1]


def state_area(
    forward: ForwardModel,
    state: MembraneSolution,
    family: ShapeModel,
    theta: Array,
    hint: InitialGuess,
    s: ContactShapeSettings,
    share: float = 1.0,
) -> float:
    """Return the contact area of one part, m^2, that carries the fraction `share` of the force.

    For a flat face, use the fraction of the face with touching nodes. The fitted rim is rounded; a
    steep membrane leaves the sharp rim farther outward than a flat one. For a round shape, use
    the area of the membrane model, which has uniform tension. Correct it for the stretch of the
    membrane.
    """
    if family.name in FACES:
        distance, face_area = face_of(family, theta, hint, state.displacements[:2])
        within = np.clip(0.5 - distance / forward.spacing, 0.0, 1.0)
        lies = float(within[state.contact_forces > 0].sum())
        area = face_area * lies / max(float(within.sum()), 1e-9)
        rim = rim_length(family, theta)
        steep = slope_at_rim(share * state.force_normal, area, rim, state)
        out = (s.rim_slope * steep - s.rim_in) * hint.rounding
        return area * max(1 + out * rim / area, _FACE_MIN) if area > 0 else 0.0
    stretched = state.found[TENSION] / forward.membrane.rest.found[TENSION] - 1
    ratio = s.area_light + s.area_stretched * min(max(stretched, 0.0), s.stretched_max)
    return share * ratio * state.area


def rim_length(family: ShapeModel, theta: Array) -> float:
    """Return the length of a face's rim, m."""
    if family.name == "disc":
        return 2e-3 * math.pi * float(theta[5])
    return 4e-3 * float(theta[6] + theta[7])


def slope_at_rim(force: float, area: float, rim: float, state: MembraneSolution) -> float:
    """Compute the mean sine of the membrane's slope angle at the rim (length `rim`, m) of a face
    from the force balance: the membrane tension there carries the force that gas pressure on the
    face does not. It is clipped to the range that a membrane can have."""
    excess = force - state.gauge_pressure * area
    slope = excess / max(float(state.found[TENSION]) * rim, 1e-9)
    return min(max(slope, _SLOPES[0]), _SLOPES[1])


def area_sd(found: Fit, area: float, noise: float, s: ContactShapeSettings) -> float:
    """Return the standard deviation of an area, m^2, from the covariance of the parameters and the
    error of membrane and shape model. Marker variances are multiplied by `noise`."""
    if found.family.name in FACES:
        half = found.theta[5:] if found.family.name == "disc" else found.theta[6:8]
        indices = np.arange(len(found.theta) - len(half), len(found.theta))
        cov = found.cov_with(noise)[np.ix_(indices, indices)]
        by = (2 if found.family.name == "disc" else 1) * area / half
        known = float(by @ cov @ by)
        rim_sd = s.mesh_ratio * s.rim_sd * found.hint.rounding
        model = rim_sd * rim_length(found.family, found.theta)
    else:
        known = float(found.sums_cov_with(noise)[SUM_AREA, SUM_AREA])
        by_node = s.mesh_ratio**2 * s.area_by_node / touching(found)
        model = math.hypot(s.area_sd, by_node) * area
    return math.hypot(math.sqrt(max(known, 0.0)), model)


def rim_areas(
    found: Fit, growth: tuple[float, float], p: float, area: float, sd: float
) -> list[tuple[float, float, float]]:
    """Return the contact areas of a face with a sharp and with a round rim, the likelier first.
    Each has its probability, out of `p`, and its standard deviation, m^2. `area` and `sd` are those
    of the sharp rim. On a round one, contact spreads with depth, and the fitted face grows by the
    relative `growth` (and its variance). The area of the membrane model includes the rim. On a
    tilted face that touches in part, contact spreads as well, and nothing is known of the rim."""
    mean, variance = growth
    name, theta = found.family.name, found.theta
    if name not in FACES or not math.isfinite(variance):
        return [(p, area, sd)]
    face = math.pi * theta[5] ** 2 if name == "disc" else 4 * theta[6] * theta[7]
    if area < _WHOLE * 1e-6 * face:
        return [(p, area, sd)]
    low, high, spread = _GROWTH
    square = variance + spread**2
    log_odds = ((mean - low) ** 2 - (mean - high) ** 2) / (2 * square) + _ROUND_LOG_ODDS
    is_round = 1 / (1 + math.exp(-min(max(log_odds, -_CERTAIN), _CERTAIN)))
    spreads = found.state.area
    rims = [(p * (1 - is_round), area, sd), (p * is_round, spreads, _ROUND_SD * spreads)]
    return sorted(rims, reverse=True)


def resolves_kind(area: float, s: ContactShapeSettings) -> bool:
    """Return True unless a contact of `area`, m^2, covers few cells of a coarse simulated mesh. An
    egg touches at so few vertices that it resembles a small disc."""
    return s.mesh_ratio <= _FINE or not area < _CELLS * s.mesh_spacing**2


def interval(bodies: Sequence[tuple[float, float, float]]) -> tuple[float, float]:
    """Return the 68 % interval of an area, m^2, over all candidate shapes, each with probability,
    area and its standard deviation."""
    likely = [body for body in bodies if body[0] > _LIKELY]
    if len(likely) == 1:
        _, area, sd = likely[0]
        low, high = (max(area + sd * end, 0.0) for end in (-_INTERVAL_SD, _INTERVAL_SD))
        return low, high
    p, area, sd = np.array(likely).T
    sd = np.maximum(sd, 1e-9)
    low = float((area - 4 * sd).min())
    high = float((area + 4 * sd).max())
    grid = np.linspace(max(0.0, low), high, 128)
    fraction = (p * normal_cdf_of((grid[:, None] - area) / sd)).sum(axis=1) / p.sum()
    ends = np.interp(_INTERVAL, fraction, grid)
    return float(ends[0]), float(ends[1])
