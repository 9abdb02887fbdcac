"""Sensor parts as solids from a `Layout`: parts to make, and purchased parts for the figures."""

from __future__ import annotations

import math
from itertools import pairwise

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
PEG = 1.25  # mm, radius of the stretching jig's pegs
_JIG = 5.0
_PEG_HEIGHT = 5.0
_BACK = 0.01  # mm, of a chamber's wall with a flat behind the mouth: contours must not touch
_PEG_SPACING = 9.0
JAW_HOLE = 1.7  # mm, radius: M3
CAMERA_HOLE = 1.1  # M2, clear


def make_parts(layout: Layout) -> dict[str, Part]:
    """Return the parts by name, from front to back."""
    makers = (
        _clamp_ring,
        _membrane,
        _frame,
        _gasket,
        _glass,
        _glass_seat,
        _camera_mount,
        _led_ring,
        _camera,
        _bolts,
        _nuts,
        _stretch_jig,
    )
    return {part.name: part for part in (maker(layout) for maker in makers)}


def bolt_holes(layout: Layout) -> list[Contour]:
    return [circle(layout.bolt.hole, x, y) for x, y in layout.bolts]


def flange(layout: Layout) -> Contour:
    """The outline of all that is bolted together."""
    return Contour(layout.outer_x, layout.outer_y, layout.bolt.head + 1)


def mouth(layout: Layout) -> Contour:
    """The membrane's outline, within the rim."""
    return _outline(layout, 0.0)


def opening(layout: Layout) -> Contour:
    """Return the contour of the chamber's wall behind the rim.

    It equals the rim's opening, unless the +x side is not straight. Then that side has a flat for
    the port.
    """
    return _outline(layout, _BACK, layout.flat) if layout.is_traced else mouth(layout)


def rim_outer(layout: Layout, more: float = 0.0) -> Contour:
    """Return the outside of the rim over which the membrane is laid, plus `more` mm.

    Its corners are round so that the membrane does not tear.
    """
    return _outline(layout, layout.rim + more)


def _outline(layout: Layout, by: float, flat: float = 0.0) -> Contour:
    """The contour `by` mm outside of the opening's outline."""
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


def _clamp_ring(layout: Layout) -> Part:
    inner = _outline(layout, layout.ring)
    return Part(
        "clamp_ring",
        (plate(*layout.z_ring, flange(layout), [inner, *bolt_holes(layout)]),),
        _LIGHT,
        what="clamps the rubber on the frame's flange",
    )


def _membrane(layout: Layout) -> Part:
    """The rubber as mounted: over the opening and down the rim."""
    cover = rim_outer(layout, layout.sheet)
    skirt = plate(layout.z_flange + layout.sheet, 0.0, cover, [rim_outer(layout)])
    return Part(
        "membrane",
        (
            plate(
                layout.z_flange,
                layout.z_flange + layout.sheet,
                flange(layout),
                [rim_outer(layout), *bolt_holes(layout)],
            ),
            skirt,
            plate(0.0, layout.sheet, cover),
        ),
        (0.95, 0.94, 0.9),
        make=False,
        what="rubber sheet with markers on its inside",
    )


def _frame(layout: Layout) -> Part:
    """Block and rim, with the groove behind the lip where fiducials ask for one."""
    heights = {layout.z_block, layout.z_flange, 0.0}
    groove = layout.groove
    if groove is not None:
        heights |= {groove[0], groove[1]}
    cuts = sorted(heights)
    bore = Bore(opening(layout), flange(layout), layout.port.radius, 0.0, layout.z_port)
    return Part(
        "frame",
        tuple(_frame_layer(layout, low, high) for low, high in pairwise(cuts)),
        _PRINTED,
        bore,
        what="airtight frame with the air port on its +x side",
    )


def _frame_layer(layout: Layout, low: float, high: float) -> Layer:
    inner = opening(layout)
    groove = layout.groove
    grooved = groove is not None and groove[0] <= low and high <= groove[1]
    if grooved and groove is not None:
        inner = groove_outline(layout, groove[2])
    if high > layout.z_flange:
        return plate(low, high, rim_outer(layout), [inner if grooved else mouth(layout)])
    return plate(low, high, flange(layout), [inner, *bolt_holes(layout)])


def groove_outline(layout: Layout, step: float) -> Contour:
    """Return the walls of a groove set back by `step` mm from the opening, including the
    corners."""
    return _outline(layout, step)


def _gasket(layout: Layout) -> Part:
    return Part(
        "gasket",
        (
            plate(
                layout.z_glass,
                layout.z_block,
                flange(layout),
                [opening(layout), *bolt_holes(layout)],
            ),
        ),
        (0.85, 0.45, 0.35),
        make=False,
        what="silicone sheet 0.5 mm, cut along gasket.svg",
    )


def _glass(layout: Layout) -> Part:
    return Part(
        "glass",
        (plate(layout.z_glass_plane, layout.z_glass, Contour(layout.glass_x, layout.glass_y)),),
        (0.72, 0.88, 0.92),
        make=False,
        what="flat pane",
    )


