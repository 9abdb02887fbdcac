"""What a hand can know of the thing that it holds, from what its fingers feel: what it weighs, how
rough it is, who carries how much, and whether the table or somebody else has a hand in it.

Pure functions of touches, for any controller and any number of fingers; N, kg, m/s^2. A finger
feels the force on its membrane in its own frame S and does not know which way is down. It need not:
what hangs in the air hangs on the fingers alone, and these share it in parallel planes (for tips
that are inclined by an angle, what is felt along them is too small by the angle's cosine).

    found = weigh(touch)                # lifted: 0.0602 kg +- 0.0014
    grip = min_grip_force(found.mass, friction=0.6, fingers=2)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core.types import Array, Touch

GRAVITY = 9.81  # m/s^2
GAIN_SD = 0.015
"""Of a felt shear force, beside its noise: what is left of stiffness and geometry after a
calibration (docs/validation/accuracy.md)."""


@dataclass(frozen=True, eq=False)
class Weight:
    """What hangs on a grip.

    Attributes:
        mass: kg; NaN where a force is unknown.
        sd: Its standard deviation, kg.
        load: (n,) N, what each finger carries of it.
        share: (n,) the same as shares of the whole.
    """

    mass: float
    sd: float
    load: Array
    share: Array


@dataclass(frozen=True, eq=False)
class Friction:
    """What a moment says of the friction between object and membranes.

    Attributes:
        used: (n,) shear over normal force of each finger, as slip sees it; NaN where nothing
            presses.
        sd: (n,) standard deviations.
        least: The coefficient is at least this: the largest ratio that a finger holds without
            slipping, less two of its sd; 0 where none says anything.
        slipped: The coefficient itself, where fingers slip: the smallest ratio among them. NaN:
            none does.
    """

    used: Array
    sd: Array
    least: float
    slipped: float


def shear(touch: Sequence[Touch]) -> Array:
    """Say what each finger feels along its membrane.

    Args:
        touch: One value a finger.

    Returns:
        (n, 2) N in each finger's frame S; NaN where it is unknown.
    """
    return np.array([_wrench(one)[:2] for one in touch])


def weigh(touch: Sequence[Touch], before: ArrayLike = 0.0, *, acceleration: float = 0.0) -> Weight:
    """Weigh what was lifted: sum of shears = m (g + a).

    Args:
        touch: While the object hangs on the fingers alone.
        before: (n, 2) N, `shear` that was there without the load and still is: the first weight's
            where something was added. What the table's friction held before goes with the table.
        acceleration: Of the hand, m/s^2, positive upward.

    Returns:
        The weight, with its error from the forces' covariances and `GAIN_SD`.
    """
    change = shear(touch) - np.asarray(before, float)
    load = np.linalg.norm(change, axis=1)
    total = float(load.sum())
    pull = GRAVITY + acceleration
    if not math.isfinite(total) or pull <= 0:
        unknown = np.full(len(touch), np.nan)
        return Weight(math.nan, math.nan, unknown, unknown)
    along = change / np.maximum(load, 1e-9)[:, None]
    noise = sum(float(way @ _covariance(one) @ way) for one, way in zip(touch, along, strict=True))
    moments = 1 + bool(np.any(before))
    sd = math.sqrt(moments * noise + (GAIN_SD * total) ** 2)
    return Weight(total / pull, sd / pull, load, load / max(total, 1e-9))


def friction(touch: Sequence[Touch], *, min_force: float = 0.1) -> Friction:
    """Say what the shears say of friction: a hold shows that there is more, a slip what it is
    (Coulomb).

    Args:
        touch: One value a finger.
        min_force: N; a finger that presses with less says nothing.

    Returns:
        What is known from this moment alone.
    """
    force = np.array([_wrench(one)[:3] for one in touch])
    normal = -force[:, 2]
    presses = normal > min_force
    used = np.where(
        presses, np.linalg.norm(force[:, :2], axis=1) / np.maximum(normal, 1e-9), np.nan
    )
    noise = np.array([math.sqrt(np.trace(_covariance(one))) for one in touch])
    sd = np.where(presses, np.hypot(noise / np.maximum(normal, 1e-9), GAIN_SD * used), np.nan)
    states = ["unknown" if one.slip is None else one.slip.state for one in touch]
    slips = np.array([state == "slipping" for state in states]) & presses
    holds = np.array([state in ("sticking", "incipient") for state in states]) & presses
    least = float(np.max((used - 2 * sd)[holds], initial=0.0))
    slipped = float(np.min(used[slips])) if slips.any() else math.nan
    return Friction(used, sd, least, slipped)


def min_grip_force(
    mass: float, friction: float, fingers: int, *, acceleration: float = 0.0
) -> float:
    """Say what each finger must press with at least: n mu N >= m |g + a|.

    Args:
        mass: kg.
        friction: Coefficient.
        fingers: How many share it.
        acceleration: Of the hand, m/s^2, in any direction (the worst, upward, is taken).

    Returns:
        N, the mean of the fingers, for a grip at the centre of mass.
    """
    return mass * (GRAVITY + abs(acceleration)) / (fingers * friction)


def support(touch: Sequence[Touch], held: ArrayLike) -> float:
    """Say how hard something pushes back against the load that the fingers carried: the table, on
    the way down.

    As it takes over, the shear that the load made goes, and then comes again from the other side,
    whichever side that is. Less than the load's own going (0 or below) is a table that carries
    not more than the object.

    Args:
        touch: Now.
        held: (n, 2) N, `shear` while the object hung on the fingers.

    Returns:
        N on each finger, beyond what it held; NaN where that is unknown.
    """
    before = np.asarray(held, float)
    gone = np.linalg.norm(shear(touch) - before, axis=1)
    return float(np.mean(gone - np.linalg.norm(before, axis=1)))


def downward(touch: Sequence[Touch], before: ArrayLike = 0.0) -> Array:
    """Find where the load drags each finger.

    Args:
        touch: While the object hangs on the fingers, and does not lean in them yet.
        before: (n, 2) N, `shear` that was there without the load and still is.

    Returns:
        (n, 2) unit vectors, each in its finger's frame S; NaN where that is unknown.
    """
    change = shear(touch) - np.asarray(before, float)
    return change / np.maximum(np.linalg.norm(change, axis=1), 1e-9)[:, None]


def load_vector(touch: Sequence[Touch], down: ArrayLike) -> Array:
    """Say with how much the world pulls at what is held, as far as the fingers can tell it from
    what they do to each other: a thing that leans in the grip drags one finger up and the other
    down, and the more so the harder it is gripped; that is no load, and cancels here.

    Args:
        touch: Now.
        down: (n, 2), as of `downward`.

    Returns:
        (3,) N: downward; of two fingers that face each other also across (sideways along both) and
            through (from the second to the first), which are 0 of more than two: those hold that
            by pressing.
    """
    change = shear(touch)
    way = np.asarray(down, float)
    along = float((change * way).sum())
    if len(touch) != 2:
        return np.array([along, 0.0, 0.0])
    side = change[:, 1] * way[:, 0] - change[:, 0] * way[:, 1]
    press = [one.force_normal for one in touch]
    # seen from outside, left of down is right of down for who faces it
    return np.array([along, float(side[0] - side[1]), float(press[0] - press[1])])


def pull(touch: Sequence[Touch], held: ArrayLike) -> float:
    """Say how hard somebody else pulls at what is held, along the membranes.

    Args:
        touch: Now.
        held: (n, 2) N, `shear` while nobody did.

    Returns:
        N, over all fingers; NaN where that is unknown.
    """
    return float(np.linalg.norm(shear(touch) - np.asarray(held, float), axis=1).sum())


def _wrench(touch: Touch) -> Array:
    known = touch.traction is not None and math.isfinite(touch.force_normal)
    return touch.traction.wrench if known and touch.traction is not None else np.full(6, np.nan)


def _covariance(touch: Touch) -> Array:
    """(2, 2) N^2 of the shear."""
    return np.zeros((2, 2)) if touch.traction is None else touch.traction.wrench_cov[:2, :2]
