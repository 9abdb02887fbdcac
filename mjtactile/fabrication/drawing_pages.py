"""Drawings on paper at 1:1, written as SVG (units mm) or as pages of a PDF.

Shapes are in mm from the page's center, x right, y down: the camera's view of the membrane.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

from mjtactile.fabrication.layered_solid import Contour, Traced

_PAPERS = ((210.0, 297.0), (297.0, 210.0), (297.0, 420.0), (420.0, 297.0))
_BORDER = 12.0  # mm that printers leave white, and the text needs
BAR = 100.0  # maximum length of the scale bar, mm
HEAD = 24.0  # mm of the page for the title
FOOT = 26.0  # mm of the page for the scale bar
_STYLES = {
    "black": ("#000000", None, 0.0),
    "cut": (None, "#d00000", 0.1),
    "mark": (None, "#000000", 0.2),
    "faint": (None, "#888888", 0.15),
}
"""Style to fill, line and its width in mm."""


@dataclass(frozen=True)
class DrawingShape:
    """A `contour`, a polyline through `points`, or a `text` at the first of them."""

    style: str
    group: str
    contour: Contour | None = None
    points: tuple[tuple[float, float], ...] = ()
    text: str = ""
    size: float = 3.5


@dataclass(frozen=True)
class PrintedPage:
    """A page of `width` x `height` mm."""

    title: str
    width: float
    height: float
    shapes: tuple[DrawingShape, ...]


def line(group: str, *points: tuple[float, float], style: str = "mark") -> DrawingShape:
    return DrawingShape(style, group, points=points)


def label(group: str, at: tuple[float, float], text: str, size: float) -> DrawingShape:
    return DrawingShape("black", group, points=(at,), text=text, size=size)


def cross(group: str, x: float, y: float, half: float = 2.0) -> list[DrawingShape]:
    """Return a register mark."""
    return [line(group, (x - half, y), (x + half, y)), line(group, (x, y - half), (x, y + half))]


def page(
    title: str,
    shapes: Sequence[DrawingShape],
    half_x: float,
    half_y: float,
    notes: Sequence[str] = (),
) -> PrintedPage:
    """Return the smallest paper that holds `shapes` (within the half sizes), with a title."""
    need = 2 * (half_x + _BORDER), 2 * (half_y + max(HEAD, FOOT))
    large = (paper for paper in _PAPERS if paper[0] >= need[0] and paper[1] >= need[1])
    width, height = (max(side, 90.0) for side in next(large, need))
    left = _BORDER - width / 2
    top = 8 - height / 2
    head = [
        label("text", (left, top + 5.0 * k), text, 3.2 if k else 4.5)
        for k, text in enumerate((title, *notes))
    ]
    return PrintedPage(title, width, height, (*shapes, *head, *_scale_bars(width, height)))


def _scale_bars(width: float, height: float) -> list[DrawingShape]:
    """Return scale bars along both sides, with a tick each 10 mm.

    The scale of a printer may differ between the two directions.
    """
    found = []
    for axis, room in ((0, width - 2 * _BORDER), (1, height - HEAD - FOOT)):
        length = BAR if room >= BAR else 10 * (room // 10)
        at = height / 2 - 10 if axis == 0 else width / 2 - 9

        def place(
            along: float, across: float, axis: int = axis, at: float = at
        ) -> tuple[float, float]:
            return (along, at + across) if axis == 0 else (at + across, along)

        found.append(line("scale", place(-length / 2, 0), place(length / 2, 0)))
        for k in range(round(length / 10) + 1):
            along = 10 * k - length / 2
            long = 2.5 if k in (0, round(length / 10)) else 1.2
            found.append(line("scale", place(along, -long), place(along, 0)))
        if axis == 0:
            note = ': print at 100 %, never "fit to page", and measure it'
            found.append(label("scale", place(-length / 2, 5.0), f"{length:g} mm{note}", 3.2))
        else:
            corner = (width / 2 - 24, length / 2 + 5)
            found.append(label("scale", corner, f"{length:g} mm", 3.2))
    return found


def write_svg(printed: PrintedPage) -> str:
    """Write the page as SVG: one user unit is a millimeter, the origin the page's center."""
    groups: dict[str, list[str]] = {}
    for shape in printed.shapes:
        groups.setdefault(shape.group, []).append(_svg(shape))
    body = "\n".join(
        f'<g id="{name}">\n' + "\n".join(lines) + "\n</g>" for name, lines in groups.items()
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{_n(printed.width)}mm" '
        f'height="{_n(printed.height)}mm" '
        f'viewBox="{_n(-printed.width / 2)} {_n(-printed.height / 2)} '
        f'{_n(printed.width)} {_n(printed.height)}">\n'
        f"<title>{escape(printed.title)}</title>\n{body}\n</svg>\n"
    )


