"""Check that all markers are in the image, sharp, unsmeared and lit; the required lens.

Blur, px, has three parts: a pixel's own square (sd 1/sqrt 12), diffraction and defocus. A Gaussian
of sd 0.42 lambda N fits the Airy disc (Zhang, Zerubia, Olivo-Marin, Applied Optics 46, 2007). A
thin lens of focal length f and f-number N is focused on Z_f. It shows a point at Z as a disc of
diameter

    c = f^2 / (N (Z_f - f)) |Z - Z_f| / Z,                                             sd c / 4,

on the sensor (Born and Wolf; any text on depth of field). Focus on the harmonic mean of the nearest
and farthest Z makes both ends equally blurred. Smear: a marker at speed v across the axis moves by
f_px v t / Z in the exposure t.

Light: a pixel of area A under the irradiance E gets E A t QE lambda / (h c) electrons (EMVA 1288).
A matte white membrane under E_m gives E = E_m / (4 N^2) on the axis. A Lambertian LED of flux P
gives E_m = P cos^4(theta) / (pi D^2).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mjtactile.core import optics
from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.core.types import Array
from mjtactile.fabrication import purchased_parts as hw
from mjtactile.fabrication.manufacturability import Limit
from mjtactile.fabrication.marker_positions import MembraneState
from mjtactile.fabrication.purchased_parts import Hardware

_AROUND = 24  # points of a marker's edge
_STOPS = (2.0, 2.8, 4.0, 5.6, 8.0)
_WAVELENGTH = 0.55e-3  # mm, green
_PHOTON = 3.61e-19  # J, of that wavelength: h c / lambda
_SHORTEST = 1e-5  # shortest exposure of small cameras, s


@dataclass(frozen=True)
class Optics:
    """Requirements of the camera module, and the margins."""

    margin: float  # from the markers' edges to the image border, px
    worst: str  # state with the smallest margin
    fov: tuple[float, float, float]  # field of view in x, y and diagonal, deg
    focal: float  # focal length, mm
    stop: float  # f-number
    near: float  # nearest and farthest marker and focus, from the pupil, mm
    far: float
    focus: float
    blur: float  # sd at the ends of that range, px
    exposure: float  # s
    flux: float  # light from each LED during the exposure, W
    noise: float  # photon noise at the membrane's gray level, in gray levels
    mirrors: Array  # reflections of the LEDs in the glass, px


def plan_camera(
    design: SensorDesign, hardware: Hardware, states: Sequence[MembraneState], source: str
) -> Optics:
    """Compute the camera's requirements. Raises InputError naming the invalid value."""
    margin, worst = _margins(design, states, source)
    near, far = _range(design, states)
    focal = design.camera.fx * hardware.pixel
    stop = _stop(design, hardware, near, far, source)
    exposure = _exposure(design, hardware, near)
    level = design.leds.membrane_dn / 255 * hw.FULL_WELL
    flux = _flux(design, hardware, stop, exposure)
    Limit(
        "leds.count",
        design.leds.count,
        f"LEDs would need {flux:.2g} W of light each, more than {hw.LED_FLUX:g}, for an "
        f"exposure of {1e6 * exposure:.0f} us at f/{stop:g} (or use a smaller --speed-mm-s)",
        math.ceil(design.leds.count * flux / hw.LED_FLUX),
    ).check(source)
    return Optics(
        margin,
        worst,
        _fov(design),
        focal,
        stop,
        near,
        far,
        2 * near * far / (near + far),
        blur(design, hardware, stop, near, far),
        exposure,
        flux,
        design.leds.membrane_dn / math.sqrt(level),
        led_mirrors(design),
    )


