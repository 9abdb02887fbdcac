"""Motion of the estimated shape relative to the rubber over the last images.

It consists of rolling, sliding and spinning rates (docs/theory/slip.md, Eq. F22).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mjtactile.core.types import Array, RelativeMotion
from mjtactile.sensing.contact_shape.gauss_newton import Fit
from mjtactile.sensing.contact_shape.primitives import place_of
from mjtactile.sensing.settings import ContactShapeSettings

_IMAGES_MIN = 3  # minimum number of images for a rate


@dataclass(frozen=True, eq=False)
class MembraneMotion:
    """Motion of the rubber under a contact since the previous image: `step` (2,), m, and `twist`
    about z, rad."""

    step: Array
    twist: float


def rubber_step(weights: tuple[Array, Array], positions: tuple[Array, Array]) -> MembraneMotion:
    """Compute the rubber motion between two images, from the fraction of the contact force at each
    node (J,) and the node positions (J, 3), m, in both."""
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
    """Pose of a shape of model `family` in the image at `time`, s.

    `values` (6,) starts with the position relative to the rubber since the track started (2,), m.
    Then follows the angle about z relative to the rubber, rad. Last are the rotations about x, y
    and z (3,), rad (NaN: the model has none). `var` (6,) are their variances. `dragged`, m, and
    `twisted`, rad, are the motion of the rubber so far.
    """

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
    """Return the track extended by one image at `time`, s. Without a known motion of the rubber
    since the last image it restarts. `scale` is the factor on the fit's covariance."""
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
    # information from earlier images is common to all of them
    variances = found.image_cov_with(scale).diagonal()
    turns = np.full(3, np.nan)
    rotation_var = np.full(3, np.nan)
    family = found.family
    indices = family.index("tilt_x"), family.index("tilt_y"), family.index("direction", "angle")
    for axis, index in enumerate(indices):  # rotation about x, y and z of S
        if index is not None:
            turns[axis] = found.theta[index]
            rotation_var[axis] = variances[index]
    position = place_of(found.theta, found.hint)[:2] - dragged
    values = np.array([*position, turns[2] - twisted, *turns])
    position_cov = 1e-6 * variances[:2] + s.motion_sd**2
    var = np.array([*position_cov, rotation_var[2], *rotation_var])
    stand = ShapePose(name, time, values, var, dragged, twisted)
    return (*(old for old in track if time - old.time < s.motion_time), stand)


def motion(track: Track, found: Fit, *, slips: bool) -> RelativeMotion | None:
    """Compute the motion rates of a shape relative to the rubber; None: too few images. `slips` is
    True if the contact is classified as slipping: the shape alone does not separate rolling from
    sliding for a round object."""
    if len(track) < _IMAGES_MIN:
        return None
    time = np.array([pose.time for pose in track])
    values = np.array([pose.values for pose in track])
    centered = time - time.mean()
    over = float(centered @ centered)
    rates = centered @ values / over
    rate_var = np.array([pose.var for pose in track]).mean(axis=0) / over
    velocity = rates[:2]
    velocity_cov = np.diag(rate_var[:2])
    rolling, rolling_cov = rates[3:5], np.diag(rate_var[3:5])
    known = np.isfinite(rolling)
    flat = bool(known.all())
    if not flat:
        rolls, rolls_cov = _rolling(found, velocity, velocity_cov)
        rolling = np.where(known, rolling, 0.0 if slips else rolls)
        rolling_cov = np.where(np.outer(known, known), rolling_cov, rolls_cov)
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
    """Return the rotation rate (2,) about x and y, rad/s, of a shape that rolls without sliding."""
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
