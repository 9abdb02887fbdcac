"""Input of one fault step."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass

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