def _svg(shape: DrawingShape) -> str:
    fill, stroke, width = _STYLES[shape.style]
    line = f' stroke="{stroke}" stroke-width="{width}"' if stroke else ""
    paint = f'fill="{fill or "none"}"{line}'
    if shape.text:
        ((x, y),) = shape.points
        return (
            f'<text x="{_n(x)}" y="{_n(y)}" font-family="sans-serif" font-size="{shape.size}" '
            f"{paint}>{escape(shape.text)}</text>"
        )
    c = shape.contour
    if c is None or isinstance(c, Traced):
        name, points = ("polyline", shape.points) if c is None else ("polygon", c.points)
        corners = " ".join(f"{_n(x)},{_n(y)}" for x, y in points)
        return f'<{name} points="{corners}" {paint}/>'
    if c.is_circle:
        return f'<circle cx="{_n(c.x)}" cy="{_n(c.y)}" r="{_n(c.r)}" {paint}/>'
    return (
        f'<rect x="{_n(c.x - c.hx)}" y="{_n(c.y - c.hy)}" width="{_n(2 * c.hx)}" '
        f'height="{_n(2 * c.hy)}" rx="{_n(c.r)}" {paint}/>'
    )


def _n(value: float) -> str:
    return f"{round(value, 5) + 0.0:.5f}".rstrip("0").rstrip(".")


def write_pdf(printed_pages: Sequence[PrintedPage]) -> bytes:
    """Write the pages as a PDF, vectors at 1:1."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_pdf import PdfPages

    out = io.BytesIO()
    with (
        rc_context({"pdf.fonttype": 42, "pdf.compression": 0}),
        PdfPages(out, metadata={"CreationDate": None, "Creator": "mjtactile"}) as pages,
    ):
        for printed in printed_pages:
            pages.savefig(_figure(printed))
    return out.getvalue()


_DOTS_PER_MM = 10.0


def write_png(printed: PrintedPage, half_x: float, half_y: float) -> bytes:
    """Write the area within the half sizes, mm, around the page center as an image."""
    out = io.BytesIO()
    figure = _figure(PrintedPage(printed.title, 2 * half_x, 2 * half_y, printed.shapes))
    figure.savefig(out, format="png", dpi=25.4 * _DOTS_PER_MM, metadata={"Software": None})
    return out.getvalue()


def _figure(printed: PrintedPage) -> Any:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(printed.width / 25.4, printed.height / 25.4))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(
        xlim=(-printed.width / 2, printed.width / 2), ylim=(printed.height / 2, -printed.height / 2)
    )
    axes.set_axis_off()
    for shape in printed.shapes:
        _plot_shape(axes, shape)
    return figure


def _plot_shape(axes: Any, shape: DrawingShape) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Circle, FancyBboxPatch, Polygon, Rectangle

    fill, stroke, width = _STYLES[shape.style]
    points = 72 / 25.4  # points per mm
    paint = {"fc": fill or "none", "ec": stroke or "none", "lw": width * points}
    c = shape.contour
    if shape.text:
        ((x, y),) = shape.points
        axes.text(x, y, shape.text, fontsize=shape.size * points, parse_math=False, clip_on=True)
    elif c is None:
        x, y = zip(*shape.points, strict=True)
        axes.add_artist(Line2D(x, y, color=stroke, linewidth=width * points))
    elif isinstance(c, Traced):
        axes.add_artist(Polygon(c.points, **paint))
    elif c.is_circle:
        axes.add_artist(Circle((c.x, c.y), c.r, **paint))
    elif c.r:
        style = f"round,pad=0,rounding_size={c.r}"
        axes.add_artist(FancyBboxPatch(c.corner, 2 * c.hx, 2 * c.hy, boxstyle=style, **paint))
    else:
        axes.add_artist(Rectangle(c.corner, 2 * c.hx, 2 * c.hy, **paint))
