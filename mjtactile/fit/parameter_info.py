"""What the fitted numbers are called, when they count as known, what to record where they are not,
and what goes together."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mjtactile.core.types import Array

SD95 = 1.96
TOGETHER = 0.9  # a correlation from which on it is said


@dataclass(frozen=True)
class ParameterInfo:
    """A field of the sensor file: its `name` in a sentence, the sd up to which it counts as known,
    as a share of its value (`share`) or in the file's unit (`least`), whichever is more, and what
    to `record` for it."""

    name: str
    record: str
    share: float = 0.1
    least: float = 0.0

    def is_finite_value(self, value: float, sd: float) -> bool:
        return sd <= max(self.share * abs(value), self.least)


_BULGE = "inflate it to 0.5 kPa, where its tension holds it, and to 3 kPa, where its modulus does"
_TAP = "press fast and hold (protocol `tap`), with a pressure sensor"
ABOUT: Mapping[str, ParameterInfo] = {
    "membrane.young_MPa": ParameterInfo("modulus", _BULGE, 0.05),
    "membrane.pre_stretch": ParameterInfo("pre-stretch", _BULGE, 0.0, 0.003),
    "membrane.thickness_mm": ParameterInfo(
        "thickness",
        "no recording tells it from the modulus: measure the sheet, then --known "
        "membrane.thickness_mm=…",
    ),
    "membrane.friction": ParameterInfo(
        "friction", "drag a pressed indenter until it slides (protocol `drag`)"
    ),
    "chamber.extra_volume_mL": ParameterInfo(
        "gas volume",
        "press with the valve closed (protocol `press`), with a pressure sensor",
        0.0,
        math.inf,
    ),
    "chamber.leak_mL_s_kPa": ParameterInfo(
        "leak",
        "leave it inflated and closed for a minute (protocol `still`), with a pressure sensor",
        0.1,
        5e-4,
    ),
    "chamber.polytropic_exponent": ParameterInfo("heat ratio", _TAP, 0.0, 0.02),
    "chamber.thermal_time_constant_s": ParameterInfo("heat exchange", _TAP, 0.1),
    "camera.blur_px": ParameterInfo("blur", "images of the flat membrane", 0.1),
    "camera.noise_DN": ParameterInfo("noise", "two images or more of the flat membrane", 0.1, 0.1),
    "leds.membrane_DN": ParameterInfo("grey of the membrane", "images of the flat membrane", 0.1),
    "leds.marker_DN": ParameterInfo("grey of the markers", "images of the flat membrane", 0.1, 2.0),
    "leds.falloff": ParameterInfo("falloff of the light", "images of the flat membrane", 0.1, 0.03),
}
GAS_FRACTION = (
    0.05  # of the gas behind the flat membrane: sd up to which its volume counts as known
)
NOT_FITTED = {
    "membrane.poisson_ratio": "taken as the file says: modulus and pre-stretch "
    "are those of a sheet with this ratio",
    "chamber.valve_mL_s_kPa": "the recordings begin when the valve has closed",
    "damping": "the simulated rubber has none that a file could set, and a camera is too slow to "
    "see it",
}


@dataclass(frozen=True)
class FittedParameter:
    """A `field` of the sensor file: `value` and standard deviation in its unit, `state` "fitted",
    "known" (by hand) or "not in these recordings" (then the value is the file's), where it comes
    from, and the file's own value, `before`."""

    field: str
    value: float
    sd: float
    state: str
    source: str
    before: float

    @property
    def interval(self) -> tuple[float, float]:
        """95 %."""
        return self.value - SD95 * self.sd, self.value + SD95 * self.sd

    @property
    def comment(self) -> str:
        """What stands behind it in the sensor file."""
        if self.state == "fitted":
            low, high = self.interval
            return (
                f"fitted: {digits(low, self.sd)} to {digits(high, self.sd)} (95 %), {self.source}"
            )
        if self.state == "known":
            return self.source
        return f"not in these recordings; {ABOUT[self.field].record}"


def judge(
    field: str, value: float, sd: float, before: float, source: str, *, gas_mL: float = math.inf
) -> FittedParameter:
    """A fitted number, or the file's value where the recordings do not tell; `gas_mL` behind the
    flat membrane."""
    if field == "chamber.extra_volume_mL":
        known = sd <= GAS_FRACTION * gas_mL
    else:
        known = ABOUT[field].is_finite_value(value, sd)
    if known:
        return FittedParameter(field, value, sd, "fitted", source, before)
    return missing(field, before)


def missing(field: str, before: float) -> FittedParameter:
    """A number that the recordings do not tell."""
    return FittedParameter(field, before, math.inf, "not in these recordings", "", before)


def digits(value: float, sd: float) -> str:
    """With as many decimals as a twentieth of the sd has."""
    if not (math.isfinite(value) and math.isfinite(sd) and sd > 0):
        return f"{value:.6g}"
    return f"{value:.{max(0, 1 - math.floor(math.log10(sd)))}f}"


def correlations(names: Sequence[str], cov: Array, states: Mapping[str, str]) -> list[str]:
    """A sentence for each pair that goes together by more than TOGETHER; `names` (n,) are fields,
    or what a sentence says, of the covariance (n, n). Where one of the two is not known alone, they
    cannot be told apart."""
    sd = np.sqrt(np.diag(cov))
    sentences = []
    for i, j in itertools.combinations(range(len(names)), 2):
        rho = float(cov[i, j] / (sd[i] * sd[j])) if sd[i] > 0 and sd[j] > 0 else 0.0
        if abs(rho) < TOGETHER:
            continue
        one, two = (ABOUT[n].name if n in ABOUT else n for n in (names[i], names[j]))
        advice = next((ABOUT[n].record for n in (names[j], names[i]) if n in ABOUT), "")
        apart = all(states.get(n, "fitted") == "fitted" for n in (names[i], names[j]))
        verb = "are known better together than alone" if apart else "cannot be told apart from this"
        sentences.append(f"{one} and {two} {verb} (correlation {rho:+.2f}): {advice}")
    return sentences
