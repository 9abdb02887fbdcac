"""Manufacturability limits of the design; a message states a rejected value and its limit."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.fabrication import purchased_parts as hw
from mjtactile.fabrication.purchased_parts import Hardware
from mjtactile.sim.sensor.validity_checks import STRETCHED

MM = 1e3  # mm in a m
_WEB = 0.3  # minimum web of a cut stencil, mm
_MARGIN = 0.3  # accuracy of manual placement, mm
_STRETCH_ERROR = 0.2  # allowed error of the pre-stretch, relative to the pre-stretch less 1
_SMALLEST_STRETCH = 0.02  # the pre-stretch less 1 below which the tolerance is constant
_DIGITS = 4  # digits of a limit, rounded to the safe side


@dataclass(frozen=True)
class Limit:
    """Limits of the `value` of one `field` (or option), in the file's unit; `why` follows it."""

    field: str
    value: float
    why: str
    low: float = -math.inf
    high: float = math.inf

    def check(self, source: str) -> None:
        """Raise InputError if the value is outside of its limits."""
        slack = 1e-9 * abs(self.value)
        if self.low - slack <= self.value <= self.high + slack:
            return
        if self.value < self.low:
            limit = f"at least {_rounded(self.low, up=True)}"
        else:
            limit = f"at most {_rounded(self.high)}"
        raise InputError(
            f"{self.value:g} {self.why}; {limit}",
            source=None if self.field.startswith("--") else source,
            field=self.field,
        )


def check_all(limits: Iterable[Limit], source: str) -> None:
    """Reject the first value that is outside of its limits."""
    for limit in limits:
        limit.check(source)


def limits_of(design: SensorDesign, hardware: Hardware) -> Iterator[Limit]:
    """Yield the limits that require no drawing and no simulation."""
    yield from _housing(design)
    yield from _glass(design, hardware)
    yield from _pattern(design, hardware)
    yield from _lights(design, hardware)
    thinnest = 2 + hw.SPACER + hw.LED_BODY[2] + hw.LED_BOARD
    why = "leaves less than 2 mm for the camera's plate"
    yield Limit("--pupil-mm", hardware.pupil, why, thinnest)
    if hardware.press is not None:
        why = "would press the membrane against the glass"
        yield Limit("--press-mm", hardware.press, why, high=0.9 * MM * design.chamber.depth)
    why = "puts the camera's screws into the lens's hole"
    yield Limit("--camera-holes-mm", hardware.holes, why, hardware.lens + 6)


def _housing(design: SensorDesign) -> Iterator[Limit]:
    rim = MM * design.frame.rim
    yield Limit("frame.wall_mm", rim, "is too thin a wall", hw.PRINT_WALL)
    fiducials = design.fiducials
    if fiducials is not None and fiducials.surface == "rim":
        why = f"leaves too thin a wall of the rim of {rim:g} mm"
        setback = MM * fiducials.step
        yield Limit("fiducials.wall_setback_mm", setback, why, high=rim - hw.PRINT_WALL)
    why = "cannot be mounted by stretching"
    yield Limit("membrane.pre_stretch", design.membrane.pre_stretch, why, 1.0)
    why = "is beyond the stretch up to which the simulated material law holds"
    yield Limit("membrane.pre_stretch", design.membrane.pre_stretch, why, high=STRETCHED)


def glass_limit(design: SensorDesign, pressure: float, load: str) -> Limit:
    """Return the limit of the glass thickness under a gauge pressure, Pa, of a `load`."""
    thickness = MM * design.glass.thickness
    stress = glass_stress(design, pressure)
    why = (
        f"has a bending stress of {stress:.3g} MPa under {load}, "
        f"above the {hw.GLASS_STRESS:g} MPa allowed for glass"
    )
    minimum = thickness * math.sqrt(stress / hw.GLASS_STRESS)
    return Limit("glass.thickness_mm", thickness, why, minimum)


def _glass(design: SensorDesign, hardware: Hardware) -> Iterator[Limit]:
    glass = design.glass
    distance = MM * glass.distance
    thickness = MM * glass.thickness
    yield Limit("glass.thickness_mm", thickness, "does not close the chamber", 0.5)
    yield glass_limit(design, design.chamber.supply_gauge, "the supply pressure")
    end = MM * (design.camera.distance - design.chamber.depth - glass.thickness)
    why = f"leaves a gap between glass and chamber, which ends at {end:g}"
    yield Limit("glass.distance_mm", distance, why, end - 0.05, end + 0.05)
    why = "lets the lens touch the glass"
    yield Limit("glass.distance_mm", distance, why, hardware.lens_front + 1)


