"""A valve's step response: zero of its pressure sensor, rise time, reached pressure, leak of the
sealed chamber."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mjtactile.calibrate.result_io import fit_line
from mjtactile.core.calibration_parts import CalibrationMetadata, ValveZero
from mjtactile.core.errors import InputError
from mjtactile.core.types import Array

STATES = ("vent", "open", "closed")
OFFSET_MAX_FRACTION = 0.05  # as a fraction of the step: the rest reference uses this pressure
ERROR_MAX_FRACTION = 0.10
NOISE_MAX_FRACTION = 0.05
RISE_MAX = 1.0  # maximum, s; the driver reports a stuck valve after 1.5 s
LEAK_MAX = 0.10  # as a fraction of the step per minute: the zero force follows slower changes
# the last quarter of a stage counts as settled; s after sealing that are left out
_SETTLED = 0.75
_SEALED_AFTER = 0.5


@dataclass(frozen=True)
class ValveCalibration:
    """Valve parameters from a step response.

    `offset` Pa is the sensor's reading at ambient pressure, with noise `noise_sd` Pa. `step` Pa is
    the pressure reached above the offset, `requested` Pa the commanded one. `rise_time` s is from
    10 to 90 %, `time_constant` s to 63 %. `leak` Pa/s of the sealed chamber (positive: loss) has
    the standard deviation `leak_sd`. `fall_time` s is from 90 to 10 % when vented (NaN: not
    recorded).
    """

    requested: float
    offset: float
    noise_sd: float
    step: float
    rise_time: float
    time_constant: float
    leak: float
    leak_sd: float
    fall_time: float
    reasons: tuple[str, ...]

    def report(self) -> dict[str, Any]:
        return {
            "requested_Pa": self.requested,
            "offset_Pa": self.offset,
            "noise_sd_Pa": self.noise_sd,
            "step_Pa": self.step,
            "rise_time_s": self.rise_time,
            "time_constant_s": self.time_constant,
            "leak_Pa_per_s": self.leak,
            "leak_sd_Pa_per_s": self.leak_sd,
            "fall_time_s": self.fall_time,
        }


def valve_part(c: ValveCalibration, stamp: CalibrationMetadata) -> ValveZero:
    """Return the valve part of a finger's calibration."""
    return ValveZero(c.offset, c.noise_sd, stamp)


def calibrate_valve(
    time: Array, pressure: Array, state: Sequence[str], requested: float
) -> ValveCalibration:
    """Evaluate samples of the gauge `pressure`, Pa, at `time`, s, of a step response.

    The stages are vent, open (`requested` Pa commanded), closed, and optionally vent again. Raises
    InputError when a stage is missing or too short.
    """
    stages = _stages(time, state)
    vent, rise, sealed = (
        _stage(stages, i, name) for i, name in enumerate(("vent", "open", "closed"))
    )
    calm = vent[len(vent) // 3 :]
    offset = float(np.mean(pressure[calm]))
    noise = float(np.std(pressure[calm], ddof=1))
    settled = rise[int(_SETTLED * len(rise)) :]
    step = float(np.mean(pressure[settled])) - offset
    start = time[rise[0]]
    fraction = (pressure[rise] - offset) / step if step else np.full(len(rise), np.nan)
    at = {
        level: _crossing(time[rise] - start, fraction, level)
        for level in (0.1, 1 - math.exp(-1), 0.9)
    }
    low, tau, high = at.values()
    tight = sealed[time[sealed] > time[sealed[0]] + _SEALED_AFTER]
    if len(tight) < 5:
        message = f"the sealed stage is too short; at least {_SEALED_AFTER + 1:g} s are needed"
        raise InputError(message, field="state closed")
    (_, slope), (_, slope_sd), _ = fit_line(time[tight] - time[tight[0]], pressure[tight])
    fall = math.nan
    if len(stages) > 3 and stages[3][0] == "vent":
        down = stages[3][1]
        left = 1 - (pressure[down] - offset) / (pressure[sealed[-1]] - offset)
        fall = _crossing(time[down], left, 0.9) - _crossing(time[down], left, 0.1)
    result = ValveCalibration(
        requested, offset, noise, step, high - low, tau, -slope, float(slope_sd), fall, ()
    )
    return replace(result, reasons=tuple(_refusals(result)))


def _refusals(c: ValveCalibration) -> list[str]:
    size = abs(c.requested)
    checks = {
        (
            f"the vented sensor reads {c.offset:.0f} Pa: set its zero, or check that the "
            "valve vents"
        ): abs(c.offset) <= OFFSET_MAX_FRACTION * size,
        (
            f"the noise of the pressure sensor is {c.noise_sd:.0f} Pa of {size:.0f} Pa: check "
            "cable, ground and range"
        ): c.noise_sd <= NOISE_MAX_FRACTION * size,
        (
            f"the pressure reached {c.step:.0f} Pa instead of {c.requested:.0f} Pa: check the "
            "supply, a stuck valve, and leaks as large as the flow"
        ): abs(c.step - c.requested) <= ERROR_MAX_FRACTION * size,
        (
            f"the rise from 10 to 90 % takes {c.rise_time:.2f} s (allowed: {RISE_MAX:g}): "
            "check for a narrow hose"
        ): c.rise_time <= RISE_MAX,
        (
            f"the sealed chamber loses {c.leak:.1f} Pa/s ({6000 * c.leak / size:.0f} % per "
            "minute): check membrane rim, hose and valve seat"
        ): c.leak <= LEAK_MAX * size / 60 + 2 * c.leak_sd,
    }
    return [text for text, good in checks.items() if not good]


def _stages(time: Array, state: Sequence[str]) -> list[tuple[str, Array]]:
    """Return runs of equal state: (name, indices)."""
    if len(time) != len(state) or np.any(np.diff(time) <= 0):
        raise InputError("times must increase from row to row", field="time_s")
    bad = next((text for text in state if text not in STATES), None)
    if bad is not None:
        raise InputError(f"{bad!r} is not a valve state", field="state", choices=STATES)
    cuts = [i for i in range(1, len(state)) if state[i] != state[i - 1]]
    return [(str(state[int(part[0])]), part) for part in np.split(np.arange(len(state)), cuts)]


def _stage(stages: list[tuple[str, Array]], index: int, name: str) -> Array:
    if index >= len(stages) or stages[index][0] != name or len(stages[index][1]) < 5:
        found = ", ".join(f"{text} ({len(part)})" for text, part in stages) or "nothing"
        raise InputError(
            "at least 5 samples each of vent, open, closed are needed, in this order; found "
            f"{found}",
            field="state",
        )
    return stages[index][1]


def _crossing(time: Array, fraction: Array, level: float) -> float:
    """Return the time at which `fraction` first reaches `level`, by linear interpolation; NaN if
    never."""
    above = np.flatnonzero(fraction >= level)
    if len(above) == 0:
        return math.nan
    i = int(above[0])
    if i == 0:
        return float(time[0])
    part = (level - fraction[i - 1]) / (fraction[i] - fraction[i - 1])
    return float(time[i - 1] + part * (time[i] - time[i - 1]))
