"""Use of fiducials in the sensing pipeline.

They are separated from markers. Markers are corrected to their positions as observed by the camera
at the rest reference.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.optics import Camera
from mjtactile.core.types import Array, Ellipses, FiducialDetections, Markers
from mjtactile.sensing.force.camera_drift_estimator import OBSERVED_MODES, CameraDriftEstimator
from mjtactile.sensing.force.rest_equilibrium import darker
from mjtactile.sensing.pipeline_state import PipelineState
from mjtactile.sensing.pose.fiducial_matching import FiducialFinder
from mjtactile.sensing.pose.image_transform import UNCHANGED
from mjtactile.sensing.settings import Settings


class FiducialCompensation:
    """Compensation of one sensor's camera drift by its fiducials. Stateless."""

    def __init__(self, design: SensorDesign, camera: Camera, settings: Settings):
        fiducials = design.fiducials
        assert fiducials is not None
        self.count = fiducials.count
        self.fewest = settings.fiducials.fewest
        self._middle = np.array([camera.cx, camera.cy])
        self._circles = FiducialFinder(design, camera, fiducials)
        self._camera = CameraDriftEstimator(
            design, camera, fiducials, settings.inverse, settings.fiducials
        )

    def stand(self, seen: FiducialDetections) -> tuple[Array, float]:
        """Estimate the image shift (2,), px, to the right and down relative to the sensor file, and
        the scale factor, from at least two detected fiducials."""
        places = self._circles.places_px[seen.ids]
        away = places - self._middle
        # motion = shift + more * away, by least squares
        rows = np.zeros((*places.shape, 3))
        rows[:, :, :2] = np.eye(2)
        rows[:, :, 2] = away
        moved = seen.center_px - places
        right, down, more = np.linalg.lstsq(rows.reshape(-1, 3), moved.ravel())[0]
        return np.array([right, down]), 1 + float(more)

    def look(self, state: PipelineState, ellipses: Ellipses) -> tuple[Ellipses, PipelineState]:
        """Separate fiducials from markers, and estimate the camera drift from them. With a rest
        reference, the markers' ellipses are transformed back to its image. If too few fiducials are
        detected, the camera drift is assumed near its last estimate."""
        reference = state.reference
        before = None if reference is None else reference.fiducials
        markers, seen = self._circles.split(ellipses, before)
        camera = None if before is None else self._camera.find(seen, before)
        if camera is None and before is not None and state.camera is not None:
            camera = replace(state.camera, root=np.eye(OBSERVED_MODES), change=None)
        picture = UNCHANGED if camera is None else self._camera.picture(camera.mean, camera.darker)
        ellipses = picture.undone_ellipses(ellipses, markers)
        return ellipses, replace(state, camera=camera, fiducials=seen)

    def undone(self, state: PipelineState, markers: Markers) -> tuple[Markers, PipelineState]:
        """Correct markers from the transformed image to the camera of the rest reference. Return
        them with the fiducials attached, and the state with the remaining camera uncertainty."""
        p_SM = markers.p_SM
        reference = state.reference
        if reference is not None and state.camera is not None:
            changed = darker(markers, reference.rest)
            p_SM = self._camera.undone(p_SM, changed, state.camera)
            state = replace(state, camera=self._camera.doubted(state.camera, changed))
        return replace(markers, p_SM=p_SM, fiducials=state.fiducials), state
