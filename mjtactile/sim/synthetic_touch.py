"""Touch without the sensing pipeline (`--effects -mesh,-pipeline`).

Loads of a quasi-static membrane get the errors of the sensing pipeline at that load. It models the
sensor with its software, so it may read the ground truth. It replaces a camera and returns
`SyntheticTouch` instead of an image.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from mjtactile.core.errors import InputError
from mjtactile.core.status import OK, Status, StatusCode
from mjtactile.core.types import Array, Contact, Slip, SlipState, SyntheticTouch, Touch, Traction
from mjtactile.core.types.arrays import fixed
from mjtactile.kernels import bound
from mjtactile.sim.sensing_error_model import ErrorsAtLoad, SensingErrorModel
from mjtactile.sim.sensor.quasistatic_sensor import QuasistaticSensor
from mjtactile.sim.sensor.sensor_types import AnySensor

_RECENT = 0.12  # time window of slip detection, s, as in the sensing pipeline
_NONE = fixed(np.zeros(0))
_NO_FORCES = fixed(np.zeros((0, 0, 3)))
_NO_MASK = fixed(np.zeros((0, 0), bool))
_NOWHERE = fixed(np.full(2, np.nan))
_STILL = fixed(np.zeros(2))
_NO_CONTACT = Contact(False, 0.0, _NOWHERE, 0.0, _NO_MASK)
_NO_SLIP = Slip("none", _STILL, 0.0, 1.0)
_COLUMNS = 30
# indices in the kernel's settings
_GRASP = 1
_ELAPSED = 3
METHOD = "sampled"
"""Value of `Traction.method` for a touch without a sensing pipeline."""


class SensingErrorSampler:
    """The errors of one sensor's wrench, image after image."""

    def __init__(self, errors: SensingErrorModel):
        self._errors = errors
        self._spread = np.linalg.cholesky(errors.correlation)
        self._slow = np.zeros(6)
        self._settings = np.array([errors.slow_time, 0.0, 0.0, 0.0, 0.0])
        self._normals = np.zeros(12)
        self._true = np.zeros(6)
        self._row = np.zeros(_COLUMNS)
        self._wrench = np.zeros(6)
        self._cov = np.zeros((6, 6))
        model = (len(errors.loads), errors.loads, errors.at_loads, errors.gain, self._spread)
        settings = (errors.reported_correlation, self._settings, errors.outlier_size)
        state = (self._normals, self._true, self._slow)
        results = (self._row, self._wrench, self._cov)
        self._sample = bound("sample_errors", *model, *settings, *state, *results)

    def start(self, rng: np.random.Generator) -> None:
        """Sample the persistent errors again."""
        self._slow[:] = self._spread @ rng.standard_normal(6)
        grasp, gain = rng.standard_normal(2)
        self._settings[_GRASP:_ELAPSED] = grasp, self._errors.shear_gain * gain

    def estimated(
        self, true: Array, elapsed: float, rng: np.random.Generator
    ) -> tuple[Array, Array, ErrorsAtLoad]:
        """Return a simulated estimate (6,) of the `true` wrench (6,), its covariance and errors.

        `elapsed` s is the time since the previous image. Arrays are valid until the next call.
        """
        self._true[:] = true
        rng.standard_normal(out=self._normals)
        self._settings[_ELAPSED:] = elapsed, rng.random()
        self._sample()
        return self._wrench, self._cov, ErrorsAtLoad.of(self._row)


