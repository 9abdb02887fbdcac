"""Estimation of the membrane shape from the markers of one image.

The gas state from a pressure sensor is included.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Markers, PressureReading
from mjtactile.sensing.estimate import Estimate, ImageContext
from mjtactile.sensing.force.camera_drift_estimator import CameraDriftEstimate
from mjtactile.sensing.force.camera_drift_model import CameraDriftFilter
from mjtactile.sensing.force.gas_filter import GasFilter, GasState
from mjtactile.sensing.force.inverse_fem import InverseMembrane
from mjtactile.sensing.force.linearization import PlaneContact, Shape
from mjtactile.sensing.force.rest_equilibrium import InverseRest
from mjtactile.sensing.pipeline_state import DISPLACED_IMAGES, PipelineState, Reference
from mjtactile.sensing.settings import Settings
from mjtactile.sensing.wide_face import WideFaceTest, has_changed

_SAME_TIME = 0.1  # maximum time between an image and a reading that are compared, s
_NOISE_SD = 3.0  # deviation of a reading without a contradiction, standard deviations
_SET_ASIDE_FRACTION = 0.03  # maximum fraction of the markers, and at least one: more are not dirt


class MembraneEstimator:
    """Membrane shape estimator of one sensor. Stateless."""

    def __init__(self, design: SensorDesign, inverse: InverseMembrane, settings: Settings):
        self._design = design
        self._inverse = inverse
        self._settings = settings
        self._faces = WideFaceTest(design, inverse, settings)
        self.gas_filter = GasFilter(design.chamber, settings.gas_filter)

    def estimate(
        self,
        state: PipelineState,
        reference: Reference,
        markers: Markers,
        time: float,
        reading: PressureReading | None,
    ) -> Estimate:
        """Estimate the shape that explains these markers at `time`, s, or all but one;
        `fits_markers` checks the result. Dirt on a marker makes it appear larger, and closer. Such
        a marker is excluded from then on. `reading` is the newest one of the chamber's pressure
        sensor, if any."""
        image = ImageContext(reference, time, reading)
        known = without(markers, state.set_aside)
        found = self._with_gas(state, image, known)
        is_seen = state.camera is not None
        assumed = None
        if not is_seen and state.camera_drift is None:
            found, assumed = self._static_retry(state, image, found)
        fit = partial(self._with_gas, image=image, markers=known)
        face = self._faces.estimate(state, image, found, fit)
        if face is not None and (face.on_frame or self.fits_markers(face.shape)):
            return face
        state = replace(state, face=None)
        found = replace(found, state=replace(found.state, face=None))
        if state.camera_drift is not None and has_changed(found.shape, self._settings.inverse):
            state = replace(state, camera_drift=None)
            found = self._with_gas(state, image, known)
        if state.shape is not None:
            found = self._missed_touch_retry(state, state.shape, image, found)
        # a camera observed by fiducials is not displaced; gas without a pressure sensor may be lost
        sure = state.displaced >= DISPLACED_IMAGES or (is_seen and found.state.gas is not None)
        if not sure:
            found = self._retry_displaced(state, image, found, loaded=assumed is not None)
        found = self._faces.with_alternative(
            state, found, partial(fit, markers=found.markers, camera=assumed)
        )
        allowed = max(1, round(_SET_ASIDE_FRACTION * self._design.markers.count))
        if self.fits_markers(found.shape) or len(state.set_aside) >= allowed:
            return found
        # marker with the largest misfit
        worst = int(found.markers.ids[found.shape.excess[0, found.markers.ids].argmax()])
        fewer = without(found.markers, (worst,))
        if not self.has_enough_markers(len(fewer)):
            return found
        aside = replace(state, set_aside=(*state.set_aside, worst))
        again = self._with_gas(aside, image, fewer)
        return again if self.fits_markers(again.shape) else found

    def has_enough_markers(self, detected: int) -> bool:
        """Return True if this number of markers determines the shape."""
        return detected >= self._settings.min_detected * self._design.markers.count

    def fits_markers(self, shape: Shape) -> bool:
        """Return True if the markers fit this shape. If all of them have drifted together, they
        fit, and the reference is lost."""
        s = self._settings
        drifted = shape.drift > s.zero.drift_max
        load = float(np.linalg.norm(self._inverse.force(shape)))
        maximum = s.inverse.excess_max * max(1.0, load / s.inverse.overload_min) ** 2
        sharp = float(shape.excess[0].mean()) > maximum and not drifted
        return not sharp and shape.misfit < s.inverse.misfit_max

    def _static_retry(
        self, state: PipelineState, image: ImageContext, found: Estimate
    ) -> tuple[Estimate, CameraDriftFilter | None]:
        """Return the estimate for a camera without drift, and that camera, if that also fits. A
        large load and a camera drift may explain one image equally well. Until an image without
        load shows the camera, it is assumed unchanged: a drift is slow, a load is not."""
        load = float(np.linalg.norm(self._inverse.force(found.shape)))
        if load < self._settings.inverse.cold_load:
            return found, None
        steady = CameraDriftFilter.unseen(self._settings.inverse, steady=True)
        again = self._with_gas(state, image, found.markers, camera=steady)
        if not self.fits_markers(again.shape):
            return found, None
        # this fit carries no information on the camera
        again = replace(again, state=replace(again.state, camera_drift=None))
        return replace(again, other=found.shape), steady

    def _missed_touch_retry(
        self, state: PipelineState, before: Shape, image: ImageContext, found: Estimate
    ) -> Estimate:
        """Return `found`, or the estimate without a history if it fits the markers much better.
        After a phase without contact, the prior may reject a new touch and the markers that show
        it."""
        s = self._settings.inverse
        misfit = found.shape.misfit
        excess = float(found.shape.excess[0].mean())
        as_before = misfit < max(s.overlooked_misfit, s.overlooked_rise * before.misfit)
        distrusted = excess > s.overlooked_excess
        load = float(np.linalg.norm(self._inverse.force(found.shape)))
        if (as_before and not distrusted) or load > s.overlooked_load:
            return found
        afresh = replace(state, shape=None)
        again = self._with_gas(afresh, image, found.markers)
        fits = again.shape.misfit < misfit / s.overlooked_rise
        if distrusted:
            fits = float(again.shape.excess[0].mean()) < excess / s.overlooked_rise
        return replace(again, state=replace(again.state, shape=before)) if fits else found

    def _retry_displaced(
        self, state: PipelineState, image: ImageContext, found: Estimate, *, loaded: bool
    ) -> Estimate:
        """Return the estimate for a displaced camera if that explains the markers, else `found`. It
        must also explain the load of a `loaded` sensor that was never observed without load."""
        shape = found.shape
        if shape.drift > self._settings.inverse.displaced_min:
            sure = replace(state, displaced=DISPLACED_IMAGES, camera_drift=None)
            again = self._with_gas(sure, image, found.markers)
            better = again.shape.drift < shape.drift and again.shape.misfit < shape.misfit
            if loaded:
                load = float(np.linalg.norm(self._inverse.force(again.shape)))
                better = better and load < self._settings.inverse.cold_load
            if better and self.fits_markers(again.shape):
                return replace(again, state=replace(again.state, displaced=state.displaced + 1))
        return replace(found, state=replace(found.state, displaced=0))

    def _with_gas(
        self,
        state: PipelineState,
        image: ImageContext,
        markers: Markers,
        *,
        camera: CameraDriftFilter | None = None,
        correlation: float | None = None,
        plane: PlaneContact | None = None,
    ) -> Estimate:
        """Estimate the shape together with the gas state. In a sealed chamber a reading is combined
        with the volume from the image. If it carries much new information, the image is evaluated
        again."""
        reference, time, reading = image.reference, image.time, image.reading
        rest = reference.rest
        before = camera or self._camera(state, time)
        gas = self._gas_before(state.gas, rest, time, reading)
        if gas is None:
            shape = self._fit(before, state, rest, markers, correlation, plane)
            camera_drift = self._camera_drift(before, shape, reference, rest, time)
            return Estimate(markers, shape, rest, replace(state, camera_drift=camera_drift))
        fit = partial(
            self._shape_with,
            before,
            markers=markers,
            image=image,
            correlation=correlation,
            plane=plane,
        )
        shape, rest, volume = fit(gas, rest, state)
        observed = self.gas_filter.after_image(
            gas, time, volume, self._settings.inverse.dent_fraction
        )
        if reading is not None and not gas.is_open:
            observed, informative = self.gas_filter.read(observed, reading)
            if informative:
                shape, rest, volume = fit(observed, rest, state)
                observed = observed.refine_estimate(volume)
        camera_drift = self._camera_drift(before, shape, reference, rest, time)
        state = replace(
            state, gas=observed, reference=replace(reference, rest=rest), camera_drift=camera_drift
        )
        return Estimate(markers, shape, rest, state, pressure_gap=_gap(shape, time, reading))

    def _gas_before(
        self, gas: GasState | None, rest: InverseRest, time: float, reading: PressureReading | None
    ) -> GasState | None:
        """Return the gas state before the image is evaluated; None without a pressure sensor."""
        if reading is None:
            return gas
        if gas is None:
            volume = self._inverse.volume(rest.c)
            gas = self.gas_filter.start(rest.gas, min(time, reading.time) - 1e-3, volume)
        gas = self.gas_filter.switched(gas, reading)
        if gas.is_open:
            gas, _ = self.gas_filter.read(gas, reading)
        return gas

    def _shape_with(
        self,
        camera: CameraDriftFilter | CameraDriftEstimate,
        gas: GasState,
        rest: InverseRest,
        state: PipelineState,
        markers: Markers,
        image: ImageContext,
        correlation: float | None,
        plane: PlaneContact | None,
    ) -> tuple[Shape, InverseRest, float]:
        """Return the shape for the given gas state, the sensor at rest with it, and the gas volume,
        m^3."""
        chamber = self._design.chamber
        now, sd = self.gas_filter.gas_at(gas, image.time)
        rest = self._inverse.with_gas(rest, now, sd, gas.seen[-1][1])
        measured = None
        reading = image.reading
        if not gas.is_open and reading is not None and abs(image.time - reading.time) < _SAME_TIME:
            measured = reading.gauge_pressure, math.hypot(reading.sd, sd)
        shape = self._fit(camera, state, rest, markers, correlation, plane, measured)
        volume = self._inverse.volume(shape.c)
        pressure = now.pressure_at(volume, chamber.ambient, chamber.polytropic_exponent)
        return replace(shape, gauge_pressure=pressure), rest, volume

    def _fit(
        self,
        camera: CameraDriftFilter | CameraDriftEstimate,
        state: PipelineState,
        rest: InverseRest,
        markers: Markers,
        correlation: float | None,
        plane: PlaneContact | None,
        measured: tuple[float, float] | None = None,
    ) -> Shape:
        if plane is not None:
            plane = self._inverse.plane_contact(markers, rest, camera, plane, measured)
        lost = state.displaced >= DISPLACED_IMAGES and state.camera is not None
        return self._inverse.estimate(
            markers,
            rest,
            state.shape,
            camera=camera,
            lost=lost,
            correlation=correlation,
            mean=plane,
        )

    def _camera(self, state: PipelineState, time: float) -> CameraDriftFilter | CameraDriftEstimate:
        """Return the prior of the camera drift before the image is evaluated."""
        s = self._settings.inverse
        if state.camera is not None:
            return state.camera
        if state.camera_drift is not None:
            return state.camera_drift.later(time, s)
        return CameraDriftFilter.unseen(s, displaced=state.displaced >= DISPLACED_IMAGES)

    def _camera_drift(
        self,
        before: CameraDriftFilter | CameraDriftEstimate,
        shape: Shape,
        reference: Reference,
        rest: InverseRest,
        time: float,
    ) -> CameraDriftFilter | None:
        """Return the camera drift filter after the image; None if fiducials observe the camera. At
        another pressure than that of the reference, or under a load, the bulge height depends on
        the model. Then the image carries little information on the camera."""
        if not isinstance(before, CameraDriftFilter):
            return None
        moved = rest.gauge_pressure - reference.first.gas.gauge_pressure
        moved = moved if math.isfinite(moved) else 0.0  # no gauge
        load = float(np.linalg.norm(self._inverse.force(shape)))
        s = self._settings.inverse
        weight = 1 / (1 + (moved / s.same_bulge) ** 2 + (load / s.same_load) ** 2)
        gain = shape.gain
        return before.updated(shape.camera, gain.left, gain.camera.root, time, weight)


def _gap(shape: Shape, time: float, reading: PressureReading | None) -> float:
    """Return measured minus estimated gauge pressure, Pa, beyond three standard deviations of the
    reading."""
    if reading is None or reading.is_open or abs(time - reading.time) > _SAME_TIME:
        return 0.0
    gap = reading.gauge_pressure - shape.gauge_pressure
    return math.copysign(max(abs(gap) - _NOISE_SD * reading.sd, 0.0), gap)


def without(markers: Markers, ids: Sequence[int]) -> Markers:
    """Return all markers except `ids`."""
    keep = ~np.isin(markers.ids, ids) if ids else np.ones(len(markers), bool)
    if keep.all():
        return markers
    dark = markers.darkness
    return Markers(
        markers.ids[keep],
        markers.p_SM[keep],
        markers.n_S[keep],
        markers.cov_p[keep],
        None if dark is None else dark[keep],
        markers.fiducials,
    )
