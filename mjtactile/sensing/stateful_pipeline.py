"""A chain and its newest state together, for those that only go forward in time."""

from __future__ import annotations

from collections.abc import Sequence

from mjtactile.core.calibration import Calibration
from mjtactile.core.design import SensorDesign
from mjtactile.core.types import ContactShape, Image, Markers, PressureReading, Touch
from mjtactile.sensing.apply_contact_shape import attach_shape, finder_gauge
from mjtactile.sensing.contact_shape.estimator import ContactShapeEstimator, uninformative_status
from mjtactile.sensing.force.rest_equilibrium import InverseRest
from mjtactile.sensing.pipeline import SensingPipeline
from mjtactile.sensing.pipeline_state import PipelineState
from mjtactile.sensing.pose.flat_reference import FlatReference
from mjtactile.sensing.settings import DEFAULTS, Settings


class StatefulPipeline:
    """A chain and its newest state, for those that only go forward in time.

    Args:
        chain: The chain.
        state: Where to begin; None: before anything was measured.
        shapes: Whether every touch has its `shape`; docs/reference/effects.md has what that costs.
    """

    def __init__(
        self, chain: SensingPipeline, state: PipelineState | None = None, *, shapes: bool = False
    ):
        self.chain = chain
        self.state = chain.begin() if state is None else state
        self.shapes = shapes
        self._finder: tuple[tuple[InverseRest, float], ContactShapeEstimator] | None = None

    @classmethod
    def of(
        cls,
        design: SensorDesign,
        calibration: Calibration | None = None,
        *,
        settings: Settings = DEFAULTS,
    ) -> StatefulPipeline:
        """Begin with a sensor that has no references yet.

        Args:
            design: The sensor file's values.
            calibration: What was measured of this sensor; None: nothing.
            settings: The stages' chosen numbers.

        Returns:
            Its chain, with the state before anything was measured.
        """
        return cls(SensingPipeline(design, calibration, settings=settings))

    def measure_flat_reference(self, images: Sequence[Image]) -> FlatReference:
        """Take the flat reference; see `SensingPipeline.measure_flat_reference`.

        Args:
            images: With the valve open to the air, nothing touching.

        Returns:
            The flat reference.
        """
        self.state = self.chain.measure_flat_reference(self.state, images)
        return self.state.flat

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
        markers = self.chain.detect_rest_markers(self.state, images)
        time = max(image.time for image in images)
        self.state = self.chain.load_rest_reference(
            self.state, markers, gauge_pressure, sealed=sealed, time=time
        )
        return markers

    def perceive(self, image: Image, now: float, reading: PressureReading | None = None) -> Touch:
        """Feel what one image shows, and keep the state; see `SensingPipeline.step`.

        Args:
            image: The image.
            now: s on the clock of the image's time.
            reading: Newest reading of the chamber's pressure gauge; None: there is none.

        Returns:
            The touch.
        """
        before = self.state
        touch, self.state = self.chain.step(before, image, now, reading)
        if not self.shapes:
            return touch
        lacking = uninformative_status(touch, self.chain.settings.body)
        if lacking is not None and before.press is None:
            return attach_shape(touch, lacking)
        touch, self.state = self.chain.track_contact_shape(
            before, self.state, touch, self._finder_now()
        )
        return touch

    def shape(self, touches: Touch | Sequence[Touch]) -> ContactShape:
        """Say what body touches.

        Args:
            touches: One touch, or those of one press, oldest first: a ball's contact grows with the
                force and a flat face's does not, so that several tell more than one.

        Returns:
            The shape in the newest; "unknown", with a status, where it cannot be said.

        Raises:
            DeviceError: The rest reference is missing.
        """
        history = [touches] if isinstance(touches, Touch) else list(touches)
        lacking = uninformative_status(history[-1], self.chain.settings.body)
        if lacking is not None:
            return lacking
        return self.chain.estimate_contact_shape(self.state, history, self._finder_now())

    def _finder_now(self) -> ContactShapeEstimator:
        """Made when it is first asked for, and again for another rest or another amount of gas."""
        reference = self.state.reference
        key = None if reference is None else (reference.first, finder_gauge(reference))
        if self._finder is None or key is None or self._finder[0] != key:
            finder = self.chain.make_shape_estimator(self.state)
            assert key is not None
            self._finder = (key, finder)
        return self._finder[1]
