"""How a body that was found moves against the rubber: rolling, sliding and spinning, as rates over
the last images (docs/theory/slip.md, Eq. F22)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mjtactile.core.types import Array, RelativeMotion
from mjtactile.sensing.contact_shape.gauss_newton import Fit
from mjtactile.sensing.contact_shape.primitives import place_of
from mjtactile.sensing.settings import ContactShapeSettings

_LEAST = 3  # images that a rate wants


@dataclass(frozen=True, eq=False)
class MembraneMotion:
    """How the rubber under a contact has moved since the image before: `step` (2,) m, and `twist`
    rad about z."""

    step: Array
    twist: float


def rubber_step(weights: tuple[Array, Array], positions: tuple[Array, Array]) -> MembraneMotion:
    """Of two images.

    Args:
        weights: (J,) share of the press at each node, in both.
        positions: (J, 3) m of the nodes, in both.

    Returns:
        Its motion.
    """
    weight = (weights[0] + weights[1]) / 2
    moved = positions[1] - positions[0]
    step = weight @ moved
    away = (positions[0] + positions[1]) / 2
    away = away - weight @ away
    left = moved - step
    turning = weight @ (away[:, 0] * left[:, 1] - away[:, 1] * left[:, 0])
    return MembraneMotion(
        step[:2], float(turning / max(weight @ (away[:, :2] ** 2).sum(axis=1), 1e-12))
    )


@dataclass(frozen=True, eq=False)
class ShapePose:
    """Where a body of `family` stands in one image: `time` s; its place over the rubber, (2,) m
    since the track began, and the `angle` rad about z over the rubber; its `turns` (3,) rad about
    x, y and z (NaN: the family has none); of all these the variances `var` (6,); what the rubber
    has moved, and twisted, so far."""

    family: str
    time: float
    values: Array
    var: Array
    dragged: Array
    twisted: float


Track = tuple[ShapePose, ...]


def tracked(
    track: Track,
    found: Fit,
    time: float,
    rubber: MembraneMotion | None,
    scale: float,
    s: ContactShapeSettings,
) -> Track:
    """A track with one image more.

    Args:
        track: So far.
        found: The body.
        time: Of the image, s.
        rubber: How it moved since the last one; None: that is not known, and the track begins anew.
        scale: Factor on the fit's covariance.
        s: Settings.

    Returns:
        The track over the last images.
    """
    if found.family.parts:
        return ()
    name = found.family.name
    goes_on = rubber is not None and track and track[-1].family == name
    if not goes_on or not 0 < time - track[-1].time < s.motion_time:
        track = ()
        dragged = np.zeros(2)
        twisted = 0.0
    else:
        assert rubber is not None
        dragged = track[-1].dragged + rubber.step
        twisted = track[-1].twisted + rubber.twist
    # of one image alone: what a press has told of the numbers is common to all its images
    precision = found.curvature / scale + np.eye(len(found.theta))
    cov = np.linalg.inv(precision) * np.outer(found.family.sd, found.family.sd)
    turns = np.full(3, np.nan)
    rotation_var = np.full(3, np.nan)
    for axis, number in enumerate(TURNS[name]):
        if number is not None:
            turns[axis] = found.theta[number]
            rotation_var[axis] = cov[number, number]
    place = place_of(found.theta, found.hint)[:2] - dragged
    values = np.array([*place, turns[2] - twisted, *turns])
    places = 1e-6 * np.diag(cov)[:2] + s.motion_sd**2
    var = np.array([*places, rotation_var[2], *rotation_var])
    stand = ShapePose(name, time, values, var, dragged, twisted)
    return (*(old for old in track if time - old.time < s.motion_time), stand)


def motion(track: Track, found: Fit, *, slips: bool) -> RelativeMotion | None:
    """Rates of a body over the rubber.

    Args:
        track: Of the last images.
        found: The body.
        slips: Whether it is known to slip: what a round body does of itself, roll or slide, its
            shape does not tell.

    Returns:
        The rates; None: too few images.
    """
    if len(track) < _LEAST:
        return None
    time = np.array([one.time for one in track])
    values = np.array([one.values for one in track])
    var = np.mean([one.var for one in track], axis=0)
    off = time - time.mean()
    over = float(off @ off)
    rates = off @ (values - values.mean(axis=0)) / over
    rate_var = var / over
    velocity = rates[:2]
    velocity_cov = np.diag(rate_var[:2])
    rolls, rolls_cov = _rolling(found, velocity, velocity_cov)
    turns = rates[3:5]
    known = np.isfinite(turns)
    rolling = np.where(known, turns, 0.0 if slips else rolls)
    rolling_cov = np.where(np.outer(known, known), np.diag(rate_var[3:5]), rolls_cov)
    flat = bool(known.all())
    sliding = velocity if slips or flat else np.zeros(2)
    return RelativeMotion(
        velocity=velocity,
        velocity_cov=velocity_cov,
        rolling=rolling,
        rolling_cov=rolling_cov,
        sliding=sliding,
        spinning=float(rates[2]),
        spinning_sd=math.sqrt(rate_var[2]) if np.isfinite(rate_var[2]) else math.nan,
    )


def _rolling(found: Fit, velocity: Array, cov: Array) -> tuple[Array, Array]:
    """Turning, (2,) rad/s about x and y, of a body whose contact goes over the rubber and does not
    slide: z x K v, K (2, 2) its curvatures."""
    K = np.zeros((2, 2))
    name = found.family.name
    if name == "ball":
        K = found.theta[3] * np.eye(2)
    elif name == "smooth":
        kxx, kxy, kyy = found.theta[3:6]
        K = np.array([[kxx, kxy], [kxy, kyy]])
    elif name == "cylinder":
        across = np.array([-math.sin(found.theta[4]), math.cos(found.theta[4])])
        K = found.theta[3] * np.outer(across, across)
    rows = np.array([[0.0, -1.0], [1.0, 0.0]]) @ K
    return rows @ velocity, rows @ cov @ rows.T


TURNS: dict[str, tuple[int | None, int | None, int | None]] = {
    "ball": (None, None, None),
    "cylinder": (None, None, 4),
    "smooth": (None, None, None),
    "disc": (3, 4, None),
    "block": (3, 4, 5),
}
"""Of each family the numbers that turn it about x, y and z of S, where there are any."""
