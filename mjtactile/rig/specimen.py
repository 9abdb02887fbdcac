"""One sensor as it really is, against its sensor file: what `[emulator.specimen.FINGER]` of a rig
file and `--vary` change.

Only simulated and emulated worlds and their devices know; sensing reads the sensor file, and
measures the rest as on a real rig.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mjtactile.core import geometry
from mjtactile.core.design import SensorDesign
from mjtactile.core.toml import Section
from mjtactile.core.types import Array


@dataclass(frozen=True)
class SpecimenConfig:
    """How the sensor on one finger really is, against its file.

    Camera: `focal_share` more focal length, `center` (u, v) px off, its own `k1` (None: the file's)
    and `k1_offset` more of it, with its pane `shift` (x, y, z) m off and turned by `tilt` (rotation
    vector) rad, `blur` px more (sd), `noise_share` more noise, `light_share` more light. Sheet:
    `stiffness_share` more Young's modulus, `thickness_share` thicker, `pre_stretch` more of it,
    `friction_share` more friction; markers larger by `radius` m, and `missing` ones (their
    numbers). Gas: `leak` m^3/(s Pa) of a hole, `warming` K/s of gas and walls; `valve_zero` Pa that
    its pressure sensor shows too much.
    """

    finger: str
    focal_share: float = 0.0
    center: tuple[float, float] = (0.0, 0.0)
    k1: float | None = None
    k1_offset: float = 0.0
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tilt: tuple[float, float, float] = (0.0, 0.0, 0.0)
    blur: float = 0.0
    noise_share: float = 0.0
    light_share: float = 0.0
    stiffness_share: float = 0.0
    thickness_share: float = 0.0
    pre_stretch: float = 0.0
    friction_share: float = 0.0
    radius: float = 0.0
    missing: tuple[int, ...] = ()
    leak: float = 0.0
    warming: float = 0.0
    valve_zero: float = 0.0


NOMINAL = SpecimenConfig("")
"""One that is as its file says."""


@dataclass(frozen=True)
class Row:
    """A key of a file: the `attribute` it sets, lowest and highest value and `scale` (SI units in
    one of the file's), the `names` of its components where it has several."""

    key: str
    attribute: str
    low: float
    high: float
    scale: float = 1.0
    names: str = ""

    def read(self, section: Section) -> Any:
        """What the section says, SI; None where it says nothing."""
        if self.names:
            return section.numbers(
                self.key, self.names, self.low, self.high, self.scale, default=None
            )
        return section.number(self.key, self.low, self.high, self.scale, default=None)

    def si(self, value: Any) -> Any:
        """The file's `value`, SI."""
        return tuple(self.scale * one for one in value) if self.names else self.scale * value


_PERCENT = 1e-2
SENSOR_ROWS = (
    Row("fx_percent", "focal_share", -50, 50, _PERCENT),
    Row("center_px", "center", -500, 500, 1.0, "uv"),
    Row("k1_offset", "k1_offset", -1, 1),
    Row("camera_shift_mm", "shift", -10, 10, 1e-3, "xyz"),
    Row("camera_tilt_deg", "tilt", -20, 20, math.pi / 180, "xyz"),
    Row("blur_px", "blur", -5, 10),
    Row("noise_percent", "noise_share", -100, 1000, _PERCENT),
    Row("light_percent", "light_share", -90, 35, _PERCENT),
    Row("stiffness_percent", "stiffness_share", -90, 400, _PERCENT),
    Row("thickness_percent", "thickness_share", -90, 400, _PERCENT),
    Row("pre_stretch_offset", "pre_stretch", -0.2, 0.5),
    Row("friction_percent", "friction_share", -100, 400, _PERCENT),
    Row("marker_radius_um", "radius", -500, 500, 1e-6),
)
GAS_ROWS = (
    Row("leak_mL_s_kPa", "leak", 0, 1e3, 1e-9),
    Row("warming_K_min", "warming", -60, 60, 1 / 60),
)
MISSING = "missing_markers"
_FILE_ROWS = (
    *SENSOR_ROWS,
    *GAS_ROWS,
    Row("k1", "k1", -1, 1),
    Row("valve_zero_Pa", "valve_zero", -1000, 1000),
)


def read_specimen(finger: str, section: Section) -> SpecimenConfig:
    """`[emulator.specimen.FINGER]` of a rig file. Raises InputError for an unknown field or a value
    out of range."""
    found = {row.attribute: value for row in _FILE_ROWS if (value := row.read(section)) is not None}
    missing = section.wholes(MISSING, 0, 40_000) if section.has(MISSING) else ()
    section.done()
    return SpecimenConfig(finger, **found, missing=missing)


def specimen_of(finger: str, values: Mapping[str, Any]) -> SpecimenConfig:
    """The specimen of `values` in the file's units, by key."""
    known = {row.key: row for row in _FILE_ROWS}
    return SpecimenConfig(
        finger,
        missing=tuple(values.get(MISSING, ())),
        **{
            known[key].attribute: known[key].si(value)
            for key, value in values.items()
            if key in known
        },
    )


def true_design(design: SensorDesign, specimen: SpecimenConfig) -> SensorDesign:
    """The sensor as it is, but for the camera's pose (`camera_pose`), what is not drawn
    (`marker_radii`), and what goes on with its gas."""
    camera = design.camera
    k = design.camera.distortion
    focal, (du, dv) = 1 + specimen.focal_share, specimen.center
    k1 = (k[0] if specimen.k1 is None else specimen.k1) + specimen.k1_offset
    camera = replace(
        camera,
        fx=focal * camera.fx,
        fy=focal * camera.fy,
        cx=camera.cx + du,
        cy=camera.cy + dv,
        distortion=(k1, *k[1:]),
        blur_px=max(camera.blur_px + specimen.blur, 0.0),
        noise_dn=(1 + specimen.noise_share) * camera.noise_dn,
    )
    sheet = design.membrane
    sheet = replace(
        sheet,
        young=(1 + specimen.stiffness_share) * sheet.young,
        thickness=(1 + specimen.thickness_share) * sheet.thickness,
        pre_stretch=sheet.pre_stretch + specimen.pre_stretch,
        friction=(1 + specimen.friction_share) * sheet.friction,
    )
    light = 1 + specimen.light_share
    leds = design.leds
    leds = replace(leds, membrane_dn=light * leds.membrane_dn, marker_dn=light * leds.marker_dn)
    markers = replace(design.markers, radius=design.markers.radius + specimen.radius)
    return replace(design, camera=camera, membrane=sheet, markers=markers, leds=leds)


def camera_pose(design: SensorDesign, specimen: SpecimenConfig) -> tuple[Array, Array]:
    """Pose R_SC (3, 3), p_SC (3,) m of the camera, with its pane and LEDs, in S."""
    return geometry.rotation_from_vector(specimen.tilt), design.camera.p_SC + np.array(
        specimen.shift
    )


def marker_radii(design: SensorDesign, specimen: SpecimenConfig) -> Array:
    """Radius (N,) m of each marker of the true `design` as it is drawn: none of those that are
    missing."""
    radii = np.full(design.markers.count, design.markers.radius)
    radii[[number for number in specimen.missing if number < len(radii)]] = 0.0
    return radii
