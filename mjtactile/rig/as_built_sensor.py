"""Deviation of an as-built sensor from its sensor file.

The deviations come from `[emulator.as_built.FINGER]` of a rig file and from `--randomization`. Only
simulated and emulated worlds and their devices use them. Sensing reads the sensor file, and
measures the remainder as on a real rig.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from mjtactile.core import geometry
from mjtactile.core.config_fields import DEGREE, ML_S_KPA, MM, PERCENT, entry, number, numbers, part
from mjtactile.core.design import SensorDesign
from mjtactile.core.field_types import Numbers
from mjtactile.core.relaxation import Relaxation, decades
from mjtactile.core.types import Array
from mjtactile.rig.camera_faults import NO_CAMERA_FAULTS, CameraFaults

_CREEP_TIMES = (1.0, 1e3)  # shortest and longest time constant, s

_deviation = partial(number, default=0.0, group="sensor")


@dataclass(frozen=True)
class AsBuiltSensor:
    """Deviations of the sensor on one finger from its file, SI.

    Domain randomization can also set the fields of the groups "sensor" and "gas".
    """

    finger: str
    focal_fraction: float = _deviation("fx_percent", -50, 50, PERCENT, about="longer focal length")
    center: tuple[float, float] = numbers(
        "center_px",
        "uv",
        -500,
        500,
        default=(0.0, 0.0),
        group="sensor",
        about="offset of the principal point",
    )
    k1: float | None = number(
        "k1", -1, 1, default=None, about="first distortion coefficient, in place of the file's"
    )
    k1_offset: float = _deviation("k1_offset", -1, 1, about="offset of k1")
    shift: tuple[float, float, float] = numbers(
        "camera_shift_mm",
        "xyz",
        -10,
        10,
        MM,
        default=(0.0, 0.0, 0.0),
        group="sensor",
        about="displacement of camera and glass, frame S",
    )
    tilt: tuple[float, float, float] = numbers(
        "camera_tilt_deg",
        "xyz",
        -20,
        20,
        DEGREE,
        default=(0.0, 0.0, 0.0),
        group="sensor",
        about="rotation vector of camera and glass",
    )
    blur: float = _deviation("blur_px", -5, 10, about="increase of the blur (sd), px")
    noise_fraction: float = _deviation("noise_percent", -100, 1000, PERCENT, about="more noise")
    light_fraction: float = _deviation("light_percent", -90, 35, PERCENT, about="more light")
    stiffness_fraction: float = _deviation(
        "stiffness_percent", -90, 400, PERCENT, about="more Young's modulus"
    )
    thickness_fraction: float = _deviation("thickness_percent", -90, 400, PERCENT, about="thicker")
    pre_stretch: float = _deviation(
        "pre_stretch_offset", -0.2, 0.5, about="offset of the pre-stretch"
    )
    creep: float = number(
        "creep_percent",
        0,
        50,
        PERCENT,
        default=0.0,
        about="fraction of the long-term stress that relaxes in each decade from 1 to 1000 s",
    )
    friction_fraction: float = _deviation(
        "friction_percent", -100, 400, PERCENT, about="more friction"
    )
    radius: float = _deviation("marker_radius_um", -500, 500, 1e-6, about="larger markers")
    missing: tuple[int, ...] = entry(
        Numbers(
            key="missing_markers",
            low=0,
            high=40_000,
            group="sensor",
            about="numbers of the missing markers",
        ),
        (),
    )
    leak: float = number(
        "leak_mL_s_kPa", 0, 1e3, ML_S_KPA, default=0.0, group="gas", about="leak through a hole"
    )
    warming: float = number(
        "temperature_drift_K_min",
        -60,
        60,
        1 / 60,
        default=0.0,
        group="gas",
        about="drift of gas and walls",
    )
    valve_zero: float = number(
        "pressure_offset_Pa", -1000, 1000, default=0.0, about="offset of the pressure sensor"
    )
    camera: CameraFaults = part(
        "camera", CameraFaults, default=NO_CAMERA_FAULTS, about="faults of its images"
    )


NOMINAL = AsBuiltSensor("")
"""Sensor without deviations from its file."""


def true_design(design: SensorDesign, as_built: AsBuiltSensor) -> SensorDesign:
    """Return the as-built design of a sensor.

    It excludes the camera pose (`camera_pose`), missing markers (`marker_radii`), and changes of
    the gas over time.
    """
    camera = design.camera
    k = design.camera.distortion
    focal = 1 + as_built.focal_fraction
    du, dv = as_built.center
    k1 = (k[0] if as_built.k1 is None else as_built.k1) + as_built.k1_offset
    camera = replace(
        camera,
        fx=focal * camera.fx,
        fy=focal * camera.fy,
        cx=camera.cx + du,
        cy=camera.cy + dv,
        distortion=(k1, *k[1:]),
        blur_px=max(camera.blur_px + as_built.blur, 0.0),
        noise_dn=(1 + as_built.noise_fraction) * camera.noise_dn,
    )
    membrane = design.membrane
    membrane = replace(
        membrane,
        young=(1 + as_built.stiffness_fraction) * membrane.young,
        thickness=(1 + as_built.thickness_fraction) * membrane.thickness,
        pre_stretch=membrane.pre_stretch + as_built.pre_stretch,
        friction=(1 + as_built.friction_fraction) * membrane.friction,
    )
    light = 1 + as_built.light_fraction
    leds = design.leds
    leds = replace(leds, membrane_dn=light * leds.membrane_dn, marker_dn=light * leds.marker_dn)
    markers = replace(design.markers, radius=design.markers.radius + as_built.radius)
    creep = Relaxation(decades(as_built.creep, *_CREEP_TIMES)) if as_built.creep else None
    return replace(
        design,
        camera=camera,
        membrane=membrane,
        markers=markers,
        leds=leds,
        relaxation=creep or design.relaxation,
    )


def camera_pose(design: SensorDesign, as_built: AsBuiltSensor) -> tuple[Array, Array]:
    """Return the as-built pose of the camera with its glass and LEDs: R_SC (3, 3), p_SC (3,), m, in
    S."""
    position = design.camera.p_SC + np.array(as_built.shift)
    return geometry.rotation_from_vector(as_built.tilt), position


def marker_radii(design: SensorDesign, as_built: AsBuiltSensor) -> Array:
    """Return the rendered radius (N,) m of each marker of the true `design`.

    It is 0 for missing markers.
    """
    radii = np.full(design.markers.count, design.markers.radius)
    radii[[marker for marker in as_built.missing if marker < len(radii)]] = 0.0
    return radii
