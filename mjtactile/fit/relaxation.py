"""Stress relaxation of the rubber, from a recording with a free membrane.

The membrane is free after inflation or unloading.

The stress that has not relaxed yet is q = sum a_i (S - s_i). s_i is the stress S remembered by
element i (docs/theory/membrane_inverse.md, F23). To first order, q displaces a free membrane by
-K^-1 F(q). The displacement is relative to its long-term equilibrium at the measured gauge pressure
p. Markers minus the effect of the pressure are therefore linear in the fractions a_i. A constant at
each marker absorbs the errors of the sensor file. S comes from the shapes estimated by the sensing
pipeline, also during contact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import nnls

from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.fit.measurements import calibration_of, pressures_at
from mjtactile.recording.reader import Recording, load_recording
from mjtactile.sensing.force.inverse_fem import InverseMembrane
from mjtactile.sensing.force.rest_equilibrium import InverseRest
from mjtactile.sensing.force.spline_fem import Gas
from mjtactile.sensing.stateful_pipeline import StatefulPipeline

SHORTEST = 1.0  # shortest time constant, s; faster relaxation ends before the membrane is at rest
_FREE_MIN = 10.0  # minimum duration of a free membrane, s
_ALIKE = 2.0  # neighbouring images that are wrong alike, by the pressure between two readings


@dataclass(frozen=True, eq=False)
class RelaxationFit:
    """Fractions (k,) of elements with the time constants `times` (k,), s.

    `faded` is the relaxation `within` (from, to) s, as a fraction of the long-term stress.
    `faded_sd` is its sd.
    """

    times: Array
    fractions: Array
    within: tuple[float, float]
    faded: float
    faded_sd: float

    @property
    def is_finite_value(self) -> bool:
        """True if the relaxation is significant."""
        return self.faded > 3 * self.faded_sd

    @property
    def section(self) -> str:
        """Section of a sensor file."""
        terms = [
            f"[{fraction:.3g}, {seconds:g}]"
            for fraction, seconds in zip(self.fractions, self.times, strict=True)
            if fraction > 0
        ]
        return f"[relaxation]\nterms_s = [{', '.join(terms)}]  # {self.sentence}\n"

    @property
    def sentence(self) -> str:
        start, end = self.within
        return (
            f"from {start:g} to {end:.0f} s {100 * self.faded:.1f} % of the long-term stress "
            f"relaxes (+-{100 * self.faded_sd:.1f} %)"
        )

    def to_table(self) -> dict[str, Any]:
        """Return the JSON object of the result."""
        return {
            "terms_s": np.column_stack([self.fractions, self.times]).tolist(),
            "within_s": list(self.within),
            "faded_share": self.faded,
            "faded_share_sd": self.faded_sd,
            "known": self.is_finite_value,
        }


def fit_relaxation(path: Path, design: SensorDesign, finger: str) -> RelaxationFit:
    """Fit the fractions of elements spaced a decade apart, up to the length of the recording.

    The static parameters of `design` are fitted already. Raises InputError if the recording has no
    images, no pressures, or no free membrane for 10 s.
    """
    recording = load_recording(path)
    recording.require_images()
    if finger not in recording.fingers:
        message = f"has no finger {finger!r}"
        raise InputError(message, source=path, field="--relaxation", choices=recording.fingers)
    memories = _Memories(recording, design, finger)
    free = memories.free
    lasts = float(memories.time[free].max(initial=0.0) - memories.time[free].min(initial=math.inf))
    if not np.isfinite(memories.pressure).all() or lasts < _FREE_MIN:
        message = (
            f"contains no unloaded membrane with known pressure for {_FREE_MIN:g} s: inflate "
            "and wait, or load, hold and release"
        )
        raise InputError(message, source=path, field="--relaxation")
    fractions, cov = _solve(*memories.equations())
    within = (SHORTEST, lasts)
    start, end = (np.exp(-moment / memories.times) for moment in within)
    sd = math.sqrt((start - end) @ cov @ (start - end))
    return RelaxationFit(memories.times, fractions, within, float(fractions @ (start - end)), sd)


def _solve(shown: Array, requested: Array) -> tuple[Array, Array]:
    """Fit nonnegative fractions (k,) of the responses (n, k, 3 N) to `requested` (n, 3 N).

    The covariance comes from the scatter of the residuals from image to image. An error of the
    pressure sensor moves all markers of an image together.
    """
    shown = shown - shown.mean(axis=0)
    requested = requested - requested.mean(axis=0)
    normal = np.einsum("nkj,nlj->kl", shown, shown)
    normal += 1e-9 * np.trace(normal) * np.eye(len(normal))
    root = np.linalg.cholesky(normal)
    fractions = nnls(root.T, np.linalg.solve(root, np.einsum("nkj,nj->k", shown, requested)))[0]
    left = requested - np.einsum("nkj,k->nj", shown, fractions)
    scores = np.einsum("nkj,nj->nk", shown, left)
    inverse = np.linalg.inv(normal)
    return fractions, _ALIKE * inverse @ (scores.T @ scores) @ inverse


class _Memories:
    """Processed recording.

    For each image it holds `time`, s, gauge `pressure`, Pa, and the flag `free` of an unloaded
    membrane. It also holds the markers, and the stresses remembered by elements of `times`, s.
    """

    def __init__(self, recording: Recording, design: SensorDesign, finger: str):
        finger_index = recording.fingers.index(finger)
        calibration = calibration_of(recording, design, finger)
        perception = StatefulPipeline.of(design, calibration, contact_shapes=False)
        flat, rest = recording.references
        perception.measure_flat_reference(list(flat.images(finger_index)))
        reading = rest.gauge_pressure[finger_index]
        if reading is None:
            raise InputError(
                "has no pressure sensor", source=recording.folder, field="--relaxation"
            )
        gauge = calibration.pressure(reading)
        at_rest = list(rest.images(finger_index))
        perception.measure_rest_reference(at_rest, gauge)
        state = perception.state
        if state.reference is None:
            raise InputError("has no rest reference", source=recording.folder)
        self._inverse: InverseMembrane = perception.pipeline.inverse
        self._rest: InverseRest = state.reference.rest
        self._gauge = gauge
        images = [images[finger_index] for images in recording.images()]
        seconds = images[-1].time - at_rest[-1].time
        self.times = 10.0 ** np.arange(0, max(1, math.ceil(math.log10(seconds))) + 1)
        self._start(at_rest[-1].time - state.flat_at, at_rest[-1].time)
        self.free = np.zeros(len(images), bool)
        self._markers = np.zeros((len(images), design.markers.count, 3))
        self._unfaded: list[Array] = []
        for k, image in enumerate(images):
            touch = perception.perceive(image, image.time)
            shape = perception.state.shape
            if shape is None or touch.markers is None:
                self._unfaded.append(np.zeros(0))
                continue
            self._remember(shape.c, image.time)
            self.free[k] = touch.status == "ok" and not touch.touching
            self.free[k] &= len(touch.markers) == design.markers.count
            self._markers[k, touch.markers.ids] = touch.markers.p_SM
            self._unfaded.append(self._show(shape.c) if self.free[k] else np.zeros(0))
        start = float(recording.columns["time"][0])
        self.time = np.array([image.time - start for image in images])
        self.pressure = pressures_at(recording, finger_index, calibration, self.time)

    def equations(self) -> tuple[Array, Array]:
        """Return the least-squares equations of the n free images.

        The first array is the response to a fraction of 1 of each element, (n, k, 3 N) m. The
        second array is the markers minus the effect of the pressure, (n, 3 N) m.
        """
        shown = np.array(
            [unfaded for unfaded, free in zip(self._unfaded, self.free, strict=True) if free]
        )
        bulge = self._marker_displacement(self._inverse.membrane.state(self._rest.c).gradient)
        markers = self._markers[self.free].reshape(len(shown), -1)
        moved = (self.pressure[self.free] - self._gauge)[:, None] * bulge
        return shown, markers - moved

    def _start(self, inflated_s: float, now: float) -> None:
        membrane = self._inverse.membrane
        rest = self._rest
        state = membrane.state(rest.c, rest.stiffness_scale)
        self._stiffness = membrane.linearise(state, Gas(self._gauge))[1]
        flat = rest.stiffness_scale * membrane.stress(np.zeros_like(rest.c))
        self._stress = rest.stiffness_scale * membrane.stress(rest.c)
        kept = np.exp(-inflated_s / self.times)[:, None, None, None]
        self._remembered = kept * flat + (1 - kept) * self._stress
        self._now = now

    def _remember(self, c: Array, now: float) -> None:
        stress = self._rest.stiffness_scale * self._inverse.membrane.stress(c)
        kept = np.exp(-(now - self._now) / self.times)[:, None, None, None]
        self._remembered = kept * self._remembered + (1 - kept) * (stress + self._stress) / 2
        self._stress = stress
        self._now = now

    def _show(self, c: Array) -> Array:
        """Return the marker displacement for a fraction of 1 of each element, (k, 3 N) m."""
        forces = (
            self._inverse.membrane.forces_of(c, self._stress - stress)
            for stress in self._remembered
        )
        return np.stack([-self._marker_displacement(force) for force in forces])

    def _marker_displacement(self, forces: Array) -> Array:
        """Return the marker displacement (3 N,), m, by generalized forces (3, n), N, at constant
        pressure."""
        moved = self._inverse.positions(self._stiffness.solve(forces))
        return (moved - self._inverse.design.markers.p_SM).ravel()