class SyntheticTouchSource:
    """Replacement for one sensor's camera and sensing pipeline.

    `friction` is the coefficient that the sensing pipeline assumes. Raises InputError for a sensor
    with a mesh membrane.
    """

    def __init__(self, sensor: AnySensor, errors: SensingErrorModel, friction: float, seed: int):
        if not isinstance(sensor, QuasistaticSensor):
            raise InputError(
                "synthetic touch needs a quasi-static membrane, not a mesh",
                field="--effects",
                choices=["-mesh,-pipeline"],
            )
        self._sensor = sensor
        self._errors = errors
        self._friction = friction
        self._error_sampler = SensingErrorSampler(errors)
        self._time = math.nan
        self._touching = False
        self._slides: deque[tuple[float, float]] = deque()
        self._sampled: SyntheticTouch | None = None
        self.reseed(seed)

    def reseed(self, seed: int) -> None:
        """Sample all future errors from a new generator, including the persistent ones."""
        self._rng = np.random.default_rng(seed)
        self._error_sampler.start(self._rng)
        self._sampled = None

    def capture(self) -> None:
        """Compute the current touch for `read`."""
        self._sampled = SyntheticTouch.of(self._touch())

    def read(self) -> SyntheticTouch:
        """Return the simulated measurement at the present time."""
        if self._sampled is None or self._sampled.time != self._sensor.time:
            self.capture()
        sampled = self._sampled
        self._sampled = None
        assert sampled is not None
        return sampled

    def _touch(self) -> Touch:
        sensor = self._sensor
        time = sensor.time
        elapsed = 0.0 if math.isnan(self._time) else max(time - self._time, 0.0)
        self._time = time
        wrench, cov, here = self._error_sampler.estimated(
            sensor.present_wrench(), elapsed, self._rng
        )
        if self._rng.random() < here.unknown:
            status = Status(StatusCode.FIT_FAILED, "the markers fit no membrane shape")
            lost = Slip("unknown", _NOWHERE, math.nan, math.nan, status)
            return Touch(time, 0.0, math.nan, math.nan, False, slip=lost, status=status)
        traction = Traction(_NONE, _NONE, _NO_FORCES, wrench, cov, sensor.gauge_pressure, METHOD)
        wrench = traction.wrench
        force = -float(wrench[2])
        self._detect(force)
        contact = self._contact(wrench, here, self._rng.standard_normal(3).tolist())
        return Touch(
            time,
            0.0,
            force,
            float(here.reported_sd[2]),
            self._touching,
            contact,
            traction,
            slip=self._slip(time, wrench),
            patches=(contact,) if self._touching else (),
            status=OK,
        )

    def _detect(self, force: float) -> None:
        release = self._errors.release if self._touching else 1.0
        self._touching = force > release * self._errors.touch_force

    def _contact(self, wrench: Array, here: ErrorsAtLoad, new: list[float]) -> Contact:
        sensor = self._sensor
        if not self._touching:
            return _NO_CONTACT
        area = sensor.contact_area * math.exp(here.area + here.area_sd * new[0])
        x, y, _ = sensor.middle.tolist()
        centroid = x + here.centroid_sd * new[1], y + here.centroid_sd * new[2]
        radius = math.sqrt(area / math.pi)
        return Contact(
            True,
            area,
            np.array(centroid),
            self._errors.depth * sensor.depth,
            _NO_MASK,
            force=wrench[:3],
            semi_axes=np.array([radius, radius]),
            angle=0.0,
        )

    def _slip(self, time: float, wrench: Array) -> Slip:
        """Return the slip state that the pipeline would report, after some sliding distance."""
        if not self._touching:
            self._slides.clear()
            return _NO_SLIP
        slid = self._sensor.slid
        slides = self._slides
        if slides and slides[-1][1] > slid:  # another touch
            slides.clear()
        slides.append((time, slid))
        while time - slides[0][0] > _RECENT:
            slides.popleft()
        distance = slid - slides[0][1]
        elapsed = time - slides[0][0]
        pressed = max(-float(wrench[2]), 1e-6)
        shear = wrench[:2]
        used = float(math.hypot(*shear)) / (self._friction * pressed)
        if distance > self._errors.slip_displacement:
            velocity = shear / max(math.hypot(*shear), 1e-9) * (distance / max(elapsed, 1e-9))
            return Slip("slipping", velocity, slid, 0.0)
        state: SlipState = "incipient" if used > self._errors.incipient else "sticking"
        reported = slid if slid > self._errors.slip_displacement else 0.0
        return Slip(state, _STILL, reported, max(0.0, 1 - used) ** (2 / 3))
