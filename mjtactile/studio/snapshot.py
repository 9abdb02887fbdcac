"""What Studio shows at one moment, whoever felt it: a session, a recording, or sensors in somebody
else's scene. Frozen values, and the words for them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mjtactile.core.types import Array, Image, Surface, Touch, ValveState
from mjtactile.report.shape_wireframe import describe_shape

HISTORY = 20.0  # s that the plots show
_CURVE = 300  # points of a curve, at most


@dataclass(frozen=True, eq=False)
class Pose:
    """Where a sensor's frame S is in the scene: `p_WS` (3,) m, `R_WS` (3, 3)."""

    p_WS: Array
    R_WS: Array

    def place(self, p_S: Array) -> Array:
        """Points (..., 3) m in S, in W."""
        return self.p_WS + p_S @ self.R_WS.T


@dataclass(frozen=True, eq=False)
class FingerSnapshot:
    """One finger: its camera's `image` and the `touch` in it. `rest` is its membrane with nothing
    touching, `design` its sensor, `true` N what really presses, `gauge_pressure` Pa and
    `temperature` K of the chamber: NaN where nobody knows. It is at `pose`, or where the scene's
    `body` is. `tracks`: what its sensing follows from image to image, with this one's ellipses."""

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
    """One cycle. `scene` is MuJoCo's model and state (mjSTATE_INTEGRATION) then, where there is
    one; `session` says what only a session has: phase, supervisor's state and reason, opening and
    lift, m, ms of perception; `flags` what makes a simulation's numbers worse than usual."""

    number: int
    time: float
    fingers: tuple[FingerSnapshot, ...]
    session: SessionState | None = None
    scene: Any = None
    flags: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class SessionState:
    """What a session does beside feeling."""

    phase: str
    state: str
    reason: str
    opening: float
    lift_height: float
    perception_ms: float


def finger_lines(felt: FingerSnapshot, perception_ms: float = math.nan) -> list[str]:
    """What the panel says of a finger."""
    touch = felt.touch
    shear = math.nan if touch.traction is None else float(np.hypot(*touch.traction.wrench[:2]))
    lines = [
        f"normal {touch.force_normal:+.3f} N, 2 sd {2 * touch.force_normal_sd:.3f}",
        f"shear  {shear:.3f} N, 2 sd {2 * _shear_sd(touch):.3f}",
    ]
    if math.isfinite(felt.true):
        lines.append(f"true   {felt.true:+.3f} N")
    if touch.contact is not None:
        lines.append(
            f"area   {1e6 * touch.contact.area:.0f} mm2, {1e3 * touch.contact.depth:.2f} mm deep"
        )
    if touch.shape is not None:
        lines.append(f"body   {describe_shape(touch.shape)}")
    lines.append(f"slip   {_slip(touch)}")
    lines.append(f"gas    {_gas(felt)}")
    thought = f"; perception {perception_ms:.1f} ms" if math.isfinite(perception_ms) else ""
    return [*lines, f"image  {1e3 * touch.age:.0f} ms old{thought}"]


def _shear_sd(touch: Touch) -> float:
    """Standard deviation of the shear's size, N: that along it."""
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


def _gas(felt: FingerSnapshot) -> str:
    """Valve, pressure and temperature, as far as they are known."""
    parts = [] if felt.valve is None else ["open" if felt.valve.is_open else "closed"]
    measured = felt.valve.gauge_pressure if felt.valve is not None else None
    if measured is not None:
        parts.append(f"{1e-3 * measured:.2f} kPa")
    elif math.isfinite(felt.gauge_pressure):
        parts.append(f"{1e-3 * felt.gauge_pressure:.2f} kPa (true)")
    if math.isfinite(felt.temperature):
        parts.append(f"{felt.temperature - 273.15:.1f} C")
    return ", ".join(parts) or "sealed by hand"


@dataclass(frozen=True)
class Row:
    """One moment in the plots: `time` s, forces (n,) N felt, their sd, and true, gauge pressures
    (n,) Pa, `opening` m."""

    time: float
    felt: tuple[float, ...]
    sd: tuple[float, ...]
    true: tuple[float, ...]
    pressure: tuple[float, ...]
    opening: float
    phase: str
    state: str


def row_of(moment: StudioSnapshot) -> Row:
    fingers = moment.fingers
    session = moment.session
    return Row(
        moment.time,
        tuple(f.touch.force_normal for f in fingers),
        tuple(f.touch.force_normal_sd for f in fingers),
        tuple(f.true for f in fingers),
        tuple(_pressure(f) for f in fingers),
        math.nan if session is None else session.opening,
        "" if session is None else session.phase,
        "running" if session is None else session.state,
    )


def _pressure(felt: FingerSnapshot) -> float:
    measured = None if felt.valve is None else felt.valve.gauge_pressure
    return felt.gauge_pressure if measured is None else measured


@dataclass(frozen=True, eq=False)
class Curves:
    """The rows of some time as columns: `time` (k,) s, the others (n, k), `opening` (k,) m; `spans`
    are name, begin and end, s, of the phases, and of the times in which the supervisor was not at
    ease."""

    time: Array
    felt: Array
    sd: Array
    true: Array
    pressure: Array
    opening: Array
    spans: tuple[tuple[str, float, float], ...]
    now: float = math.nan
    """s, where a recording is looked at."""


def curves_of(rows: Sequence[Row]) -> Curves | None:
    """At most so many rows that their drawing costs nothing to speak of; None of none."""
    if not rows:
        return None
    every = -(-len(rows) // _CURVE)
    some = rows[::-every][::-1]  # the newest is among them

    def column(name: str) -> Array:
        return np.array([getattr(row, name) for row in some], dtype=float).T

    return Curves(
        column("time"),
        column("felt"),
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
    """The rows of the last `seconds`. One thread adds, another looks."""

    seconds: float = HISTORY
    rows: deque[Row] = field(default_factory=deque)
    _made: tuple[Row | None, Curves | None] = (None, None)

    def add(self, moment: StudioSnapshot) -> None:
        row = row_of(moment)
        if self.rows and row.time < self.rows[-1].time:  # it began again
            self.rows.clear()
        self.rows.append(row)
        while self.rows[-1].time - self.rows[0].time > self.seconds:
            self.rows.popleft()

    def clear(self) -> None:
        self.rows.clear()

    def curves(self) -> Curves | None:
        """The columns, made anew where there is a new row."""
        rows = list(self.rows)  # at once: Python's lock is held
        last = rows[-1] if rows else None
        if last is not self._made[0]:
            self._made = (last, curves_of(rows))
        return self._made[1]
