"""Force calibration of a sensor against known loads.

It estimates the paper's constant c (dF = c dA) and the scale of the inverse finite elements.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.calibrate.result_io import fit_line
from mjtactile.core.calibration_parts import CalibrationMetadata, ForceScale
from mjtactile.core.errors import InputError
from mjtactile.core.types import Array, Image
from mjtactile.sensing.stateful_pipeline import StatefulPipeline

LOADS_MIN = 4
FORCE_MIN = 0.2  # Minimum of the largest load, N; below it, noise dominates
SCALE_OFF_MAX = 0.25  # tolerance of the sensor file's thickness and modulus
RMS_FRACTION = 0.10  # maximum rms, as a fraction of the largest load
# accuracy limit of dF = c dA for a sealed membrane (tests/physics/test_paper_force.py)
AREA_RMS_FRACTION = 0.30
GRAVITY = 9.80665  # standard gravity, m/s^2


@dataclass(frozen=True)
class AreaCalibration:
    """The paper's calibration: `constant` c, N/m^2, of dF = c dA, and its rms `residual`, N."""

    constant: float
    residual: float

    @classmethod
    def fit(cls, area_change: ArrayLike, force: ArrayLike) -> AreaCalibration:
        """Fit a line through the origin to area changes, m^2, at known normal forces, N.

        The forces come from a load cell or weights. Raises InputError if the area did not change,
        or shrank under load: then no such constant exists.
        """
        dA = np.asarray(area_change, dtype=float)
        F = np.asarray(force, dtype=float)
        if not np.isfinite(dA).all() or float(dA @ F) <= 0:
            message = "the membrane area does not grow with the force"
            raise InputError(message, source="calibration", field="area_change")
        constant = float(dA @ F / (dA @ dA))
        return cls(constant, float(np.sqrt(np.mean((F - constant * dA) ** 2))))

    def force(self, area_change: float) -> float:
        """Compute the normal force, N, from the change of membrane area, m^2 (paper Eq. 11)."""
        return self.constant * area_change


@dataclass(frozen=True, eq=False)
class ForceCalibration:
    """Force calibration: `area` is the paper's c with its rms residual (None: area and load do not
    correlate). The load is `scale` times the force of the inverse FEM plus `offset` N, with `rms` N
    residual. Arrays hold each load's ground truth and measured force, N, and area change, m^2.
    `reasons` lists why the calibration is refused."""

    area: AreaCalibration | None
    scale: float
    scale_sd: float
    offset: float
    offset_sd: float
    rms: float
    true: Array
    estimated: Array
    area_change: Array
    reasons: tuple[str, ...]

    def report(self) -> dict[str, Any]:
        return {
            "area_constant_N_per_m2": self.area.constant if self.area else None,
            "area_residual_N": self.area.residual if self.area else None,
            "scale": self.scale,
            "scale_sd": self.scale_sd,
            "offset_N": self.offset,
            "offset_sd_N": self.offset_sd,
            "residual_N": self.rms,
            "loads": [
                {"force_N": t, "estimated_N": f, "area_change_mm2": 1e6 * a}
                for t, f, a in zip(self.true, self.estimated, self.area_change, strict=True)
            ],
        }


def mean_force(perception: StatefulPipeline, images: Sequence[Image]) -> tuple[float, float]:
    """Estimate the mean normal force, N, and area, m^2, from images of one load.

    The sensor must have references. Raises InputError with the reason if no image is usable.
    """
    touches = [perception.perceive(image, image.time) for image in images]
    good = [
        t
        for t in touches
        if np.isfinite(t.force_normal) and t.surface is not None and t.traction is not None
    ]
    if not good:
        raise InputError(
            "the images of this load cannot be used: "
            f"{touches[0].status if touches else 'no image'}"
        )
    # Use the raw wrench: below its touch threshold the pipeline reports zero, which would bias the
    # line.
    force = float(np.mean([-t.traction.wrench[2] for t in good if t.traction is not None]))
    return force, float(np.mean([t.surface.area for t in good if t.surface is not None]))


def calibrate_force(
    true: Array, estimated: Array, area: Array, area_rest: float
) -> ForceCalibration:
    """Fit the force scale and the paper's area constant to known loads.

    Inputs are the known normal loads, N, and the measured forces, N. Further inputs are the
    membrane areas, m^2, and the area without load. Raises InputError for too few loads.
    """
    if len(true) < LOADS_MIN or len(np.unique(true)) < 3:
        raise InputError(
            f"only {len(np.unique(true))} different loads are given; at least {LOADS_MIN} "
            "loads, 3 of them different, are needed",
            field="force_N",
        )
    change = area - area_rest
    try:
        constant = AreaCalibration.fit(change, true)
    except InputError:
        constant = None
    if np.ptp(estimated) > 0:
        (offset, scale), (offset_sd, scale_sd), rms = fit_line(estimated, true)
    else:
        (offset, scale), (offset_sd, scale_sd), rms = ((np.nan,) * 2,) * 2 + (np.nan,)
    reasons = _refusals(true, estimated, constant, float(scale), float(offset), rms)
    return ForceCalibration(
        constant,
        float(scale),
        float(scale_sd),
        float(offset),
        float(offset_sd),
        rms,
        true,
        estimated,
        change,
        tuple(reasons),
    )


def force_part(c: ForceCalibration, stamp: CalibrationMetadata) -> ForceScale:
    """Return the force part of a finger's calibration, which stores only the slope.

    A sensor without load reports zero. The offset comes from the load cell's support or its
    zero.
    """
    return ForceScale(c.scale, c.scale_sd, float(np.max(c.true)), stamp)


def _refusals(
    true: Array,
    estimated: Array,
    constant: AreaCalibration | None,
    scale: float,
    offset: float,
    rms: float,
) -> list[str]:
    largest = float(np.max(true))
    if largest < FORCE_MIN:
        return [f"the largest load is {largest:.2f} N; at least {FORCE_MIN:g} N is needed"]
    if np.ptp(estimated) < 0.1 * np.ptp(true):
        return [
            f"the sensor reports {np.min(estimated):.2f} to {np.max(estimated):.2f} N for loads of "
            f"{np.min(true):.2f} to {largest:.2f} N: check that the load acts on the membrane "
            "and that the images are in the order of the loads"
        ]
    checks = {
        (
            f"the load is {scale:.2f} times the estimated force ({1 - SCALE_OFF_MAX:g} to "
            f"{1 + SCALE_OFF_MAX:g} is plausible): check thickness, modulus and pressure in "
            "the sensor file"
        ): abs(scale - 1) <= SCALE_OFF_MAX,
        (
            f"the loads deviate from a line by {rms:.2f} N rms of {largest:.2f} N: check for "
            "sliding loads and a tilted load cell"
        ): rms <= RMS_FRACTION * largest,
        (
            f"without a load the estimated force would be {-offset / scale:.2f} N: the "
            "membrane was touched in the rest images, or the zero of the load cell is off"
        ): abs(offset) <= RMS_FRACTION * largest,
        ("the membrane area does not grow with the load, so the constant c is undefined"): constant
        is not None,
        (
            f"dF = c dA leaves a residual of {constant.residual if constant else np.nan:.2f} "
            f"N of {largest:.2f} N: use more or larger loads"
        ): constant is None or constant.residual <= AREA_RMS_FRACTION * largest,
    }
    return [text for text, good in checks.items() if not good]
