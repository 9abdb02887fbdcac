"""Faults in front of the image sensor: camera pose, lens, dirt on the glass, light."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from mjtactile.rig.camera_faults import CameraFaults

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class FaultContext:
    """One image at one step: camera `seed`, image `number` and `time` s, step `name`.

    `last` holds the previous image's time and its levels before and after this step, or None.
    """

    seed: int
    number: int
    time: float
    name: str
    last: tuple[float, Floats, Floats] | None

    @property
    def fixed(self) -> np.random.Generator:
        """Random generator for values that are the same in all images of this camera."""
        return np.random.default_rng([self.seed, zlib.crc32(self.name.encode())])

    @property
    def own(self) -> np.random.Generator:
        """Random generator for values that differ in each image."""
        return np.random.default_rng([self.seed, zlib.crc32(self.name.encode()), self.number + 1])


@dataclass(frozen=True)
class Step:
    """One image fault: `switches` are the fields of `CameraFaults` that enable it."""

    name: str
    switches: tuple[str, ...]
    apply: Callable[[Floats, CameraFaults, FaultContext], Floats]


_FOG_DN = 160.0
_SPECK_EDGE = 1.5  # edge blur, px, sd: the glass is out of focus
_SCRATCH_TAKES = 0.35  # of the light
# fingerprint, px: size (sd), period of the ridges, blur by grease
_PRINT = 45.0
_RIDGE = 9.0
_GREASE_BLUR = 4.0
_RIDGE_TAKES = 0.25  # of the light
_BANDS = 2.0  # periods of mains light from the first row to the last, at any rate


def placed(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Zoom, shift and rotate about the image center, by cubic splines (no rounding to pixels)."""
    from scipy.ndimage import affine_transform  # takes a while to import

    height, width = pixels.shape
    center = np.array([(height - 1) / 2, (width - 1) / 2])
    cos = math.cos(t.rotation) / (1 + t.zoom)
    sin = math.sin(t.rotation) / (1 + t.zoom)
    back = np.array([[cos, sin], [-sin, cos]])  # rows, columns
    start = center - back @ (center + np.array(t.shift)[::-1])
    change = np.column_stack([back, start])
    return _floats(affine_transform(pixels, change, order=3, mode="mirror"))


def defocused(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Blur with a Gaussian of standard deviation `defocus`, px."""
    return _floats(cv2.GaussianBlur(pixels, (0, 0), t.defocus))


def fogged(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Replace a fraction of the light by uniform light."""
    return (1 - t.fog) * pixels + t.fog * _FOG_DN


def dusty(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Add discs that absorb light, away from the image border."""
    key = (round(t.dust), t.dust_radius, int(shot.fixed.integers(2**31)))
    return _floats(pixels * (1 - t.dust_darkness * _specks(pixels.shape, *key)))


def scratched(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Add fine straight lines across most of the image."""
    lines = _lines(pixels.shape, round(t.scratches), int(shot.fixed.integers(2**31)))
    return _floats(pixels * (1 - _SCRATCH_TAKES * lines))


def fingerprinted(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Add a fingerprint, whose grease blurs and whose ridges absorb light."""
    tip, ridges = _fingertip(pixels.shape, int(shot.fixed.integers(2**31)))
    greasy = cv2.GaussianBlur(pixels, (0, 0), _GREASE_BLUR)
    fraction = t.fingerprint * tip
    return (pixels + fraction * (0.5 * (greasy - pixels))) * (1 - _RIDGE_TAKES * fraction * ridges)


def lit_aside(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Increase the light linearly from the left to the right border, by `gradient` in total."""
    return pixels * np.linspace(1 - t.gradient / 2, 1 + t.gradient / 2, pixels.shape[1]).astype(
        np.float32
    )


def flickering(pixels: Floats, t: CameraFaults, shot: FaultContext) -> Floats:
    """Modulate the light by a sine over time while the rows are read."""
    height = pixels.shape[0]
    phase = t.flicker_rate * shot.time + _BANDS * np.arange(height) / height
    swing = 1 + t.flicker * np.sin(2 * np.pi * phase)
    return _floats(pixels * swing[:, None])


STEPS = (
    Step("placed", ("zoom", "shift", "rotation"), placed),
    Step("defocused", ("defocus",), defocused),
    Step("fogged", ("fog",), fogged),
    Step("dusty", ("dust",), dusty),
    Step("scratched", ("scratches",), scratched),
    Step("fingerprinted", ("fingerprint",), fingerprinted),
    Step("lit aside", ("gradient",), lit_aside),
    Step("flickering", ("flicker",), flickering),
)


@lru_cache(maxsize=8)
def _specks(shape: tuple[int, int], count: int, radius: float, seed: int) -> Floats:
    """Return the coverage (H, W) by specks, 0 to 1."""
    from scipy.special import ndtr  # takes a while to import

    rng = np.random.default_rng(seed)
    v, u = np.mgrid[: shape[0], : shape[1]]
    cover = np.zeros(shape)
    for _ in range(count):
        at = rng.uniform(0.12, 0.88, 2) * shape
        distance = np.hypot(v - at[0], u - at[1])
        cover = np.maximum(cover, ndtr((radius - distance) / _SPECK_EDGE))
    return _floats(cover)


@lru_cache(maxsize=8)
def _lines(shape: tuple[int, int], count: int, seed: int) -> Floats:
    """Return the coverage (H, W) by scratches, 0 to 1."""
    rng = np.random.default_rng(seed)
    cover = np.zeros(shape, np.float32)
    for _ in range(count):
        ends = rng.uniform(0.05, 0.95, (2, 2)) * shape[::-1]
        cv2.line(cover, *(tuple(int(x) for x in end) for end in ends), 1.0, 1, cv2.LINE_AA)
    return _floats(cv2.GaussianBlur(cover, (0, 0), 0.7))


@lru_cache(maxsize=8)
def _fingertip(shape: tuple[int, int], seed: int) -> tuple[Floats, Floats]:
    """Return the mask (H, W) of a fingerprint, 0 to 1, and its ridges, 0 to 1."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[: shape[0], : shape[1]]
    at = rng.uniform(0.3, 0.7, 2) * shape
    dv = v - at[0]
    du = u - at[1]
    tip = np.exp(-0.5 * (dv**2 / (1.3 * _PRINT) ** 2 + du**2 / _PRINT**2))
    whorl = np.hypot(dv + 0.6 * _PRINT, 1.2 * du)
    return _floats(tip), _floats(0.5 + 0.5 * np.cos(2 * np.pi * whorl / _RIDGE))


def _floats(values: np.ndarray) -> Floats:
    return np.asarray(values, np.float32)
