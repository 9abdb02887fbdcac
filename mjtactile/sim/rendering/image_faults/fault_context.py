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
    """One image at one step: the camera's `seed`, the image's `number` and `time` s, the step's
    `name`.

    `last` holds the previous image's time and its levels before and after this step (None: there
    was none).
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
    """One image fault.

    It has a `name` and `switches`, the fields of `CameraFaults` that enable it. `apply` is its
    function of levels (H, W).
    """

    name: str
    switches: tuple[str, ...]
    apply: Callable[[Floats, CameraFaults, FaultContext], Floats]
