"""What fiducials do for the chain: they are kept apart from markers, and markers are taken back to
where a camera would see them that is as it was at the rest reference."""

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
    """The camera of one sensor, known by its fiducials; nothing changes.

    Args:
        design: The sensor's values, with fiducials.
        camera: Its camera.
        settings: The stages' chosen numbers.
    """

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
        """Say where fiducials stand in a picture.

        Args:
            seen: Two and more of them.

        Returns:
            By how much the picture's middle stands right and down of where the sensor file has it,
            (2,) px, and how many times as large all is.
        """
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
        """Tell fiducials from markers, and the camera by them.

        Args:
            state: What the image before left.
            ellipses: All circles of an image.

        Returns:
            Those of markers, in a picture that is taken back to that of the rest reference, where
            there is one; and the state with the fiducials, and the camera as it is now. Where too
            few fiducials are seen, it is near where it was last.
        """
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
        """Take markers back to where the camera of the rest reference would see them.

        Args:
            state: With the camera as it is now.
            markers: Of a picture that is taken back.

        Returns:
            The markers, with the fiducials beside, and the state with what is in doubt of them.
        """
        p_SM = markers.p_SM
        reference = state.reference
        if reference is not None and state.camera is not None:
            changed = darker(markers, reference.rest)
            p_SM = self._camera.undone(p_SM, changed, state.camera)
            state = replace(state, camera=self._camera.doubted(state.camera, changed))
        return replace(markers, p_SM=p_SM, fiducials=state.fiducials), state
