"""A chain and its newest state together, for those that only go forward in time."""

from __future__ import annotations

from collections.abc import Sequence

from mjtactile.core.calibration import Calibration
from mjtactile.core.design import SensorDesign
from mjtactile.core.types import FeltShape, Image, Markers, PressureReading, Touch
from mjtactile.sensing.apply_contact_shape import finder_gauge, with_shape
from mjtactile.sensing.contact_shape.estimator import ShapeFinder, told_nothing
from mjtactile.sensing.force.rest_equilibrium import InverseRest
from mjtactile.sensing.pipeline import Chain
from mjtactile.sensing.pipeline_state import ChainState
from mjtactile.sensing.pose.flat_reference import FlatReference
from mjtactile.sensing.settings import DEFAULTS, Settings


class Perception:
    """A chain and its newest state, for those that only go forward in time.

    Args:
        chain: The chain.
        state: Where to begin; None: before anything was measured.
        shapes: Whether every touch has its `shape`; docs/reference/effects.md has what that costs.
    """

    def __init__(self, chain: Chain, state: ChainState | None = None, *, shapes: bool = False):
        self.chain = chain
        self.state = chain.begin() if state is None else state
        self.shapes = shapes
        self._finder: tuple[tuple[InverseRest, float], ShapeFinder] | None = None

    @classmethod
    def of(
        cls,
        design: SensorDesign,
        calibration: Calibration | None = None,
        *,
        settings: Settings = DEFAULTS,
    ) -> Perception:
        """Begin with a sensor that has no references yet.

        Args:
            design: The sensor file's values.
            calibration: What was measured of this sensor; None: nothing.
            settings: The stages' chosen numbers.

        Returns:
            Its chain, with the state before anything was measured.
        """
        return cls(Chain(design, calibration, settings=settings))

    def take_flat(self, images: Sequence[Image]) -> FlatReference:
        """Take the flat reference; see `Chain.take_flat`.

        Args:
            images: With the valve open to the air, nothing touching.

        Returns:
            The flat reference.
        """
        self.state = self.chain.take_flat(self.state, images)
        return self.state.flat

    def take_rest(
        self, images: Sequence[Image], pressure_gauge: float, *, sealed: bool = True
    ) -> Markers:
        """Take the rest reference; see `Chain.take_rest`.

        Args:
            images: Of the membrane at rest.
            pressure_gauge: Pa in the chamber, above ambient.
            sealed: Whether the chamber keeps its gas.

        Returns:
            The markers at rest.
        """
        markers = self.chain.rest_markers(self.state, images)
        time = max(image.time for image in images)
        self.state = self.chain.set_rest(
            self.state, markers, pressure_gauge, sealed=sealed, time=time
        )
        return markers

    def perceive(self, image: Image, now: float, reading: PressureReading | None = None) -> Touch:
        """Feel what one image shows, and keep the state; see `Chain.step`.

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
        lacking = told_nothing(touch, self.chain.settings.body)
        if lacking is not None and before.press is None:
            return with_shape(touch, lacking)
        touch, self.state = self.chain.follow_shape(before, self.state, touch, self._finder_now())
        return touch

    def shape(self, touches: Touch | Sequence[Touch]) -> FeltShape:
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
        lacking = told_nothing(history[-1], self.chain.settings.body)
        if lacking is not None:
            return lacking
        return self.chain.find_shape(self.state, history, self._finder_now())

    def _finder_now(self) -> ShapeFinder:
        """Made when it is first asked for, and again for another rest or another amount of gas."""
        reference = self.state.reference
        key = None if reference is None else (reference.first, finder_gauge(reference))
        if self._finder is None or key is None or self._finder[0] != key:
            finder = self.chain.shape_finder(self.state)
            assert key is not None
            self._finder = (key, finder)
        return self._finder[1]
