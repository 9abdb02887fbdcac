"""Small plots for a page, as SVG text: fractions with intervals, histograms."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence

import numpy as np

COLOURS = ("#1f5fa8", "#d1571b", "#2e8b57", "#8e44ad", "#7f6000")
_WIDTH = 300
_HEIGHT = 130
_LEFT = 34
_BOTTOM = 30
_TOP = 8
_FAR = 1.6  # limit of the linear scale, as a multiple of the range of 97 % of the values


def colour(series: int) -> str:
    """Return the color of a series."""
    return COLOURS[series % len(COLOURS)]


def interval_bar(low: float, fraction: float, high: float, color: str) -> str:
    """Plot a fraction between 0 and 1 and its interval on a line."""
    width = 220
    x0, x, x1 = (round(width * value, 1) for value in (low, fraction, high))
    return (
        f'<svg width="{width}" height="14" viewBox="0 0 {width} 14"><rect y="5" width="{width}" '
        f'height="4" fill="#e6e6e6"/><rect x="{x0}" y="3" width="{max(x1 - x0, 1)}" height="8" '
        f'fill="{color}" opacity="0.35"/><rect x="{max(x - 1.5, 0)}" y="0" width="3" height="14" '
        f'fill="{color}"/></svg>'
    )


def fractions(
    labels: Sequence[str], series: Mapping[str, Sequence[tuple[float, float, float] | None]]
) -> str:
    """Plot the fractions (low, value, high) of each of `series` over the bins called `labels`."""
    step = (_WIDTH - _LEFT - 6) / len(labels)
    parts = [_axes([(0.0, "0"), (0.5, "50"), (1.0, "100 %")])]
    for k, label in enumerate(labels):
        parts.append(_text(_LEFT + (k + 0.5) * step, _HEIGHT - 14, html.escape(label)))
    for s, points in enumerate(series.values()):
        for k, point in enumerate(points):
            if point is None:
                continue
            x = _LEFT + (k + 0.5 + 0.16 * (s - (len(series) - 1) / 2)) * step
            low, fraction, high = (_y(value) for value in point)
            parts.append(
                f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{low:.1f}" y2="{high:.1f}" '
                f'stroke="{colour(s)}" stroke-width="2" opacity="0.5"/>'
                f'<circle cx="{x:.1f}" cy="{fraction:.1f}" r="3.2" fill="{colour(s)}"/>'
            )
    return _svg(parts)


def histogram(
    series: Mapping[str, Sequence[float]], unit: str, marks: Sequence[tuple[float, str]] = ()
) -> str:
    """Render a histogram with 24 bins, one color for each of `series`; `marks`: labeled lines.

    A few values far above the others fall into the last bin, labeled with their maximum.
    """
    everything = np.array([value for values in series.values() for value in values], float)
    if not len(everything):
        return "<p>no measured values</p>"
    low = float(everything.min())
    high = float(everything.max())
    low, high = (low, high) if high > low else (low - 0.5, high + 0.5)
    usual = low + _FAR * (float(np.quantile(everything, 0.97)) - low)
    end = f"{high:.3g}"
    if low < usual < high:
        high = usual
        end = f"{usual:.3g} to {end}"
    edges = np.linspace(low, high, 25)
    counts = {
        name: np.histogram(np.minimum(values, high), edges)[0] for name, values in series.items()
    }
    maximum = max(int(count.max()) for count in counts.values()) or 1
    parts = [_axes([(0.0, "0"), (1.0, str(maximum))])]
    wide = _WIDTH - _LEFT - 6
    for s, count in enumerate(counts.values()):
        bars = "".join(
            f'<rect x="{_LEFT + k * wide / 24:.1f}" y="{_y(n / maximum):.1f}" '
            f'width="{wide / 24 - 0.6:.1f}" height="{_y(0) - _y(n / maximum):.1f}"/>'
            for k, n in enumerate(count)
            if n
        )
        parts.append(f'<g fill="{colour(s)}" opacity="0.6">{bars}</g>')
    ticks = ((0, low, "start"), (0.5, (low + high) / 2, "middle"), (1, None, "end"))
    for position, value, anchor in ticks:
        tick = end if value is None else f"{value:.3g}"
        parts.append(_text(_LEFT + wide * position, _HEIGHT - 16, tick, anchor))
    parts.append(_text(_LEFT + wide / 2, _HEIGHT - 4, html.escape(unit)))
    for value, label in marks:
        if low <= value <= high:
            x = _LEFT + wide * (value - low) / (high - low)
            parts.append(
                f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{_TOP}" y2="{_y(0)}" stroke="#b00020"/>'
                f'<text x="{x - 3:.1f}" y="{_TOP + 8}" text-anchor="end" '
                f'fill="#b00020">{html.escape(label)}</text>'
            )
    return _svg(parts)


def _y(fraction: float) -> float:
    return _TOP + (1 - fraction) * (_HEIGHT - _BOTTOM - _TOP)


def _text(x: float, y: int, text: str, anchor: str = "middle") -> str:
    return f'<text x="{x:.1f}" y="{y}" text-anchor="{anchor}">{text}</text>'


def _axes(ticks: Sequence[tuple[float, str]]) -> str:
    return "".join(
        f'<line x1="{_LEFT}" x2="{_WIDTH - 6}" y1="{_y(at):.1f}" y2="{_y(at):.1f}" stroke="#ddd"/>'
        f'<text x="{_LEFT - 4}" y="{_y(at) + 3:.1f}" text-anchor="end">{label}</text>'
        for at, label in ticks
    )


def _svg(parts: Sequence[str]) -> str:
    return (
        f'<svg width="{_WIDTH}" height="{_HEIGHT}" viewBox="0 0 {_WIDTH} {_HEIGHT}" '
        f'font-size="9" font-family="sans-serif">{"".join(parts)}</svg>'
    )