def marker_edges(design: SensorDesign, state: MembraneState) -> Array:
    """Return points (N, k, 2) on the marker edges in the image, px, through glass and lens."""
    camera = optics.Camera.from_design(design.camera, design.glass)
    axis = np.where(np.abs(state.n_S[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
    across = np.cross(state.n_S, axis)
    across /= np.linalg.norm(across, axis=1)[:, None]
    along = np.cross(state.n_S, across)
    angle = np.linspace(0, 2 * np.pi, _AROUND, endpoint=False)[:, None]
    edge = state.p_SM[:, None] + design.markers.radius * (
        np.cos(angle) * across[:, None] + np.sin(angle) * along[:, None]
    )
    return optics.project(camera, edge - design.camera.p_SC)


def _margins(
    design: SensorDesign, states: Sequence[MembraneState], source: str
) -> tuple[float, str]:
    """Return the minimum distance of a marker's edge band from the image border, px; its state."""
    camera = design.camera
    band = 2 + 3 * camera.blur_px  # the edge profiles that the fit needs
    minimum = math.inf
    worst = ""
    limits = {"fx": math.inf, "fy": math.inf}
    axes = (("fx", camera.fx, camera.cx, camera.width), ("fy", camera.fy, camera.cy, camera.height))
    for state in states:
        uv = marker_edges(design, state)
        for k, (name, f, c, size) in enumerate(axes):
            away = uv[..., k] - c
            room = np.where(away > 0, size - 0.5 - band - c, c + 0.5 - band)
            slack = float(np.nan_to_num(room - np.abs(away), nan=-np.inf).min())
            limit = float((f * room / np.maximum(np.abs(away), 1e-9)).min())
            limits[name] = min(limits[name], limit)
            if slack < minimum:
                minimum = slack
                worst = state.name
    for name, limit in limits.items():
        Limit(
            f"camera.{name}_px",
            getattr(camera, name),
            f"places a marker edge {-minimum:.0f} px outside the usable image ({worst})",
            high=limit,
        ).check(source)
    return minimum, worst


def _range(design: SensorDesign, states: Sequence[MembraneState]) -> tuple[float, float]:
    """Return the apparent distances from pupil to nearest and farthest marker, mm."""
    z = np.concatenate([state.p_SM[:, 2] for state in states])
    flat = design.camera.distance - design.apparent_glass_thickness
    return float(1e3 * (flat + z.min())), float(1e3 * (flat + z.max()))


def blur(design: SensorDesign, hardware: Hardware, stop: float, near: float, far: float) -> float:
    """Return the standard deviation of the blur, px, at both ends of the range.

    The focus is between them, so that both ends are equally blurred.
    """
    focal = design.camera.fx * hardware.pixel
    focus = 2 * near * far / (near + far)
    disc = focal**2 / (stop * (focus - focal)) * (far - focus) / far
    diffraction = 0.42 * _WAVELENGTH * stop / hardware.pixel
    return math.sqrt(1 / 12 + diffraction**2 + (disc / (4 * hardware.pixel)) ** 2)


def _stop(design: SensorDesign, hardware: Hardware, near: float, far: float, source: str) -> float:
    """Return the widest stop with a sufficiently sharp image."""
    allowed = design.camera.blur_px
    stops = _STOPS if hardware.f_number is None else (hardware.f_number,)
    blurs = {stop: blur(design, hardware, stop, near, far) for stop in stops}
    for stop, value in blurs.items():
        if value <= allowed:
            return stop
    stop = min(blurs, key=lambda s: blurs[s])
    blur_text = f"{blurs[stop]:.2f} px at f/{stop:g} from {near:.1f} to {far:.1f} mm"
    if hardware.f_number is not None:
        raise InputError(
            f"{stop:g} gives a blur of {blur_text}; the sensor file allows camera.blur_px = "
            f"{allowed:g}",
            field="--f-number",
        )
    Limit(
        "camera.blur_px",
        allowed,
        f"is sharper than possible with pixels of {1e3 * hardware.pixel:g} um: {blur_text}",
        blurs[stop],
    ).check(source)
    return stop


def _exposure(design: SensorDesign, hardware: Hardware, near: float) -> float:
    """Return the longest exposure, s, with a motion blur of SMEAR px at the nearest marker."""
    exposure = hw.SMEAR * near / (max(design.camera.fx, design.camera.fy) * hardware.speed)
    Limit(
        "--speed-mm-s",
        hardware.speed,
        f"needs an exposure of {1e6 * exposure:.1f} us for {hw.SMEAR:g} px of motion blur, "
        f"below the minimum of {1e6 * _SHORTEST:g} us",
        high=hardware.speed * exposure / _SHORTEST,
    ).check("")
    return min(exposure, 1 / design.camera.rate)


def _flux(design: SensorDesign, hardware: Hardware, stop: float, exposure: float) -> float:
    """Return the light power of each LED, W, for the specified gray level of the center."""
    electrons = design.leds.membrane_dn / 255 * hw.FULL_WELL
    on_sensor = electrons * _PHOTON / (hw.QUANTUM * exposure * (1e-3 * hardware.pixel) ** 2)
    on_membrane = 4 * stop**2 * on_sensor
    distance = design.camera.distance
    tilt = math.atan2(design.leds.ring_radius, distance)
    return on_membrane * math.pi * distance**2 / (design.leds.count * math.cos(tilt) ** 4)


def _fov(design: SensorDesign) -> tuple[float, float, float]:
    x, y = design.camera.half_view
    return tuple(math.degrees(2 * math.atan(t)) for t in (x, y, math.hypot(x, y)))  # pyright: ignore[reportReturnType]


def led_mirrors(design: SensorDesign) -> Array:
    """Return the images of the LEDs in the near face of the glass, a mirror, (count, 2) px."""
    count = design.leds.count
    radius = design.leds.ring_radius
    angle = 2 * np.pi * (np.arange(count) + 0.5) / count
    depth = np.full(count, 2 * design.glass.distance)
    virtual = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), depth])
    bare = replace(optics.Camera.from_design(design.camera), glass_thickness=0.0)
    return optics.project(bare, virtual)


def mirrored_in_image(design: SensorDesign, mirrors: Array) -> int:
    """Return the number of LED reflections inside the image."""
    inside = (mirrors > -0.5) & (mirrors < (design.camera.width - 0.5, design.camera.height - 0.5))
    return int(inside.all(axis=1).sum())
