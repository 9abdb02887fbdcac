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


def interval_bar(
    low: float, share: float, high: float, colour: str = COLOURS[0], width: int = 220
) -> str:
    """Plot a fraction between 0 and 1 and its interval on a line."""
    x0, x, x1 = (round(width * value, 1) for value in (low, share, high))
    return (
        f'<svg width="{width}" height="14" viewBox="0 0 {width} 14"><rect y="5" width="{width}" '
        'height="4" fill="#e6e6e6"/>'
        f'<rect x="{x0}" y="3" width="{max(x1 - x0, 1)}" height="8" fill="{colour}" '
        'opacity="0.35"/>'
        f'<rect x="{max(x - 1.5, 0)}" y="0" width="3" height="14" fill="{colour}"/></svg>'
    )


def shares(
    labels: Sequence[str], series: Mapping[str, Sequence[tuple[float, float, float] | None]]
) -> str:
    """Plot the fractions (low, share, high) of each of `series` over the bins called `labels`."""
    step = (_WIDTH - _LEFT - 6) / len(labels)
    parts = [_axes([(0.0, "0"), (0.5, "50"), (1.0, "100 %")])]
    for k, label in enumerate(labels):
        x = _LEFT + (k + 0.5) * step
        parts.append(
            f'<text x="{x:.1f}" y="{_HEIGHT - 14}" text-anchor="middle">{html.escape(label)}</text>'
        )
    for s, points in enumerate(series.values()):
        colour = COLOURS[s % len(COLOURS)]
        for k, point in enumerate(points):
            if point is None:
                continue
            x = _LEFT + (k + 0.5 + 0.16 * (s - (len(series) - 1) / 2)) * step
            low, share, high = (_y(value) for value in point)
            parts.append(
                f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{low:.1f}" y2="{high:.1f}" '
                f'stroke="{colour}" stroke-width="2" '
                f'opacity="0.5"/><circle cx="{x:.1f}" cy="{share:.1f}" r="3.2" '
                f'fill="{colour}"/>'
            )
    return _svg(parts)


def histogram(
    series: Mapping[str, Sequence[float]], unit: str, marks: Sequence[tuple[float, str]] = ()
) -> str:
    """Render a histogram with 24 bins, one color for each of `series`.

    `marks` are labeled lines. A few values far above the others fall into the last bin, whose end
    is labeled with their maximum.
    """
    everything = np.concatenate(
        [np.asarray(values, float) for values in series.values()] or [np.zeros(0)]
    )
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
            f'width="{wide / 24 - 0.6:.1f}" '
            f'height="{_y(0) - _y(n / maximum):.1f}"/>'
            for k, n in enumerate(count)
            if n
        )
        parts.append(f'<g fill="{COLOURS[s % len(COLOURS)]}" opacity="0.6">{bars}</g>')
    for share, word, anchor in (
        (0, f"{low:.3g}", "start"),
        (0.5, f"{(low + high) / 2:.3g}", "middle"),
        (1, end, "end"),
    ):
        parts.append(
            f'<text x="{_LEFT + wide * share:.1f}" y="{_HEIGHT - 16}" '
            f'text-anchor="{anchor}">{word}</text>'
        )
    parts.append(
        f'<text x="{_LEFT + wide / 2:.1f}" y="{_HEIGHT - 4}" '
        f'text-anchor="middle">{html.escape(unit)}</text>'
    )
    for value, word in marks:
        if low <= value <= high:
            x = _LEFT + wide * (value - low) / (high - low)
            parts.append(
                f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{_TOP}" '
                f'y2="{_y(0)}" stroke="#b00020"/>'
                f'<text x="{x - 3:.1f}" y="{_TOP + 8}" text-anchor="end" '
                f'fill="#b00020">{html.escape(word)}</text>'
            )
    return _svg(parts)


def _y(share: float) -> float:
    return _TOP + (1 - share) * (_HEIGHT - _BOTTOM - _TOP)


def _axes(ticks: Sequence[tuple[float, str]]) -> str:
    return "".join(
        f'<line x1="{_LEFT}" x2="{_WIDTH - 6}" y1="{_y(share):.1f}" y2="{_y(share):.1f}" '
        'stroke="#ddd"/>'
        f'<text x="{_LEFT - 4}" y="{_y(share) + 3:.1f}" '
        f'text-anchor="end">{word}</text>'
        for share, word in ticks
    )


def _svg(parts: Sequence[str]) -> str:
    return (
        f'<svg width="{_WIDTH}" height="{_HEIGHT}" viewBox="0 0 {_WIDTH} {_HEIGHT}" '
        'font-size="9" '
        f'font-family="sans-serif">{"".join(parts)}</svg>'
    )
