"""Snapshot of a session, a recording, or sensors in a user's scene, as Studio shows it. Immutable
values and their text."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mjtactile.core.flags import Flags
from mjtactile.core.types import Array, Image, Surface, Touch, ValveState
from mjtactile.report.shape_wireframe import describe_shape

HISTORY = 20.0  # time window of the plots, s
_CURVE = 300  # maximum number of points of a curve


@dataclass(frozen=True, eq=False)
class Pose:
    """Pose of a sensor's frame S in the scene: `p_WS` (3,) m, `R_WS` (3, 3)."""

    p_WS: Array
    R_WS: Array

    def place(self, p_S: Array) -> Array:
        """Transform points (..., 3), m, from S to W."""
        return self.p_WS + p_S @ self.R_WS.T


@dataclass(frozen=True, eq=False)
class FingerSnapshot:
    """One finger: its camera's `image` and the `touch` estimated from it.

    `rest` is its membrane without contact and `design` its sensor. `true` is the ground-truth
    normal force, N. `gauge_pressure`, Pa, and `temperature`, K, are those of the chamber. Unknown
    values are NaN. The finger is at `pose`, or at the scene's `body`. `tracks` is the state of
    image tracking, with the ellipses of this image.
    """

    name: str
    image: Image
    touch: Touch
    design: Any = None
    rest: Surface | None = None
    pose: Pose | None = None
    valve: ValveState | None = None
    true: float = math.nan
    gauge_pressure: float = math.nan
    temperature: float = math.nan
    body: int | None = None
    tracks: Any = None


@dataclass(frozen=True, eq=False)
class StudioSnapshot:
    """One cycle.

    `scene` is MuJoCo's model and state (mjSTATE_INTEGRATION) at that time, if there is one.
    `session` holds the values of a session. These are phase, the supervisor's state and reason,
    opening and lift, m, and perception time, ms. `flags` are the reasons for reduced accuracy of a
    simulation.
    """

    number: int
    time: float
    fingers: tuple[FingerSnapshot, ...]
    session: SessionState | None = None
    scene: Any = None
    flags: Flags = field(default_factory=dict)


@dataclass(frozen=True)
class SessionState:
    """State of a session in addition to its touch estimates."""

    phase: str
    state: str
    reason: str
    opening: float
    lift_height: float
    perception_ms: float


def finger_lines(estimated: FingerSnapshot, perception_ms: float = math.nan) -> list[str]:
    """Return the panel's text lines of a finger."""
    touch = estimated.touch
    shear = math.nan if touch.traction is None else float(np.hypot(*touch.traction.wrench[:2]))
    lines = [
        f"normal {touch.force_normal:+.3f} N, 2 sd {2 * touch.force_normal_sd:.3f}",
        f"shear  {shear:.3f} N, 2 sd {2 * _shear_sd(touch):.3f}",
    ]
    if math.isfinite(estimated.true):
        lines.append(f"ground truth {estimated.true:+.3f} N")
    if touch.contact is not None:
        lines.append(
            f"area   {1e6 * touch.contact.area:.0f} mm2, {1e3 * touch.contact.depth:.2f} mm deep"
        )
    if touch.shape is not None:
        lines.append(f"shape  {describe_shape(touch.shape)}")
    lines.append(f"slip   {_slip(touch)}")
    lines.append(f"gas    {_gas(estimated)}")
    duration = f"; perception {perception_ms:.1f} ms" if math.isfinite(perception_ms) else ""
    return [*lines, f"image  {1e3 * touch.age:.0f} ms old{duration}"]


def _shear_sd(touch: Touch) -> float:
    """Return the standard deviation of the shear force along its direction, N."""
    if touch.traction is None:
        return math.nan
    along = touch.traction.wrench[:2] / max(float(np.hypot(*touch.traction.wrench[:2])), 1e-12)
    return math.sqrt(max(float(along @ touch.traction.wrench_cov[:2, :2] @ along), 0.0))


def _slip(touch: Touch) -> str:
    if touch.slip is None:
        return "unknown"
    slip = touch.slip
    if slip.state in ("none", "unknown"):
        return slip.state
    if slip.state == "slipping":
        speed = f", {1e3 * float(np.hypot(*slip.velocity)):.0f} mm/s"
    else:
        speed = ""
    return f"{slip.state}, {1e3 * slip.distance:.1f} mm so far{speed}"


