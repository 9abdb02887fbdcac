"""Touch without a chain (`--effects -sheet,-chain`): what a film bears, with the errors that the
sensing chain has at that load. A model of the sensor with its software, which may read the truth as
a camera's may; what comes out is a measurement.

It stands where a camera does, and gives `SyntheticTouch` in place of an image.
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

_RECENT = 0.12  # s over which a slip is told, as by the chain
_NONE = fixed(np.zeros(0))
_NO_FORCES = fixed(np.zeros((0, 0, 3)))
_NO_MASK = fixed(np.zeros((0, 0), bool))
_NOWHERE = fixed(np.full(2, np.nan))
_STILL = fixed(np.zeros(2))
_NO_CONTACT = Contact(False, 0.0, _NOWHERE, 0.0, _NO_MASK)
_NO_SLIP = Slip("none", _STILL, 0.0, 1.0)
_COLUMNS = 30
# of what the kernel is given
_GRASP = 1
_ELAPSED = 3
METHOD = "drawn"
"""`Traction.method` of a touch that no chain has felt."""


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
        self._draw = bound(
            "draw_errors",
            len(errors.loads),
            errors.loads,
            errors.at_loads,
            errors.gain,
            self._spread,
            errors.reported_correlation,
            self._settings,
            errors.outlier_size,
            self._normals,
            self._true,
            self._slow,
            self._row,
            self._wrench,
            self._cov,
        )

    def begin(self, rng: np.random.Generator) -> None:
        """Draw anew what lasts."""
        self._slow[:] = self._spread @ rng.standard_normal(6)
        grasp, gain = rng.standard_normal(2)
        self._settings[_GRASP:_ELAPSED] = grasp, self._errors.shear_gain * gain

    def felt(
        self, true: Array, elapsed: float, rng: np.random.Generator
    ) -> tuple[Array, Array, ErrorsAtLoad]:
        """The wrench that the chain would say.

        Args:
            true: (6,) N and N m, frame S.
            elapsed: s since the image before.
            rng: What is drawn from.

        Returns:
            The wrench (6,) and the covariance (6, 6) that the chain would say, which hold until the
                next call, and the errors at this load.
        """
        self._true[:] = true
        rng.standard_normal(out=self._normals)
        self._settings[_ELAPSED:] = elapsed, rng.random()
        self._draw()
        return self._wrench, self._cov, ErrorsAtLoad.of(self._row)


class SyntheticTouchSource:
    """Stands for one sensor's camera and chain.

    Args:
        sensor: What bears the touch.
        errors: Of its chain.
        friction: The coefficient that the chain takes the membrane to have.
        seed: Of the errors.

    Raises InputError for a sensor whose sheet is a mesh.
    """

    def __init__(self, sensor: AnySensor, errors: SensingErrorModel, friction: float, seed: int):
        if not isinstance(sensor, QuasistaticSensor):
            raise InputError(
                "touch is drawn of a film, not of a mesh",
                field="--effects",
                choices=["-sheet,-chain"],
            )
        self._sensor = sensor
        self._errors = errors
        self._friction = friction
        self._erring = SensingErrorSampler(errors)
        self._time = math.nan
        self._touching = False
        self._slides: deque[tuple[float, float]] = deque()
        self._drawn: SyntheticTouch | None = None
        self.reseed(seed)

    def reseed(self, seed: int) -> None:
        """Draw the errors to come from another generator, those that last among them."""
        self._rng = np.random.default_rng(seed)
        self._erring.begin(self._rng)
        self._drawn = None

    def draw(self) -> None:
        """Have the touch of now ready for `read`."""
        self._drawn = SyntheticTouch.of(self._touch())

    def read(self) -> SyntheticTouch:
        """What is felt now."""
        if self._drawn is None or self._drawn.time != self._sensor.time:
            self.draw()
        drawn = self._drawn
        self._drawn = None
        assert drawn is not None
        return drawn

    def _touch(self) -> Touch:
        sensor = self._sensor
        time = sensor.time
        elapsed = 0.0 if math.isnan(self._time) else max(time - self._time, 0.0)
        self._time = time
        wrench, cov, here = self._erring.felt(sensor.look(), elapsed, self._rng)
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
            float(here.said[2]),
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
        """What the chain would say of a slip: none before some way is slid within the last images.
        How much of friction is used, by the coefficient of the sensor's file."""
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
        way = slid - slides[0][1]
        elapsed = time - slides[0][0]
        pressed = max(-float(wrench[2]), 1e-6)
        shear = wrench[:2]
        used = float(math.hypot(*shear)) / (self._friction * pressed)
        if way > self._errors.slip_displacement:
            velocity = shear / max(math.hypot(*shear), 1e-9) * (way / max(elapsed, 1e-9))
            return Slip("slipping", velocity, slid, 0.0)
        state: SlipState = "incipient" if used > self._errors.incipient else "sticking"
        told = slid if slid > self._errors.slip_displacement else 0.0
        return Slip(state, _STILL, told, max(0.0, 1 - used) ** (2 / 3))
