"""How much of the sheet lies on a body that was found (docs/theory/contact_shape.md, Eq. F20)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mjtactile.core.types import Array
from mjtactile.quasistatic import MembraneSolution
from mjtactile.quasistatic.solution import TENSION
from mjtactile.sensing.contact_shape.forward_model import SUM_AREA, ForwardModel
from mjtactile.sensing.contact_shape.gauss_newton import Fit
from mjtactile.sensing.contact_shape.primitives import InitialGuess
from mjtactile.sensing.contact_shape.shape_filter import touching
from mjtactile.sensing.contact_shape.shape_models import ShapeModel, face_of
from mjtactile.sensing.contact_shape.stiction_factor import sticks
from mjtactile.sensing.settings import ContactShapeSettings

_INTERVAL = (0.16, 0.84)
_LIKELY = 1e-3  # probability, below which a family has no part in an interval
FACES = ("disc", "block")
_SLOPES = (0.02, 1.2)  # of a sheet at a rim: least, most
_FACE_MIN = 0.5  # of a face that was found, that may be left of it


def areas(forward: ForwardModel, found: Fit, s: ContactShapeSettings) -> list[float]:
    """Area, m^2, of each of the bodies (of the one that there is).

    Args:
        forward: The film.
        found: The body, or bodies.
        s: Settings.

    Returns:
        An area for each part.
    """
    family = found.family
    if not family.parts:
        return [_area(forward, found, family, found.theta, found.hint, 1.0, s)]
    carried = shares(forward, found)
    thetas = family.split(found.theta)
    return [
        _area(forward, found, part, theta, hint, share, s)
        for part, theta, hint, share in zip(
            family.parts, thetas, found.hint.parts, carried, strict=True
        )
    ]


def shares(forward: ForwardModel, found: Fit) -> list[float]:
    """Of several bodies, each one's part of the force."""
    force = found.state.contact_forces
    nearest = nearest_part(forward, found)
    total = max(float(force.sum()), 1e-9)
    count = len(found.family.parts)
    return [float(force[nearest == place].sum()) / total for place in range(count)]


def nearest_part(forward: ForwardModel, found: Fit) -> Array:
    """Which of several bodies each node (nx, ny) is nearest to."""
    x, y = _places(forward, found)
    middles = [
        hint.place + 1e-3 * theta[:2]
        for theta, hint in zip(found.family.split(found.theta), found.hint.parts, strict=True)
    ]
    return np.argmin([np.hypot(x - at[0], y - at[1]) for at in middles], axis=0)


def _places(forward: ForwardModel, found: Fit) -> tuple[Array, Array]:
    moved = found.state.displacements
    return forward.nodes[0] + moved[0], forward.nodes[1] + moved[1]


def _area(
    forward: ForwardModel,
    found: Fit,
    family: ShapeModel,
    theta: Array,
    hint: InitialGuess,
    share: float,
    s: ContactShapeSettings,
) -> float:
    """Of a flat face, what of it has nodes that touch; of what is round, the film's own, as far as
    one tension would have it, by how much the sheet is stretched."""
    state = found.state
    if family.name in FACES:
        off, whole = face_of(family, theta, hint, state.displacements[:2])
        within = np.clip(0.5 - off / forward.spacing, 0.0, 1.0)
        lies = float(within[state.contact_forces > 0].sum())
        area = whole * lies / max(float(within.sum()), 1e-9)
        rim = rim_length(family, theta)
        steep = slope_at_rim(share * state.force_normal, area, rim, state)
        out = _rim_out(steep, sticks(forward, state, s) - s.friction, s) * hint.rounding
        return area * max(1 + out * rim / area, _FACE_MIN) if area > 0 else 0.0
    stretched = state.found[TENSION] / forward.film.rest.found[TENSION] - 1
    ratio = s.area_light + s.area_stretched * min(max(stretched, 0.0), s.stretched_max)
    return share * ratio * state.area


def rim_length(family: ShapeModel, theta: Array) -> float:
    """Of a face's rim, m."""
    if family.name == "disc":
        return 2e-3 * math.pi * float(theta[5])
    return 4e-3 * float(theta[6] + theta[7])


def slope_at_rim(force: float, area: float, rim: float, state: MembraneSolution) -> float:
    """By how much the sheet goes up from a face at its rim, from how it is borne: what gas does not
    press on the face, the sheet's tension draws to the rim.

    Args:
        force: N on the face.
        area: m^2 of it.
        rim: Its length, m.
        state: Of the film.

    Returns:
        The mean sine of the angle, within what a film bears.
    """
    drawn = force - state.gauge_pressure * area
    slope = drawn / max(float(state.found[TENSION]) * rim, 1e-9)
    return min(max(slope, _SLOPES[0]), _SLOPES[1])


def _rim_out(slope: float, stuck: float, s: ContactShapeSettings) -> float:
    """By how many roundings a sharp rim is outside of the one that was found.

    The found one is round: a sheet that goes up steeply leaves it farther out than a flat one, and
    more so beside the frame, where it sticks and is steeper than the film.
    """
    return s.rim_slope * slope + s.rim_stuck * stuck - s.rim_in


def area_sd(found: Fit, area: float, noise: float, s: ContactShapeSettings) -> float:
    """Standard deviation, m^2, of an area: by the numbers' covariance, and what film and family
    leave.

    Args:
        found: The body.
        area: m^2.
        noise: Factor on the markers' variances.
        s: Settings.

    Returns:
        The standard deviation.
    """
    if found.family.name in FACES:
        half = found.theta[5:] if found.family.name == "disc" else found.theta[6:8]
        places = np.arange(len(found.theta) - len(half), len(found.theta))
        cov = found.cov_with(noise)[np.ix_(places, places)]
        by = (2 if found.family.name == "disc" else 1) * area / half
        known = float(by @ cov @ by)
        model = s.rim_sd * found.hint.rounding * rim_length(found.family, found.theta)
    else:
        known = float(found.sums_cov_with(noise)[SUM_AREA, SUM_AREA])
        model = math.hypot(s.area_sd, s.area_by_node / touching(found)) * area
    return math.hypot(math.sqrt(max(known, 0.0)), model)


def interval(bodies: Sequence[tuple[float, float, float]]) -> tuple[float, float]:
    """68 % interval, m^2, of an area over all bodies that may be.

    Args:
        bodies: Of each the probability, the area and its standard deviation.

    Returns:
        Its ends.
    """
    from scipy.special import ndtr  # takes a while to import

    likely = [body for body in bodies if body[0] > _LIKELY]
    p, area, sd = np.array(likely).T
    sd = np.maximum(sd, 1e-9)
    low = float((area - 4 * sd).min())
    high = float((area + 4 * sd).max())
    grid = np.linspace(max(0.0, low), high, 400)
    share = (p * ndtr((grid[:, None] - area) / sd)).sum(axis=1) / p.sum()
    ends = np.interp(_INTERVAL, share, grid)
    return float(ends[0]), float(ends[1])
