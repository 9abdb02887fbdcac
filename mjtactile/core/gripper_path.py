"""`GripperPath`: motion of a gripper over time, from waypoint to waypoint.

Each segment is a minimum-jerk motion, which starts and ends at rest (Flash and Hogan, J.
Neuroscience 5, 1985).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mjtactile.core.types import Array

_SAMPLES = 40  # samples of a segment for its maximum acceleration
_ZERO = (0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Segment:
    """One waypoint with the motion to it, SI; None: the coordinate keeps its value."""

    x: float | None
    y: float | None
    z: float | None
    tilt: float | None
    speed: float
    tilt_speed: float
    wait: float


@dataclass(frozen=True)
class GripperPath:
    """Positions (x, y, z, tilt), m and rad, at which segments end, and their times, s.

    Segment k starts at `starts[k]` and ends at `ends[k]`, relative to the end of the lift.
    """

    starts: tuple[float, ...]
    ends: tuple[float, ...]
    points: tuple[tuple[float, float, float, float], ...]

    @classmethod
    def of(cls, segments: Sequence[Segment]) -> GripperPath:
        """Return the path through these waypoints."""
        time, last = 0.0, _ZERO
        starts: list[float] = []
        ends: list[float] = []
        points: list[tuple[float, float, float, float]] = []
        for segment in segments:
            requested = (segment.x, segment.y, segment.z, segment.tilt)
            pairs = zip(requested, last, strict=True)
            x, y, z, tilt = (old if new is None else new for new, old in pairs)
            distance = math.dist((x, y, z), last[:3])
            duration = max(distance / segment.speed, abs(tilt - last[3]) / segment.tilt_speed)
            starts.append(time + segment.wait)
            time = starts[-1] + duration
            ends.append(time)
            last = (x, y, z, tilt)
            points.append(last)
        return cls(tuple(starts), tuple(ends), tuple(points))

    @property
    def end(self) -> float:
        """Time of the last waypoint, s."""
        return self.ends[-1]

    @property
    def max_offset(self) -> float:
        """Maximum horizontal distance from the start along x or y, m."""
        return max(abs(value) for point in self.points for value in point[:2])

    def next_start(self, time: float) -> float:
        """Return the start of the first motion that has not ended at `time`, s; inf without one."""
        pairs = zip(self.starts, self.ends, strict=True)
        return min((start for start, end in pairs if end > time), default=math.inf)

    def at(self, time: float) -> Array:
        """Return the displacement (4,) at `time`, s: x, y, z, m, and tilt, rad."""
        point = np.array(_ZERO)
        for start, end, goal in zip(self.starts, self.ends, self.points, strict=True):
            if time <= start:
                break
            done = 1.0 if end <= start else min((time - start) / (end - start), 1.0)
            smooth = done**3 * (10 - 15 * done + 6 * done**2)
            point = point + smooth * (np.array(goal) - point)
        return point

    def acceleration(self, time: float) -> Array:
        """Return the acceleration (3,) at `time`, s, m/s^2."""
        last = np.array(_ZERO)
        for start, end, goal in zip(self.starts, self.ends, self.points, strict=True):
            if start < time < end:
                done = (time - start) / (end - start)
                curve = 60 * done - 180 * done**2 + 120 * done**3
                return (np.array(goal) - last)[:3] * curve / (end - start) ** 2
            last = np.array(goal)
        return np.zeros(3)

    def max_load(self, gravity: float) -> float:
        """Return the maximum of gravity minus acceleration on the path, m/s^2."""
        times = [
            time
            for start, end in zip(self.starts, self.ends, strict=True)
            for time in np.linspace(start, end, _SAMPLES)
        ]
        loads = [self.acceleration(float(time)) + [0.0, 0.0, gravity] for time in times]
        return max(gravity, *(float(np.linalg.norm(load)) for load in loads))
