"""Information on the fitted parameters: names, accuracy limits, necessary recordings,
correlations."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mjtactile.core.types import Array

SD95 = 1.96
TOGETHER = 0.9  # correlation threshold of the report


@dataclass(frozen=True)
class ParameterInfo:
    """Information on a field of the sensor file.

    `name` is its name in a sentence. The value counts as known up to a certain sd. This sd is the
    larger of `fraction`, relative to its value, and `minimum`, in the file's unit. `record` names
    the necessary recording.
    """

    name: str
    record: str
    fraction: float = 0.1
    minimum: float = 0.0

    def is_finite_value(self, value: float, sd: float) -> bool:
        return sd <= max(self.fraction * abs(value), self.minimum)


FIT_PRESSURES = (500.0, 3000.0)
"""Gauge pressures of the recordings that separate pre-stretch and modulus, Pa."""
_BULGE = (
    "inflate it to 0.5 kPa, where its tension dominates, and to 3 kPa, where its modulus dominates"
)
_TAP = "load it quickly and hold (protocol `tap`), with a pressure sensor"
ABOUT: Mapping[str, ParameterInfo] = {
    "membrane.young_MPa": ParameterInfo("modulus", _BULGE, 0.05),
    "membrane.pre_stretch": ParameterInfo("pre-stretch", _BULGE, 0.0, 0.003),
    "membrane.thickness_mm": ParameterInfo(
        "thickness",
        "recordings determine only its product with the modulus: measure the thickness, then "
        "--fix membrane.thickness_mm=…",
    ),
    "membrane.friction": ParameterInfo(
        "friction", "drag a loaded indenter until it slides (protocol `drag`)"
    ),
    "chamber.extra_volume_mL": ParameterInfo(
        "gas volume",
        "load it with the valve closed (protocol `press`), with a pressure sensor",
        0.0,
        math.inf,
    ),
    "chamber.leak_mL_s_kPa": ParameterInfo(
        "leak",
        "keep it inflated with the valve closed for a minute (protocol `still`), with a "
        "pressure sensor",
        0.1,
        5e-4,
    ),
    "chamber.polytropic_exponent": ParameterInfo("heat ratio", _TAP, 0.0, 0.02),
    "chamber.thermal_time_constant_s": ParameterInfo("heat exchange", _TAP, 0.1),
    "camera.blur_px": ParameterInfo("blur", "images of the flat membrane", 0.1),
    "camera.noise_DN": ParameterInfo("noise", "two images or more of the flat membrane", 0.1, 0.1),
    "leds.membrane_DN": ParameterInfo("grey of the membrane", "images of the flat membrane", 0.1),
    "leds.marker_DN": ParameterInfo("grey of the markers", "images of the flat membrane", 0.1, 2.0),
    "leds.vignetting": ParameterInfo(
        "vignetting of the light", "images of the flat membrane", 0.1, 0.03
    ),
}
GAS_FRACTION = (
    0.05  # fraction of the gas volume behind the flat membrane: sd limit of a known volume
)
NOT_FITTED = {
    "membrane.poisson_ratio": "taken from the file; modulus and pre-stretch refer to it",
    "chamber.valve_mL_s_kPa": "recordings start after the valve has closed",
    "damping": "not a file parameter of the simulated rubber, and too fast for a camera",
}


@dataclass(frozen=True)
class FittedParameter:
    """Result for a `field` of the sensor file.

    `value` and standard deviation are in its unit. `state` is "fitted", "known" (set by the user)
    or "not in these recordings" (then the value is the file's). `source` is the origin of the
    value, and `before` the file's own value.
    """

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
        """Comment on the value in the sensor file."""
        if self.state == "fitted":
            low, high = self.interval
            return (
                f"fitted: {digits(low, self.sd)} to {digits(high, self.sd)} (95 %), {self.source}"
            )
        if self.state == "known":
            return self.source
        return f"not in these recordings; {ABOUT[self.field].record}"


def classify(
    field: str, value: float, sd: float, before: float, source: str, *, gas_mL: float = math.inf
) -> FittedParameter:
    """Return the fitted value, or the file's value if the recordings do not determine it.

    `gas_mL` is the gas volume behind the flat membrane.
    """
    if field == "chamber.extra_volume_mL":
        known = sd <= GAS_FRACTION * gas_mL
    else:
        known = ABOUT[field].is_finite_value(value, sd)
    if known:
        return FittedParameter(field, value, sd, "fitted", source, before)
    return missing(field, before)


def missing(field: str, before: float) -> FittedParameter:
    """Return the result for a parameter that the recordings do not determine."""
    return FittedParameter(field, before, math.inf, "not in these recordings", "", before)


def digits(value: float, sd: float) -> str:
    """Format a value with as many decimals as a twentieth of the sd has."""
    if not (math.isfinite(value) and math.isfinite(sd) and sd > 0):
        return f"{value:.6g}"
    return f"{value:.{max(0, 1 - math.floor(math.log10(sd)))}f}"


def correlations(names: Sequence[str], cov: Array, states: Mapping[str, str]) -> list[str]:
    """Return a sentence for each pair with a correlation above TOGETHER.

    `names` (n,) of the covariance (n, n) are fields or words for the sentence. If one of the two is
    undetermined, the pair cannot be separated.
    """
    sd = np.sqrt(np.diag(cov))
    sentences = []
    for i, j in itertools.combinations(range(len(names)), 2):
        rho = float(cov[i, j] / (sd[i] * sd[j])) if sd[i] > 0 and sd[j] > 0 else 0.0
        if abs(rho) < TOGETHER:
            continue
        first, second = (ABOUT[n].name if n in ABOUT else n for n in (names[i], names[j]))
        advice = next((ABOUT[n].record for n in (names[j], names[i]) if n in ABOUT), "")
        is_separable = all(states.get(n, "fitted") == "fitted" for n in (names[i], names[j]))
        verb = (
            "are determined better together than separately"
            if is_separable
            else "cannot be separated by these recordings"
        )
        sentences.append(f"{first} and {second} {verb} (correlation {rho:+.2f}): {advice}")
    return sentences