def _glass_seat(layout: Layout) -> Part:
    pocket = Contour(layout.glass_x + hw.GLASS_PLAY, layout.glass_y + hw.GLASS_PLAY)
    window = Contour(*layout.opening_view)
    holes = bolt_holes(layout)
    return Part(
        "glass_seat",
        (
            plate(layout.z_seat, layout.z_glass_plane, flange(layout), [window, *holes]),
            plate(layout.z_glass_plane, layout.z_glass, flange(layout), [pocket, *holes]),
        ),
        _LIGHT,
        what="presses the glass against gasket and frame",
    )


def _camera_mount(layout: Layout) -> Part:
    """Back plate with the lens's hole, tube, flange."""
    inside = Contour(layout.tube_x, layout.tube_y)
    outside = Contour(layout.tube_x + hw.TUBE_WALL, layout.tube_y + hw.TUBE_WALL, 2.0)
    half = layout.hardware.holes / 2
    jaw_x = layout.plate_x - 4
    jaw_y = layout.plate_y - 5
    holes = [
        circle(layout.hardware.lens / 2 + 0.5),
        circle(1.5, layout.tube_x - 2.5),
        *(circle(CAMERA_HOLE, sx * half, sy * half) for sx in (-1, 1) for sy in (-1, 1)),
        *(circle(JAW_HOLE, sx * jaw_x, sy * jaw_y) for sx in (-1, 1) for sy in (-1, 1)),
    ]
    back = plate(layout.z_back, layout.z_plate, Contour(layout.plate_x, layout.plate_y, 3.0), holes)
    tube = plate(layout.z_plate, layout.z_mount, outside, [inside])
    front = plate(layout.z_mount, layout.z_seat, flange(layout), [inside, *bolt_holes(layout)])
    return Part(
        "camera_mount",
        (back, tube, front),
        _PRINTED,
        what="light-tight tube with seats for LED ring and camera, and four M3 holes for a jaw",
    )


def led_places(layout: Layout) -> list[tuple[float, float]]:
    """Centres of the LEDs, at the angles that the simulator has."""
    radius = 1e3 * layout.design.leds.ring_radius
    count = layout.design.leds.count
    turns = [2 * math.pi * (k + 0.5) / count for k in range(count)]
    return [(radius * math.cos(turn), radius * math.sin(turn)) for turn in turns]


def _led_ring(layout: Layout) -> Part:
    """The circuit board, and the LEDs as discs on it."""
    board = plate(
        layout.z_plate, layout.z_leds, circle(layout.led_outer), [circle(layout.led_inner)]
    )
    leds = Layer(
        layout.z_leds,
        layout.z_camera,
        tuple(Region(circle(hw.LED_BODY[1] / 2, x, y)) for x, y in led_places(layout)),
    )
    return Part(
        "led_ring",
        (board, leds),
        (0.2, 0.55, 0.3),
        make=False,
        what="LEDs in the plane of the lens pupil: led_ring.svg",
    )


def _camera(layout: Layout) -> Part:
    """Board and lens barrel."""
    front = layout.z_back - hw.SPACER
    half = layout.hardware.holes / 2 + 2
    board = plate(front - 1.6, front, Contour(half, half, 1.5))
    lens = plate(
        front, layout.z_camera + layout.hardware.lens_front, circle(layout.hardware.lens / 2)
    )
    return Part(
        "camera",
        (board, lens),
        (0.15, 0.3, 0.5),
        make=False,
        what="camera module on four M2 screws with 2 mm spacers",
    )


def _bolts(layout: Layout) -> Part:
    ring_top = layout.z_ring[1]
    bolt = layout.bolt
    shanks = tuple(Region(circle(bolt.radius, x, y)) for x, y in layout.bolts)
    heads = tuple(Region(circle(bolt.head, x, y)) for x, y in layout.bolts)
    return Part(
        "bolts",
        (
            Layer(ring_top - layout.bolt_length, ring_top, shanks),
            Layer(ring_top, ring_top + bolt.head_height, heads),
        ),
        (0.78, 0.78, 0.8),
        make=False,
        what=bolt.name,
    )


def _nuts(layout: Layout) -> Part:
    rings = tuple(
        Region(circle(layout.bolt.nut, x, y), (circle(layout.bolt.radius, x, y),))
        for x, y in layout.bolts
    )
    return Part(
        "nuts",
        (Layer(layout.z_mount - layout.bolt.nut_height, layout.z_mount, rings),),
        (0.7, 0.7, 0.72),
        make=False,
        what="nuts",
    )


def _stretch_jig(layout: Layout) -> Part:
    """Return a plate around the flange, level with the frame's rim. Its pegs hold the stretched
    membrane."""
    grip = Contour(
        layout.outer_x + hw.CLEARANCE,
        layout.outer_y + hw.CLEARANCE,
        layout.bolt.head + 1 + hw.CLEARANCE,
    )
    outside = Contour(layout.outer_x + 11, layout.outer_y + 11, 5.0)
    return Part(
        "stretch_jig",
        (
            plate(-_JIG, 0.0, outside, [grip]),
            Layer(0.0, _PEG_HEIGHT, tuple(Region(circle(PEG, x, y)) for x, y in pegs(layout))),
        ),
        (0.75, 0.62, 0.35),
        what="tool that holds the rubber at its pre-stretch while it is glued to the rim",
    )
