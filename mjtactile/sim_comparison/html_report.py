"""HTML report of a comparison: recording and simulation over time, and the cause."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from mjtactile.core.types import Array
from mjtactile.report import html
from mjtactile.sim_comparison.attribution import SimComparison, TestedParameter
from mjtactile.sim_comparison.discrepancy_parameters import words
from mjtactile.sim_comparison.signals import KINDS, TOLERANCE, UNIT, Signals

_COLOURS = {"recorded": "#1f5fa8", "simulated": "#b9b9b9", "simulated with the cause": "#d1571b"}
_WIDTH = 520
_HEIGHT = 170
_LEFT = 46
_TOP = 10
_BOTTOM = 26


def verdict(shadow: SimComparison) -> str:
    """Return one line: agreement of rig and simulator, or the cause of their difference."""
    if not shadow.differs:
        return "agrees with the simulator within the tolerances"
    where = " and ".join(parting(shadow))
    if shadow.named is None:
        return f"differs from the simulator in {where}; no single cause explains it"
    named = notify(shadow.named)
    if shadow.alike:
        named += (
            ", or "
            + ", or ".join(notify(signal) for signal in shadow.alike)
            + " (indistinguishable)"
        )
    explained = f"{named} (explains {100 * shadow.explains:.0f} % of it)"
    return f"differs from the simulator in {where}: {explained}"


def parting(shadow: SimComparison) -> list[str]:
    """Return the kinds of signals whose difference exceeds its tolerance."""
    return [
        kind
        for kind in KINDS
        if np.nanmax(shadow.differences[kind] / TOLERANCE[kind], initial=0.0) > 1.0
    ]


def notify(one: TestedParameter, fingers: Sequence[str] = ()) -> str:
    """Describe a cause with its amount, per finger for a sensor if the amounts differ."""
    amounts = one.amounts
    largest = max(range(len(amounts)), key=lambda k: abs(amounts[k]))
    if one.cause.on != "sensor" or not fingers or len(fingers) < 2:
        return words(one.cause, amounts[largest])
    own = [
        f"{name}: {words(one.cause, amount)}"
        for name, amount in zip(fingers, amounts, strict=True)
        if abs(amount) > 0.2 * abs(amounts[largest])
    ]
    return "; ".join(own)


def numbers(shadow: SimComparison, fingers: Sequence[str]) -> dict[str, Any]:
    """Return the result for JSON."""

    def rms(found: Any) -> dict[str, Any]:
        units = {kind: UNIT[kind] for kind in KINDS if kind in found}
        return {
            f"{kind}_{unit}": dict(zip(fingers, (scale * found[kind]).tolist(), strict=True))
            for kind, (scale, unit) in units.items()
        }

    def tested(one: TestedParameter) -> dict[str, Any]:
        scale = one.cause.scale
        return {
            "cause": one.cause.name,
            "unit": one.cause.unit,
            "amounts": [amount / scale for amount in one.amounts],
            "sd": [sd / scale for sd in one.sd],
            "explains": one.explains,
            "text": notify(one, fingers),
        }

    return {
        "verdict": verdict(shadow),
        "differs": shadow.differs,
        "named": None if shadow.named is None else tested(shadow.named),
        "explains": shadow.explains,
        "alike": [item.cause.name for item in shadow.alike],
        "remedy": "" if shadow.named is None else shadow.named.cause.remedy,
        "difference_rms": rms(shadow.differences),
        "left": rms(shadow.left),
        "tested": [tested(item) for item in shadow.tried],
    }


def page(shadow: SimComparison, fingers: Sequence[str], title: str) -> str:
    """Return the HTML page of a comparison."""
    body = [f"<h1>{escape(title)}</h1>", f"<p><b>{escape(verdict(shadow))}</b></p>"]
    if shadow.named is not None:
        body.append(f"<p>{escape(notify(shadow.named, fingers))}</p>")
        body.append(f"<p>Remedy: {escape(shadow.named.cause.remedy)}</p>")
    body.append(_legend(shadow))
    for index, finger in enumerate(fingers):
        body.append(f"<h2>{escape(finger)}</h2>")
        body += [_chart(kind, shadow, index) for kind in KINDS]
    head = ["", *fingers, "tolerance", "remaining with the cause"]
    body += ["<h2>Differences, rms</h2>", html.table(head, _difference_rows(shadow))]
    if shadow.tried:
        rows = [
            (escape(item.cause.name), escape(notify(item, fingers)), f"{100 * item.explains:.0f} %")
            for item in shadow.tried
        ]
        table = html.table(["cause", "best fit", "explains"], rows, text=True)
        body += ["<h2>Tested causes</h2>", table]
    return html.document(title, body)


def _difference_rows(shadow: SimComparison) -> list[tuple[str, ...]]:
    rows = []
    for kind in KINDS:
        scale, unit = UNIT[kind]
        values = [f"{scale * value:.3g}" for value in shadow.differences[kind]]
        left = "-"
        if shadow.left:
            left = ", ".join(f"{scale * value:.3g}" for value in shadow.left[kind])
        rows.append((f"{kind}, {unit}", *values, f"{scale * TOLERANCE[kind]:.3g}", left))
    return rows


def _legend(shadow: SimComparison) -> str:
    shown = list(_COLOURS)[: 3 if shadow.explained is not None else 2]
    marks = [f'<span style="color:{_COLOURS[name]}">&#9644; {name}</span>' for name in shown]
    return f"<p>{' &nbsp; '.join(marks)}</p>"


def _curve(kind: str, signals: Signals, there: Signals, finger: int) -> Array:
    """Return a curve (t,): normal force, N, pressure, Pa, or marker distance (rms), um."""
    if kind == "force":
        return -signals.force[:, finger, 2]
    if kind == "pressure":
        return signals.pressure[:, finger]
    square = ((signals.markers[:, finger] - there.markers[:, finger]) ** 2).sum(axis=-1)
    known = np.isfinite(square)
    total = np.where(known, square, 0).sum(axis=1)
    with np.errstate(invalid="ignore"):
        return 1e6 * np.sqrt(total / known.sum(axis=1))  # NaN without a known marker


_CAPTIONS = {
    "force": "normal force, N",
    "markers": "marker distance from the recording, rms, um",
    "pressure": "gauge pressure, Pa",
}


def _chart(kind: str, shadow: SimComparison, finger: int) -> str:
    """Plot one kind of signal over time, as SVG."""
    there = shadow.recorded
    curves = {"recorded": _curve(kind, there, there, finger)}
    curves["simulated"] = _curve(kind, shadow.simulated, there, finger)
    if shadow.explained is not None:
        curves["simulated with the cause"] = _curve(kind, shadow.explained, there, finger)
    if kind == "markers":
        del curves["recorded"]
    values = np.concatenate(list(curves.values()))
    if not np.isfinite(values).any():
        return f"<p>{_CAPTIONS[kind]}: not recorded</p>"
    low = float(np.nanmin(values))
    high = float(np.nanmax(values))
    room = max(high - low, 1e-9)
    x = _LEFT + (_WIDTH - _LEFT - 8) * there.time / max(float(there.time[-1]), 1e-9)
    parts = [
        f'<text x="{_LEFT}" y="{_HEIGHT - 6}">0 s</text>',
        f'<text x="{_WIDTH - 8}" y="{_HEIGHT - 6}" text-anchor="end">{there.time[-1]:.1f} s</text>',
    ]
    for value in (low, high):
        y = _TOP + (1 - (value - low) / room) * (_HEIGHT - _TOP - _BOTTOM)
        parts.append(
            f'<text x="{_LEFT - 4}" y="{y + 3:.1f}" text-anchor="end">{value:.3g}</text>'
            f'<line x1="{_LEFT}" x2="{_WIDTH - 8}" y1="{y:.1f}" y2="{y:.1f}" stroke="#eee"/>'
        )
    for name, curve in curves.items():
        y = _TOP + (1 - (curve - low) / room) * (_HEIGHT - _TOP - _BOTTOM)
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True) if np.isfinite(b))
        parts.append(
            f'<polyline points="{points}" fill="none" stroke="{_COLOURS[name]}" '
            'stroke-width="1.6"/>'
        )
    return (
        '<figure style="display:inline-block;margin:.3em">'
        f"<figcaption>{_CAPTIONS[kind]}</figcaption>"
        f'<svg width="{_WIDTH}" height="{_HEIGHT}" font-size="10" font-family="sans-serif">'
        f"{''.join(parts)}</svg></figure>"
    )
