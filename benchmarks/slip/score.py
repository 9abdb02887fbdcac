"""Score of slip detection in one finger's case, relative to the true slip.

In a *slip*, the object slides over the finger by 0.5 mm in total while the whole contact slides.
The whole contact slides from 95 % of the available friction until less than 85 % is used. The slip
starts at `onset`, the first time of this. It is detected in time if the first "slipping" comes
before 0.5 mm and within 100 ms of onset, by the times of the images. A detection is early if it
comes more than 100 ms before onset while at most 80 % of the friction is used.

A *hold* never slides and never uses more than 85 % of the friction. "slipping" is a false alarm
there. Cases between (creep at the limit, slides of less than 0.5 mm) are counted, not scored.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

# slip distance, m; time limit, s; fractions of friction; maximum sliding distance in a hold, m
SLIP = 0.5e-3
IN_TIME = 0.1
MAX_USED_EARLY = 0.8
MAX_USED_HOLD = 0.85
MAX_SLID_HOLD = 5e-5
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
ROUNDING = 1e-6  # rounding tolerance of the time limit, s


@dataclass(frozen=True)
class Frame:
    """One image of one finger.

    `state` is the estimate of the pipeline, one of SLIP_STATES. Ground truth: fraction of friction
    `used`, sliding distance `slid`, m, and `onset` of the slip, s (NaN: not yet).
    """

    time: float
    state: str
    used: float
    slid: float
    onset: float


@dataclass(frozen=True)
class Outcome:
    """Outcome of one finger's case.

    `name` is one of OUTCOMES. `latency`, s, of a detected slip is relative to onset. `slid`, m, is
    the sliding distance at detection. `speed`, m/s, is the mean over the first 0.5 mm.
    """

    name: str
    latency: float = float("nan")
    slid: float = float("nan")
    speed: float = float("nan")


def outcome(frames: Sequence[Frame]) -> Outcome:
    """Score one finger's case; `frames` begin with the load."""
    detected = next((frame for frame in frames if frame.state == "slipping"), None)
    last = frames[-1]
    if last.slid < SLIP:
        if last.slid > MAX_SLID_HOLD or max(frame.used for frame in frames) > MAX_USED_HOLD:
            return Outcome("between")
        return Outcome("quiet" if detected is None else "false")
    beyond = next(frame for frame in frames if frame.slid >= SLIP)
    speed = beyond.slid / max(beyond.time - last.onset, 1e-3)
    if detected is None:
        return Outcome("missed", speed=speed)
    latency = detected.time - last.onset
    if latency < -IN_TIME and detected.used < MAX_USED_EARLY:
        return Outcome("early", latency, detected.slid, speed)
    in_distance = detected.slid < SLIP
    in_time = latency <= IN_TIME + ROUNDING
    name = {
        (True, True): "in time",
        (True, False): "before 0.5 mm",
        (False, True): "within 100 ms",
        (False, False): "late",
    }
    return Outcome(name[in_distance, in_time], latency, detected.slid, speed)
