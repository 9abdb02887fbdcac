"""Sensor parts as solids from a `Layout`: parts to make, and purchased parts for the figures."""

from __future__ import annotations

import math
from itertools import pairwise, product

from mjtactile.core.sensor_parts import FrameShape
from mjtactile.fabrication import purchased_parts as hw
from mjtactile.fabrication.housing_layout import Layout
from mjtactile.fabrication.layered_solid import (
    Bore,
    Contour,
    Layer,
    Part,
    Region,
    Traced,
    circle,
    plate,
)
from mjtactile.fabrication.manufacturability import MM

_PRINTED = (0.36, 0.40, 0.46)
_LIGHT = (0.55, 0.60, 0.66)
RUBBER = (0.95, 0.94, 0.9)
PEG = 1.25  # mm, radius of the stretching jig's pegs
_JIG = 5.0
_PEG_HEIGHT = 5.0
_BACK = 0.01  # mm, of a chamber's wall with a flat behind the mouth: contours must not touch
_PEG_SPACING = 9.0
JAW_HOLE = 1.7  # mm, radius: M3
CAMERA_HOLE = 1.1  # M2, clear


def bolt_holes(layout: Layout) -> list[Contour]:
    return [circle(layout.bolt.hole, x, y) for x, y in layout.bolts]


def flange(layout: Layout) -> Contour:
    """Return the outline of all that is bolted together."""
    return Contour(layout.outer_x, layout.outer_y, layout.bolt.head + 1)


def mouth(layout: Layout) -> Contour:
    """Return the membrane's outline, within the rim."""
    return outline_offset(layout, 0.0)


def opening(layout: Layout) -> Contour:
    """Return the chamber's wall behind the rim; a +x side that is not straight gets a flat."""
    return outline_offset(layout, _BACK, layout.flat) if layout.is_traced else mouth(layout)


def rim_outer(layout: Layout, more: float = 0.0) -> Contour:
    """Return the rim's outside plus `more` mm; the membrane would tear on sharp corners."""
    return outline_offset(layout, layout.rim + more)


def outline_offset(layout: Layout, by: float, flat: float = 0.0) -> Contour:
    """Return the contour `by` mm outside of the opening's outline."""
    frame = layout.design.frame
    if layout.is_traced and frame.outline is not None:
        return Traced.around(frame.outline, by, flat)
    radius = MM * frame.corner_radius if frame.shape == FrameShape.ROUNDED else 0.0
    return Contour(layout.open_x + by, layout.open_y + by, radius + by)


def pegs(layout: Layout) -> list[tuple[float, float]]:
    """Return the peg positions of the stretching jig, evenly spaced around the flange."""
    hx = layout.outer_x + 6
    hy = layout.outer_y + 6
    across, along = (max(2, round(2 * half / _PEG_SPACING)) for half in (hx, hy))
    xs, ys = (
        [half * (2 * k / count - 1) for k in range(count + 1)]
        for half, count in ((hx, across), (hy, along))
    )
    return [(x, s * hy) for s in (-1, 1) for x in xs] + [
        (s * hx, y) for s in (-1, 1) for y in ys[1:-1]
    ]


def _flange_plate(layout: Layout, low: float, high: float, *holes: Contour) -> Layer:
    """Return a plate with the flange's outline, `holes`, and those of the bolts."""
    return plate(low, high, flange(layout), [*holes, *bolt_holes(layout)])


def _clamp_ring(layout: Layout) -> Part:
    ring = _flange_plate(layout, *layout.z_ring, outline_offset(layout, layout.ring))
    return Part(
        "clamp_ring", (ring,), _LIGHT, description="clamps the rubber on the frame's flange"
    )


def _membrane(layout: Layout) -> Part:
    """Return the mounted rubber: over the opening and down the rim."""
    top = layout.z_flange + layout.rubber_thickness
    cover = rim_outer(layout, layout.rubber_thickness)
    layers = (
        _flange_plate(layout, layout.z_flange, top, rim_outer(layout)),
        plate(top, 0.0, cover, [rim_outer(layout)]),
        plate(0.0, layout.rubber_thickness, cover),
    )
    description = "rubber sheet with markers on its inside"
    return Part("membrane", layers, RUBBER, make=False, description=description)


def _frame(layout: Layout) -> Part:
    """Return block and rim; fiducials require a groove behind the lip."""
    heights = {layout.z_block, layout.z_flange, 0.0, *(layout.groove or ())[:2]}
    layers = tuple(_frame_layer(layout, low, high) for low, high in pairwise(sorted(heights)))
    bore = Bore(opening(layout), flange(layout), layout.port.radius, 0.0, layout.z_port)
    description = "airtight frame with the air port on its +x side"
    return Part("frame", layers, _PRINTED, bore, description=description)


def _frame_layer(layout: Layout, low: float, high: float) -> Layer:
    groove = layout.groove
    is_block = high <= layout.z_flange
    if groove is not None and groove[0] <= low and high <= groove[1]:
        inner = outline_offset(layout, groove[2])
    else:
        inner = opening(layout) if is_block else mouth(layout)
    if is_block:
        return _flange_plate(layout, low, high, inner)
    return plate(low, high, rim_outer(layout), [inner])


def _gasket(layout: Layout) -> Part:
    layer = _flange_plate(layout, layout.z_glass, layout.z_block, opening(layout))
    description = "silicone sheet 0.5 mm, cut along gasket.svg"
    return Part("gasket", (layer,), (0.85, 0.45, 0.35), make=False, description=description)


