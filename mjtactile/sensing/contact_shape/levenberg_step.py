"""A step of a fit (docs/theory/contact_shape.md, Eq. F18)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mjtactile.core.types import Array
from mjtactile.sensing.contact_shape.fit_state import FitState, Prior
from mjtactile.sensing.contact_shape.shape_models import ShapeModel

# Maximum steps: mm and rad, and fractions of a curvature (at least `_FLAT`, 1/m) and of a size
_STRAIGHT = {
    "x": 1.5, "y": 1.5, "z": 0.5, "tilt": 0.1, "lean": 0.1, "direction": 0.35, "angle": 0.35,
}  # fmt: skip
_BEND_STEP = 0.6
_FLAT = 40.0
_SIZE_STEP = 0.25


@dataclass(frozen=True, eq=False)
class Step:
    """Step `by` (k,) of the scaled parameters, with the predicted decrease of the cost. `cut` is
    True if the step was limited."""

    by: Array
    promised: float
    cut: bool


def damped_step(J: Array, at: FitState, family: ShapeModel, prior: Prior, damping: float) -> Step:
    """Compute one damped Gauss-Newton step with the Jacobian (n, k) of the whitened markers by the
    scaled parameters. It is limited per parameter to the range where the membrane responds about
    linearly."""
    gradient = J.T @ at.residual + prior.precision @ (at.theta / family.sd - prior.mean)
    normal = J.T @ J
    H = normal + prior.precision + damping * np.diag(np.diag(normal) + 1e-3)
    step = -np.linalg.solve(H, gradient)
    maximum = _straight(family, at.theta) / family.sd
    far = np.abs(step) > maximum
    cut = bool(far.any())
    if cut:
        step = _within(H, gradient, step, maximum, far)
    return Step(step, float(-(2 * gradient + H @ step) @ step), cut)


def _within(
    H: Array, gradient: Array, step: Array, maximum: Array, far: NDArray[np.bool_]
) -> Array:
    """Return a step within its limits. Parameters that would go too `far` are held at their limit,
    and the others are solved again. If these then exceed their limits, the whole step is
    shortened."""
    held = step.copy()
    held[far] = np.clip(step, -maximum, maximum)[far]
    near = ~far
    asked = gradient[near] + H[np.ix_(near, far)] @ held[far]
    held[near] = -np.linalg.solve(H[np.ix_(near, near)], asked)
    falls = (2 * gradient + H @ held) @ held < 0
    if falls and (np.abs(held) <= maximum).all():
        return held
    return step * float((maximum / np.maximum(np.abs(step), 1e-12)).min())


def _straight(family: ShapeModel, theta: Array) -> Array:
    """Return the maximum step (k,) of each parameter."""
    bent = [abs(value) for value, name in zip(theta, family.names, strict=True) if name[0] == "k"]
    curved = _BEND_STEP * max([_FLAT, *bent])
    maximum = []
    for value, name in zip(theta, family.names, strict=True):
        kind = name.split("_")[0]
        if kind == "k":
            maximum.append(curved)
        elif kind in ("half", "radius"):
            maximum.append(_SIZE_STEP * value)
        else:
            maximum.append(_STRAIGHT[kind])
    return np.array(maximum)
