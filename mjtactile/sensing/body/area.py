"""How much of the sheet lies on a body that was found (docs/equations.md, Eq. F20)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mjtactile.core.types import Array
from mjtactile.film.state import TENSION
from mjtactile.sensing.body.bodies import Hint
from mjtactile.sensing.body.families import Family, face_of
from mjtactile.sensing.body.fit import Fit
from mjtactile.sensing.body.forward import SUM_AREA, Forward
from mjtactile.sensing.settings import BodySettings

_INTERVAL = (0.16, 0.84)
_LIKELY = 1e-3  # probability, below which a family has no part in an interval
FACES = ("disc", "block")


def areas(forward: Forward, found: Fit, s: BodySettings) -> list[float]:
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


def shares(forward: Forward, found: Fit) -> list[float]:
    """Of several bodies, each one's part of the force."""
    force = found.state.contact_forces
    nearest = nearest_part(forward, found)
    total = max(float(force.sum()), 1e-9)
    count = len(found.family.parts)
    return [float(force[nearest == place].sum()) / total for place in range(count)]


def nearest_part(forward: Forward, found: Fit) -> Array:
    """Which of several bodies each node (nx, ny) is nearest to."""
    x, y = _places(forward, found)
    middles = [
        hint.place + 1e-3 * theta[:2]
        for theta, hint in zip(found.family.split(found.theta), found.hint.parts, strict=True)
    ]
    return np.argmin([np.hypot(x - at[0], y - at[1]) for at in middles], axis=0)


def _places(forward: Forward, found: Fit) -> tuple[Array, Array]:
    moved = found.state.displacements
    return forward.nodes[0] + moved[0], forward.nodes[1] + moved[1]


def _area(
    forward: Forward,
    found: Fit,
    family: Family,
    theta: Array,
    hint: Hint,
    share: float,
    s: BodySettings,
) -> float:
    """Of a flat face, what of it has nodes that touch; of what is round, the film's own, as far as
    one tension would have it, by how much the sheet is stretched."""
    state = found.state
    if family.name in FACES:
        off, whole = face_of(family, theta, hint, state.displacements[:2])
        within = np.clip(0.5 - off / forward.spacing, 0.0, 1.0)
        touching = float(within[state.contact_forces > 0].sum())
        area = whole * touching / max(float(within.sum()), 1e-9)
        pressed = share * state.force_normal / max(state.pressure_gauge * area, 1e-9)
        return area / too_large(pressed, s)
    stretched = state.found[TENSION] / forward.film.rest.found[TENSION] - 1
    ratio = s.area_light + s.area_stretched * min(max(stretched, 0.0), s.stretched_most)
    return share * ratio * state.area


def too_large(pressed: float, s: BodySettings) -> float:
    """By what share a face's area is found too large.

    Args:
        pressed: Its force over the gas's on its area.
        s: Settings.

    Returns:
        The share, from one up or down.
    """
    light = s.face_light - s.face_fades * math.log(max(pressed, 1e-3) / s.face_load)
    return min(max(1 + light, s.face_bounds[0]), s.face_bounds[1])


def area_sd(found: Fit, area: float, noise: float, s: BodySettings) -> float:
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
        model = s.area_face_sd
    else:
        known = float(found.sums_cov_with(noise)[SUM_AREA, SUM_AREA])
        model = s.area_sd
    return math.hypot(math.sqrt(max(known, 0.0)), model * area)


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
