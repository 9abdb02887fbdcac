"""Sensing pipeline combined with its newest state, for sequential use only."""

from __future__ import annotations

from collections.abc import Sequence

from mjtactile.core.calibration import Calibration
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.signature_checks import validated
from mjtactile.core.types import ContactShape, Image, Markers, PressureReading, Touch
from mjtactile.sensing.apply_contact_shape import attach_shape, finder_gauge
from mjtactile.sensing.contact_shape.estimator import ContactShapeEstimator, uninformative_status
from mjtactile.sensing.force.rest_equilibrium import InverseRest
from mjtactile.sensing.pipeline import SensingPipeline
from mjtactile.sensing.pipeline_state import PipelineState
from mjtactile.sensing.pose.flat_reference import FlatReference
from mjtactile.sensing.settings import Settings


@validated()
class StatefulPipeline:
    """Sensing pipeline and its newest state, for callers that only go forward in time.

    Args:
        pipeline: The sensing pipeline.
        state: Initial state; None: the state before any measurement.
        contact_shapes: None: every touch gets its `shape`, and its contact area from it. True:
            force and slip come from it as well. False: no shapes. docs/reference/effects.md lists
            the cost.

    Raises:
        InputError: The state is of another sensor.
    """

    def __init__(
        self,
        pipeline: SensingPipeline,
        state: PipelineState | None = None,
        *,
        contact_shapes: bool | None = None,
    ):
        count = pipeline.design.markers.count
        if state is not None and len(state.expected) != count:
            raise InputError(
                f"is of another sensor: {len(state.expected)} markers, not {count}",
                source="StatefulPipeline",
                field="state",
            )
        self.pipeline = pipeline
        self.state = pipeline.initial_state() if state is None else state
        self.contact_shapes = contact_shapes
        self._finder: tuple[tuple[InverseRest, float], ContactShapeEstimator] | None = None

    @classmethod
    @validated()
    def of(
        cls,
        design: SensorDesign,
        calibration: Calibration | None = None,
        *,
        settings: Settings | None = None,
        contact_shapes: bool | None = None,
    ) -> StatefulPipeline:
        """Create a pipeline for a sensor that has no references yet.

        Args:
            design: The sensor file's values.
            calibration: Measured calibration of this sensor; None: no calibration.
            settings: The stages' parameters; None: the defaults.
            contact_shapes: As for the class.

        Returns:
            The pipeline, with the state before any measurement.
        """
        pipeline = SensingPipeline(design, calibration, settings=settings)
        return cls(pipeline, contact_shapes=contact_shapes)

    @validated()
    def measure_flat_reference(self, images: Sequence[Image]) -> FlatReference:
        """Take the flat reference; see `SensingPipeline.measure_flat_reference`.

        Args:
            images: Images with the valve open to the air, and without contact.

        Returns:
            The flat reference.
        """
        self.state = self.pipeline.measure_flat_reference(self.state, images)
        return self.state.flat

    @validated()
    def measure_rest_reference(
        self, images: Sequence[Image], gauge_pressure: float, *, sealed: bool = True
    ) -> Markers:
        """Take the rest reference; see `SensingPipeline.measure_rest_reference`.

        Args:
            images: Of the membrane at rest.
            gauge_pressure: Pa in the chamber, above ambient.
            sealed: Whether the chamber keeps its gas.

        Returns:
            The markers at rest.
        """
        markers = self.pipeline.detect_rest_markers(self.state, images)
        time = max(image.time for image in images)
        self.state = self.pipeline.load_rest_reference(
            self.state, markers, gauge_pressure, sealed=sealed, time=time
        )
        return markers

    @validated()
    def perceive(self, image: Image, now: float, reading: PressureReading | None = None) -> Touch:
        """Estimate the touch from one image, and keep the state; see `SensingPipeline.step`.

        Args:
            image: The image.
            now: Current time on the clock of the image's time, s.
            reading: Newest reading of the chamber's pressure sensor; None: there is none.

        Returns:
            The touch.
        """
        before = self.state
        touch, self.state = self.pipeline.step(before, image, now, reading)
        if self.contact_shapes is False:
            return touch
        lacking = uninformative_status(touch, self.pipeline.settings.contact_shape)
        if lacking is not None and before.press is None:
            return attach_shape(touch, lacking)
        touch, self.state = self.pipeline.track_contact_shape(
            before, self.state, touch, self._finder_now(), with_load=self.contact_shapes is True
        )
        return touch

    @validated()
    def shape(self, touches: Touch | Sequence[Touch]) -> ContactShape:
        """Estimate the contact shape.

        Args:
            touches: One touch, or those of one contact episode, oldest first. Several touches carry
                more information: a sphere's contact area grows with the force, a flat face's does
                not.

        Returns:
            The shape in the newest touch; "unknown", with a status, if it cannot be determined.

        Raises:
            DeviceError: The rest reference is missing.
            InputError: There is no touch.
        """
        history = [touches] if isinstance(touches, Touch) else list(touches)
        if not history:
            raise InputError("is empty", source="shape", field="touches")
        lacking = uninformative_status(history[-1], self.pipeline.settings.contact_shape)
        if lacking is not None:
            return lacking
        return self.pipeline.estimate_contact_shape(self.state, history, self._finder_now())

    def _finder_now(self) -> ContactShapeEstimator:
        """Return the shape estimator. It is created at its first use, and again for another rest
        reference or gas amount."""
        reference = self.state.required(self.pipeline.design.name, "a shape")
        gauge_pressure = None
        if self._finder is not None and self._finder[0][0] == reference.first:
            gauge_pressure = self._finder[0][1]
        key = (reference.first, finder_gauge(reference, gauge_pressure))
        if self._finder is None or self._finder[0] != key:
            self._finder = (key, self.pipeline.make_shape_estimator(self.state))
        return self._finder[1]
