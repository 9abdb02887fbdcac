"""Calibration of a gripper with a caliper and a load cell.

It estimates zero, scale and backlash of the opening, and the force per current.

Opening model: caliper reading = offset + scale * reported - backlash / 2 * direction. Direction is
+1 while opening and -1 while closing. The jaws lag the servo by half the play in both directions.
Force model per finger: load cell = friction offset + factor * reported. The factor corrects the
data sheet's torque per ampere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mjtactile.calibrate.result_io import fit_line
from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.devices.dynamixel.jaw_kinematics import JawGeometry, JawServo
from mjtactile.devices.dynamixel.servo_models import TICKS_PER_RAD
from mjtactile.rig.file import RigFile
from mjtactile.rig.gripper_calibration import gripper_fingerprint

DIRECTIONS = ("closing", "opening")
# a larger error indicates a wrong pinion radius or law, which scaling must not hide
SCALE_OFF_MAX = 0.03
OPENING_RMS_MAX = 2e-4  # maximum rms, m; a caliper reads 0.02 mm, a servo's tick is 0.02 to 0.03 mm
BACKLASH_MAX = 1e-3  # maximum, m; the membrane is indented by 1 to 3 mm
# data sheets list stall values, accurate to 20 %; friction reduces the force further
FACTOR_RANGE = (0.5, 1.5)
FORCE_RMS_FRACTION = 0.10  # maximum rms, as a fraction of the largest force


@dataclass(frozen=True)
class OpeningCalibration:
    """Opening parameters: `offset` m, `scale` and `backlash` m with standard deviations.

    `rms` is the residual, m. `reasons` lists why the calibration is refused.
    """

    offset: float
    offset_sd: float
    scale: float
    scale_sd: float
    backlash: float
    backlash_sd: float
    rms: float
    reasons: tuple[str, ...]

    def report(self) -> dict[str, Any]:
        mm = {
            f"{name}_mm": 1e3 * getattr(self, name)
            for name in ("offset", "offset_sd", "backlash", "backlash_sd", "rms")
        }
        return {"scale": self.scale, "scale_sd": self.scale_sd, **mm}


@dataclass(frozen=True)
class GripperForceCalibration:
    """Force parameters: `factor` on the reported force and `offset`, N (negative: friction).

    Both have standard deviations; `rms` is the residual, N.
    """

    factor: float
    factor_sd: float
    offset: float
    offset_sd: float
    rms: float
    reasons: tuple[str, ...]

    def report(self) -> dict[str, Any]:
        return {
            "factor": self.factor,
            "factor_sd": self.factor_sd,
            "offset_N": self.offset,
            "offset_sd_N": self.offset_sd,
            "rms_N": self.rms,
        }


def calibrate_opening(
    reported: Array, direction: Sequence[str], measured: Array
) -> OpeningCalibration:
    """Fit the opening model to servo openings, m, their directions, and caliper readings, m.

    Raises InputError when the readings cannot separate offset, scale and backlash.
    """
    bad = next((text for text in direction if text not in DIRECTIONS), None)
    if bad is not None:
        raise InputError(f"{bad!r} is not a direction", field="direction", choices=DIRECTIONS)
    sign = np.array([1.0 if text == "opening" else -1.0 for text in direction])
    if len(reported) < 4 or np.ptp(reported) < 5e-3 or not (sign > 0).any() or not (sign < 0).any():
        raise InputError(
            "at least two openings are needed, 5 mm or more apart, each reached both closing "
            "and opening",
            field="openings",
        )
    A = np.column_stack([np.ones_like(reported), reported, -0.5 * sign])
    inverse = np.linalg.inv(A.T @ A)
    x = inverse @ A.T @ measured
    left = measured - A @ x
    sd = np.sqrt(float(left @ left) / max(len(left) - 3, 1) * np.diag(inverse))
    result = OpeningCalibration(
        float(x[0]),
        float(sd[0]),
        float(x[1]),
        float(sd[1]),
        float(x[2]),
        float(sd[2]),
        float(np.sqrt(np.mean(left**2))),
        (),
    )
    return replace(result, reasons=tuple(_assess_opening(result)))


def _assess_opening(c: OpeningCalibration) -> list[str]:
    checks = {
        (
            f"the jaws move {c.scale:.3f} times the distance of the rig file: correct "
            "mm_per_rad or law"
        ): abs(c.scale - 1) <= SCALE_OFF_MAX,
        (
            f"the caliper readings deviate from the fit by {1e3 * c.rms:.2f} mm rms (allowed: "
            f'{1e3 * OPENING_RMS_MAX:g} mm): a wrong reading, or transmission "rack" for a crank'
        ): c.rms <= OPENING_RMS_MAX,
        (
            f"the backlash is {1e3 * c.backlash:.2f} mm: check for a loose horn or a worn gear"
        ): c.backlash <= BACKLASH_MAX,
        (f"the backlash is {1e3 * c.backlash:.2f} mm: the directions may be swapped"): c.backlash
        >= -3 * max(c.backlash_sd, 1e-5),
    }
    return [text for text, good in checks.items() if not good]


def calibrate_force(reported: Array, measured: Array) -> GripperForceCalibration:
    """Fit load cell readings, N, to closing forces computed from the currents, N. Raises InputError
    for fewer than 4."""
    if len(reported) < 4 or np.ptp(reported) < 0.2 * np.max(np.abs(reported)):
        raise InputError("at least 4 different forces are needed", field="forces")
    (offset, factor), (offset_sd, factor_sd), rms = fit_line(reported, measured)
    result = GripperForceCalibration(
        float(factor), float(factor_sd), float(offset), float(offset_sd), rms, ()
    )
    return replace(result, reasons=tuple(_assess_force(result, float(np.max(measured)))))


def _assess_force(c: GripperForceCalibration, largest: float) -> list[str]:
    low, high = FACTOR_RANGE
    checks = {
        (
            f"the force is {c.factor:.2f} times the value from the currents ({low:g} to "
            f"{high:g} is plausible): check servo model, mm_per_rad and load cell range"
        ): low <= c.factor <= high,
        (
            f"the forces deviate from a line by {c.rms:.2f} N rms of {largest:.2f} N: check "
            "for stick-slip and other contacts of the jaws"
        ): c.rms <= FORCE_RMS_FRACTION * largest,
        (
            f"the load cell reads {c.offset:.2f} N more than the currents explain: check its zero"
        ): c.offset <= 0.1 * largest,
    }
    return [text for text, good in checks.items() if not good]


def report(
    rig_file: RigFile, opening: OpeningCalibration | None, force: GripperForceCalibration | None
) -> dict[str, Any]:
    """Return the results and corrected servo values for the gripper's calibration file.

    The file also contains the acceptance result, which is added separately.
    """
    geometry = JawGeometry(rig_file.gripper, str(rig_file.path))
    return {
        "rig": rig_file.name,
        "fingerprint": gripper_fingerprint(rig_file.gripper),
        "opening": opening.report() if opening else None,
        "force": force.report() if force else None,
        "servo": servo_lines(geometry, opening, force),
    }


def servo_lines(
    geometry: JawGeometry, opening: OpeningCalibration | None, force: GripperForceCalibration | None
) -> list[dict[str, Any]]:
    """Return the values for each `[[gripper.servo]]` of the rig file.

    The values are id, zero_ticks, mm_per_rad (racks) and torque_Nm_per_A.

    The opening's offset is divided equally among the servos. A servo's zero moves by the angle of
    its part. On a rack the scale corrects the pinion's radius. Another law keeps its parameters and
    is corrected at the center of the range.
    """
    return [
        _servo_line(jaw, len(geometry.servos), sum(geometry.config.opening) / 2, opening, force)
        for jaw in geometry.servos
    ]


def _servo_line(
    jaw: JawServo,
    count: int,
    midpoint: float,
    opening: OpeningCalibration | None,
    force: GripperForceCalibration | None,
) -> dict[str, Any]:
    line: dict[str, Any] = {"id": jaw.config.id}
    scale = 1.0
    if opening is not None and jaw.config.transmission == "rack":
        scale = opening.scale
        part = opening.offset / count
        per_rad = scale * jaw.config.per_rad
        shift = (part + (scale - 1) * jaw.config.opening_part) / per_rad
        line["mm_per_rad"] = round(1e3 * per_rad, 4)
        line["zero_ticks"] = round(jaw.config.zero_ticks - shift * TICKS_PER_RAD)
    elif opening is not None:
        part = (opening.offset + (opening.scale - 1) * midpoint) / count
        line["zero_ticks"] = round(
            jaw.config.zero_ticks - part / jaw.slope(jaw.ticks(midpoint / count)) * TICKS_PER_RAD
        )
    if force is not None:
        # force = torque over radius
        line["torque_Nm_per_A"] = round(jaw.torque_per_A * force.factor * scale, 4)
    return line
