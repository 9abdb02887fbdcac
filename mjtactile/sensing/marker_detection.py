"""Detection and identification of markers in images, with a check for a sufficient number."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import DeviceError
from mjtactile.core.optics import Camera
from mjtactile.core.status import OK, Status, StatusCode
from mjtactile.core.types import Array, Ellipses, Image, Markers, SyntheticEllipses
from mjtactile.sensing.fiducial_compensation import FiducialCompensation, average_fiducials
from mjtactile.sensing.force.temporal_blending import BlendEstimator
from mjtactile.sensing.image import tracking
from mjtactile.sensing.image.markers import grey_image, is_overexposed
from mjtactile.sensing.membrane_estimator import MembraneEstimator
from mjtactile.sensing.pipeline_state import PipelineState
from mjtactile.sensing.pose import marker_matching
from mjtactile.sensing.pose.circles import estimate_poses
from mjtactile.sensing.settings import Settings

_NEIGHBORS = 3  # nearest markers of an unseen part of the membrane


class MarkerDetector:
    """Marker detector of one sensor. Stateless. The estimator defines the minimum number of
    markers."""

    def __init__(
        self, design: SensorDesign, camera: Camera, estimator: MembraneEstimator, settings: Settings
    ):
        self.design = design
        self.camera = camera
        self.settings = settings
        self.known = (
            None if design.fiducials is None else FiducialCompensation(design, camera, settings)
        )
        self._blend = BlendEstimator(design.markers.p_SM)
        self._are_enough = estimator.has_enough_markers
        self._circles = design.markers.count + (0 if self.known is None else self.known.count)
        # radius at a view angle of 60 degrees and 1.5 times the distance
        self._smallest_px = max(
            1.5, 0.33 * camera.fx * design.markers.radius / design.camera.distance
        )
        self._largest_px = _largest_px(design, camera)
        self._nearest = _nearest(design.markers.p_SM)

    def detect_markers(self, state: PipelineState, image: Image) -> tuple[Markers, PipelineState]:
        """Detect the markers of one image, in S, and update the state for the next one. See
        `SensingPipeline.detect_markers`."""
        return self._identified(state, *self._ellipses(state.tracks, image))

    def _identified(
        self, state: PipelineState, ellipses: Ellipses, tracks: tracking.Tracks | None
    ) -> tuple[Markers, PipelineState]:
        """Return the markers of the ellipses of one image, and the updated state."""
        if self.known is not None:
            ellipses, state = self.known.compensate(state, ellipses)
        poses = estimate_poses(ellipses, self.camera, self.design.markers.radius)
        poses = state.flat.to_nominal(self.design, poses)
        markers = marker_matching.identify(
            poses,
            self.design,
            state.expected,
            state.flat.scale,
            self.settings.identity,
            darkness=ellipses.darkness,
        )
        if self.known is not None:
            markers, state = self.known.correct_markers(state, markers)
        return markers, replace(
            state,
            expected=moved(state.expected, markers),
            tracks=tracks,
            blend=self._blend.after(state.blend, markers),
        )

    def _ellipses(
        self, tracks: tracking.Tracks | None, image: Image
    ) -> tuple[Ellipses, tracking.Tracks | None]:
        """Return the markers' ellipses in the image, tracked by `tracks`, and the tracks for the
        next."""
        if isinstance(image, SyntheticEllipses) and image.ellipses is not None:
            return image.ellipses, None
        if mismatch := self.camera.size_mismatch(image.pixels, f"sensor {self.design.name}"):
            raise DeviceError(mismatch)
        return tracking.follow(
            image,
            tracks,
            self._circles,
            min_radius_px=self._smallest_px,
            max_radius_px=self._largest_px,
            settings=self.settings,
        )

    def check_markers(self, markers: Markers) -> Status:
        """Check that enough markers were detected to determine the shape; see
        `SensingPipeline.check_markers`."""
        count = len(markers)
        text = f"only {count} of {self.design.markers.count} markers detected"
        if not self._are_enough(count):
            return Status(StatusCode.TOO_FEW_MARKERS, text)
        missing = np.ones(self.design.markers.count, bool)
        missing[markers.ids] = False
        if missing[self._nearest].all(axis=1).any():
            text += ": a part of the image is black, white, covered or torn"
            return Status(StatusCode.TOO_FEW_MARKERS, text)
        return OK

    def locate(self, state: PipelineState, image: Image, expected: Array, purpose: str) -> Markers:
        """Find the markers of one image near the `expected` positions (N, 3), m, for the reference
        `purpose`. Raises DeviceError if the image is overexposed or of another size than the
        camera's, or too few markers are detected."""
        ellipses, tracks = self._ellipses(None, image)  # searched, not followed
        self._require_levels(image, ellipses, purpose)
        afresh = replace(state, expected=expected, reference=None)
        markers, _ = self._identified(afresh, ellipses, tracks)
        self.require(markers, purpose)
        return markers

    def _require_levels(self, image: Image, ellipses: Ellipses, purpose: str) -> None:
        """Raise DeviceError if the image is overexposed around most circles. Their apparent size
        then changes with the light."""
        if isinstance(image, SyntheticEllipses):
            return
        if is_overexposed(grey_image(image), ellipses, "dark", self.settings.locate):
            raise DeviceError(
                f"sensor {self.design.name}: {purpose}: the image is overexposed, white around "
                "most markers; reduce light, exposure or gain"
            )

    def require(self, markers: Markers, purpose: str) -> None:
        """Raise DeviceError for too few markers, or for non-finite positions."""
        known = int(np.isfinite(markers.p_SM).all(axis=1).sum())
        if known < len(markers) or self.check_markers(markers) != OK:
            raise DeviceError(
                f"sensor {self.design.name}: {purpose}: only {known} of "
                f"{self.design.markers.count} markers found; check lighting, focus and "
                "the sensor file"
            )


