"""Estimation of the membrane shape from the markers of one image.

The gas state from a pressure sensor is included.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Markers, PressureReading
from mjtactile.sensing.force.camera_drift_estimator import CameraDriftEstimate
from mjtactile.sensing.force.camera_drift_model import MODES, CameraDriftFilter
from mjtactile.sensing.force.gas_filter import GasFilter, GasState
from mjtactile.sensing.force.inverse_fem import InverseMembrane
from mjtactile.sensing.force.linearization import Shape
from mjtactile.sensing.force.rest_equilibrium import InverseRest
from mjtactile.sensing.pipeline_state import DISPLACED_IMAGES, PipelineState, Reference
from mjtactile.sensing.settings import Settings

_SAME_TIME = 0.1  # maximum time between an image and a reading that are compared, s
_NOISE_SD = 3.0  # standard deviations of a reading that contradict nothing
_SET_ASIDE_FRACTION = 0.03  # maximum fraction of the markers, and at least one: more are not dirt


@dataclass(frozen=True, eq=False)
class Estimate:
    """Membrane `shape` estimated from the `markers`, relative to the sensor at `rest`. `state`
    contains the gas state, from pressure sensor and shape. If without a history two shapes explain
    the markers, `other` is the less likely one. `pressure_gap` is the measured minus the estimated
    gauge pressure beyond the sensor's noise, Pa; 0 without a pressure sensor."""

    markers: Markers
    shape: Shape
    rest: InverseRest
    state: PipelineState
    other: Shape | None = None
    pressure_gap: float = 0.0


@dataclass(frozen=True, eq=False)
class _Image:
    """Context of one image: sensor at rest, capture time, s, and newest pressure reading, if
    any."""

    reference: Reference
    time: float
    reading: PressureReading | None


