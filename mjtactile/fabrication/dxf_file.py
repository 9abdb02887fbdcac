"""Drawing pages as DXF (R12, AC1009) for laser cutters and CAD.

Only lines, arcs, circles, polylines and texts are written. The unit is mm. The y axis points up, so
that the drawing appears like its SVG. Layers: CUT, BLACK, MARK and FAINT.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from mjtactile.core.types import Array
from mjtactile.fabrication.drawing_pages import DrawingShape, PrintedPage
from mjtactile.fabrication.layered_solid import Contour, Traced

_COLORS = {"cut": 1, "black": 7, "mark": 5, "faint": 8}  # AutoCAD color numbers by style

Pairs = Iterator[tuple[int, str | float | int]]


def write_dxf(page: PrintedPage) -> str:
    """Write the page as DXF: one unit is a millimeter, the origin the page's center.

    Args:
        page: The page.

    Returns:
        The file's text.
    """
    return "".join(f"{code:>3}\n{_value(value)}\n" for code, value in _pairs(page))


def _value(value: str | float | int) -> str:
    return f"{value + 0.0:.6f}" if isinstance(value, float) else str(value)


def _pairs(page: PrintedPage) -> Pairs:
    yield 999, f"{page.title}; unit: mm"
    yield from ((0, "SECTION"), (2, "HEADER"), (9, "$ACADVER"), (1, "AC1009"))
    yield from ((9, "$EXTMIN"), (10, -page.width / 2), (20, -page.height / 2))
    yield from ((9, "$EXTMAX"), (10, page.width / 2), (20, page.height / 2))
    yield from ((0, "ENDSEC"), (0, "SECTION"), (2, "TABLES"))
    yield from ((0, "TABLE"), (2, "LAYER"), (70, len(_COLORS)))
    for style, color in _COLORS.items():
        yield from ((0, "LAYER"), (2, style.upper()), (70, 0), (62, color), (6, "CONTINUOUS"))
    yield from ((0, "ENDTAB"), (0, "ENDSEC"), (0, "SECTION"), (2, "ENTITIES"))
    for shape in page.shapes:
        yield from _shape(shape)
    yield from ((0, "ENDSEC"), (0, "EOF"))


def _shape(shape: DrawingShape) -> Pairs:
    layer = shape.style.upper()
    c = shape.contour
    if shape.text:
        ((x, y),) = shape.points
        yield from _entity("TEXT", layer, x, y)
        yield from ((40, float(shape.size)), (1, shape.text))
    elif c is None:
        yield from _polyline(layer, shape.points, closed=False)
    elif isinstance(c, Traced):
        yield from _polyline(layer, c.points, closed=True)
    elif c.is_circle:
        yield from _entity("CIRCLE", layer, c.x, c.y)
        yield 40, float(c.r)
    else:
        yield from _edges(layer, c)


def _edges(layer: str, contour: Contour) -> Pairs:
    """Return the lines and arcs of a rounded rectangle."""
    for start, end, center in contour.edges():
        if center is None:
            yield from _entity("LINE", layer, *start.tolist())
            yield from ((11, float(end[0])), (21, -float(end[1])))
            continue
        # counter-clockwise with y up: from end to start
        yield from _entity("ARC", layer, *center.tolist())
        yield from ((40, float(contour.r)), (50, _angle(center, end)), (51, _angle(center, start)))


def _entity(name: str, layer: str, x: float, y: float) -> Pairs:
    yield from ((0, name), (8, layer), (10, float(x)), (20, -float(y)))


def _angle(center: Array, point: Array) -> float:
    """Return the direction of a point from a center with y up, degrees."""
    return math.degrees(math.atan2(center[1] - point[1], point[0] - center[0])) % 360.0


def _polyline(layer: str, points: Sequence[tuple[float, float]], *, closed: bool) -> Pairs:
    yield from ((0, "POLYLINE"), (8, layer), (66, 1), (70, int(closed)))
    for x, y in points:
        yield from _entity("VERTEX", layer, x, y)
    yield from ((0, "SEQEND"), (8, layer))
