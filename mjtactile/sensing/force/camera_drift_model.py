"""Effect of camera drift since the references on the apparent marker positions (Eq. F11), on images
and on their gray levels.

A displacement changes position and orientation of the camera. Lens breathing scales the image. A
changed tone curve moves all edges inward or outward by about the same amount. So every circle
appears larger, and closer. Each effect moves all markers in a pattern that no load on the membrane
produces. The reason is that the membrane is fixed at its frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array, Ellipses
from mjtactile.sensing.settings import InverseSettings

MODES = 9
"""Number of drift modes: position x, y, z; rotation about x, y, z; and image scale. The last two
are the circle size: one common to all, one that follows their levels."""
_SIZE = 7
_STEADY = 1e-6  # fraction of a mode's sd that counts as zero
_TONE_ROUNDS = 5
_TONE_STEP_LIMIT = 0.3  # maximum step of ln gamma in a round
_TONE_MIN_CIRCLES = 3
_UNCHANGED_LEVELS = 0.02  # maximum relative change of all levels for an unchanged curve
_WHITE = 255.0


def camera_modes(design: SensorDesign, p_SM: Array, darker: Array, s: InverseSettings) -> Array:
    """Compute the apparent motion (m, 3, MODES), m, of markers at `p_SM` (m, 3), m, for one
    standard deviation of each mode of a displaced camera. `darker` (m,) is the change of their
    darkness since the reference."""
    away = p_SM - design.camera.p_SC
    depth = away[:, 2:]
    modes = np.zeros((len(p_SM), 3, MODES))
    modes[:, :, :3] = s.displaced_shift * np.eye(3)
    modes[:, :, 3:6] = s.displaced_rotation * np.cross(np.eye(3), away[:, None]).transpose(0, 2, 1)
    modes[:, 2, 6] = -s.drift_zoom * depth[:, 0]
    # depth is proportional to one over the size, and changes along the ray
    radius_px = design.camera.fx * design.markers.radius / depth
    grown = -away / radius_px
    modes[:, :, 7] = s.drift_size * grown
    modes[:, :, 8] = s.drift_levels * darker[:, None] * grown
    return modes


@dataclass(frozen=True, eq=False)
class CameraDriftFilter:
    """Camera drift estimated from the markers of all images up to `time`, s. `mean` (MODES,) holds
    the modes in units of their standard deviation. `known` (MODES, MODES) is the lower factor of
    their covariance. In each image all circles appear larger by an independent `jitter`, in
    standard deviations of the size mode."""

    mean: Array
    known: Array
    time: float = math.nan
    jitter: float = 0.0

    @classmethod
    def unseen(
        cls, s: InverseSettings, *, displaced: bool = False, steady: bool = False
    ) -> CameraDriftFilter:
        """Return the prior of a camera without images since the references. It may have been
        `displaced`, or be as `steady` as it was there."""
        sd = np.ones(MODES)
        if not displaced:
            sd[:3] = s.drift_camera / s.displaced_shift
            sd[3:6] = s.drift_rotation / s.displaced_rotation
        if steady:
            sd[6:] = _STEADY
        return cls(np.zeros(MODES), np.diag(sd))

    @property
    def root(self) -> Array:
        """Factor (MODES, unknowns) of the covariance in an image: the filter's, and the jitter of
        that image."""
        if not self.jitter:
            return self.known
        alone = np.zeros(MODES)
        alone[_SIZE] = self.jitter
        return np.column_stack([self.known, alone])

    def later(self, time: float, s: InverseSettings) -> CameraDriftFilter:
        """Return the filter at `time`, s, of another image, after a small random change of the
        camera."""
        usual = np.diagonal(CameraDriftFilter.unseen(s).known)
        cov = self.known @ self.known.T
        cov += np.diag((s.drift_walk * usual) ** 2 * abs(time - self.time))
        return CameraDriftFilter(
            self.mean, np.linalg.cholesky(cov), time, s.drift_jitter / s.drift_size
        )

    def updated(
        self, found: Array, left: Array, root: Array, time: float, weight: float = 1.0
    ) -> CameraDriftFilter:
        """Return the filter after an image at `time`, s.

        Args:
            found: Modes that a fit estimated relative to the mean (unknowns,), in units of `root`.
            left: Covariance that the fit left (unknowns, unknowns), in the same units.
            root: Covariance factor of the prior of that fit, about as certain as this one.
            time: Capture time of the image, s.
            weight: Fraction of the fit's information that counts.

        Returns:
            The posterior. With the information J = root^-T (left^-1 - 1) root^-1 of the image, P^-1
            grows by J, and the mean moves by P root^-T left^-1 found. If these cannot be computed,
            the image has no effect.
        """
        empty = CameraDriftFilter(self.mean, self.known, time)
        try:
            back = np.linalg.inv(root[:, :MODES])
            after = np.linalg.inv(left[:MODES, :MODES])
            information = weight * back.T @ (after - np.eye(MODES)) @ back
            remains = np.linalg.inv(np.eye(MODES) + self.known.T @ information @ self.known)
            known = self.known @ np.linalg.cholesky((remains + remains.T) / 2)
        except np.linalg.LinAlgError:
            return empty
        moved = known @ (known.T @ (back.T @ (after @ found[:MODES])))
        if not np.isfinite(known).all() or not np.isfinite(moved).all():
            return empty
        return CameraDriftFilter(self.mean + weight * moved, known, time)


def drift_of(found: Array, observed: Array) -> float:
    """Return the mean square drift relative to its expected value; 1 means as assumed. `found` is
    the estimated drift in standard deviations (gas, then the camera's modes). `observed` is the
    fraction of their variance that estimates have. Gas counts as one mode of four."""
    fraction = found**2 / observed
    return float((fraction[0] + 3 * fraction[1:].mean()) / 4)


@dataclass(frozen=True, eq=False)
class ImageTransform:
    """Image transform about `middle` (2,), px: `shift` (2,), px, rotation `turn` (from u to v),
    rad, and relative enlargement `scale`. Radii grow by `grown` px in addition."""

    middle: Array
    shift: Array
    turn: float
    scale: float
    grown: float

    def inverse(self, uv: Array) -> Array:
        """Return the positions (n, 2), px, before the transform."""
        cos = math.cos(self.turn)
        sin = math.sin(self.turn)
        away = (uv - self.middle - self.shift) / (1 + self.scale)
        return self.middle + away @ np.array([[cos, -sin], [sin, cos]])

    def inverse_ellipses(self, ellipses: Ellipses, at: Array) -> Ellipses:
        """Return the ellipses with indices `at` before the transform."""
        axes = (ellipses.semi_axes_px[at] - self.grown) / (1 + self.scale)
        dark = ellipses.darkness
        return Ellipses(
            self.inverse(ellipses.center_px[at]),
            np.maximum(axes, 1e-3),
            ellipses.angle[at] - self.turn,
            ellipses.cov[at],
            ellipses.status[at],
            None if dark is None else dark[at],
        )


UNCHANGED = ImageTransform(np.zeros(2), np.zeros(2), 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Tone:
    """level = black + `light` top (level before / top)^(1/gamma), less `black`; NaN: unknown."""

    light: float
    gamma: float
    black: float


_UNKNOWN_TONE = Tone(math.nan, math.nan, math.nan)


def tone_of(inside: Array, outside: Array, inside_then: Array, outside_then: Array) -> Tone:
    """Fit the curve from the reference levels `_then` (n,) to the current levels inside circles and
    of the background around them, by least squares. Black and white determine two of its three
    parameters. Light that falls off toward the corners spreads either level over a range, whose
    slope gives the third."""
    then = np.concatenate([inside_then, outside_then])
    now = np.concatenate([inside, outside])
    known = np.isfinite(then + now) & (then > 0)
    if known.sum() < 2 * _TONE_MIN_CIRCLES:
        return _UNKNOWN_TONE
    ratio = now[known] / then[known]
    if np.abs(ratio - 1).max() < _UNCHANGED_LEVELS:
        return Tone(float(ratio.mean()), 1.0, 0.0)
    fraction = np.log(then[known] / _WHITE)
    level = now[known] / _WHITE
    power = 1.0
    for _ in range(_TONE_ROUNDS):
        curve = np.exp(power * fraction)
        columns = np.stack([np.ones_like(curve), curve, curve * fraction])
        normal = columns @ columns.T
        normal[2, 2] += 1e-12
        black, light, steeper = np.linalg.solve(normal, columns @ level)
        if not light > 0:
            return _UNKNOWN_TONE
        change = float(np.clip(steeper / light, -_TONE_STEP_LIMIT, _TONE_STEP_LIMIT))
        power = float(np.clip(power + change, 0.1, 10.0))
        if abs(change) < 1e-3:
            break
    return Tone(float(light), 1 / power, _WHITE * float(black))
