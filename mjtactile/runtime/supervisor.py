"""Supervisor: state machine between controller and rig, for protection against faults.

States:

- `idle`: no command is sent.
- `armed`: the references are taken, and the rig is ready.
- `running`: the controller's command is passed on. The other states restrict or replace it.
- `holding`: an estimate is missing. The jaws do not close and the gripper does not rise.
- `safe`: the gripper is lowered and opened automatically (`mjtactile.runtime.retreat`).
- `latched`: final. `reason` holds the cause, and `unverified` the unverified part of the safe state
  (empty: none).

For the faults and their detectors see docs/how-to/hardware.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from mjtactile.core.types import Command, Touch, ValveState
from mjtactile.runtime.retreat import Retreat

BLIND_TIME_MAX = 0.5  # time without a known force before the retreat, s
# as a fraction of the sealed pressure; objects only raise it, 3 K change it by 1 %
_LEAK_FRACTION = 0.8
# Pa, above the noise of pressure sensors: a chamber at or below the air's pressure has none to lose
_LEAK_MIN = 30.0
# consecutive cycles for a leak by shape; one is enough by pressure, since the valve driver repeats
# surprising readings
_SINK_CYCLES = 3
# fraction of the bulge volume without contact: leak criterion without a pressure sensor
_BULGE_FRACTION = 0.6
STATES = ("idle", "armed", "running", "holding", "safe", "latched")


@dataclass(frozen=True)
class Transition:
    """Change of state: time on the rig's clock, s, new state, and reason."""

    time: float
    state: str
    reason: str


class Supervisor:
    """State machine of one run. `decide` is called once per cycle with the controller's command."""

    def __init__(self, period: float):
        self._period = period
        self.state = "idle"
        self.reason = ""
        self.history: list[Transition] = []
        self._blind_since: float | None = None
        self._blind_why = ""
        self._sealed: list[float | None] | None = None
        self._bulge: list[float | None] | None = None
        self._sink_cycles = 0
        self._safe_requested = ""
        self._retreat = Retreat(period)
        self._opening: float | None = None
        self._height: float | None = None
        self.unverified = ""

    @property
    def is_over(self) -> bool:
        return self.state == "latched"

    def arm(self, now: float) -> None:
        self._enter("armed", "references taken", now)

    def decide(
        self,
        now: float,
        requested: Command,
        last: Command,
        touch: Sequence[Touch],
        valves: Sequence[ValveState],
        height: float | None = None,
        opening: float | None = None,
    ) -> Command:
        """Return the command to pass on.

        `last` is the previous command. `height` and `opening`, m, are the gripper's measurements
        (None: unknown).
        """
        self._opening = opening
        self._height = height
        if self._safe_requested:
            self.make_safe(self._safe_requested, now)
        if self.state in ("safe", "latched"):
            return self._retreat_command(now, last, touch)
        self._retreat.watch(touch, last.lift_height)
        leak = self._leak(touch, valves)
        if leak:
            self.make_safe(leak, now)
            return self._retreat_command(now, last, touch)
        unknown = [t.status for t in touch if not math.isfinite(t.force_normal)]
        if unknown:
            return self._hold(now, requested, last, touch, unknown[0])
        self._blind_since = None
        if self.state != "running":
            self._enter("running", "forces are known", now)
        return requested

    def make_safe(self, reason: str, now: float) -> None:
        """Start the retreat: lower and open the gripper, and ignore the controller's commands."""
        if self.state not in ("safe", "latched"):
            self._enter("safe", reason, now)

    def request_safe_state(self, reason: str) -> None:
        """Request the retreat at the next `decide`, from another thread such as an emergency
        stop."""
        self._safe_requested = reason

    def latch(self, reason: str, now: float, unverified: str = "") -> None:
        """Enter the final state, after which no command is sent.

        `unverified` is the unverified part of the safe state.
        """
        self.unverified = unverified
        self._enter("latched", self.reason if self.state == "safe" else reason, now)

    def _hold(
        self, now: float, requested: Command, last: Command, touch: Sequence[Touch], why: str
    ) -> Command:
        """Restrict a command while forces are unknown: opening and lowering only.

        After too long a time, the retreat starts.
        """
        if self._blind_since is None:
            self._blind_since = now
            self._blind_why = why
        if now - self._blind_since > BLIND_TIME_MAX:
            self.make_safe(f"no force for {BLIND_TIME_MAX:g} s: {self._blind_why}", now)
            return self._retreat_command(now, last, touch)
        if self.state != "holding":
            self._enter("holding", why, now)
        return replace(
            requested,
            opening=max(requested.opening, last.opening),
            force_limit=requested.force_limit if last.force_limit is None else last.force_limit,
            lift_height=min(requested.lift_height, last.lift_height),
            gauge_pressure=last.gauge_pressure,
        )

    def _retreat_command(self, now: float, last: Command, touch: Sequence[Touch]) -> Command:
        """Return the next command of the retreat, and latch at its end."""
        if self.state == "latched":
            return last
        command = self._retreat.next(last, touch, self._opening, self._height)
        if command is None:
            self.latch(self.reason, now, self._retreat.unverified)
            return last
        return command

    def _leak(self, touch: Sequence[Touch], valves: Sequence[ValveState]) -> str:
        """Return a description of the sealed chamber that leaks, or ""."""
        if self._sealed is None or self._bulge is None:
            self._sealed = [None if v.is_open else v.gauge_pressure for v in valves]
            self._bulge = [t.surface.volume if t.surface else None for t in touch]
        for i, t in enumerate(touch):
            self._record_sealed_pressure(i, t, valves[i] if i < len(valves) else None)
        lost = [
            f"chamber {i} lost pressure: {v.gauge_pressure:.0f} Pa, sealed at {sealed:.0f} Pa"
            for i, (v, sealed) in enumerate(zip(valves, self._sealed, strict=True))
            if v.gauge_pressure is not None
            and not v.is_open
            and sealed is not None
            and v.gauge_pressure < min(_LEAK_FRACTION * sealed, sealed - _LEAK_MIN)
        ]
        sunk = [
            f"the membrane of chamber {i} has sunk to {1e9 * t.surface.volume:.0f} mm^3 from "
            f"{1e9 * bulge:.0f} mm^3 without contact"
            for i, (t, bulge) in enumerate(zip(touch, self._bulge, strict=True))
            if t.surface is not None
            and math.isfinite(t.force_normal)  # an unknown force may be a contact
            and not t.touching
            and bulge is not None
            and bulge > 0
            and t.surface.volume < _BULGE_FRACTION * bulge
        ]
        self._sink_cycles = self._sink_cycles + 1 if sunk else 0
        if lost:
            return f"leak: {lost[0]}"
        return f"leak: {sunk[0]}" if self._sink_cycles >= _SINK_CYCLES else ""

    def _record_sealed_pressure(self, i: int, touch: Touch, valve: ValveState | None) -> None:
        """Store pressure and bulge volume of chamber `i` after sealing.

        They are reset while its valve is open, because that is not a leak. They are stored again
        once the valve is closed and there is no contact.
        """
        assert self._sealed is not None and self._bulge is not None
        if valve is not None and valve.is_open:
            self._sealed[i] = self._bulge[i] = None
            return
        if touch.touching:
            return
        if valve is not None and self._sealed[i] is None:
            self._sealed[i] = valve.gauge_pressure
        if touch.surface is not None and self._bulge[i] is None:
            self._bulge[i] = touch.surface.volume

    def _enter(self, state: str, reason: str, now: float) -> None:
        self.state = state
        self.reason = reason
        self.history.append(Transition(now, state, reason))