def _gas(estimated: FingerSnapshot) -> str:
    """Return valve state, pressure and temperature as text, if known."""
    parts = [] if estimated.valve is None else ["open" if estimated.valve.is_open else "closed"]
    measured = estimated.valve.gauge_pressure if estimated.valve is not None else None
    if measured is not None:
        parts.append(f"{1e-3 * measured:.2f} kPa")
    elif math.isfinite(estimated.gauge_pressure):
        parts.append(f"{1e-3 * estimated.gauge_pressure:.2f} kPa (ground truth)")
    if math.isfinite(estimated.temperature):
        parts.append(f"{estimated.temperature - 273.15:.1f} C")
    return ", ".join(parts) or "sealed by hand"


@dataclass(frozen=True)
class Row:
    """One sample of the plots.

    It holds `time` s, estimated forces (n,) N, their standard deviations and ground truth. It also
    holds gauge pressures (n,) Pa, and `opening` m.
    """

    time: float
    estimated: tuple[float, ...]
    sd: tuple[float, ...]
    true: tuple[float, ...]
    pressure: tuple[float, ...]
    opening: float
    phase: str
    state: str


def row_of(snapshot: StudioSnapshot) -> Row:
    fingers = snapshot.fingers
    session = snapshot.session
    return Row(
        snapshot.time,
        tuple(f.touch.force_normal for f in fingers),
        tuple(f.touch.force_normal_sd for f in fingers),
        tuple(f.true for f in fingers),
        tuple(_pressure(f) for f in fingers),
        math.nan if session is None else session.opening,
        "" if session is None else session.phase,
        "running" if session is None else session.state,
    )


def _pressure(estimated: FingerSnapshot) -> float:
    measured = None if estimated.valve is None else estimated.valve.gauge_pressure
    return estimated.gauge_pressure if measured is None else measured


@dataclass(frozen=True, eq=False)
class Curves:
    """Rows of a time window as columns: `time` (k,) s, `opening` (k,) m, the others (n, k).

    `spans` are name, start and end, s, of the phases and of the supervisor's interventions.
    """

    time: Array
    estimated: Array
    sd: Array
    true: Array
    pressure: Array
    opening: Array
    spans: tuple[tuple[str, float, float], ...]
    now: float = math.nan
    """Displayed time of a recording, s."""


def curves_of(rows: Sequence[Row]) -> Curves | None:
    """Return curves of at most `_CURVE` rows, which keeps plotting fast; None without rows."""
    if not rows:
        return None
    every = -(-len(rows) // _CURVE)
    sampled = rows[::-every][::-1]  # the newest is among them

    def column(name: str) -> Array:
        return np.array([getattr(row, name) for row in sampled], dtype=float).T

    return Curves(
        column("time"),
        column("estimated"),
        column("sd"),
        column("true"),
        column("pressure"),
        column("opening"),
        _spans(rows),
    )


def _spans(rows: Sequence[Row]) -> tuple[tuple[str, float, float], ...]:
    spans: list[tuple[str, float, float]] = []
    for row in rows:
        name = row.phase if row.state in ("armed", "running") else row.state
        if spans and spans[-1][0] == name:
            spans[-1] = (name, spans[-1][1], row.time)
        else:
            spans[-1:] = [(*spans[-1][:2], row.time)] if spans else []
            spans.append((name, row.time, row.time))
    return tuple(spans)


@dataclass(eq=False)
class History:
    """Rows of the last `seconds`. One thread adds rows, another reads them."""

    seconds: float = HISTORY
    rows: deque[Row] = field(default_factory=deque)
    _made: tuple[Row | None, Curves | None] = (None, None)

    def add(self, snapshot: StudioSnapshot) -> None:
        row = row_of(snapshot)
        if self.rows and row.time < self.rows[-1].time:  # the run was restarted
            self.rows.clear()
        self.rows.append(row)
        while self.rows[-1].time - self.rows[0].time > self.seconds:
            self.rows.popleft()

    def clear(self) -> None:
        self.rows.clear()

    def curves(self) -> Curves | None:
        """Return the columns, computed again when there is a new row."""
        rows = list(self.rows)  # at once: Python's lock is held
        last = rows[-1] if rows else None
        if last is not self._made[0]:
            self._made = (last, curves_of(rows))
        return self._made[1]