def _glass(layout: Layout) -> Part:
    layer = plate(layout.z_glass_plane, layout.z_glass, Contour(layout.glass_x, layout.glass_y))
    return Part("glass", (layer,), (0.72, 0.88, 0.92), make=False, description="flat glass")


def _glass_seat(layout: Layout) -> Part:
    pocket = Contour(layout.glass_x + hw.GLASS_PLAY, layout.glass_y + hw.GLASS_PLAY)
    layers = (
        _flange_plate(layout, layout.z_seat, layout.z_glass_plane, Contour(*layout.opening_view)),
        _flange_plate(layout, layout.z_glass_plane, layout.z_glass, pocket),
    )
    return Part(
        "glass_seat", layers, _LIGHT, description="presses the glass against gasket and frame"
    )


def _camera_mount(layout: Layout) -> Part:
    """Return back plate with the lens's hole, tube and flange."""
    inside = Contour(layout.tube_x, layout.tube_y)
    outside = Contour(layout.tube_x + hw.TUBE_WALL, layout.tube_y + hw.TUBE_WALL, 2.0)
    half = layout.hardware.holes / 2
    jaw_x = layout.plate_x - 4
    jaw_y = layout.plate_y - 5
    signs = tuple(product((-1, 1), repeat=2))
    holes = [
        circle(layout.hardware.lens / 2 + 0.5),
        circle(1.5, layout.tube_x - 2.5),
        *(circle(CAMERA_HOLE, sx * half, sy * half) for sx, sy in signs),
        *(circle(JAW_HOLE, sx * jaw_x, sy * jaw_y) for sx, sy in signs),
    ]
    layers = (
        plate(layout.z_back, layout.z_plate, Contour(layout.plate_x, layout.plate_y, 3.0), holes),
        plate(layout.z_plate, layout.z_mount, outside, [inside]),
        _flange_plate(layout, layout.z_mount, layout.z_seat, inside),
    )
    description = "light-tight tube with seats for LED ring and camera, and four M3 holes for a jaw"
    return Part("camera_mount", layers, _PRINTED, description=description)


def led_positions(layout: Layout) -> list[tuple[float, float]]:
    """Return the centers of the LEDs, mm, at the angles of the simulator."""
    radius = 1e3 * layout.design.leds.ring_radius
    count = layout.design.leds.count
    turns = [2 * math.pi * (k + 0.5) / count for k in range(count)]
    return [(radius * math.cos(angle), radius * math.sin(angle)) for angle in turns]


def _discs(low: float, high: float, radius: float, centres: list[tuple[float, float]]) -> Layer:
    return Layer(low, high, tuple(Region(circle(radius, x, y)) for x, y in centres))


def _led_ring(layout: Layout) -> Part:
    """Return the circuit board, and the LEDs as discs on it."""
    outer = circle(layout.led_outer)
    board = plate(layout.z_plate, layout.z_leds, outer, [circle(layout.led_inner)])
    leds = _discs(layout.z_leds, layout.z_camera, hw.LED_BODY[1] / 2, led_positions(layout))
    description = "LEDs in the plane of the lens pupil: led_ring.svg"
    return Part("led_ring", (board, leds), (0.2, 0.55, 0.3), make=False, description=description)


def _camera(layout: Layout) -> Part:
    """Return board and lens barrel."""
    front = layout.z_back - hw.SPACER
    half = layout.hardware.holes / 2 + 2
    board = plate(front - 1.6, front, Contour(half, half, 1.5))
    barrel = circle(layout.hardware.lens / 2)
    lens = plate(front, layout.z_camera + layout.hardware.lens_front, barrel)
    description = "camera module on four M2 screws with 2 mm spacers"
    return Part("camera", (board, lens), (0.15, 0.3, 0.5), make=False, description=description)


def _bolts(layout: Layout) -> Part:
    ring_top = layout.z_ring[1]
    bolt = layout.bolt
    layers = (
        _discs(ring_top - layout.bolt_length, ring_top, bolt.radius, layout.bolts),
        _discs(ring_top, ring_top + bolt.head_height, bolt.head, layout.bolts),
    )
    return Part("bolts", layers, (0.78, 0.78, 0.8), make=False, description=bolt.name)


def _nuts(layout: Layout) -> Part:
    bolt = layout.bolt
    rings = tuple(
        Region(circle(bolt.nut, x, y), (circle(bolt.radius, x, y),)) for x, y in layout.bolts
    )
    layer = Layer(layout.z_mount - bolt.nut_height, layout.z_mount, rings)
    return Part("nuts", (layer,), (0.7, 0.7, 0.72), make=False, description="nuts")


def _stretch_jig(layout: Layout) -> Part:
    """Return a plate around the flange, level with the rim; its pegs hold the stretched
    membrane."""
    x = layout.outer_x
    y = layout.outer_y
    play = hw.CLEARANCE
    grip = Contour(x + play, y + play, layout.bolt.head + 1 + play)
    layers = (
        plate(-_JIG, 0.0, Contour(x + 11, y + 11, 5.0), [grip]),
        _discs(0.0, _PEG_HEIGHT, PEG, pegs(layout)),
    )
    description = "tool that holds the rubber at its pre-stretch while it is glued to the rim"
    return Part("stretch_jig", layers, (0.75, 0.62, 0.35), description=description)


_MAKERS = (
    *(_clamp_ring, _membrane, _frame, _gasket, _glass, _glass_seat),
    *(_camera_mount, _led_ring, _camera, _bolts, _nuts, _stretch_jig),
)


def make_parts(layout: Layout) -> dict[str, Part]:
    """Return the parts by name, from front to back."""
    return {part.name: part for part in (maker(layout) for maker in _MAKERS)}