class MembraneEstimator:
    """Membrane shape estimator of one sensor. Stateless."""

    def __init__(self, design: SensorDesign, inverse: InverseMembrane, settings: Settings):
        self._design = design
        self._inverse = inverse
        self._settings = settings
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
        `fits_markers` checks the result. Dirt on a marker makes it appear larger, and nearer. Such
        a marker is excluded from then on. `reading` is the newest one of the chamber's pressure
        sensor, if any."""
        image = _Image(reference, time, reading)
        known = without(markers, state.set_aside)
        found = self._with_gas(state, image, known)
        is_seen = state.camera is not None
        if self._is_doubtful(state, image, found):
            face = self._face(state, image, found)
            if face is not None:
                return face
        state = replace(state, face=False)
        found = replace(found, state=replace(found.state, face=False))
        if state.camera_drift is not None and self._has_changed(found.shape):
            state = replace(state, camera_drift=None)
            found = self._with_gas(state, image, known)
        if state.shape is None and not is_seen and state.camera_drift is None:
            found = self._static_retry(state, image, found)
        elif state.shape is not None:
            found = self._missed_touch_retry(state, state.shape, image, found)
        # a camera observed by fiducials is not displaced; gas without a pressure sensor may be lost
        sure = state.displaced >= DISPLACED_IMAGES or (is_seen and found.state.gas is not None)
        if not sure:
            found = self._retry_displaced(state, image, found)
        allowed = max(1, round(_SET_ASIDE_FRACTION * self._design.markers.count))
        if self.fits_markers(found.shape) or len(state.set_aside) >= allowed:
            return found
        # whose misfit is largest
        worst = int(found.markers.ids[found.shape.excess[0, found.markers.ids].argmax()])
        fewer = without(found.markers, (worst,))
        if not self.has_enough_markers(len(fewer)):
            return found
        aside = replace(state, set_aside=(*state.set_aside, worst))
        again = self._with_gas(aside, image, fewer)
        return again if self.fits_markers(again.shape) else found

    def has_enough_markers(self, seen: int) -> bool:
        """Return True if this number of markers determines the shape."""
        return seen >= self._settings.min_detected * self._design.markers.count

    def fits_markers(self, shape: Shape) -> bool:
        """Return True if the markers fit this shape. If all of them have drifted together, they
        fit, and the reference is lost."""
        s = self._settings
        drifted = shape.drift > s.zero.drift_max
        load = float(np.linalg.norm(self._inverse.force(shape)))
        maximum = s.inverse.excess_max * max(1.0, load / s.inverse.overload_min) ** 2
        sharp = float(shape.excess[0].mean()) > maximum and not drifted
        return not sharp and shape.misfit < s.inverse.misfit_max

    def _is_doubtful(self, state: PipelineState, image: _Image, found: Estimate) -> bool:
        """Return True if a load is explained only by drift, discounted markers or new gas."""
        s = self._settings.inverse
        shape = found.shape
        if state.face or self._gained_gas(state, found, image.reading):
            return True
        if float(np.linalg.norm(self._inverse.force(shape))) < s.face_load:
            return False
        changed = state.camera_drift is not None and self._has_changed(shape)
        excess = float(shape.excess[0].mean())
        return changed or shape.drift > s.face_drift or excess > s.face_excess

    def _gained_gas(
        self, state: PipelineState, found: Estimate, reading: PressureReading | None
    ) -> bool:
        """Return True if the sealed chamber would contain more gas than before the image. A sealed
        chamber gains no gas. A pressure that rises more than the estimated volume falls is a
        contact that the shape does not show."""
        gas = state.gas
        if reading is None or gas is None or gas.is_open or reading.is_open:
            return False
        chamber = self._design.chamber
        volume = self._inverse.volume(found.shape.c)
        pressure = chamber.ambient + reading.gauge_pressure
        amount = pressure * volume**chamber.polytropic_exponent
        before = gas.amount * math.exp(gas.value + gas.zero)
        return amount > before * (1 + self._settings.inverse.gained_max)

    def _face(self, state: PipelineState, image: _Image, found: Estimate) -> Estimate | None:
        """Return the estimate for a wide face in contact, if the markers favor it, else None.

        A face wider than the frame moves nearly all markers alike. A changed camera or lost gas
        does the same. The prior of compact contacts would discount the markers, or attribute the
        load to such a change. The hypotheses are compared by their evidence. The prior probability
        of a camera change in this very image is exp(-`face_change`).
        """
        s = self._settings.inverse
        fresh = replace(state, shape=None)

        def fit(start: PipelineState, correlation: float | None = None) -> Estimate:
            return self._with_gas(start, image, found.markers, correlation=correlation)

        wide = s.face_correlations[1]
        minimum = found.shape.log_evidence + s.face_margin
        camera = self._camera(state, image.time)
        rough = self._inverse.evidence(found.shape, found.markers, found.rest, camera, wide)
        if rough < minimum - s.face_rough:
            return None
        evidence = fit(fresh, wide).shape.log_evidence
        if evidence < minimum:
            return None
        # while a face is in contact, its load is not interpreted as a camera change
        for other in () if state.face else self._changed(state, found):
            rival = fit(other)
            likelier = rival.shape.log_evidence - s.face_change > evidence
            if likelier and not self._gained_gas(state, rival, image.reading):
                return None
        face = fit(fresh, s.face_correlations[0])
        if not self.fits_markers(face.shape):
            return None
        kept = replace(
            face.state, shape=state.shape, camera_drift=state.camera_drift, displaced=0, face=True
        )
        return replace(face, state=kept)

    def _changed(self, state: PipelineState, found: Estimate) -> list[PipelineState]:
        """Return the states that compete with a wide face: displaced camera or lost gas, and
        another drift."""
        rivals = []
        if state.camera is None or found.state.gas is None:
            rivals.append(replace(state, camera_drift=None, displaced=DISPLACED_IMAGES))
        if state.camera_drift is not None:
            rivals.append(replace(state, camera_drift=None))
        return rivals

    def _static_retry(self, state: PipelineState, image: _Image, found: Estimate) -> Estimate:
        """Return the estimate without a history, for a camera without drift if that also fits. A
        large load and a camera drift may explain one image equally well. Without earlier images,
        the camera is assumed unchanged."""
        load = float(np.linalg.norm(self._inverse.force(found.shape)))
        if load < self._settings.inverse.cold_load:
            return found
        steady = CameraDriftFilter.unseen(self._settings.inverse, steady=True)
        again = self._with_gas(state, image, found.markers, camera=steady)
        if not self.fits_markers(again.shape):
            return found
        # this fit carries no information on the camera
        again = replace(again, state=replace(again.state, camera_drift=None))
        return replace(again, other=found.shape)

    def _has_changed(self, shape: Shape) -> bool:
        """Return True if the camera differs from the drift estimated in earlier images."""
        share = shape.camera**2 / shape.gain.observed_drift[1:]
        return bool(share[:MODES].max() > self._settings.inverse.changed_min**2)

    def _missed_touch_retry(
        self, state: PipelineState, before: Shape, image: _Image, found: Estimate
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

    def _retry_displaced(self, state: PipelineState, image: _Image, found: Estimate) -> Estimate:
        """Return the estimate for a displaced camera if that explains the markers, else `found`."""
        shape = found.shape
        if shape.drift > self._settings.inverse.displaced_min:
            sure = replace(state, displaced=DISPLACED_IMAGES, camera_drift=None)
            again = self._with_gas(sure, image, found.markers)
            better = again.shape.drift < shape.drift and again.shape.misfit < shape.misfit
            if better and self.fits_markers(again.shape):
                return replace(again, state=replace(again.state, displaced=state.displaced + 1))
        return replace(found, state=replace(found.state, displaced=0))

    def _with_gas(
        self,
        state: PipelineState,
        image: _Image,
        markers: Markers,
        *,
        camera: CameraDriftFilter | None = None,
        correlation: float | None = None,
    ) -> Estimate:
        """Estimate the shape together with the gas state. In a sealed chamber a reading is combined
        with the volume from the image. If it carries much new information, the image is evaluated
        again."""
        reference, time, reading = image.reference, image.time, image.reading
        rest = reference.rest
        before = camera or self._camera(state, time)
        gas = self._gas_before(state.gas, rest, time, reading)
        if gas is None:
            shape = self._fit(before, state, rest, markers, correlation)
            camera_drift = self._camera_drift(before, shape, reference, rest, time)
            return Estimate(markers, shape, rest, replace(state, camera_drift=camera_drift))
        fit = partial(self._shape_with, before, markers=markers, time=time, correlation=correlation)
        shape, rest, volume = fit(gas, rest, state)
        seen = self.gas_filter.after_image(gas, time, volume, self._settings.inverse.dent_fraction)
        if reading is not None and not gas.is_open:
            seen, informative = self.gas_filter.read(seen, reading)
            if informative:
                shape, rest, volume = fit(seen, rest, state)
                seen = seen.refine_estimate(volume)
        camera_drift = self._camera_drift(before, shape, reference, rest, time)
        state = replace(
            state, gas=seen, reference=replace(reference, rest=rest), camera_drift=camera_drift
        )
        return Estimate(markers, shape, rest, state, pressure_gap=_gap(shape, time, reading))

    def _gas_before(
        self, gas: GasState | None, rest: InverseRest, time: float, reading: PressureReading | None
    ) -> GasState | None:
        """The gas before the image is looked at; None without a gauge."""
        if reading is None:
            return gas
        if gas is None:
            volume = self._inverse.volume(rest.c)
            gas = self.gas_filter.begin(rest.gas, min(time, reading.time) - 1e-3, volume)
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
        time: float,
        correlation: float | None,
    ) -> tuple[Shape, InverseRest, float]:
        """Return the shape for the given gas state, the sensor at rest with it, and the gas volume,
        m^3."""
        chamber = self._design.chamber
        now, sd = self.gas_filter.gas_at(gas, time)
        rest = self._inverse.with_gas(rest, now, sd, gas.seen[-1][1])
        shape = self._fit(camera, state, rest, markers, correlation)
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
    ) -> Shape:
        lost = state.displaced >= DISPLACED_IMAGES and state.camera is not None
        return self._inverse.estimate(
            markers, rest, state.shape, camera=camera, lost=lost, correlation=correlation
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
    """All markers but these."""
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
