"""Parts of a finger's calibration: lens, camera pose with marker sizes, zero of the pressure
sensor, and force scale.

Each part records its sensor file, date, software versions and residuals.
"""

from __future__ import annotations

import datetime
import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from mjtactile.core.config_fields import KPA, MM, entry, given, number, part, text
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.field_types import NumberArray, Table
from mjtactile.core.lens import PLUMB_BOB
from mjtactile.core.renamed import old_keys
from mjtactile.core.sensor_parts import Pinhole
from mjtactile.core.signature_checks import validated
from mjtactile.core.toml import Section
from mjtactile.core.types import Array, FiducialDetections, Markers, Traction

_FAR = 1e9  # maximum value of any calibration parameter


@validated()
@dataclass(frozen=True)
class CalibrationMetadata:
    """Origin of a part of a calibration.

    Attributes:
        date: ISO 8601, UTC.
        fingerprint: Fingerprint of the sensor file at that time.
        versions: Software versions.
        residuals: Residuals and quality measures of the calibration.
    """

    date: str = text("date")
    fingerprint: str = text("fingerprint")
    versions: Mapping[str, str] = entry(Table(key="versions"), default_factory=dict)
    residuals: Mapping[str, Any] = entry(Table(key="residuals"), default_factory=dict)


def stamp(
    design: SensorDesign, versions: Mapping[str, str], residuals: Mapping[str, Any]
) -> CalibrationMetadata:
    """Return the metadata of a calibration part measured now, on a sensor of this sensor file."""
    return CalibrationMetadata(now(), fingerprint(design), versions, residuals)


def fingerprint(design: SensorDesign) -> str:
    """Return the SHA-256 of all values of a sensor file, without comments and layout."""
    values = old_keys(asdict(replace(design, calibration=None)))
    for added in ("fiducials", "relaxation"):  # keeps the fingerprints of older files
        if values[added] is None:
            del values[added]
    if values["camera"]["distortion_model"] == PLUMB_BOB:
        del values["camera"]["distortion_model"]
    del values["markers"]["frame"]
    if not design.frame.has_corners:
        del values["frame"]["corner_radius"], values["frame"]["corners"]
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


@validated()
@dataclass(frozen=True)
class LensCalibration(Pinhole):
    """Measured intrinsics of one camera.

    Attributes:
        kind: "lens".
        rests_on: Parts that this one was measured with: when one of them is newer, this one is
            outdated.
        of_sensor: True if a change of the sensor file makes it outdated.
        stamp: Origin of the part.
    """

    kind: ClassVar[str] = "lens"
    rests_on: ClassVar[tuple[str, ...]] = ()
    of_sensor: ClassVar[bool] = False

    stamp: CalibrationMetadata = field(kw_only=True)

    def __post_init__(self) -> None:
        """Raise InputError for intrinsics that are not finite, or focal lengths below 0."""
        super().__post_init__()
        values = {name: getattr(self, name) for name in ("fx", "fy", "cx", "cy")}
        values |= {f"distortion[{k}]": value for k, value in enumerate(self.distortion)}
        for name, value in values.items():
            if not math.isfinite(value):
                raise InputError(
                    f"{value!r} is not a finite number", source="LensCalibration", field=name
                )
            if name in ("fx", "fy") and value <= 0:
                raise InputError(
                    f"{value!r} px must be above 0", source="LensCalibration", field=name
                )


@dataclass(frozen=True, eq=False)
class RestMarkers:
    """The membrane at rest: `markers` in S, the chamber's `gauge_pressure` Pa, and whether it was
    `sealed`."""

    markers: Markers
    gauge_pressure: float
    sealed: bool

    def to_table(self) -> dict[str, Any]:
        """Return the file's table."""
        m = self.markers
        fiducials = m.fiducials
        table = {
            "pressure_kPa": self.gauge_pressure / KPA,
            "sealed": self.sealed,
            "ids": m.ids.tolist(),
            "p_SM_mm": (m.p_SM / MM).tolist(),
            "n_S": m.n_S.tolist(),
            "cov_p_mm2": (m.cov_p / MM**2).tolist(),
        }
        if fiducials is None or not fiducials.has_levels:
            return table
        values = {name: np.asarray(value).tolist() for name, value in vars(fiducials).items()}
        return table | {"fiducials": values}

    @classmethod
    def from_section(cls, section: Section) -> RestMarkers:
        """Read the markers, stored as lists of equal length."""
        ids = section.array("ids", (None,))
        n = len(ids)
        markers = Markers(
            ids.astype(np.int64),
            section.array("p_SM_mm", (n, 3)) * MM,
            section.array("n_S", (n, 3)),
            section.array("cov_p_mm2", (n, 3, 3)) * MM**2,
            fiducials=_read_fiducials(section.optional("fiducials")),
        )
        pressure = section.number("pressure_kPa", -_FAR, _FAR, KPA)
        return cls(markers, pressure, section.flag("sealed", True))


