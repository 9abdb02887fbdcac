"""Properties of the grasped object from touch: mass, friction, loads, external support.

The friction is a coefficient, and the load is per finger. External support or pull comes from a
table or a person.

Pure functions of touches, for any controller and any number of fingers; N, kg, m/s^2. A finger
measures the force on its membrane in its own frame S. The direction of gravity is unknown and not
needed. The fingers alone carry a hanging object, in parallel contact planes. For tips inclined by
an angle, the shear is underestimated by the cosine of that angle.

    found = estimate_weight(touch)                # lifted: 0.0602 kg +- 0.0014
    grip = min_grip_force(found.mass, friction=0.6, fingers=2)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from mjtactile.core.errors import InputError
from mjtactile.core.signature_checks import not_below, validated
from mjtactile.core.types import Array, Touch

_TABLE_FORCE = 0.03  # noise of the load on all fingers, N
GRAVITY = 9.81  # acceleration of gravity, m/s^2
GAIN_SD = 0.015
"""Relative error (sd) of a measured shear force, in addition to noise.

It is the residual of stiffness and geometry after a calibration (docs/validation/accuracy.md).
"""

_HALF_TURN = np.array([-1.0, 1.0])


@dataclass(frozen=True, eq=False)
class Weight:
    """Weight of the object in a grip.

    Attributes:
        mass: Mass, kg; NaN if a force is unknown.
        sd: Its standard deviation, kg.
        load: (n,) Load on each finger, N.
        share: (n,) Load on each finger as a fraction of the total.
    """

    mass: float
    sd: float
    load: Array
    fraction: Array


@dataclass(frozen=True, eq=False)
class Friction:
    """Friction between object and membranes at one time.

    Attributes:
        used: (n,) Shear over normal force of each finger, as used for slip; NaN without contact.
        sd: (n,) Standard deviations.
        minimum: Lower bound of the coefficient: the largest ratio of a finger without slip, minus
            two of its sd; 0 if there is none.
        slipped: Coefficient from slipping fingers: the smallest ratio among them. NaN: no slip.
    """

    used: Array
    sd: Array
    minimum: float
    slipped: float


@validated()
def shear(touch: Sequence[Touch]) -> Array:
    """Return the shear force on each finger's membrane.

    Args:
        touch: One value per finger.

    Returns:
        (n, 2) Force, N, in each finger's frame S; NaN if it is unknown.
    """
    return np.array([_wrench(estimate)[:2] for estimate in touch]).reshape(-1, 2)


@validated()
def external_shear(touch: Sequence[Touch]) -> Array:
    """Return the shear of each finger without the internal forces of two opposite fingers.

    A box that stands askew is sheared by the closing fingers in opposite directions, and more so
    with a stronger grip. This is not a load. The y axes of both frames S must have the same
    direction (docs/reference/rig_files.md): each frame is the other one after a half turn about y.

    Args:
        touch: One value per finger.

    Returns:
        (n, 2) Half of the external force, N, in each finger's frame S. For more than two fingers,
        or one, the shear.
    """
    found = shear(touch)
    return (found + _HALF_TURN * found[::-1]) / 2 if len(touch) == 2 else found


@validated()
def estimate_weight(
    touch: Sequence[Touch], before: ArrayLike = 0.0, *, acceleration: float = 0.0
) -> Weight:
    """Estimate the mass of a lifted object: sum of shears = m (g + a).

    Args:
        touch: Touches while the fingers alone carry the object.
        before: (n, 2) `shear` present without this load and still present, N: that of the first
            weight, if something was added. Shear held by friction of the table disappears with the
            table.
        acceleration: Acceleration of the gripper, m/s^2, positive upward.

    Returns:
        The weight, with its error from the forces' covariances and `GAIN_SD`.
    """
    change = shear(touch) - _per_finger(before, touch, "before")
    load = np.linalg.norm(change, axis=1)
    total = float(load.sum())
    pull = GRAVITY + acceleration
    if not math.isfinite(total) or pull <= 0:
        unknown = np.full(len(touch), np.nan)
        return Weight(math.nan, math.nan, unknown, unknown)
    along = change / np.maximum(load, 1e-9)[:, None]
    noise = sum(
        float(direction @ _covariance(estimate) @ direction)
        for estimate, direction in zip(touch, along, strict=True)
    )
    moments = 1 + bool(np.any(before))
    sd = math.sqrt(moments * noise + (GAIN_SD * total) ** 2)
    return Weight(total / pull, sd / pull, load, load / max(total, 1e-9))


@validated(min_force=not_below(0))
def estimate_friction(touch: Sequence[Touch], *, min_force: float = 0.1) -> Friction:
    """Estimate friction from the shears: a hold gives a lower bound, a slip the value (Coulomb).

    Args:
        touch: One value per finger.
        min_force: Minimum normal force of a finger, N. Below it the finger is ignored.

    Returns:
        The estimate from this moment alone.
    """
    force = np.array([_wrench(estimate)[:3] for estimate in touch]).reshape(-1, 3)
    normal = -force[:, 2]
    presses = normal > min_force
    used = np.where(
        presses, np.linalg.norm(force[:, :2], axis=1) / np.maximum(normal, 1e-9), np.nan
    )
    noise = np.array([math.sqrt(np.trace(_covariance(estimate))) for estimate in touch])
    sd = np.where(presses, np.hypot(noise / np.maximum(normal, 1e-9), GAIN_SD * used), np.nan)
    states = ["unknown" if estimate.slip is None else estimate.slip.state for estimate in touch]
    slips = np.array([state == "slipping" for state in states], bool) & presses
    holds = np.array([state in ("sticking", "incipient") for state in states], bool) & presses
    minimum = float(np.max((used - 2 * sd)[holds], initial=0.0))
    slipped = float(np.min(used[slips])) if slips.any() else math.nan
    return Friction(used, sd, minimum, slipped)


@validated(fingers=not_below(1))
def min_grip_force(
    mass: float, friction: float, fingers: int, *, acceleration: float = 0.0
) -> float:
    """Return the minimum grip force of each finger: n mu N >= m |g + a|.

    Args:
        mass: Mass, kg.
        friction: Coefficient.
        fingers: Number of fingers.
        acceleration: Acceleration of the gripper, m/s^2, in any direction (upward, the worst case,
            is assumed).

    Returns:
        Mean force of the fingers, N, for a grip at the center of mass.

    Raises:
        InputError: The coefficient is not positive.
    """
    if friction <= 0:
        text = f"{friction:g} is not above 0"
        raise InputError(text, source="min_grip_force", field="friction")
    return mass * (GRAVITY + abs(acceleration)) / (fingers * friction)


@validated()
def stands(carried: float, held: float) -> bool:
    """Decide if an object that is lowered stands: the table carries more than half of its weight.

    Args:
        carried: Present load on all fingers, along that of the hanging object, N.
        held: Load on all fingers while the object hung on them, N.

    Returns:
        True if the load has decreased below half by more than its noise; False if it is unknown.
    """
    return carried < 0.5 * held - _TABLE_FORCE


@validated()
def support_force(touch: Sequence[Touch], held: ArrayLike) -> float:
    """Return the external support against the load of the fingers, such as the table during
    lowering.

    While the table takes over, the shear of the load decreases to zero. It then grows in the
    opposite direction. A value of 0 or below means that the table carries at most the weight of the
    object.

    Args:
        touch: Current touches.
        held: (n, 2) `shear` while the object hung on the fingers, N.

    Returns:
        Support beyond the object's weight, N on each finger; NaN if it is unknown.
    """
    before = _per_finger(held, touch, "held")
    gone = np.linalg.norm(shear(touch) - before, axis=1)
    return float(np.mean(gone - np.linalg.norm(before, axis=1)))


@validated()
def load_direction(touch: Sequence[Touch]) -> Array:
    """Estimate the direction of the load on each finger.

    Args:
        touch: Touches while the object hangs on the fingers without a tilting moment.

    Returns:
        (n, 2) Unit vectors, each in its finger's frame S; NaN if unknown.
    """
    change = external_shear(touch)
    return change / np.maximum(np.linalg.norm(change, axis=1), 1e-9)[:, None]


@validated()
def load_vector(touch: Sequence[Touch], down: ArrayLike) -> Array:
    """Return the external force on the held object, without internal forces between the fingers.

    A tilted object loads one finger upward and the other downward, and more so with a stronger
    grip. This is not a load and cancels here.

    Args:
        touch: Current touches.
        down: (n, 2) Directions from `downward`.

    Returns:
        (3,) Force, N: downward; for two opposite fingers also across (sideways along both) and
        through (from the second to the first). The latter two are 0 for more than two fingers,
        which hold them by normal forces.
    """
    change = shear(touch)
    direction = _per_finger(down, touch, "down")
    along = float((change * direction).sum())
    if len(touch) != 2:
        return np.array([along, 0.0, 0.0])
    side = change[:, 1] * direction[:, 0] - change[:, 0] * direction[:, 1]
    press = [estimate.force_normal for estimate in touch]
    # opposite fingers see mirrored sideways directions, so the difference adds the two shears
    return np.array([along, float(side[0] - side[1]), float(press[0] - press[1])])


@validated()
def pull_force(touch: Sequence[Touch], held: ArrayLike) -> float:
    """Return the external pull on the held object along the membranes, for example by a person.

    Args:
        touch: Current touches.
        held: (n, 2) `shear` without the pull, N.

    Returns:
        Sum over all fingers, N; NaN if it is unknown.
    """
    return float(np.linalg.norm(shear(touch) - _per_finger(held, touch, "held"), axis=1).sum())


def _per_finger(values: ArrayLike, touch: Sequence[Touch], field: str) -> Array:
    """Return values (n, 2) of the fingers. Raises InputError naming `field`."""
    found = np.asarray(values, float)
    shape = (len(touch), 2)
    try:
        return np.broadcast_to(found, shape)
    except ValueError:
        raise InputError(f"shape {found.shape} does not match {shape}", field=field) from None


def _wrench(touch: Touch) -> Array:
    known = touch.traction is not None and math.isfinite(touch.force_normal)
    return touch.traction.wrench if known and touch.traction is not None else np.full(6, np.nan)


def _covariance(touch: Touch) -> Array:
    """Return the covariance (2, 2) of the shear force, N^2."""
    return np.zeros((2, 2)) if touch.traction is None else touch.traction.wrench_cov[:2, :2]