def _nearest(p_SM: Array) -> NDArray[np.intp]:
    """Return the indices (N, k) of each marker at `p_SM` (N, 3), m, and of its nearest ones. No
    contact hides all of them, and a contact among them would remain unnoticed."""
    away = np.linalg.norm(p_SM[:, None] - p_SM, axis=2)
    return np.argsort(away, axis=1)[:, : _NEIGHBORS + 1]


def _largest_px(design: SensorDesign, camera: Camera) -> float:
    """Return a radius above that of any marker, px: twice that of a marker at the glass. Only a
    frame that is not rectangular has an edge that resembles a circle and encloses all markers."""
    if design.frame.outline is None:
        return math.inf
    nearest = max(design.camera.distance - design.chamber.depth, 1e-3)
    return 2 * camera.fx * design.markers.radius / nearest


def moved(expected: Array, markers: Markers) -> Array:
    """Return `expected` with the detected markers at their current positions."""
    expected = expected.copy()
    expected[markers.ids] = markers.p_SM
    return expected


def average(images: Sequence[Markers]) -> Markers:
    """Return the mean of repeated measurements of markers at rest. A marker counts if it is
    detected in at least half of them."""
    count = np.bincount(np.concatenate([m.ids for m in images]))
    total = np.zeros((len(count), 3))
    normal = np.zeros((len(count), 3))
    cov = np.zeros((len(count), 3, 3))
    dark = np.zeros(len(count))
    for m in images:
        total[m.ids] += m.p_SM
        normal[m.ids] += m.n_S
        cov[m.ids] += m.cov_p
        dark[m.ids] += np.nan if m.darkness is None else m.darkness
    ids = np.flatnonzero(count >= len(images) / 2)
    n = count[ids][:, None]
    direction = normal[ids] / np.linalg.norm(normal[ids], axis=1, keepdims=True)
    mean = dark[ids] / count[ids]
    darkness = mean if np.isfinite(mean).all() else None
    fiducials = [m.fiducials for m in images if m.fiducials is not None]
    return Markers(
        ids,
        total[ids] / n,
        direction,
        cov[ids] / n[..., None] ** 2,
        darkness,
        average_fiducials(fiducials) if fiducials else None,
    )
