"""Key figures of a sensor, for the comparison of sensors."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array
from mjtactile.design_study.resolution import ResolutionPredictor, ball
from mjtactile.design_study.virtual_bench import VirtualBench
from mjtactile.sensing.settings import DEFAULTS

RADII = (2e-3, 3e-3, 4e-3, 6e-3, 8e-3, 12e-3, 16e-3)  # tested radii, m
MAX_RADIUS_SD = 0.25
"""Maximum relative standard deviation of a radius that counts as measured."""
RANGE_RADIUS = 10e-3
"""Radius of the ball used for the maximum force, m."""
# search range of the force, N, and number of halvings in its logarithm: to 2 %
_MIN_FORCE = 0.25
_MAX_FORCE = 20.0
_HALVINGS = 8
MIN_TOUCH = DEFAULTS.zero.touch_min
"""Smallest force that the sensing pipeline reports as a contact, however small the noise, N."""
MAX_FORCE_ERROR = 0.1
"""Relative error limit at the largest force."""
# fractions of half the opening: three positions, unaligned with markers and membrane nodes
_POSITIONS = ((0.05, 0.08), (0.31, -0.22), (-0.27, 0.36))


def _number(key: str, unit: float, about: str, digits: int) -> Any:
    return field(metadata={"key": key, "unit": unit, "about": about, "digits": digits})


@dataclass(frozen=True)
class Score:
    """Predicted performance of a sensor, SI; NaN: not defined. Smaller is better, except for
    `maximum`.

    The means are root mean squares over three positions near the center.
    """

    touch: float = _number("detection_mN", 1e-3, "smallest touch that the pipeline detects", 1)
    seen: float = _number(
        "detection_by_noise_mN",
        1e-3,
        "five sd of the running level: limit of the pixel noise alone",
        1,
    )
    force_sd: float = _number(
        "force_sd_mN", 1e-3, "sd of the force, as reported by the pipeline", 1
    )
    noise: float = _number("force_noise_mN", 1e-3, "its part from image to image", 2)
    position_sd: float = _number("position_sd_mm", 1e-3, "sd of the force position", 3)
    edge_sd: float = _number("edge_sd_mm", 1e-3, "sd of an edge position", 3)
    radius: float = _number(
        "smallest_radius_mm", 1e-3, "smallest ball whose radius is estimated to a quarter", 1
    )
    maximum: float = _number("force_max_N", 1.0, "largest force of a 10 mm ball", 2)

    def table(self) -> dict[str, float]:
        """Return the values by key, in the key's unit."""
        items = [(each.metadata, getattr(self, each.name)) for each in fields(self)]
        return {about["key"]: value / about["unit"] for about, value in items}


def score(design: SensorDesign, force: float, *, stand: VirtualBench | None = None) -> Score:
    """Predict the performance of a sensor.

    Args:
        design: The sensor.
        force: Indenting force for force, position, edge and radius, N.
        stand: Bench of that design, if it exists already.

    Returns:
        The key figures.

    Raises:
        InputError: The membrane has no equilibrium, or markers are outside of the image.
    """
    stand = stand or VirtualBench(design)
    predictor = ResolutionPredictor(stand)
    half = np.array([design.frame.length, design.frame.width]) / 2
    positions = [half * fraction for fraction in _POSITIONS]
    resolutions = [predictor.at(position, force) for position in positions]
    zero = stand.pipeline.settings.zero
    seen = max(zero.touch_sd * stand.level_noise(), stand.reference.min_force)
    return Score(
        touch=max(zero.touch_min, seen),
        seen=seen,
        force_sd=rms([resolution.force_sd for resolution in resolutions]),
        noise=rms([resolution.noise for resolution in resolutions]),
        position_sd=rms([resolution.position_sd for resolution in resolutions]),
        edge_sd=rms([resolution.edge_sd for resolution in resolutions]),
        radius=smallest_radius(predictor, positions, force),
        maximum=largest_force(stand),
    )


def smallest_radius(predictor: ResolutionPredictor, positions: list[Array], force: float) -> float:
    """Return the smallest radius, m, from which on all can be measured; NaN: none."""
    smallest = math.nan
    for radius in reversed(RADII):
        sd = rms([predictor.radius_sd(radius, position, force) for position in positions])
        if not sd <= MAX_RADIUS_SD:
            break
        smallest = radius
    return smallest


def largest_force(stand: VirtualBench) -> float:
    """Find the largest force of a ball at the center, N, with a relative error below a tenth.

    The membrane must carry it. NaN if 0.25 N fails already.
    """
    held = _MIN_FORCE
    if not _within_tolerance(stand, held):
        return math.nan
    lost = _MAX_FORCE
    for _ in range(_HALVINGS):
        midpoint = math.sqrt(held * lost)
        if _within_tolerance(stand, midpoint):
            held = midpoint
        else:
            lost = midpoint
    return held


def _within_tolerance(stand: VirtualBench, force: float) -> bool:
    pressed = stand.press(ball(np.zeros(2), RANGE_RADIUS), force)
    if pressed is None:
        return False
    estimated = stand.estimate_touch(pressed.state)
    if not estimated.ok or estimated.touch.traction is None:
        return False
    return bool(abs(-estimated.touch.traction.wrench[2] - force) < MAX_FORCE_ERROR * force)


def rms(values: ArrayLike) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
