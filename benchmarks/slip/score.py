"""What the chain detected in one finger's case, against what really slid.

A *slip* is a finger over which the body slides by 0.5 mm in all while everything in the contact
slides (95 % of the friction that there can be resists the motion; it ends where less than 85 %
does). It begins, at `onset`, when that is first so, and is detected in time when the first
"slipping" comes before 0.5 mm and within 100 ms of it, by the times of the images. What comes more
than 100 ms before it, while a fifth of the friction is left, is early. A *hold* never slides and
never uses more than 85 % of the friction; "slipping" is a false alarm there. What lies between
(creeping at the limit, slides of less than 0.5 mm) is counted, not judged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

# m, s, shares of friction, m
SLIP = 0.5e-3
IN_TIME = 0.1
LEFT = 0.8
NEAR = 0.85
STILL = 5e-5
OUTCOMES = (
    "in time",
    "before 0.5 mm",
    "within 100 ms",
    "late",
    "missed",
    "early",
    "quiet",
    "false",
    "between",
)
SLIPS = OUTCOMES[:6]
_ROUNDING = 1e-6  # s


@dataclass(frozen=True)
class Frame:
    """One image of one finger: the `state` that the chain gave (of SLIP_STATES), and by truth the
    share of friction `used`, the way `slid`, m, and its `onset`, s (NaN: not yet)."""

    time: float
    state: str
    used: float
    slid: float
    onset: float


@dataclass(frozen=True)
class Outcome:
    """`name` of OUTCOMES; of detected slips the `latency` s (negative: before it) and the way
    `slid` m by then; the `speed` m/s of the first 0.5 mm."""

    name: str
    latency: float = float("nan")
    slid: float = float("nan")
    speed: float = float("nan")


def outcome(frames: Sequence[Frame]) -> Outcome:
    """What became of one finger's case; `frames` from the beginning of the load on."""
    detected = next((frame for frame in frames if frame.state == "slipping"), None)
    last = frames[-1]
    if last.slid < SLIP:
        if last.slid > STILL or max(frame.used for frame in frames) > NEAR:
            return Outcome("between")
        return Outcome("quiet" if detected is None else "false")
    beyond = next(frame for frame in frames if frame.slid >= SLIP)
    speed = beyond.slid / max(beyond.time - last.onset, 1e-3)
    if detected is None:
        return Outcome("missed", speed=speed)
    latency = detected.time - last.onset
    if latency < -IN_TIME and detected.used < LEFT:
        return Outcome("early", latency, detected.slid, speed)
    way = detected.slid < SLIP
    soon = latency <= IN_TIME + _ROUNDING
    name = {
        (True, True): "in time",
        (True, False): "before 0.5 mm",
        (False, True): "within 100 ms",
        (False, False): "late",
    }
    return Outcome(name[way, soon], latency, detected.slid, speed)
