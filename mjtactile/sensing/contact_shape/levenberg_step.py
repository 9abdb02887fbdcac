"""A step of a fit (docs/theory/contact_shape.md, Eq. F18)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array
from mjtactile.sensing.contact_shape.fit_state import FitState, Prior
from mjtactile.sensing.contact_shape.shape_models import ShapeModel

# mm and rad that a step may go at most, and shares of a curvature (1/m, of what is as flat as that
# at least) and of a size
_STRAIGHT = {
    "x": 1.5, "y": 1.5, "z": 0.5, "tilt": 0.1, "lean": 0.1, "direction": 0.35, "angle": 0.35,
}  # fmt: skip
_BEND_STEP = 0.6
_FLAT = 40.0
_SIZE_STEP = 0.25


@dataclass(frozen=True, eq=False)
class Step:
    """A step `by` (k,), of numbers over their sd, and by how much it should lower the cost; `cut`:
    more of it would lower it more."""

    by: Array
    promised: float
    cut: bool


def damped_step(J: Array, at: FitState, family: ShapeModel, prior: Prior, damping: float) -> Step:
    """One damped Gauss-Newton step.

    Args:
        J: (n, k) of the whitened markers by the numbers over their sd.
        at: Where from.
        family: The family.
        prior: What is believed.
        damping: Levenberg's, as a share of the curvature.

    Returns:
        The step, no number of it farther than a film's answer is about straight.
    """
    gradient = J.T @ at.residual + prior.precision @ (at.theta / family.sd - prior.mean)
    normal = J.T @ J
    H = normal + prior.precision + damping * np.diag(np.diag(normal) + 1e-3)
    step = -np.linalg.solve(H, gradient)
    most = _straight(family, at.theta) / family.sd
    far = np.abs(step) > most
    cut = bool(far.any())
    if cut:
        step = _within(H, gradient, step, most, far)
    return Step(step, float(-(2 * gradient + H @ step) @ step), cut)


def _within(H: Array, gradient: Array, step: Array, most: Array, far: NDArray[np.bool_]) -> Array:
    """A step of which numbers that would go too `far` go as far as they may, and the others make
    the best of that; shorter as a whole, where that makes others go too far."""
    held = step.copy()
    held[far] = np.clip(step, -most, most)[far]
    near = ~far
    asked = gradient[near] + H[np.ix_(near, far)] @ held[far]
    held[near] = -np.linalg.solve(H[np.ix_(near, near)], asked)
    falls = (2 * gradient + H @ held) @ held < 0
    if falls and (np.abs(held) <= most).all():
        return held
    return step * float((most / np.maximum(np.abs(step), 1e-12)).min())


def _straight(family: ShapeModel, theta: Array) -> Array:
    """How far (k,) each number may go at once."""
    bent = [abs(value) for value, name in zip(theta, family.names, strict=True) if name[0] == "k"]
    curved = _BEND_STEP * max([_FLAT, *bent])
    most = []
    for value, name in zip(theta, family.names, strict=True):
        kind = name.split("_")[0]
        if kind == "k":
            most.append(curved)
        elif kind in ("half", "radius"):
            most.append(_SIZE_STEP * value)
        else:
            most.append(_STRAIGHT[kind])
    return np.array(most)