def _pattern(design: SensorDesign, hardware: Hardware) -> Iterator[Limit]:
    frame = design.frame
    markers = design.markers
    stretch = design.membrane.pre_stretch
    printed = 2 * MM * markers.radius * marker_shrink(design, hardware)
    narrow_web = f"leaves webs of less than {_WEB:g} mm in the stencil"
    at_frame = f"leaves less than {_MARGIN:g} mm between the outermost markers and the frame"
    for axis, count, pitch, size in (
        ("x", markers.columns, markers.pitch_x, frame.length),
        ("y", markers.rows, markers.pitch_y, frame.width),
    ):
        field = f"markers.pitch_{axis}_mm"
        yield Limit(field, MM * pitch, narrow_web, stretch * (printed + _WEB))
        if frame.outline is None:
            room = (MM * size - 2 * MM * markers.radius - 2 * _MARGIN) / (count - 1)
            yield Limit(field, MM * pitch, at_frame, high=room)
    if frame.outline is not None:
        room = MM * (min(opening_margins(design)) + markers.radius) - _MARGIN
        yield Limit("markers.radius_mm", MM * markers.radius, at_frame, high=room)


def _lights(design: SensorDesign, hardware: Hardware) -> Iterator[Limit]:
    leds = design.leds
    barrel = hardware.lens / 2
    ring = MM * design.leds.ring_radius
    # the barrel must not shade the far end of the membrane
    view_ratio = hardware.lens_front / (MM * design.camera.distance)
    clear = max(
        barrel + 0.5 + hw.LED_BODY[0] / 2 + 0.5,
        (barrel + MM * design.frame.length / 2 * view_ratio) / (1 - view_ratio),
    )
    yield Limit("leds.count", leds.count, "leaves the closed housing dark", 1)
    why = f"puts the LEDs behind or into the lens barrel of {hardware.lens:g} mm"
    yield Limit("leds.ring_radius_mm", ring, why, clear)
    maximum = math.floor(2 * math.pi * ring / (hw.LED_BODY[1] + 1.5))
    yield Limit("leds.count", leds.count, f"LEDs do not fit on a ring of {ring:g} mm", high=maximum)


def opening_margins(design: SensorDesign) -> tuple[float, float]:
    """Return the distance of the outermost markers' edges from the opening's, along x and y, mm."""
    frame = design.frame
    markers = design.markers
    if frame.outline is not None:
        minimum = MM * float(frame.inside(markers.p_SM[:, :2]).min() - markers.radius)
        return minimum, minimum
    return (
        MM * ((frame.length - (markers.columns - 1) * markers.pitch_x) / 2 - markers.radius),
        MM * ((frame.width - (markers.rows - 1) * markers.pitch_y) / 2 - markers.radius),
    )


def marker_shrink(design: SensorDesign, hardware: Hardware) -> float:
    """Return printed over mounted radius: ink is stretched with the membrane, discs are not."""
    return 1 / design.membrane.pre_stretch if hardware.markers == "ink" else 1.0


def glass_stress(design: SensorDesign, pressure: float) -> float:
    """Return the largest bending stress of the glass under a gauge pressure, Pa, N/mm^2.

    The stress of a simply supported plate is beta p b^2 / t^2, beta = 0.75 / (1 + 1.61 (b/a)^3)
    (Roark's formulas for stress and strain, flat rectangular plates).
    """
    b, a = sorted((design.frame.length, design.frame.width))
    beta = 0.75 / (1 + 1.61 * (b / a) ** 3)
    slenderness = b / max(design.glass.thickness, 1e-9)
    return 1e-6 * beta * abs(pressure) * slenderness**2


def mount_tolerance(design: SensorDesign) -> tuple[float, float]:
    """Return the allowed deviation of the outermost markers from the mounted pattern, mm, and the
    error of the pre-stretch at that deviation.

    The pattern is centered. The tension is proportional to the pre-stretch less 1, of which the
    error may be a fraction.
    """
    stretch = design.membrane.pre_stretch
    half = MM * float(np.ptp(design.markers.p_SM[:, :2], axis=0).min()) / 2
    error = _STRETCH_ERROR * max(stretch - 1, _SMALLEST_STRETCH)
    tolerance = min(half * error / stretch, _MARGIN)
    return tolerance, tolerance * stretch / half


def _rounded(value: float, *, up: bool = False) -> str:
    """Format with four digits, rounded so that the displayed value is itself allowed."""
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    unit = 10.0 ** (math.floor(math.log10(abs(value))) + 1 - _DIGITS)
    steps = math.ceil(value / unit - 1e-9) if up else math.floor(value / unit + 1e-9)
    return f"{steps * unit:.{_DIGITS}g}"
