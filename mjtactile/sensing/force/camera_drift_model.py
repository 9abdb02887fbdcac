"""Effect of camera drift since the references on the apparent marker positions (Eq. F11).

A knock changes position and orientation of the camera. Lens breathing scales the image. A changed
tone curve moves all edges inward or outward by about the same amount. So every circle appears
larger, and nearer. Each effect moves all markers in a pattern that no load on the membrane
produces. The reason is that the membrane is fixed at its frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array
from mjtactile.sensing.settings import InverseSettings

MODES = 9
"""Number of drift modes: position x, y, z; rotation about x, y, z; and image scale. The last two
are the circle size: one common to all, one that follows their levels."""
_SIZE = 7
_STEADY = 1e-6  # of a mode's sd: none


def camera_modes(design: SensorDesign, p_SM: Array, darker: Array, s: InverseSettings) -> Array:
    """Compute the apparent marker motion for one standard deviation of each mode of a knocked
    camera. `design`: sensor design; marker positions are relative to its camera. `p_SM`: marker
    positions (m, 3), m. `darker`: change of each marker's darkness since the reference (m,). `s`:
    settings with the standard deviations. Returns apparent motion of each marker (m, 3, MODES),
    m."""
    away = p_SM - design.camera.p_SC
    depth = away[:, 2:]
    modes = np.zeros((len(p_SM), 3, MODES))
    modes[:, :, :3] = s.knock_shift * np.eye(3)
    modes[:, :, 3:6] = s.knock_rotation * np.cross(np.eye(3), away[:, None]).transpose(0, 2, 1)
    modes[:, 2, 6] = -s.drift_zoom * depth[:, 0]
    # depth goes with one over the size, and along the ray
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
        cls, s: InverseSettings, *, knocked: bool = False, steady: bool = False
    ) -> CameraDriftFilter:
        """Return the prior of a camera without images since the references. It may have been
        `knocked`, or be as `steady` as it was there."""
        sd = np.ones(MODES)
        if not knocked:
            sd[:3] = s.drift_camera / s.knock_shift
            sd[3:6] = s.drift_rotation / s.knock_rotation
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
        """The same at `time` s, in another image: meanwhile the camera has changed a little."""
        usual = np.diagonal(CameraDriftFilter.unseen(s).known)
        cov = self.known @ self.known.T
        cov += np.diag((s.drift_walk * usual) ** 2 * abs(time - self.time))
        return CameraDriftFilter(
            self.mean, np.linalg.cholesky(cov), time, s.drift_jitter / s.drift_size
        )

    def told(
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
        nothing = CameraDriftFilter(self.mean, self.known, time)
        try:
            back = np.linalg.inv(root[:, :MODES])
            after = np.linalg.inv(left[:MODES, :MODES])
            told = weight * back.T @ (after - np.eye(MODES)) @ back
            remains = np.linalg.inv(np.eye(MODES) + self.known.T @ told @ self.known)
            known = self.known @ np.linalg.cholesky((remains + remains.T) / 2)
        except np.linalg.LinAlgError:
            return nothing
        moved = known @ (known.T @ (back.T @ (after @ found[:MODES])))
        if not np.isfinite(known).all() or not np.isfinite(moved).all():
            return nothing
        return CameraDriftFilter(self.mean + weight * moved, known, time)


def drift_of(found: Array, seen: Array) -> float:
    """Return the mean square drift relative to its expected value; 1 means as assumed. `found` is
    the estimated drift in standard deviations (gas, then the camera's modes). `seen` is the
    fraction of their variance that estimates have. Gas counts as one mode of four."""
    share = found**2 / seen
    return float((share[0] + 3 * share[1:].mean()) / 4)
