"""Fiducials in the sensing pipeline.

They are identified by their fixed positions and separated from markers. Marker positions are
corrected for the camera drift since the rest reference.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mjtactile.core import optics
from mjtactile.core.design import SensorDesign
from mjtactile.core.fiducials import Fiducials
from mjtactile.core.optics import Camera
from mjtactile.core.types import Array, Ellipses, FiducialDetections, Markers
from mjtactile.sensing.force.camera_drift_estimator import OBSERVED_MODES, CameraDriftEstimator
from mjtactile.sensing.force.camera_drift_model import UNCHANGED
from mjtactile.sensing.force.rest_equilibrium import darker
from mjtactile.sensing.pipeline_state import PipelineState
from mjtactile.sensing.settings import Settings


class FiducialCompensation:
    """Compensation of one sensor's camera drift by its fiducials, without own state."""

    def __init__(self, design: SensorDesign, camera: Camera, settings: Settings):
        fiducials = design.fiducials
        assert fiducials is not None
        self.count = fiducials.count
        self.min_visible = settings.fiducials.min_visible
        self._principal_point = np.array([camera.cx, camera.cy])
        self._finder = FiducialFinder(design, camera, fiducials)
        self._camera = CameraDriftEstimator(
            design, camera, fiducials, settings.inverse, settings.fiducials
        )

    def shift_and_scale(self, observed: FiducialDetections) -> tuple[Array, float]:
        """Estimate the image shift (2,), px, to the right and down relative to the sensor file, and
        the scale factor, from at least two detected fiducials."""
        expected = self._finder.places_px[observed.ids]
        offset = expected - self._principal_point
        # displacement = shift + magnification * offset, by least squares
        rows = np.zeros((*expected.shape, 3))
        rows[:, :, :2] = np.eye(2)
        rows[:, :, 2] = offset
        displacement = observed.center_px - expected
        solution = np.linalg.lstsq(rows.reshape(-1, 3), displacement.ravel())[0]
        right, down, magnification = solution
        return np.array([right, down]), 1 + float(magnification)

    def compensate(
        self, state: PipelineState, ellipses: Ellipses
    ) -> tuple[Ellipses, PipelineState]:
        """Separate fiducials from markers, and estimate the camera drift from them. With a rest
        reference, the markers' ellipses are transformed to the image of that reference. If too few
        fiducials are detected, the camera drift is assumed near its last estimate."""
        reference = state.reference
        before = None if reference is None else reference.fiducials
        markers, observed = self._finder.split(ellipses, before)
        camera = None if before is None else self._camera.find(observed, before)
        if camera is None and before is not None and state.camera is not None:
            camera = replace(state.camera, root=np.eye(OBSERVED_MODES), change=None)
        image = UNCHANGED if camera is None else self._camera.image(camera.mean, camera.darker)
        ellipses = image.inverse_ellipses(ellipses, markers)
        return ellipses, replace(state, camera=camera, fiducials=observed)

    def correct_markers(
        self, state: PipelineState, markers: Markers
    ) -> tuple[Markers, PipelineState]:
        """Correct markers from the transformed image to the camera of the rest reference. Return
        them with the fiducials attached, and the state with the remaining camera uncertainty."""
        p_SM = markers.p_SM
        reference = state.reference
        if reference is not None and state.camera is not None:
            changed = darker(markers, reference.rest)
            p_SM = self._camera.correct_positions(p_SM, changed, state.camera)
            state = replace(state, camera=self._camera.with_size_error(state.camera, changed))
        return replace(markers, p_SM=p_SM, fiducials=state.fiducials), state


class FiducialFinder:
    """Fiducial finder of one sensor.

    Each fiducial is the valid circle nearest to its last position. The maximum distance is half the
    minimum distance between a fiducial and another fiducial or marker.
    """

    def __init__(self, design: SensorDesign, camera: Camera, fiducials: Fiducials):
        self.count = fiducials.count
        p_SC = design.camera.p_SC
        self.places_px = optics.project(camera, fiducials.p_SF(design) - p_SC)
        markers_px = optics.project(camera, design.markers.p_SM - p_SC)
        others = np.concatenate([self.places_px, markers_px])
        distances = np.linalg.norm(self.places_px[:, None] - others, axis=2)
        distances[np.arange(self.count), np.arange(self.count)] = np.inf
        self._search_radius = float(distances.min()) / 2

    def split(
        self, ellipses: Ellipses, before: FiducialDetections | None
    ) -> tuple[Array, FiducialDetections]:
        """Return the indices of the circles that are not fiducials, and the well detected
        fiducials. `before` are their previous positions; None: those of the sensor file."""
        centers = self.places_px
        if before is not None and len(before) == self.count:
            centers = before.center_px
        elif before is not None and len(before):
            # undetected fiducials are assumed to move like the others
            moved = np.median(before.center_px - centers[before.ids], axis=0)
            centers = centers + moved
            centers[before.ids] = before.center_px
        u, v = ellipses.center_px.T
        distance = np.hypot(centers[:, :1] - u, centers[:, 1:] - v)
        within = distance < self._search_radius
        good = within & (ellipses.status == "ok")
        ids = np.flatnonzero(good.any(axis=1))
        nearest = np.where(good, distance, np.inf)[ids].argmin(axis=1)
        rest = np.flatnonzero(~within.any(axis=0))
        return rest, _detections(ids, ellipses, nearest)


def average_fiducials(images: Sequence[FiducialDetections]) -> FiducialDetections:
    """Return the mean of repeated measurements by a camera that does not move. A fiducial counts if
    it is detected in at least half of them."""
    count = np.bincount(np.concatenate([image.ids for image in images]), minlength=1)
    ids = np.flatnonzero(count >= len(images) / 2)

    def mean(name: str) -> Array:
        values = getattr(images[0], name)
        total = np.zeros((len(count), *values.shape[1:]))
        for image in images:
            total[image.ids] += getattr(image, name)
        return total[ids] / count[ids].reshape(-1, *(1,) * (total.ndim - 1))

    names = ("center_px", "radius_px", "cov", "inside", "outside", "blur_px")
    center, radius, cov, inside, outside, blur = (mean(name) for name in names)
    fraction = count[ids][:, None, None]
    return FiducialDetections(ids, center, radius, cov / fraction, inside, outside, blur)


def _detections(ids: Array, ellipses: Ellipses, at: Array) -> FiducialDetections:
    a, b = ellipses.semi_axes_px[at].T
    radius = np.sqrt(a * b)
    jacobian = np.zeros((len(a), 3, 5))
    jacobian[:, 0, 0] = 1
    jacobian[:, 1, 1] = 1
    jacobian[:, 2, 2] = b / (2 * radius)
    jacobian[:, 2, 3] = a / (2 * radius)
    cov = jacobian @ ellipses.cov[at] @ jacobian.transpose(0, 2, 1)
    unknown = np.full(len(ids), np.nan)
    outside = unknown if ellipses.outside is None else ellipses.outside[at]
    inside = unknown if ellipses.darkness is None else outside * np.exp(ellipses.darkness[at])
    blur = unknown if ellipses.blur_px is None else ellipses.blur_px[at]
    return FiducialDetections(ids, ellipses.center_px[at], radius, cov, inside, outside, blur)
