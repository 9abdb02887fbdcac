"""Templates printed or cut at 1:1: markers, stencil, mounted membrane, gasket, LED ring, ChArUco
board.

The membrane is stretched equally in all directions. A point printed at X lies at s X after
mounting, s being the pre-stretch. The center stays, and with it the centroid of the pattern.
Circles stay circles. Their radius is s times the printed one if the ink is stretched with the
rubber. It is the printed one for a marker disc that is stiffer than the rubber.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from mjtactile.calibrate.camera import Board
from mjtactile.core.design import SensorDesign
from mjtactile.fabrication.drawing_pages import DrawingShape, PrintedPage, cross, label, line, page
from mjtactile.fabrication.housing_layout import Layout
from mjtactile.fabrication.layered_solid import Contour, circle
from mjtactile.fabrication.manufacturability import MM, marker_shrink, mount_tolerance
from mjtactile.fabrication.parts import (
    PEG,
    bolt_holes,
    flange,
    led_positions,
    mouth,
    opening,
    outline_offset,
    pegs,
)

_RUBBER_EDGE = 6.0  # mm of rubber beyond the pegs, mounted
_FILM_PLAY = 0.1  # clearance between the fiducials' printed film and the groove's walls, mm
_BOARD_CELLS = 8  # across a square: Board's marker is 3/4 of it, six cells
_COLUMNS = 9
_ROWS = 7


def markers(layout: Layout, *, mounted: bool = False) -> list[Contour]:
    """Return the markers as printed on the unstretched membrane, or on the mounted one."""
    design = layout.design
    scale = 1.0 if mounted else 1 / design.membrane.pre_stretch
    shrink = 1.0 if mounted else marker_shrink(design, layout.hardware)
    return [
        circle(MM * design.markers.radius * shrink, MM * x * scale, MM * y * scale)
        for x, y, _ in design.markers.p_SM
    ]


def page_size(layout: Layout) -> tuple[float, float]:
    """Return the half sizes, mm, of the rubber to cut, unstretched."""
    stretch = layout.design.membrane.pre_stretch
    edge = 6 + _RUBBER_EDGE
    return (layout.outer_x + edge) / stretch, (layout.outer_y + edge) / stretch


def marker_pages(layout: Layout) -> list[PrintedPage]:
    """Return transfer print and stencil for the unstretched membrane, and the mounted pattern."""
    design = layout.design
    stretch = design.membrane.pre_stretch
    half = page_size(layout)
    radius = MM * design.markers.radius
    scaled = "no pre-stretch"
    if stretch != 1:
        scaled = f"scale 1/{stretch:g} of the mounted size: print on unstretched rubber"
    tags = (
        f"{design.markers.count} markers, {scaled}",
        f"radius {radius * marker_shrink(design, layout.hardware):.4g} mm here, {radius:g} mm "
        "mounted; view from inside, as from the camera",
    )
    around = [
        *_register(layout, 1 / stretch),
        DrawingShape("mark", "sheet", Contour(*half)),
        *(mark for x, y in pegs(layout) for mark in cross("pegs", x / stretch, y / stretch, PEG)),
    ]
    check = [
        *_outlines("mark", "markers", markers(layout, mounted=True)),
        *_register(layout, 1.0),
        DrawingShape("mark", "frame", mouth(layout)),
        DrawingShape("faint", "flange", flange(layout)),
    ]
    printing = (
        "the pattern is mirror-symmetric: print it unmirrored; crosses on the edge: peg holes"
    )
    cutting = "cut along red lines; punch the peg holes"
    checking = (
        "print on transparent film, lay on the mounted membrane:",
        f"markers must coincide within {mount_tolerance(design)[0]:.2f} mm, the opening within "
        "0.3 mm",
    )
    black = [*_outlines("black", "markers", markers(layout)), *around]
    cut = [*_outlines("cut", "markers", markers(layout)), *around]
    outer = layout.outer_x + 6, layout.outer_y + 6
    return [
        page(f"{design.name}: transfer print", black, *half, (*tags, printing)),
        page(f"{design.name}: stencil", cut, *half, (*tags, cutting)),
        page(f"{design.name}: as mounted", check, *outer, checking),
    ]


def _outlines(style: str, group: str, contours: Iterable[Contour]) -> list[DrawingShape]:
    return [DrawingShape(style, group, contour) for contour in contours]


def _register(layout: Layout, scale: float) -> list[DrawingShape]:
    """Return registration marks on the flange, and an arrow to +x, the side of the air inlet."""
    x = layout.outer_x * scale
    y = layout.outer_y * scale
    marks = [
        mark
        for px, py in ((x, 0), (-x, 0), (0, y), (0, -y), (x, y), (-x, y), (x, -y), (-x, -y))
        for mark in cross("registration", px, py, 2.5 * scale)
    ]
    tip = x - 3 * scale
    return [
        *marks,
        line("registration", (tip - 3, 1.0), (tip, 0), (tip - 3, -1.0)),
        label("text", (tip - 3, 4.0), "+x", 2.5),
    ]


def fiducial_page(layout: Layout) -> PrintedPage | None:
    """Return the page of the fiducial circles, as in the camera image; None without fiducials.

    They are cut out and glued to the lip's inner face, or transfer-printed on the glass.
    """
    fiducials = layout.design.fiducials
    if fiducials is None:
        return None
    radius = MM * fiducials.radius
    centres = [(MM * x, MM * y) for x, y in fiducials.places]
    groove = layout.groove
    if groove is None:
        note = "white under the black; align the marks with the glass edges"
        ground = MM * (fiducials.radius + fiducials.ground)
        shapes = _outlines("faint", "ground", (circle(ground, *centre) for centre in centres))
        shapes.append(DrawingShape("mark", "glass", Contour(layout.glass_x, layout.glass_y)))
    else:
        note = (
            "white matte film: cut along red lines into strips, glue to the inner face of the rim"
        )
        walls = outline_offset(layout, groove[2] - _FILM_PLAY)
        shapes = _outlines("cut", "lip", (walls, mouth(layout)))
    shapes += _outlines("black", "fiducials", (circle(radius, *centre) for centre in centres))
    title = f"{layout.design.name}: fiducials"
    content = f"{fiducials.count} circles of radius {radius:g} mm, view from the camera"
    return page(title, shapes, layout.outer_x, layout.outer_y, (content, note))


def cut_page(layout: Layout) -> PrintedPage:
    """Return the page of the gasket."""
    contours = (flange(layout), opening(layout), *bolt_holes(layout))
    shapes = _outlines("cut", "gasket", contours)
    title = f"{layout.design.name}: gasket"
    notes = ("silicone sheet 0.5 mm, one piece",)
    return page(title, shapes, layout.outer_x, layout.outer_y, notes)


def led_page(layout: Layout) -> PrintedPage:
    """Return the page of the LED ring: outline, numbered LEDs, and position of the wires."""
    shapes = _outlines("cut", "board", map(circle, (layout.led_outer, layout.led_inner)))
    notes = [
        "circuit board 1.6 mm; LEDs (2835) on the membrane side,",
        "emission in the plane of the lens pupil; view from the camera, through the board",
    ]
    for number, (x, y) in enumerate(led_positions(layout), 1):
        out = (layout.led_outer + 4) / math.hypot(x, y)
        at = out * x - (15 if x < 0 else 0), out * y + 1
        shapes += [
            DrawingShape("mark", "leds", circle(1.4, x, y)),
            *cross("leds", x, y, 2.2),
            label("text", at, f"{number}: {x:.2f}, {y:.2f}", 2.2),
        ]
    wires = layout.led_outer - 1.5
    shapes += [
        line("leds", (wires, -1), (wires, 1)),
        label("text", (wires + 3, 1), "wires, +x", 2.5),
    ]
    title = f"{layout.design.name}: LED ring"
    return page(title, shapes, layout.led_outer + 24, layout.led_outer + 8, notes)


def board_of(design: SensorDesign) -> Board:
    """Return a board that nearly fills the camera's view of the membrane.

    Its squares have steps of 0.5 mm.
    """
    width, height = 2 * design.camera.distance * design.camera.half_view
    square = max(0.5e-3 * math.floor(1.05 * min(width / _COLUMNS, height / _ROWS) / 0.5e-3), 1e-3)
    return Board(_COLUMNS, _ROWS, square, 0.75 * square)


def board_page(design: SensorDesign) -> PrintedPage:
    """Return the page of the board as vectors: a rectangle for each run of black pixels in a
    row."""
    board = board_of(design)
    cell = MM * board.square / _BOARD_CELLS
    pixels = board.render(_BOARD_CELLS)
    rows, columns = pixels.shape
    shapes = []
    for v in range(rows):
        dark = [False, *(pixels[v] < 128), False]
        edges = [u for u in range(columns + 1) if dark[u] != dark[u + 1]]
        for start, end in zip(edges[::2], edges[1::2], strict=True):
            x = (start + end - columns) / 2 * cell
            y = (v + 0.5 - rows / 2) * cell
            run = Contour((end - start) * cell / 2, cell / 2, 0.0, x, y)
            shapes.append(DrawingShape("black", "board", run))
    square = MM * board.square
    notes = (
        f"ChArUco {board.columns} x {board.rows}, squares {square:g} mm, markers "
        f"{MM * board.marker:g} mm, {board.dictionary}",
        f"glue it to a flat plate, measure a square: --square-mm {square:g}",
    )
    title = f"{design.name}: board for `mjtactile calibrate camera`"
    return page(title, shapes, columns * cell / 2, rows * cell / 2, notes)