def _read_fiducials(section: Section | None) -> FiducialDetections | None:
    """Read the detected fiducials from the file's section; None without a section."""
    if section is None:
        return None
    ids = section.array("ids", (None,))
    n = len(ids)
    fiducials = FiducialDetections(
        ids.astype(np.int64),
        section.array("center_px", (n, 2)),
        section.array("radius_px", (n,)),
        section.array("cov", (n, 3, 3)),
        section.array("inside", (n,)),
        section.array("outside", (n,)),
        section.array("blur_px", (n,)),
    )
    section.done()
    return fiducials


@dataclass(frozen=True, eq=False)
class FrameCalibration:
    """Camera pose in frame S and marker radii of a calibrated sensor.

    The pose is `R_SC` (3, 3) and `p_SC` (3,) m. `scale` (N,) is the measured over the nominal
    radius of each marker.

    `residual_px` and `scale_sd` come from the flat membrane. `rest` is the membrane at rest, if
    measured. `stiffness` is then the ratio of its stiffness to the sensor file's.
    """

    kind: ClassVar[str] = "frame"
    rests_on: ClassVar[tuple[str, ...]] = ("lens",)
    of_sensor: ClassVar[bool] = True

    R_SC: Array = entry(NumberArray(key="R_SC", shape=(3, 3)))
    p_SC: Array = entry(NumberArray(key="p_SC_mm", shape=(3,), unit=MM))
    scale: Array = entry(NumberArray(key="scale", shape=(None,)))
    residual_px: float = number("residual_px", 0, _FAR)
    scale_sd: float = number("scale_sd", 0, _FAR)
    stamp: CalibrationMetadata = given()
    rest: RestMarkers | None = part("rest", RestMarkers, default=None)
    stiffness: float | None = number("stiffness", 0, _FAR, default=None)


@dataclass(frozen=True)
class ValveZero:
    """Zero of the chamber's pressure sensor: reading at ambient pressure, `offset` Pa, and noise,
    `noise_sd` Pa."""

    kind: ClassVar[str] = "valve"
    rests_on: ClassVar[tuple[str, ...]] = ()
    of_sensor: ClassVar[bool] = False

    offset: float = number("offset_Pa", -_FAR, _FAR)
    noise_sd: float = number("noise_sd_Pa", 0, _FAR)
    stamp: CalibrationMetadata = given()


@dataclass(frozen=True)
class ForceScale:
    """Ratio of ground truth to estimated force, `scale`, with standard deviation `sd`, for loads up
    to `largest` N."""

    kind: ClassVar[str] = "force"
    rests_on: ClassVar[tuple[str, ...]] = ("lens", "valve")
    of_sensor: ClassVar[bool] = True

    scale: float = number("scale", 0.1, 10)
    sd: float = number("scale_sd", 0, 10)
    largest: float = number("largest_N", 0, _FAR)
    stamp: CalibrationMetadata = given()

    def apply(self, traction: Traction) -> Traction:
        """Multiply a traction by the scale and add the scale's uncertainty to the wrench's: cov' =
        k^2 cov + sd^2 w w^T."""
        wrench = traction.wrench
        k = self.scale
        cov = k**2 * traction.wrench_cov + self.sd**2 * np.outer(wrench, wrench)
        return replace(traction, force=k * traction.force, wrench=k * wrench, wrench_cov=cov)


Part = LensCalibration | FrameCalibration | ValveZero | ForceScale
KINDS: dict[str, type[Part]] = {
    part.kind: part for part in (LensCalibration, FrameCalibration, ValveZero, ForceScale)
}
"""The parts by name, in the order in which they are measured."""


def now() -> str:
    """Return the current time, ISO 8601, UTC."""
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
