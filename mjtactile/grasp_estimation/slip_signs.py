"""Signs of slip in one image, relative to the recent ones.

A finger slides if it reports slip, if its slip distance grows, or if it loses shear to the other
fingers at a constant grip. The load remains, so the others take over what a sliding finger loses.
This shows in the first image of a slip, while the slip report needs several. The noise of the hold
itself sets the threshold. Equations: docs/theory/friction.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.signature_checks import validated
from mjtactile.core.types import Array, Touch
from mjtactile.grasp_estimation.touch_statics import GRAVITY, shear

ANSWER_MIN = 0.05
"""Minimum relative change of the grip that the shear answers."""
_ANSWER_TIME = 0.15  # time constant of the mean that a change is relative to, s
# minimum growth of the distance from image to image, m: constant part, and times the relative
# increase of the grip, which drags the surface of a soft object along
_GROWTH = (1e-5, 1e-3)
# minimum shear that a sliding finger loses to the others at a constant grip, relative to the rms of
# recent images
_LOST = 4.5
# an outlier: maximum loss in the first image, as a fraction of the shear; maximum change of the
# shear across the load and of the normal force, as fractions of the loss
_MAX_LOST, _ACROSS, _NORMAL = 0.06, 0.5, 1.0
# utilization of a finger that slides alone, relative to the largest one of those that stick
_LESS_USED = 0.85
_SPREAD_TIME, _SPREAD_MIN = 0.5, 5e-4  # time constant of that rms, s, and its minimum, N
_HELD_TIME = 2.0  # time constant of the largest utilization without slip, s
_REPORT_TIME = 0.15  # duration of a slip report after the slip, s
_FORCE_MIN = 0.05  # minimum mean normal force for an update, N
_LAG = 0.15  # time until a command acts, s: an image, the servo and its play
_STOP = 1e-3  # distance within which a grip stops a sliding object, m

NONE, SOME, ALL, MOVES = range(4)
"""Signs of slip: no finger, some fingers, all fingers report it; a finger moves: its distance
grows, or it loses shear to the others."""


class Signs(NamedTuple):
    """Evidence of one image: mean `press` and `drag`, N, utilizations of the last `_REPORT_TIME`,
    slip distances, m, sign of slip, ages of the reports, s, and relative changes of grip and shear
    (NaN: unknown). `slid`: utilization of the fingers that slide; `speed`: of the slip, m/s;
    `forces`: (n, 3) shear and normal force of each finger, N; `transfer`: shear that moved from
    finger to finger, N."""

    press: float
    drag: float
    recent: list[float]
    distances: list[float]
    slip: int
    ages: list[float]
    harder: float
    more: float
    slid: float = math.nan
    speed: float = 0.0
    forces: Sequence[Sequence[float]] = ()
    transfer: float = 0.0


@dataclass(frozen=True)
class SlipSigns:
    """Recent images, as the signs of the next one need them.

    Attributes:
        press, drag: Recent mean normal force and mean shear per finger, N; 0: unknown.
        recent: Utilizations, shear over normal force, of the last `_REPORT_TIME`: slip is reported
            late.
        distances: Slip distance of each finger, m.
        slip, strongest: Sign of slip in the last image; strongest sign of the present report.
        ages: Time since each finger's last slip report, s.
        held: Recent largest utilization without slip.
        speed, acceleration: Largest speed, m/s, and acceleration, m/s^2, of the slip distances.
        forces: (n, 3) Recent mean shear and normal force of each finger, N; empty: unknown.
        spread: Recent rms of the shear that moves between the fingers, N.
    """

    press: float = 0.0
    drag: float = 0.0
    recent: Sequence[float] = ()
    distances: Sequence[float] = ()
    slip: int = NONE
    strongest: int = NONE
    ages: Sequence[float] = ()
    held: float = 0.0
    speed: float = 0.0
    acceleration: float = 0.0
    forces: Sequence[Sequence[float]] = ()
    spread: float = _SPREAD_MIN

    def signs(
        self, touch: Sequence[Touch], period: float, *, is_hanging: bool = True
    ) -> Signs | None:
        """Return the evidence of an image; None without a known grip force.

        A table takes shear from the fingers as well: its loss counts if the object `is_hanging`.
        """
        normals = [estimate.force_normal for estimate in touch]
        press = float(np.mean(normals))
        forces = np.column_stack([shear(touch), normals])
        shears = np.linalg.norm(forces[:, :2], axis=1)
        drag = float(shears.mean())
        if not (math.isfinite(drag) and press > _FORCE_MIN):
            return None
        count = max(1, round(_REPORT_TIME / period))
        recent = [*self.recent, drag / press][-count:]
        distances = [0.0 if estimate.slip is None else estimate.slip.distance for estimate in touch]
        states = [None if estimate.slip is None else estimate.slip.state for estimate in touch]
        before = self.ages or [1.0] * len(touch)
        ages = [
            0.0 if state == "slipping" else age + period
            for state, age in zip(states, before, strict=True)
        ]
        slip = slip_sign(touch)
        if slip == SOME and max(ages) < _REPORT_TIME:
            slip = ALL  # one after the other
        if min(self.press, self.drag) > 0:
            changes = press / self.press - 1, drag / self.drag - 1
        else:
            changes = math.nan, math.nan
        min_growth = _GROWTH[0] + _GROWTH[1] * np.fmax(changes[0], 0.0)
        pairs = zip(distances, self.distances or distances, strict=True)
        grows = np.array([new - old > min_growth for new, old in pairs])
        slides = np.array([state == "slipping" for state in states])
        utilization = shears / np.maximum(normals, _FORCE_MIN)
        slid, speed = max(recent), 0.0
        if slip == SOME:
            slid = float(utilization[slides].mean())
        moved, loses = self._transfer(forces)
        loses &= is_hanging and abs(changes[0]) < ANSWER_MIN
        moves = (slides & grows) | loses
        if moves.any() and self._may_slide(moves, utilization):
            slip, slid = MOVES, float(utilization[moves].mean())
            speed = max(float(np.subtract(distances, self.distances)[moves].max()) / period, 0.0)
        evidence = (slip, ages, *changes, slid, speed, forces.tolist(), moved)
        return Signs(press, drag, recent, distances, *evidence)

    def _may_slide(self, moves: NDArray[np.bool_], utilization: Array) -> bool:
        """Return True if the fingers that move use most friction, now or in the mean. A finger that
        moves although others use more and stick is turned or rolled over by the object."""
        if moves.all() or len(self.forces) != len(moves):
            return True
        before = np.array(self.forces)
        held = np.linalg.norm(before[:, :2], axis=1) / np.maximum(before[:, 2], _FORCE_MIN)
        used = np.maximum(utilization, held)
        return bool(used[moves].max() > _LESS_USED * used[~moves].max())

    def _transfer(self, forces: Array) -> tuple[float, NDArray[np.bool_]]:
        """Return the shear that moved between the fingers, N, and (n,) if a finger lost it."""
        if len(self.forces) != len(forces):
            return 0.0, np.zeros(len(forces), bool)
        before = np.array(self.forces)
        held = np.linalg.norm(before[:, :2], axis=1)
        x, y = (before[:, :2] / np.maximum(held, 1e-9)[:, None]).T
        change = forces - before
        own = -(x * change[:, 0] + y * change[:, 1])
        lost = own - own.mean()
        loses = (lost > _LOST * self.spread) & (own > 0.5 * lost)
        if self.slip == NONE:
            across = np.abs(x * change[:, 1] - y * change[:, 0])
            loses &= (own < _MAX_LOST * held) & (across < _ACROSS * own)
            loses &= np.abs(change[:, 2]) < _NORMAL * own
        return float(np.abs(lost).max()), loses

    def _spread_after(self, transfer: float, period: float) -> float:
        """Return the rms transfer of shear of the last `_SPREAD_TIME`, N."""
        limited = min(transfer, 3.0 * self.spread)
        follow = min(1.0, period / _SPREAD_TIME)
        square = self.spread**2 + follow * (limited**2 - self.spread**2)
        return max(math.sqrt(square), _SPREAD_MIN)

    @property
    def grows(self) -> bool:
        """True if a finger moved in the last image: its distance grew, or it lost shear."""
        return self.slip == MOVES

    @property
    def inertia(self) -> float:
        """Force over weight that stops the sliding object within `_STOP` once a command acts."""
        speed = self.speed + _LAG * self.acceleration
        return speed**2 / (2 * GRAVITY * _STOP)

    def followed(self, signs: Signs, period: float, *, is_test: bool = False) -> dict[str, Any]:
        """Return the attributes after an image `period` s later, with these signs."""
        follow = min(1.0, period / _ANSWER_TIME) if self.press else 1.0
        held = 0.0 if is_test else self.held * math.exp(-period / _HELD_TIME)
        # one image without the speed of a slip is no stop
        resumes = self.strongest == MOVES and self.slip != MOVES
        if signs.slip == NONE and self.press and not is_test:
            held = max(held, self.drag / self.press)
        return {
            "press": self.press + follow * (signs.press - self.press),
            "drag": self.drag + follow * (signs.drag - self.drag),
            "recent": signs.recent,
            "distances": signs.distances,
            "slip": signs.slip,
            "strongest": max(signs.slip, self.strongest) if signs.slip else NONE,
            "ages": signs.ages,
            "held": held,
            "speed": signs.speed,
            "acceleration": 0.0 if resumes else max(signs.speed - self.speed, 0.0) / period,
            "forces": _mixed(self.forces, signs.forces, follow),
            "spread": self._spread_after(signs.transfer, period),
        }


@validated()
def slip_sign(touch: Sequence[Touch]) -> int:
    """Return `ALL`, `SOME` or `NONE` if all, some or none of the fingers in contact report slip."""
    states = [estimate.slip.state for estimate in touch if estimate.slip is not None]
    slips = [state == "slipping" for state in states if state not in ("none", "unknown")]
    return NONE if not any(slips) else ALL if all(slips) else SOME


def _mixed(
    before: Sequence[Sequence[float]], new: Sequence[Sequence[float]], fraction: float
) -> list[list[float]]:
    """Return the running means after the `new` values; these alone if there are none."""
    old = np.array(before or new)
    return (old + fraction * (np.array(new) - old)).tolist()
