"""What a camera that is not as it was at the references does to where markers seem to be (Eq. F11).

A camera that was knocked has another place and direction; a lens that breathes shows all larger; a
curve of grey levels that changed moves all edges in or out by about as much, so that every circle
looks larger, and nearer. Each moves all markers in a way that no load on the sheet does, which is
held along its frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array
from mjtactile.sensing.settings import InverseSettings

MODES = 9
"""Place x, y, z; turn about x, y, z; scale of the picture; size of the circles, alike for all, and
as their levels changed."""
_SIZE = 7
_STEADY = 1e-6  # of a mode's sd: none


def camera_modes(design: SensorDesign, p_SM: Array, darker: Array, s: InverseSettings) -> Array:
    """One sd of each mode of a camera that was knocked: place and direction may be anywhere near.

    Args:
        design: The sensor; its camera is where markers' places are counted from.
        p_SM: Markers (m, 3) m.
        darker: By how much each one's darkness has changed since the reference, (m,).
        s: Has the sds.

    Returns:
        (m, 3, MODES) m by which each marker seems to move.
    """
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
    """What images up to `time` s have told of the camera: `mean` (MODES,) of the modes, in their
    sd, and the lower factor `known` (MODES, MODES) of their covariance. In each image all circles
    seem larger by another `jitter`, in sd of that mode."""

    mean: Array
    known: Array
    time: float = math.nan
    jitter: float = 0.0

    @classmethod
    def unseen(
        cls, s: InverseSettings, *, knocked: bool = False, steady: bool = False
    ) -> CameraDriftFilter:
        """Of a camera that no image has shown since the references: one that may have been
        `knocked`, or is as `steady` as it was there."""
        sd = np.ones(MODES)
        if not knocked:
            sd[:3] = s.drift_camera / s.knock_shift
            sd[3:6] = s.drift_rotation / s.knock_rotation
        if steady:
            sd[6:] = _STEADY
        return cls(np.zeros(MODES), np.diag(sd))

    @property
    def root(self) -> Array:
        """A factor (MODES, unknowns) of the covariance in an image: what is known, and beside it
        what is of that image alone."""
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
        """After an image at `time` s.

        Args:
            found: What a fit found of the modes beyond the mean, (unknowns,), in units of `root`.
            left: What it left of their covariance (unknowns, unknowns), the same.
            root: That of the belief the fit was made for, which knew about as much as this one.
            time: s.
            weight: Share of the fit's information that counts.

        Returns:
            The belief after it. With J = root^-T (left^-1 - 1) root^-1 the information of the
            image, P^-1 grows by J, and the mean moves by P root^-T left^-1 found. An image from
            which no such numbers come tells nothing.
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
    """How large the drift `found` is, in sd (gas, then the camera's modes), over what estimates of
    it have, the share `seen` of their variances: 1 is as believed. Gas counts as one mode of four.
    """
    share = found**2 / seen
    return float((share[0] + 3 * share[1:].mean()) / 4)
