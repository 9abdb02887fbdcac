"""What an inverse step is made with, `Linearization`, and what it finds, `Shape`: values that the
next image begins from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array, Markers
from mjtactile.sensing.force.camera_drift_estimator import CameraDriftEstimate
from mjtactile.sensing.force.camera_drift_model import CameraDriftFilter
from mjtactile.sensing.force.rest_equilibrium import InverseRest, darker
from mjtactile.sensing.force.spline_fem import Stiffness

NEAR = 2e-4  # m: a distance over which stiffness and gains are kept
_SD_RATIO = 1.3  # by which the gas's pressure may become better or worse known meanwhile
_CAMERA_RATIO = 1.5  # the same of what fiducials leave in doubt of the camera
_DARKER_NEAR = 0.03  # of darkness, over which the camera's modes are kept


@dataclass(frozen=True, eq=False)
class Linearization:
    """One linearisation, at `c` (3, n), for markers `ids`: the `stiffness`, the whitened markers'
    `half` covariance (r, 3 J) by the tractions' prior (r = 3 m positions, and 2 m slopes where they
    count); `weights` (m, 3, 3) that whiten positions, `slope_weights` (m,) and `tilts` (2, m, 2,
    3), the whitened slopes' derivatives by the sheet's tangents, or None, and the factors
    `distrust` (2, m) on the sd of both that they contain; the response (r, 1 + modes) to one sd of
    `drift` (gas, the camera's modes), the gas's part of it as pressure, Pa, and as a load (3, n),
    and the share `observed_drift` (1 + modes,) of their variances that estimates have; prior sd (3
    J,) of the tractions; the lower factor of the predicted covariance of the whitened markers; and
    how often it was `reweighted`: tractions had been found before it was made; by how much markers
    were `darker` than at rest (m,), what was known of the `camera` before, how (m, 3, modes) m
    markers move with its modes, and the share (modes, modes) of its covariance that is `left`."""

    c: Array
    ids: NDArray[np.int64]
    stiffness: Stiffness
    half: Array
    weights: Array
    slope_weights: Array
    tilts: Array | None
    distrust: Array
    drift: Array
    drift_gas: tuple[float, Array]
    observed_drift: Array
    prior: Array
    innovation: Array
    reweighted: int
    gas: tuple[tuple[bool, bool], float]
    darker: Array
    camera: CameraDriftFilter | CameraDriftEstimate
    lost: bool
    modes: Array
    left: Array

    def serves(
        self,
        c: Array,
        markers: Markers,
        rest: InverseRest,
        camera: CameraDriftFilter | CameraDriftEstimate,
        lost: bool,
    ) -> bool:
        """Whether it can be used near `c`, for these markers, with what is known of the gas and of
        the camera."""
        if lost != self.lost or not _equally_certain(camera, self.camera):
            return False
        if not np.array_equal(self.ids, markers.ids) or np.abs(c - self.c).max() >= NEAR:
            return False
        if np.abs(darker(markers, rest) - self.darker).max(initial=0.0) > _DARKER_NEAR:
            return False
        known, then = self.gas
        if known != (rest.gas_sd is not None, rest.gas.constant is None):
            return False
        return rest.gas_sd is None or then / _SD_RATIO < rest.gas_sd < then * _SD_RATIO


@dataclass(frozen=True, eq=False)
class Shape:
    """An estimate: coefficients `c` (3, n) m of the deformation, nodal tractions (3, J) Pa, gauge
    pressure Pa, the mean square `misfit` of the markers over their predicted sd, the gain it came
    from, and the mean square noise over its sd, `excess` (2, N), of each marker's position and
    slopes, the mean square `drift` found, over what is to be expected (`drift_of`), and the
    camera's modes (modes,) beyond what was known of them, `camera`, in units of what was left
    open. Hand it to the next frame."""

    c: Array
    traction: Array
    gauge_pressure: float
    misfit: float
    gain: Linearization
    steps: int
    excess: Array
    drift: float
    camera: Array


def _equally_certain(
    one: CameraDriftFilter | CameraDriftEstimate, other: CameraDriftFilter | CameraDriftEstimate
) -> bool:
    """Whether about as much is known of the camera."""
    if type(one) is not type(other) or one.root.shape != other.root.shape:
        return False
    ratio = np.diagonal(one.root) / np.diagonal(other.root)
    return bool(ratio.max() < _CAMERA_RATIO and ratio.min() > 1 / _CAMERA_RATIO)
