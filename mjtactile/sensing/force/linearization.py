"""Linearization of an inverse step (`Linearization`) and its result (`Shape`): start values of the
next image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array, Markers
from mjtactile.sensing.force.camera_drift_estimator import CameraDriftEstimate
from mjtactile.sensing.force.camera_drift_model import CameraDriftFilter
from mjtactile.sensing.force.rest_equilibrium import InverseRest, darker
from mjtactile.sensing.force.spline_fem import Stiffness

NEAR = 2e-4  # maximum change of the shape for which stiffness and gains are kept, m
_SD_RATIO = 1.3  # maximum ratio of change in the standard deviation of the gas pressure
_CAMERA_RATIO = 1.5  # the same for the camera drift uncertainty
_DARKER_NEAR = 0.03  # maximum change of darkness for which the camera's modes are kept


@dataclass(frozen=True, eq=False)
class PlaneContact:
    """Membrane in contact with a rigid plane.

    `plane` (3,) are its height over the origin of S, m, and its slopes along x and y. `c` (3, n),
    m, are the coefficients of the membrane, and `load` (3, n), N, the generalized contact forces.
    `traction` (3, J), Pa, are the contact tractions at the nodes. Their sum is the force.
    `log_volume` is the logarithm of the fraction of the prior volume that the plane's posterior
    has.
    """

    plane: Array
    c: Array
    load: Array
    traction: Array
    log_volume: float = 0.0


@dataclass(frozen=True, eq=False)
class Linearization:
    """Linearization at `c` (3, n) for markers `ids`.

    - `stiffness`: factorized stiffness of the membrane.
    - `half` (r, 3 J): whitened markers' covariance by the prior of the tractions. The r rows are 3
      m positions, and 2 m slopes if used.
    - `weights` (m, 3, 3): whitening of the positions.
    - `slope_weights` (m,): whitening of the slopes, or None.
    - `tilts` (2, m, 2, 3): whitened derivatives of the slopes by the membrane's tangents, or None.
    - `distrust` (2, m): factors on the standard deviations in the whitening of positions and
      slopes.
    - `drift` (r, 1 + modes): response to one standard deviation of drift (gas, the camera's modes).
    - `drift_gas`: the gas drift as pressure, Pa, and as a load (3, n).
    - `observed_drift` (1 + modes,): fraction of the drift variances that estimates have.
    - `prior` (3 J,): prior standard deviations of the tractions.
    - `innovation`: lower factor of the predicted covariance of the whitened markers.
    - `reweighted`: number of linearizations with tractions estimated before.
    - `gas`: type of the gas (measured, open) and its standard deviation.
    - `darker` (m,): darkening of the markers since the rest reference.
    - `camera`: prior of the camera drift. `lost`: True if gas may have been lost.
    - `modes` (m, 3, modes): marker motion per camera mode, m.
    - `left` (modes, modes): fraction of the camera covariance that is left.
    - `correlation`: correlation length of the prior of the tractions, m.
    - `mean`: contact with a plane around which the tractions are expected; None: around zero.
    """

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
    correlation: float
    mean: PlaneContact | None = None

    def serves(
        self,
        c: Array,
        markers: Markers,
        rest: InverseRest,
        camera: CameraDriftFilter | CameraDriftEstimate,
        lost: bool,
        correlation: float,
        mean: PlaneContact | None = None,
    ) -> bool:
        """Return True if it is valid near `c` for these markers. The gas and camera priors, and
        correlation length, m, and mean of the tractions must also match."""
        if correlation != self.correlation or mean is not self.mean:
            return False
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
    """Membrane estimate, to be passed to the next frame.

    `c` (3, n), m, are the coefficients of the deformation. `traction` (3, J), Pa, are the nodal
    tractions, and `gauge_pressure`, Pa, is the pressure. `misfit` is the mean square of the markers
    over their predicted standard deviation. `gain` is the linearization used. `excess` (2, N) is
    the mean square noise of each marker's position and slopes over its standard deviation. `drift`
    is the mean square drift relative to its expected value (`drift_of`). `camera` (modes,) are the
    camera's modes relative to their prior, in units of the remaining uncertainty.
    """

    c: Array
    traction: Array
    gauge_pressure: float
    misfit: float
    gain: Linearization
    steps: int
    excess: Array
    drift: float
    camera: Array

    @property
    def log_evidence(self) -> float:
        """Logarithm of the markers' probability density under the priors that it was made with.
        Hypotheses about load and camera that explain the same markers are compared by it. The
        discounted markers count with their larger standard deviations."""
        gain = self.gain
        log_sd = 3 * np.log(gain.distrust[0]).sum()
        if gain.tilts is not None:
            log_sd += 2 * np.log(gain.distrust[1]).sum()
        chi2 = len(gain.half) * self.misfit
        return float(-0.5 * chi2 - np.log(np.diagonal(gain.innovation)).sum() - log_sd)


def _equally_certain(
    drift: CameraDriftFilter | CameraDriftEstimate, other: CameraDriftFilter | CameraDriftEstimate
) -> bool:
    """Return True if the camera drift has about the same uncertainty in both."""
    if type(drift) is not type(other) or drift.root.shape != other.root.shape:
        return False
    ratio = np.diagonal(drift.root) / np.diagonal(other.root)
    return bool(ratio.max() < _CAMERA_RATIO and ratio.min() > 1 / _CAMERA_RATIO)
