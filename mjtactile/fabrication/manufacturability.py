"""Manufacturability limits of the design.

A value outside its limits is rejected with a message that states both.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError
from mjtactile.fabrication import purchased_parts as hw
from mjtactile.fabrication.purchased_parts import Hardware

MM = 1e3  # mm in a m
# minimum web of a cut stencil and accuracy of manual placement, mm
_WEB = 0.3
_MARGIN = 0.3
_DIGITS = 4  # of a limit, rounded so that it holds


@dataclass(frozen=True)
class Limit:
    """Limits of one `field` of the sensor file (or an option).

    Its `value`, in the file's unit, must be from `low` to `high`; `why` continues the message after
    the value.
    """

    field: str
    value: float
    why: str
    low: float = -math.inf
    high: float = math.inf

    def check(self, source: str) -> None:
        """Raise InputError where it is not."""
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
    """Those that need no drawing and no simulation."""
    yield from _housing(design)
    yield from _pane(design, hardware)
    yield from _pattern(design, hardware)
    yield from _lights(design, hardware)
    thinnest = 2 + hw.SPACER + hw.LED_BODY[2] + hw.LED_BOARD
    yield Limit(
        "--pupil-mm", hardware.pupil, "leaves less than 2 mm for the camera's plate", thinnest
    )
    if hardware.press is not None:
        yield Limit(
            "--press-mm",
            hardware.press,
            "would press the membrane against the glass",
            high=0.9 * MM * design.chamber.depth,
        )
    yield Limit(
        "--camera-holes-mm",
        hardware.holes,
        "puts the camera's screws into the lens's hole",
        hardware.lens + 6,
    )


def _housing(design: SensorDesign) -> Iterator[Limit]:
    yield Limit("frame.wall_mm", MM * design.frame.rim, "is too thin a wall", hw.PRINT_WALL)
    fiducials = design.fiducials
    if fiducials is not None and fiducials.surface == "rim":
        yield Limit(
            "fiducials.wall_setback_mm",
            MM * fiducials.step,
            f"leaves too thin a wall of the rim of {MM * design.frame.rim:g} mm",
            high=MM * design.frame.rim - hw.PRINT_WALL,
        )
    yield Limit(
        "membrane.pre_stretch", design.membrane.pre_stretch, "cannot be mounted by stretching", 1.0
    )


def _pane(design: SensorDesign, hardware: Hardware) -> Iterator[Limit]:
    glass = design.glass
    distance = MM * design.glass.distance
    thickness = MM * design.glass.thickness
    yield Limit("glass.thickness_mm", thickness, "does not close the chamber", 0.5)
    yield Limit(
        "glass.thickness_mm",
        thickness,
        f"has a bending stress of {glass_stress(design):.3g} MPa under the supply pressure, "
        f"above the {hw.GLASS_STRESS:g} MPa allowed for glass",
        thickness * math.sqrt(glass_stress(design) / hw.GLASS_STRESS),
    )
    ends = MM * (design.camera.distance - design.chamber.depth - glass.thickness)
    yield Limit(
        "glass.distance_mm",
        distance,
        f"leaves a gap between glass and chamber, which ends at {ends:g}",
        ends - 0.05,
        ends + 0.05,
    )
    yield Limit(
        "glass.distance_mm", distance, "lets the lens touch the glass", hardware.lens_front + 1
    )


def _pattern(design: SensorDesign, hardware: Hardware) -> Iterator[Limit]:
    frame = design.frame
    markers = design.markers
    stretch = design.membrane.pre_stretch
    printed = 2 * MM * markers.radius * marker_shrink(design, hardware)
    for axis, count, pitch, size in (
        ("x", markers.columns, markers.pitch_x, frame.length),
        ("y", markers.rows, markers.pitch_y, frame.width),
    ):
        field = f"markers.pitch_{axis}_mm"
        value = MM * pitch
        yield Limit(
            field,
            value,
            f"leaves webs of less than {_WEB:g} mm in the stencil",
            stretch * (printed + _WEB),
        )
        if frame.outline is not None:
            continue
        room = (MM * size - 2 * MM * markers.radius - 2 * _MARGIN) / (count - 1)
        yield Limit(
            field,
            value,
            f"leaves less than {_MARGIN:g} mm between the outermost markers and the frame",
            high=room,
        )
    if frame.outline is not None:
        yield Limit(
            "markers.radius_mm",
            MM * markers.radius,
            f"leaves less than {_MARGIN:g} mm between the outermost markers and the frame",
            high=MM * (min(opening_margins(design)) + markers.radius) - _MARGIN,
        )


def _lights(design: SensorDesign, hardware: Hardware) -> Iterator[Limit]:
    leds = design.leds
    barrel = hardware.lens / 2
    ring = MM * design.leds.ring_radius
    # the barrel must not shade the far end of the membrane
    reach = hardware.lens_front / (MM * design.camera.distance)
    clear = max(
        barrel + 0.5 + hw.LED_BODY[0] / 2 + 0.5,
        (barrel + MM * design.frame.length / 2 * reach) / (1 - reach),
    )
    yield Limit("leds.count", leds.count, "leaves the closed housing dark", 1)
    yield Limit(
        "leds.ring_radius_mm",
        ring,
        f"puts the LEDs behind or into the lens barrel of {hardware.lens:g} mm",
        clear,
    )
    yield Limit(
        "leds.count",
        leds.count,
        f"LEDs do not fit on a ring of {ring:g} mm",
        high=math.floor(2 * math.pi * ring / (hw.LED_BODY[1] + 1.5)),
    )


def opening_margins(design: SensorDesign) -> tuple[float, float]:
    """From the outermost markers' edges to the opening's, along x and y, mm."""
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
    """Return printed radius over mounted radius. Ink is stretched with the membrane; stiffer discs
    are not."""
    return 1 / design.membrane.pre_stretch if hardware.markers == "ink" else 1.0


def glass_stress(design: SensorDesign) -> float:
    """Return the largest bending stress of the glass, N/mm^2.

    It is simply supported on the opening's edge under the supply's pressure. The stress is beta p
    b^2 / t^2 with beta = 0.75 / (1 + 1.61 (b/a)^3) (Roark's formulas for stress and strain, flat
    rectangular plates).
    """
    b, a = sorted((design.frame.length, design.frame.width))
    beta = 0.75 / (1 + 1.61 * (b / a) ** 3)
    return (
        1e-6
        * beta
        * abs(design.chamber.supply_gauge)
        * (b / max(design.glass.thickness, 1e-9)) ** 2
    )


def _rounded(value: float, *, up: bool = False) -> str:
    """Format with four digits, rounded so that the displayed value is itself allowed."""
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    unit = 10.0 ** (math.floor(math.log10(abs(value))) + 1 - _DIGITS)
    whole = math.ceil(value / unit - 1e-9) if up else math.floor(value / unit + 1e-9)
    return f"{whole * unit:.{_DIGITS}g}"
