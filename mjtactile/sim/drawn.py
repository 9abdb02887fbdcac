"""Touch without a chain (`--effects -sheet,-chain`): what a film bears, with the errors that the
sensing chain has at that load. A model of the sensor with its software, which may read the truth as
a camera's may; what comes out is a measurement.

It stands where a camera does, and gives `Felt` in place of an image.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from mjtactile.core.errors import InputError
from mjtactile.core.status import OK, Status, StatusCode
from mjtactile.core.types import Array, Contact, Felt, Slip, SlipState, Touch, Traction
from mjtactile.sim.chain_errors import AtLoad, ChainErrors
from mjtactile.sim.sensor.any import AnySensor
from mjtactile.sim.sensor.film_sensor import FilmSensor

_RECENT = 0.12  # s over which a slip is told, as by the chain
_NONE = np.zeros(0)
_NO_FORCES = np.zeros((0, 0, 3))
_NO_MASK = np.zeros((0, 0), bool)
_NOWHERE = np.full(2, np.nan)
_STILL = np.zeros(2)
for _fixed in (_NONE, _NO_FORCES, _NO_MASK, _NOWHERE, _STILL):
    _fixed.setflags(write=False)
METHOD = "drawn"
"""`Traction.method` of a touch that no chain has felt."""


class Erring:
    """The errors of one sensor's wrench, image after image."""

    def __init__(self, errors: ChainErrors):
        self._errors = errors
        self._spread = np.linalg.cholesky(errors.correlation)
        self._slow = np.zeros(6)
        self._untouched = errors.at(0.0).sd ** 2
        self._factor = 1.0

    def begin(self, rng: np.random.Generator) -> None:
        """Draw anew what lasts."""
        self._slow = self._spread @ rng.standard_normal(6)
        between = self._errors.between
        # whose square is one in the mean
        self._factor = math.exp(between * (rng.standard_normal() - between))

    def felt(self, true: Array, here: AtLoad, elapsed: float, rng: np.random.Generator) -> Array:
        """The wrench that the chain would say.

        Args:
            true: (6,) N and N m, frame S.
            here: The errors at its load.
            elapsed: s since the image before.
            rng: What is drawn from.

        Returns:
            (6,).
        """
        errors = self._errors
        kept = math.exp(-elapsed / errors.slow_time)
        slow, fast = rng.standard_normal((2, 6)) @ self._spread.T
        self._slow = kept * self._slow + math.sqrt(1 - kept * kept) * slow
        error = math.sqrt(errors.slow) * self._slow + math.sqrt(1 - errors.slow) * fast
        size = errors.outlier_size if rng.random() < here.outliers else 1.0
        loaded = np.maximum(here.sd**2 - self._untouched, 0.0)
        sd = np.sqrt(np.minimum(here.sd**2, self._untouched) + self._factor**2 * loaded)
        return true + errors.gain @ true + here.mean + size * sd * error


class TouchDrawer:
    """Stands for one sensor's camera and chain.

    Args:
        sensor: What bears the touch.
        errors: Of its chain.
        friction: The coefficient that the chain takes the membrane to have.
        seed: Of the errors.

    Raises InputError for a sensor whose sheet is a mesh.
    """

    def __init__(self, sensor: AnySensor, errors: ChainErrors, friction: float, seed: int):
        if not isinstance(sensor, FilmSensor):
            raise InputError(
                "touch is drawn of a film, not of a mesh",
                field="--effects",
                choices=["-sheet,-chain"],
            )
        self._sensor = sensor
        self._errors = errors
        self._friction = friction
        self._erring = Erring(errors)
        self._time = math.nan
        self._touching = False
        self._slides: deque[tuple[float, float]] = deque()
        self._drawn: Felt | None = None
        self.reseed(seed)

    def reseed(self, seed: int) -> None:
        """Draw the errors to come from another generator, those that last among them."""
        self._rng = np.random.default_rng(seed)
        self._erring.begin(self._rng)
        self._drawn = None

    def draw(self) -> None:
        """Have the touch of now ready for `read`."""
        self._drawn = Felt.of(self._touch())

    def read(self) -> Felt:
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
        true = sensor.look()
        here = self._errors.at(max(-float(true[2]), 0.0))
        wrench = self._erring.felt(true, here, elapsed, self._rng)
        if self._rng.random() < here.unknown:
            status = Status(StatusCode.NO_SHAPE, "the markers fit no membrane shape")
            lost = Slip("unknown", _NOWHERE, math.nan, math.nan, status)
            return Touch(time, 0.0, math.nan, math.nan, False, slip=lost, status=status)
        said = here.said
        traction = Traction(
            _NONE,
            _NONE,
            _NO_FORCES,
            wrench,
            np.outer(said, said) * self._errors.said_correlation,
            sensor.pressure_gauge,
            METHOD,
        )
        self._detect(-float(wrench[2]))
        contact = self._contact(wrench, here, self._rng.standard_normal(3))
        return Touch(
            time,
            0.0,
            -float(wrench[2]),
            float(said[2]),
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

    def _contact(self, wrench: Array, here: AtLoad, new: Array) -> Contact:
        sensor = self._sensor
        if not self._touching:
            return Contact(False, 0.0, _NOWHERE, 0.0, _NO_MASK)
        area = sensor.contact_area * math.exp(here.area + here.area_sd * new[0])
        centroid = sensor.middle[:2] + here.centroid_sd * new[1:3]
        radius = math.sqrt(area / math.pi)
        return Contact(
            True,
            area,
            centroid,
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
            return Slip("none", _STILL, 0.0, 1.0)
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
        if way > self._errors.slip_way:
            velocity = shear / max(math.hypot(*shear), 1e-9) * (way / max(elapsed, 1e-9))
            return Slip("slipping", velocity, slid, 0.0)
        state: SlipState = "incipient" if used > self._errors.incipient else "sticking"
        told = slid if slid > self._errors.slip_way else 0.0
        return Slip(state, _STILL, told, max(0.0, 1 - used) ** (2 / 3))
