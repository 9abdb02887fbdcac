"""Test for a face wider than the frame.

Such a face moves nearly all markers alike, as a changed camera does. The prior of compact contacts
would discount the markers. Or it would attribute the load to such a change. A plane in equilibrium
with membrane and gas competes with it. The hypotheses are compared by their evidence. See
docs/theory/membrane_inverse.md, Eq. F11.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import PressureReading
from mjtactile.sensing.estimate import Estimate, ImageContext
from mjtactile.sensing.force.camera_drift_model import MODES, CameraDriftFilter
from mjtactile.sensing.force.inverse_fem import InverseMembrane
from mjtactile.sensing.force.linearization import PlaneContact, Shape
from mjtactile.sensing.pipeline_state import DISPLACED_IMAGES, PipelineState
from mjtactile.sensing.settings import InverseSettings, Settings

_SAME_LOAD = 0.5  # N; maximum load change in an image in which the camera changes, too
_CERTAIN = 30.0  # log ratio of probabilities beyond which the less likely one is zero


class WideFaceTest:
    """Test for a wide face under one sensor. Stateless."""

    def __init__(self, design: SensorDesign, inverse: InverseMembrane, settings: Settings):
        self._chamber = design.chamber
        self._inverse = inverse
        self._settings = settings.inverse

    def estimate(
        self,
        state: PipelineState,
        image: ImageContext,
        found: Estimate,
        fit: Callable[..., Estimate],
    ) -> Estimate | None:
        """Estimate a wide face in contact.

        Args:
            state: State before the image.
            image: Context of the image.
            found: Estimate for a compact contact.
            fit: Function that estimates from a state, around a `plane` if given.

        Returns:
            The estimate; None if the image favors another hypothesis. Its covariance includes the
            compact contact.
        """
        s = self._settings
        start = self._start(state, found) or self._steady_start(state, found, fit)
        if start is None:
            return None
        if self._inverse.planes.lowest(start.plane) < -self._settings.face_sunk:
            if self._camera_changed(state, found, fit, image):
                return None
            return replace(found, on_frame=True, state=replace(found.state, face=start))
        # tractions around a plane start from those around the last plane
        before = state.shape if state.face is not None else None
        kept = replace(state, shape=before)
        face = fit(kept, plane=start, correlation=s.face_correlation, camera=self._steady(state))
        plane = face.shape.gain.mean
        if plane is None:
            return None
        evidence = face.shape.log_evidence + plane.log_volume
        if self._camera_changed(state, found, fit, image, evidence=evidence):
            return None
        ahead = evidence - found.shape.log_evidence
        if self._gained_gas(state, found, image.reading):
            ahead = math.inf
        if ahead < 0:
            return None
        kept = replace(
            face.state, shape=state.shape, camera_drift=state.camera_drift, displaced=0, face=plane
        )
        face = replace(face, state=kept)
        if ahead > _CERTAIN:
            return face
        likely = 1 / (1 + math.exp(-ahead))
        return replace(face, other=found.shape, other_weight=likely * (1 - likely))

    def with_alternative(
        self, state: PipelineState, found: Estimate, fit: Callable[..., Estimate]
    ) -> Estimate:
        """Add the estimate for wider tractions to `found` as an alternative. This applies to
        contacts that reach the outermost markers, or are as large. The load beyond these markers
        depends on the prior. Of two alternatives the one with the larger difference remains."""
        if found.other is not None and found.other_weight < 1:
            return found  # a face and a compact contact
        shape = found.shape
        flat = np.linalg.norm(self._inverse.force(shape)) / max(shape.gauge_pressure, 1.0)
        is_large = flat > self._settings.face_area * self._inverse.design.frame.area
        reaches = self._inverse.planes.loads_outermost(
            found.markers, shape.traction, shape.gauge_pressure
        )
        if not (is_large or reaches):
            return found
        wide = fit(replace(state, shape=None), correlation=self._settings.face_correlation).shape
        others = [wide] if found.other is None else [wide, found.other]
        force = self._inverse.force(shape)
        farthest = max(
            others, key=lambda other: float(np.linalg.norm(self._inverse.force(other) - force))
        )
        return replace(found, other=farthest)

    def _start(self, state: PipelineState, found: Estimate) -> PlaneContact | None:
        """Return the plane from which the fit starts; None: the markers show no wide face."""
        shape = found.shape
        load = float(np.linalg.norm(self._inverse.force(shape)))
        if load < self._settings.face_load:
            return None
        plane = self._inverse.planes.plane_through(
            found.markers, shape.traction, shape.gauge_pressure, self._settings.face_flat
        )
        if plane is None:
            return None
        if state.face is not None:
            return replace(state.face, plane=plane)
        return PlaneContact(plane, shape.c, np.zeros_like(shape.c), shape.traction)

    def _steady_start(
        self, state: PipelineState, found: Estimate, fit: Callable[..., Estimate]
    ) -> PlaneContact | None:
        """Return the plane from which the fit starts if a camera change in `found` absorbs the load
        of a face. The tractions then follow from an unchanged camera."""
        if state.camera is not None or not has_changed(found.shape, self._settings):
            return None
        steady = CameraDriftFilter.unseen(self._settings, steady=True)
        return self._start(state, fit(state, camera=steady))

    def _camera_changed(
        self,
        state: PipelineState,
        found: Estimate,
        fit: Callable[..., Estimate],
        image: ImageContext,
        evidence: float | None = None,
    ) -> bool:
        """Return True if a changed camera, or lost gas, explains the image better than a face.

        While a face is in contact, its load is not interpreted as such a change. A camera and a
        load that change in the same image are unlikely. The evidence of a plane on the frame is
        unknown, because its equilibrium is. It exceeds that of a compact contact.

        Args:
            state: State before the image.
            found: Estimate for a compact contact.
            fit: Function that estimates from a state.
            image: Context of the image.
            evidence: Log evidence of the face; None: its plane is on the frame.
        """
        if state.face is not None:
            return False
        lowest = found.shape.log_evidence if evidence is None else evidence
        for other in self._changed(state, found):
            rival = fit(other)
            likelier = rival.shape.log_evidence - self._settings.face_change > lowest
            loaded = self._load_change(state, rival) > _SAME_LOAD
            if likelier and not loaded and not self._gained_gas(state, rival, image.reading):
                return True
        return False

    def _load_change(self, state: PipelineState, found: Estimate) -> float:
        """Return the magnitude of the change of force since the last image, N."""
        force = self._inverse.force(found.shape)
        before = np.zeros(3) if state.shape is None else self._inverse.force(state.shape)
        return float(np.linalg.norm(force - before))

    def _steady(self, state: PipelineState) -> CameraDriftFilter | None:
        """Return the prior of an unchanged camera; None: earlier images show the camera. Without
        them, a plane explains a changed zoom, too."""
        if state.camera is not None or state.camera_drift is not None:
            return None
        return CameraDriftFilter.unseen(self._settings, steady=True)

    def _gained_gas(
        self, state: PipelineState, found: Estimate, reading: PressureReading | None
    ) -> bool:
        """Return True if the sealed chamber would contain more gas than before the image. A sealed
        chamber gains no gas. The pressure shows a contact that the shape does not show."""
        gas = state.gas
        if reading is None or gas is None or gas.is_open or reading.is_open:
            return False
        volume = self._inverse.volume(found.shape.c)
        pressure = self._chamber.ambient + reading.gauge_pressure
        amount = pressure * volume**self._chamber.polytropic_exponent
        before = gas.amount * math.exp(gas.value + gas.zero)
        return amount > before * (1 + self._settings.gained_max)

    def _changed(self, state: PipelineState, found: Estimate) -> list[PipelineState]:
        """Return the states that compete with a wide face: displaced camera or lost gas, and
        another drift."""
        rivals = []
        if state.camera is None or found.state.gas is None:
            rivals.append(replace(state, camera_drift=None, displaced=DISPLACED_IMAGES))
        if state.camera_drift is not None:
            rivals.append(replace(state, camera_drift=None))
        return rivals


def size_deviation(shape: Shape) -> float:
    """Return the deviation of all circle sizes in this image from those on the membrane, in
    standard deviations of their common change from image to image; 0 if it is not estimated."""
    camera = shape.gain.camera
    if not isinstance(camera, CameraDriftFilter) or not camera.jitter:
        return 0.0
    return abs(float(shape.camera[MODES]))


def has_changed(shape: Shape, settings: InverseSettings) -> bool:
    """Return True if the camera differs from the drift estimated in earlier images."""
    fraction = shape.camera**2 / shape.gain.observed_drift[1:]
    return bool(fraction[:MODES].max() > settings.changed_min**2)
