"""Sensing pipeline of one sensor, from an image to a touch.

It is the only module that combines the stages, and it uses pixels only. A `SensingPipeline` is the
constant part: the sensor and the operators made from its design. A `PipelineState` is the part
passed from one image to the next. `step(state, image, now)` returns the touch and the next state
and changes nothing. So a state can be stored, replayed, passed to another process, or used twice.

A sensor first measures its own reference, as the real device must. It measures the flat membrane
with the valve open, then the inflated one without contact. `StatefulPipeline` combines a pipeline
with its newest state, for purely sequential use.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from mjtactile.core.calibration import Calibration
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import DeviceError
from mjtactile.core.optics import Camera
from mjtactile.core.signature_checks import validated
from mjtactile.core.status import OK, Status
from mjtactile.core.types import (
    Array,
    ContactShape,
    Image,
    Markers,
    PressureReading,
    Surface,
    Touch,
)
from mjtactile.sensing.apply_contact_shape import (
    apply_shape_and_motion,
    attach_shape,
    finder_gauge,
    membrane_displacement,
)
from mjtactile.sensing.contact_decision import ContactDecision
from mjtactile.sensing.contact_shape.estimator import ContactShapeEstimator
from mjtactile.sensing.contact_shape.start_files import load_start
from mjtactile.sensing.force.contact_detection import min_force
from mjtactile.sensing.force.inverse_fem import InverseMembrane
from mjtactile.sensing.force.rest_equilibrium import InverseRest, require_bulge
from mjtactile.sensing.force.stress_relaxation import RelaxationState
from mjtactile.sensing.marker_detection import MarkerDetector, average, moved
from mjtactile.sensing.membrane_estimator import MembraneEstimator
from mjtactile.sensing.pipeline_state import PipelineState, Reference
from mjtactile.sensing.pose.flat_reference import FlatReference, measure_flat
from mjtactile.sensing.settings import DEFAULTS, Settings
from mjtactile.sensing.surface.surface import SurfaceFitter
from mjtactile.sensing.touch import slip

REQUIRED_FORCE = 0.1
"""Force, N, that a sensor should detect; a warning names a sensor that does not."""
_logger = logging.getLogger(__name__)

_EXPLAINED = 1e-3  # fraction of the variance of sharp features below which it is not computed


@validated()
class SensingPipeline:
    """Sensing pipeline of one sensor. Stateless; its operators are made from the design once.

    Calibrated values replace those of the sensor file, unless they are outdated. The force comes
    from inverse finite elements.

    Args:
        design: Sensor design from the sensor file.
        calibration: Calibration of this sensor; None: no calibration.
        settings: Settings of the stages; None: the defaults.
    """

    def __init__(
        self,
        design: SensorDesign,
        calibration: Calibration | None = None,
        *,
        settings: Settings | None = None,
    ):
        settings = DEFAULTS if settings is None else settings
        design.require_markers_that_fit()
        empty = Calibration("", design.name)
        self._measured = empty if calibration is None else calibration.used(design)
        self.design = design = self._measured.design(design)
        self.settings = settings
        self.camera = Camera.from_design(design.camera, design.glass)
        self.inverse = InverseMembrane(
            design, settings.inverse, settings.prior, settings.model_error, settings.fiducials
        )
        self.estimator = MembraneEstimator(design, self.inverse, settings)
        self.fitter = SurfaceFitter(design, settings.surface)
        self.detector = MarkerDetector(design, self.camera, self.estimator, settings)
        self._contact_decision = ContactDecision(self.inverse, self._measured.force, settings)

    def initial_state(self) -> PipelineState:
        """Make the state before any measurement, from the sensor file.

        Returns:
            A state without references.
        """
        return PipelineState(FlatReference.nominal(self.design), self.design.markers.p_SM)

    def restored_state(self) -> PipelineState:
        """Make the state with the references that `calibrate frame` measured, if there are any.

        Returns:
            The state.
        """
        state = self.initial_state()
        frame = self._measured.frame
        if frame is None:
            return state
        flat = FlatReference(frame.R_SC, frame.p_SC, frame.scale, frame.residual_px, frame.scale_sd)
        state = replace(state, flat=flat)
        rest = frame.rest
        if rest is None:
            return state
        return self.load_rest_reference(
            state, rest.markers, rest.gauge_pressure, sealed=rest.sealed
        )

    # -- the sensor's own reference

    @validated()
    def measure_flat_reference(
        self, state: PipelineState, images: Sequence[Image]
    ) -> PipelineState:
        """Measure the camera's pose and each marker's radius on the flat membrane.

        Args:
            state: Any state; its own references are replaced.
            images: Images with the valve open to the air, and without contact.

        Returns:
            The state with the flat reference.

        Raises:
            DeviceError: Too few markers are detected, or they do not agree with the sensor file.
        """
        nominal = replace(state, flat=FlatReference.nominal(self.design))
        identified = [
            self.detector.locate(nominal, image, self.design.markers.p_SM, "flat reference")
            for image in images
        ]
        flat = measure_flat(self.design, self.camera, identified, self.settings.reference)
        flat_at = max((image.time for image in images), default=-math.inf)
        return replace(nominal, flat=flat, expected=self.design.markers.p_SM, flat_at=flat_at)

    @validated()
    def measure_rest_reference(
        self,
        state: PipelineState,
        images: Sequence[Image],
        gauge_pressure: float,
        *,
        sealed: bool = True,
    ) -> PipelineState:
        """Measure the inflated membrane without contact.

        Args:
            state: State with the flat reference.
            images: Images of the membrane at rest.
            gauge_pressure: Gauge pressure in the chamber, Pa.
            sealed: True if the chamber keeps its gas from here on; otherwise the valve keeps its
                pressure.

        Returns:
            The state with the rest reference, without history.

        Raises:
            DeviceError: The membrane does not bulge as predicted. The valve did not move, without a
                pressure sensor to report it, or the membrane is another one.
        """
        markers = self.detect_rest_markers(state, images)
        time = max(image.time for image in images)
        return self.load_rest_reference(state, markers, gauge_pressure, sealed=sealed, time=time)

    @validated()
    def detect_rest_markers(self, state: PipelineState, images: Sequence[Image]) -> Markers:
        """Detect the markers of an inflated membrane without contact.

        Args:
            state: State with the flat reference.
            images: Images of the membrane at rest.

        Returns:
            The markers, averaged over the images.

        Raises:
            DeviceError: Too few markers are detected.
        """
        expected = self.design.markers.p_SM
        found = []
        for image in images:
            markers = self.detector.locate(state, image, expected, "rest reference")
            expected = moved(expected, markers)
            found.append(markers)
        if not found:
            raise DeviceError(f"sensor {self.design.name}: rest reference: no images")
        return average(found)

    @validated()
    def load_rest_reference(
        self,
        state: PipelineState,
        markers: Markers,
        gauge_pressure: float,
        *,
        sealed: bool = True,
        time: float = math.inf,
    ) -> PipelineState:
        """Use a rest state that was measured before; see `measure_rest_reference`.

        Args:
            state: State with the flat reference.
            markers: Markers at rest.
            gauge_pressure: Gauge pressure in the chamber then, Pa.
            sealed: True if the chamber keeps its gas.
            time: Time of the measurement, s, on the images' clock; default: so long ago that stress
                relaxation of the rubber is complete.

        Returns:
            The state with the rest reference, without history.

        Raises:
            DeviceError: The markers do not show the bulge of the sensor file.
        """
        self.detector.require(markers, "rest reference")
        inflated_s = math.inf if math.isinf(time) else time - state.flat_at
        rest = self.inverse.rest_state(
            markers, gauge_pressure, sealed=sealed, inflated_s=inflated_s
        )
        require_bulge(
            self.design,
            markers,
            self.inverse.positions(rest.c)[markers.ids, 2],
            rest,
            state.flat.residual_px,
            lens_measured=self._measured.lens is not None,
            settings=self.settings,
        )
        detectable = self.inverse.detectable_force(rest, markers)
        min_force_found = min_force(detectable, self.settings.zero)
        if min_force_found > REQUIRED_FORCE:
            _warn_of_insensitivity(self.design.name, round(min_force_found, 2))
        surface = self.fitter.fit(markers)
        return replace(
            state,
            reference=Reference(rest, surface, rest, markers.fiducials, min_force_found),
            expected=self.inverse.positions(rest.c),
            gas=None,
            displaced=0,
            camera=None,
            camera_drift=None,
            rubber=self._remembered(rest, inflated_s, time),
        ).without_history()

    def _remembered(
        self, rest: InverseRest, inflated_s: float, time: float
    ) -> RelaxationState | None:
        """Return the relaxation state of the rubber at the rest reference; None: no relaxation."""
        if self.inverse.rubber is None:
            return None
        return self.inverse.rubber.start(rest.c, rest.young, inflated_s, time)

    # -- contact shape

    @validated()
    def make_shape_estimator(self, state: PipelineState) -> ContactShapeEstimator:
        """Make the contact shape estimator for this rest reference; takes 0.1 s, once per
        reference.

        Args:
            state: State with the rest reference.

        Returns:
            The estimator: for the rest as it was first measured, and approximately the current gas.

        Raises:
            DeviceError: The rest reference is missing.
        """
        reference = state.required(self.design.name, "a shape")
        gauge_pressure = finder_gauge(reference)
        start = load_start(self.design, gauge_pressure, self.settings.contact_shape)
        return ContactShapeEstimator(
            self.design, reference.first, gauge_pressure, self.settings, start
        )

    def estimate_contact_shape(
        self, state: PipelineState, touches: Sequence[Touch], finder: ContactShapeEstimator
    ) -> ContactShape:
        """Estimate the contact shape in the newest of several touches.

        Args:
            state: State with the rest reference.
            touches: Touches of one contact episode, oldest first.
            finder: Shape estimator for this rest reference.

        Returns:
            The shape; "unknown", with a status, if it cannot be estimated.

        Raises:
            DeviceError: The rest reference is missing.
        """
        return finder.find(touches, self._rest_markers(state))

    def track_contact_shape(
        self,
        before: PipelineState,
        after: PipelineState,
        touch: Touch,
        finder: ContactShapeEstimator,
        *,
        with_load: bool = True,
    ) -> tuple[Touch, PipelineState]:
        """Estimate the contact shape, using the history of earlier images.

        Args:
            before: State before the image.
            after: State after the image.
            touch: Touch estimated from the image.
            finder: Shape estimator for this rest reference.
            with_load: True for force and slip from the shape; False for its area alone.

        Returns:
            The touch with its shape, and area and force from it, and the state with the history of
            the contact episode.

        Raises:
            DeviceError: The rest reference is missing.
        """
        at_rest = self._rest_markers(after)
        if not with_load:
            found = finder.follow(touch, before.press, at_rest, with_load=False)
            return attach_shape(touch, found.shape), replace(after, press=found.press)
        rubber = membrane_displacement(before, after)
        found = finder.follow(touch, before.press, at_rest, rubber)
        sharpness = None
        explains = found.load is not None and found.load.explained > _EXPLAINED
        if explains and after.shape is not None:
            sharpness = self.inverse.sharpness(after.shape)
        return apply_shape_and_motion(touch, found, after, sharpness, self.settings.slip)

    def _rest_markers(self, state: PipelineState) -> Array:
        """Return the marker positions at rest (N, 3), m, frame S."""
        rest = state.required(self.design.name, "a shape").rest
        return self.inverse.positions(rest.c) + rest.offset

    # -- an image

    @validated()
    def step(
        self, state: PipelineState, image: Image, now: float, reading: PressureReading | None = None
    ) -> tuple[Touch, PipelineState]:
        """Estimate the touch from one image. Stateless: the same state and image give the same
        touch.

        Args:
            state: State from the previous image, with both references.
            image: Image to evaluate.
            now: Current time on the images' clock, s.
            reading: Newest reading of the chamber's pressure sensor; None: no reading.

        Returns:
            The touch, whose status reports problems of the image, and the next state.

        Raises:
            DeviceError: The references are missing.
        """
        if state.reference is None:
            raise DeviceError(
                f"sensor {self.design.name}: an image was given before the flat and rest references"
            )
        unknown = Touch(image.time, now - image.time, np.nan, np.nan, False)
        markers, state = self.detect_markers(state, image)
        if (status := self.check_markers(markers)) != OK:
            return replace(unknown, status=status), state
        if state.camera is not None:
            unknown = replace(unknown, camera=state.camera.change)
        surface = self.fitter.fit(markers)
        touch, state = self.estimate_touch(state, markers, surface, image.time, reading)
        return replace(touch, age=unknown.age, camera=unknown.camera), state

    @validated()
    def detect_markers(self, state: PipelineState, image: Image) -> tuple[Markers, PipelineState]:
        """Find and identify the markers in one image.

        Args:
            state: State from the previous image.
            image: Image to evaluate.

        Returns:
            The markers in S, and the state with their expected positions updated.
        """
        return self.detector.detect_markers(state, image)

    @validated()
    def check_markers(self, markers: Markers) -> Status:
        """Check that enough markers were detected to determine the shape.

        Args:
            markers: Detected markers.

        Returns:
            "ok", or the reason.
        """
        return self.detector.check_markers(markers)

    @validated()
    def estimate_touch(
        self,
        state: PipelineState,
        markers: Markers,
        surface: Surface,
        time: float,
        reading: PressureReading | None = None,
    ) -> tuple[Touch, PipelineState]:
        """Estimate force, contact and slip from markers and surface.

        Args:
            state: State from the previous image, with both references.
            markers: Detected markers.
            surface: Membrane surface through the markers.
            time: Capture time of the image, s.
            reading: Newest reading of the chamber's pressure sensor; None: no reading.

        Returns:
            The touch at the time of the image, and the next state.

        Raises:
            DeviceError: The rest reference is missing.
        """
        reference = state.required(self.design.name, "markers")
        unknown = Touch(time, 0.0, np.nan, np.nan, False, surface=surface, markers=markers)
        if (status := self.check_markers(markers)) != OK:
            return replace(unknown, status=status), state
        if state.rubber is not None:
            rest = self.inverse.at_rest(replace(reference.rest, faded=state.rubber.total))
            reference = replace(reference, rest=rest)
            state = replace(state, reference=reference)
        estimate = self.estimator.estimate(state, reference, markers, time, reading)
        unknown = replace(unknown, markers=estimate.markers)
        if not self.estimator.fits_markers(estimate.shape):
            state = self._contact_decision.lost(estimate.state)
            status = self._contact_decision.failure_status(state)
            lost = slip.unknown(status.code, "shape not explained")
            return replace(unknown, slip=lost, status=status), state
        if self.inverse.rubber is not None and state.rubber is not None:
            scale = estimate.rest.young
            rubber = self.inverse.rubber.after(state.rubber, estimate.shape.c, scale, time)
            estimate = replace(estimate, state=replace(estimate.state, rubber=rubber))
        air_moved = estimate.rest.gauge_pressure - reference.rest.gauge_pressure
        air_moved = air_moved if math.isfinite(air_moved) else 0.0  # no gauge
        traction = self._contact_decision.traction(estimate, air_moved, time)
        return self._contact_decision.evaluate(
            replace(unknown, traction=traction), traction, estimate, air_moved
        )


@cache
def _warn_of_insensitivity(sensor: str, force: float) -> None:
    """Log once per process that a sensor is too stiff for its camera. `force` is in N."""
    _logger.warning(
        "the sensor %r detects contacts only from %.2f N on: its membrane is too stiff for its "
        "camera; use a softer or thinner membrane, or a camera that is closer",
        sensor,
        force,
    )
