"""One sensor's chain from an image to touch; the only place where the stages meet. Works from
pixels alone.

A `SensingPipeline` is what stays the same: the sensor and the operators made from its design. A
`PipelineState` is what one image leaves for the next. `step(state, image, now)` gives the touch and
the next state and changes nothing, so that a state can be kept, replayed, handed to another
process, or tried twice.

A sensor first measures its own reference, as the real device must: the flat membrane with the valve
open, then the inflated one with nothing touching. `StatefulPipeline` keeps a chain and its newest
state together for those that only go forward."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mjtactile.core.calibration import Calibration
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import DeviceError
from mjtactile.core.optics import Camera
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
    finder_gauge,
    membrane_displacement,
)
from mjtactile.sensing.contact_decision import ContactDecision
from mjtactile.sensing.contact_shape.estimator import ContactShapeEstimator
from mjtactile.sensing.force import rest_shape_check
from mjtactile.sensing.force.inverse_fem import InverseMembrane
from mjtactile.sensing.force.rest_equilibrium import InverseRest
from mjtactile.sensing.force.stress_relaxation import RelaxationState
from mjtactile.sensing.marker_detection import MarkerDetector, average, moved
from mjtactile.sensing.membrane_estimator import MembraneEstimator
from mjtactile.sensing.pipeline_state import PipelineState, Reference
from mjtactile.sensing.pose.flat_reference import FlatReference, measure_flat
from mjtactile.sensing.settings import DEFAULTS, Settings
from mjtactile.sensing.surface.surface import SurfaceFitter
from mjtactile.sensing.touch import slip


class SensingPipeline:
    """The sensing chain of one sensor: operators made from its design once; nothing changes.

    What was measured of it stands in for what the sensor file says, but for parts that are
    outdated. The force comes from inverse finite elements.

    Args:
        design: The sensor file's values.
        calibration: What was measured of this sensor; None: nothing.
        settings: The stages' chosen numbers.
    """

    def __init__(
        self,
        design: SensorDesign,
        calibration: Calibration | None = None,
        *,
        settings: Settings = DEFAULTS,
    ):
        design.require_markers_that_fit()
        nothing = Calibration("", design.name)
        self._measured = nothing if calibration is None else calibration.used(design)
        self.design = design = self._measured.design(design)
        self.settings = settings
        self.camera = Camera.from_design(design.camera, design.glass)
        self.inverse = InverseMembrane(
            design, settings.inverse, settings.prior, settings.doubt, settings.fiducials
        )
        self.estimator = MembraneEstimator(design, self.inverse, settings)
        self.fitter = SurfaceFitter(design, settings.surface)
        self.sight = MarkerDetector(design, self.camera, self.estimator, settings)
        self._judge = ContactDecision(self.inverse, self._measured.force, settings)

    def begin(self) -> PipelineState:
        """Make the state before anything was measured: what the sensor file says.

        Returns:
            A state without references.
        """
        return PipelineState(FlatReference.nominal(self.design), self.design.markers.p_SM)

    def recall(self) -> PipelineState:
        """Make the state with the references that `calibrate frame` measured, if there are any.

        Returns:
            The state.
        """
        state = self.begin()
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

    def measure_flat_reference(
        self, state: PipelineState, images: Sequence[Image]
    ) -> PipelineState:
        """Measure the camera's pose and each marker's radius on the flat membrane.

        Args:
            state: Any state; its own references are replaced.
            images: With the valve open to the air, nothing touching.

        Returns:
            The state with the flat reference.

        Raises:
            DeviceError: Too few markers are seen, or they do not agree with the sensor file.
        """
        nominal = replace(state, flat=FlatReference.nominal(self.design))
        seen = [
            self.sight.locate(nominal, image, self.design.markers.p_SM, "flat reference")
            for image in images
        ]
        flat = measure_flat(self.design, self.camera, seen, self.settings.reference)
        flat_at = max((image.time for image in images), default=-math.inf)
        return replace(nominal, flat=flat, expected=self.design.markers.p_SM, flat_at=flat_at)

    def measure_rest_reference(
        self,
        state: PipelineState,
        images: Sequence[Image],
        gauge_pressure: float,
        *,
        sealed: bool = True,
    ) -> PipelineState:
        """Measure the inflated membrane with nothing touching.

        Args:
            state: With the flat reference.
            images: Of the membrane at rest.
            gauge_pressure: Pa in the chamber, above ambient.
            sealed: Whether the chamber keeps its gas from here on; otherwise the valve keeps its
                pressure.

        Returns:
            The state with the rest reference, without history.

        Raises:
            DeviceError: The membrane does not bulge as it must: a valve that did not move where no
                pressure sensor says so, or another membrane.
        """
        markers = self.detect_rest_markers(state, images)
        time = max(image.time for image in images)
        return self.load_rest_reference(state, markers, gauge_pressure, sealed=sealed, time=time)

    def detect_rest_markers(self, state: PipelineState, images: Sequence[Image]) -> Markers:
        """Find the markers of an inflated membrane that nothing touches.

        Args:
            state: With the flat reference.
            images: Of the membrane at rest.

        Returns:
            The markers, the mean of the images.

        Raises:
            DeviceError: Too few are seen.
        """
        expected = self.design.markers.p_SM
        seen = []
        for image in images:
            markers = self.sight.locate(state, image, expected, "rest reference")
            expected = moved(expected, markers)
            seen.append(markers)
        if not seen:
            raise DeviceError(f"sensor {self.design.name}: rest reference: no images")
        return average(seen)

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
            state: With the flat reference.
            markers: At rest.
            gauge_pressure: Pa in the chamber then.
            sealed: Whether the chamber keeps its gas.
            time: When it was measured, s on the images' clock; left out: so long ago that rubber
                that relaxes has done so.

        Returns:
            The state with the rest reference, without history.

        Raises:
            DeviceError: The markers are no bulge of the sensor file's.
        """
        self.sight.require(markers, "rest reference")
        inflated_s = math.inf if math.isinf(time) else time - state.flat_at
        rest = self.inverse.rest_state(
            markers, gauge_pressure, sealed=sealed, inflated_s=inflated_s
        )
        rest_shape_check.require_bulge(
            self.design,
            markers,
            self.inverse.positions(rest.c)[markers.ids, 2],
            rest,
            state.flat.residual_px,
            lens_measured=self._measured.lens is not None,
            settings=self.settings,
        )
        return replace(
            state,
            reference=Reference(rest, self.fitter.fit(markers), rest, markers.fiducials),
            expected=self.inverse.positions(rest.c),
            gas=None,
            knocked=0,
            camera=None,
            belief=None,
            rubber=self._remembered(rest, inflated_s, time),
        ).without_history()

    def _remembered(
        self, rest: InverseRest, inflated_s: float, time: float
    ) -> RelaxationState | None:
        """What the rubber remembers at the rest reference; None: it does not relax."""
        if self.inverse.rubber is None:
            return None
        return self.inverse.rubber.begin(rest.c, rest.young, inflated_s, time)

    # -- what touches

    def make_shape_estimator(self, state: PipelineState) -> ContactShapeEstimator:
        """Make what finds shapes with this rest; a tenth of a second, once for a rest.

        Args:
            state: With the rest reference.

        Returns:
            The finder: of the rest as it was first measured, and of about the gas that is there
            now.

        Raises:
            DeviceError: The rest reference is missing.
        """
        reference = state.required(self.design.name, "a shape")
        return ContactShapeEstimator(
            self.design, reference.first, finder_gauge(reference), self.settings
        )

    def estimate_contact_shape(
        self, state: PipelineState, touches: Sequence[Touch], finder: ContactShapeEstimator
    ) -> ContactShape:
        """Say what body touches in the newest of some touches.

        Args:
            state: With the rest reference.
            touches: Of one press, oldest first.
            finder: Of this rest.

        Returns:
            The shape; "unknown", with a status, where it cannot be said.

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
    ) -> tuple[Touch, PipelineState]:
        """Find what body touches, from what the images before have told of it.

        Args:
            before: The state before the image.
            after: The state after it.
            touch: What it was felt to be.
            finder: Of this rest.

        Returns:
            The touch with its shape, area and force by it, and the state that remembers the press.

        Raises:
            DeviceError: The rest reference is missing.
        """
        rubber = membrane_displacement(before, after)
        found = finder.follow(touch, before.press, self._rest_markers(after), rubber)
        sharpness = np.zeros(6)
        if after.shape is not None and touch.traction is not None:
            sharpness = self.inverse.sharpness(after.shape)
        return apply_shape_and_motion(touch, found, after, sharpness, self.settings.slip)

    def _rest_markers(self, state: PipelineState) -> Array:
        """Where they stand at rest, (N, 3) m in S."""
        rest = state.required(self.design.name, "a shape").rest
        return self.inverse.positions(rest.c) + rest.offset

    # -- an image

    def step(
        self, state: PipelineState, image: Image, now: float, reading: PressureReading | None = None
    ) -> tuple[Touch, PipelineState]:
        """Feel what one image shows. Changes nothing: the same state and image give the same touch.

        Args:
            state: What the image before left, with both references.
            image: The image.
            now: s on the clock of the image's time.
            reading: Newest reading of the chamber's pressure gauge; None: there is none.

        Returns:
            The touch, in whose status is what is wrong with the image, and the state for the next.

        Raises:
            DeviceError: The references are missing.
        """
        if state.reference is None:
            raise DeviceError(
                f"sensor {self.design.name}: an image before the references of the flat and the "
                "resting membrane"
            )
        unknown = Touch(image.time, now - image.time, np.nan, np.nan, False)
        markers, state = self.see(state, image)
        if (status := self.enough(markers)) != OK:
            return replace(unknown, status=status), state
        if state.camera is not None:
            unknown = replace(unknown, camera=state.camera.change)
        surface = self.fitter.fit(markers)
        touch, state = self.feel(state, markers, surface, image.time, reading)
        return replace(touch, age=unknown.age, camera=unknown.camera), state

    def see(self, state: PipelineState, image: Image) -> tuple[Markers, PipelineState]:
        """Find and identify the markers in one image.

        Args:
            state: What the image before left.
            image: The image.

        Returns:
            The markers in S, and the state in which they are expected where they are now.
        """
        return self.sight.see(state, image)

    def enough(self, markers: Markers) -> Status:
        """Judge whether so many markers were seen that the shape is no guess.

        Args:
            markers: What was seen.

        Returns:
            "ok", or why not.
        """
        return self.sight.enough(markers)

    def feel(
        self,
        state: PipelineState,
        markers: Markers,
        surface: Surface,
        time: float,
        reading: PressureReading | None = None,
    ) -> tuple[Touch, PipelineState]:
        """Find force, contact and slip from markers and surface.

        Args:
            state: What the image before left, with both references.
            markers: What was seen.
            surface: The membrane's shape through them.
            time: Of the image's capture, s.
            reading: Newest reading of the chamber's pressure gauge; None: there is none.

        Returns:
            The touch, as old as the image, and the state for the next.

        Raises:
            DeviceError: The rest reference is missing.
        """
        reference = state.required(self.design.name, "markers")
        unknown = Touch(time, 0.0, np.nan, np.nan, False, surface=surface, markers=markers)
        if (status := self.enough(markers)) != OK:
            return replace(unknown, status=status), state
        if state.rubber is not None:
            rest = self.inverse.at_rest(replace(reference.rest, faded=state.rubber.total))
            reference = replace(reference, rest=rest)
            state = replace(state, reference=reference)
        estimate = self.estimator.estimate(state, reference, markers, time, reading)
        unknown = replace(unknown, markers=estimate.markers)
        if not self.estimator.fits_markers(estimate.shape):
            state = self._judge.lost(estimate.state)
            status = self._judge.failure_status(state)
            lost = slip.unknown(status.code, "shape not explained")
            return replace(unknown, slip=lost, status=status), state
        if self.inverse.rubber is not None and state.rubber is not None:
            scale = estimate.rest.young
            rubber = self.inverse.rubber.after(state.rubber, estimate.shape.c, scale, time)
            estimate = replace(estimate, state=replace(estimate.state, rubber=rubber))
        air_moved = estimate.rest.gauge_pressure - reference.rest.gauge_pressure
        air_moved = air_moved if math.isfinite(air_moved) else 0.0  # no gauge
        traction = self._judge.traction(estimate, air_moved, time)
        return self._judge.judge(replace(unknown, traction=traction), traction, estimate, air_moved)
