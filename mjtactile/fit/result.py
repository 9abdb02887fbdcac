"""Result of a fit, and its values with their intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mjtactile.core.config_fields import scalars
from mjtactile.core.design import SensorDesign
from mjtactile.core.types import Array
from mjtactile.fit.gas import GasFit
from mjtactile.fit.image_noise import ImageNoiseFit
from mjtactile.fit.measurements import Evidence
from mjtactile.fit.membrane_fit import LENS_MIN, MembraneFit
from mjtactile.fit.parameter_info import ABOUT, FittedParameter, classify, missing

_UNKNOWN_FRACTION = 0.3  # relative uncertainty of an unmeasured thickness
SI = {
    label: (section, attribute, number.unit)
    for label, section, attribute, number in scalars(SensorDesign)
}
"""Field of the sensor file to section, attribute and SI units in its unit."""
FIELD = {(section, attribute): field for field, (section, attribute, _) in SI.items()}


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Hold of a held-out recording.

    `rms` is the difference between measured and simulated markers, m. `force` is the simulated
    stage force and `force_measured` the load cell reading, N (NaN: no load cell).
    """

    recording: str
    depth: float
    shear: float
    pressure: float
    rms: float
    force: float
    force_measured: float


@dataclass(frozen=True, eq=False)
class FitResult:
    """Result of a fit; `design` is the fitted sensor, `text` its file."""

    design: SensorDesign
    text: str
    parameters: tuple[FittedParameter, ...]
    correlations: tuple[str, ...]
    evidence: tuple[Evidence, ...]
    membrane: MembraneFit
    gas: GasFit | None
    image: ImageNoiseFit
    held_out: tuple[HeldOut, ...]
    seconds: float

    @property
    def lens(self) -> str:
        """Statement on the lens: the error of all heights that the recordings show."""
        error, sd = self.membrane.heights
        camera = self.design.camera
        scale = self.membrane.focal_scale
        found = f"{100 * error:+.1f} % (sd {100 * sd:.1f} %)"
        if scale != 1:
            fx, fy = (scale * f for f in (camera.fx, camera.fy))
            return (
                f"the lens differs from the sensor file: all measured heights are off by {found}; "
                f"the focal lengths are about {fx:.0f}, {fy:.0f} px in place of {camera.fx:g}, "
                f"{camera.fy:g} px: measure them (`mjtactile calibrate camera`)"
            )
        if sd <= LENS_MIN:
            return f"the lens agrees with the indentations: error of all heights {found}"
        distance = ""
        if max((e.height_fraction for e in self.evidence), default=0.0) > LENS_MIN:
            distance = "the flat membrane does not have the file's distance, by lens or mount; "
        return (
            f"{distance}the recordings do not determine the lens (error of all heights {found}): "
            "measure it (`mjtactile calibrate camera`)"
        )

    def parameter(self, field: str) -> FittedParameter:
        return next(parameter for parameter in self.parameters if parameter.field == field)


def fitted_parameters(
    nominal: SensorDesign,
    known: Mapping[str, float],
    evidence: Sequence[Evidence],
    membrane: MembraneFit,
    gas: GasFit | None,
    image: ImageNoiseFit,
) -> list[FittedParameter]:
    source = ", ".join(e.name for e in evidence)
    parameters = {}
    pressed = [
        (
            "membrane",
            name,
            value,
            membrane.cov[membrane.names.index(name)][membrane.names.index(name)],
        )
        for name, value in membrane.values.items()
    ]
    filled = [
        ("chamber", name, gas.values[name], gas.cov[i][i])
        for i, name in enumerate(gas.names if gas else ())
        if gas
    ]
    for section, attribute, value, variance in [*pressed, *filled]:
        field = FIELD[section, attribute]
        scale = SI[field][2]
        parameters[field] = classify(
            field,
            value / scale,
            math.sqrt(variance) / scale,
            value_before(nominal, field),
            source,
            gas_mL=nominal.chamber_volume_flat / 1e-6,
        )
    for field, (value, sd) in image.values.items():
        before = value_before(nominal, field)
        parameters[field] = classify(field, value, sd, before, f"{evidence[0].name}, flat")
    for field, value in known.items():
        before = value_before(nominal, field)
        parameters[field] = FittedParameter(field, value, 0.0, "known", "measured by hand", before)
    return [
        parameters.get(field) or missing(field, value_before(nominal, field))
        for field in dict.fromkeys([*ABOUT, *known])
    ]


def value_before(design: SensorDesign, field: str) -> float:
    section, attribute, scale = SI[field]
    return getattr(getattr(design, section), attribute) / scale


def covariance_of(
    membrane: MembraneFit, gas: GasFit | None, known_thickness: bool
) -> tuple[list[str], Array]:
    """Return the joint covariance of membrane and gas, by field.

    Statics determines only the product of thickness and modulus. An uncertainty of one is therefore
    fully correlated with that of the other.
    """
    names = [FIELD.get(("membrane", name), name) for name in membrane.names]
    n = len(names)
    m = 0 if gas is None else len(gas.names)
    cov = np.zeros((n + m + 1, n + m + 1))
    cov[:n, :n] = membrane.cov
    if gas is not None:
        cov[n : n + m, n : n + m] = gas.cov
        names += [FIELD["chamber", name] for name in gas.names]
    if "young" not in membrane.names or known_thickness:
        return names, cov[:-1, :-1]
    i = membrane.names.index("young")
    membrane_design = membrane.design.membrane
    slope = np.zeros(len(cov))
    slope[i] = -membrane_design.young
    slope[-1] = membrane_design.thickness
    return [*names, "membrane.thickness_mm"], cov + _UNKNOWN_FRACTION**2 * np.outer(slope, slope)


_NUMBERS = {name: name for name in ("field", "value", "sd", "state", "before", "source", "comment")}
_NUMBERS |= {"interval_95": "interval"}


def to_table(result: FitResult) -> dict[str, Any]:
    """Return the JSON object of `mjtactile fit`."""
    pressure_rms = {}
    if result.gas is not None:
        for run, fitted in zip(result.gas.runs, result.gas.fitted, strict=True):
            pressure_rms[run.name] = float(np.sqrt(np.mean((fitted - run.pressure) ** 2)))
    return {
        "sensor": result.design.name,
        "seconds": result.seconds,
        "recordings": [e.name for e in result.evidence],
        "numbers": [
            {name: getattr(n, attribute) for name, attribute in _NUMBERS.items()}
            for n in result.parameters
        ],
        "correlations": result.correlations,
        "markers_rms_um": 1e6 * result.membrane.rms,
        "markers_misfit_sd": result.membrane.misfit,
        "lens": {
            "height_error": result.membrane.heights[0],
            "sd": result.membrane.heights[1],
            "text": result.lens,
        },
        "first_touch_um": [1e6 * x for x in result.membrane.offsets],
        "pressure_rms_Pa": pressure_rms,
        "held_out": [
            {
                "recording": h.recording,
                "depth_mm": 1e3 * h.depth,
                "shear_mm": 1e3 * h.shear,
                "pressure_kPa": 1e-3 * h.pressure,
                "markers_rms_um": 1e6 * h.rms,
                "force_N": h.force,
                "force_measured_N": h.force_measured,
            }
            for h in result.held_out
        ],
    }
