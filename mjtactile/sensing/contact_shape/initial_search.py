"""Search for shapes without a prior.

A ball is lowered until the force matches. Other models start from the shapes fitted so far.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mjtactile.core.types import Array
from mjtactile.quasistatic import MembraneSolution
from mjtactile.quasistatic.solution import AREA
from mjtactile.sensing.contact_shape.fit_state import Data, FitState, Prior, begin, standing
from mjtactile.sensing.contact_shape.forward_model import ForwardModel, converged
from mjtactile.sensing.contact_shape.gauss_newton import Fit, refine
from mjtactile.sensing.contact_shape.primitives import InitialGuess, principal
from mjtactile.sensing.contact_shape.shape_models import ShapeModel

_APPROACH = (1.2, 0.7, 0.3, 0.0)  # heights above the start, mm: the membrane is indented in steps
_WIDE = (0.75, 1.05)  # radius of a start disc relative to a disc with the contact's area
_FORCE_STEPS = 3
_FORCE_NEAR = 0.1  # tolerance relative to the estimated force
_STIFFNESS = (0.05, 0.12, 2.0)  # contact stiffness, N/mm: minimum, first, maximum
_HOPELESS = 120.0  # of the sum of squares over the noise: a family so far behind is not looked for
_FIRST_CURVATURE = 80.0  # 1/m
_ORDER = {"ball": 0, "smooth": 1, "cylinder": 2}  # others later


@dataclass(frozen=True, eq=False)
class Films:
    """Membrane model of one sensor, and the response of its markers to gas. `by_gas` (N,), m, is
    the rise of the marker heights for a relative increase of the gas."""

    fine: ForwardModel
    by_gas: Array


def search(
    films: Films,
    families: Sequence[ShapeModel],
    hint: InitialGuess,
    data: Data,
    noise: float,
    near: MembraneSolution | None = None,
    known: float = math.inf,
) -> list[Fit]:
    """Fit each model without a prior from earlier images. Models that fit much worse than others or
    did not converge are left out. `near` is the membrane solution on another shape, from the
    previous image; a model that does not converge from there is not tried from farther away.
    `known` is the sum of squares of a model that is not among these. Marker variances are
    multiplied by `noise`."""
    found: list[Fit] = []
    for family in sorted(families, key=lambda one: _ORDER.get(one.name, len(_ORDER))):
        one = _best_start(films.fine, family, hint, data, found, noise, near, known)
        if one is not None:
            found.append(one)
    if not found:
        return []
    found = _reuse_curvature(films.fine, hint, data, found, noise)
    minimum = min(one.chi2 for one in found)
    noise = max(noise, minimum / len(data.heights))
    return [one for one in found if one.chi2 <= minimum + _HOPELESS * noise]


def _reuse_curvature(
    forward: ForwardModel, hint: InitialGuess, data: Data, found: list[Fit], noise: float
) -> list[Fit]:
    """Refit the smooth model from the lying cylinder if that special case of it fits better."""
    by_name = {one.family.name: one for one in found}
    smooth, line = (by_name.get(name) for name in ("smooth", "cylinder"))
    if smooth is None or line is None or line.chi2 > smooth.chi2:
        return found
    maximum, direction = line.theta[3:5]
    across = np.array([math.sin(direction), -math.cos(direction)])
    bent = maximum * np.outer(across, across)
    theta = np.array([*line.theta[:3], bent[0, 0], bent[0, 1], bent[1, 1]])
    at = begin(forward, smooth.family, hint, theta, data, smooth.prior, line.state)
    if at is None or at.cost > smooth.at.cost:
        return found
    minimum = min(one.chi2 for one in found)
    other = refine(forward, smooth.family, hint, at, data, smooth.prior, known=minimum, noise=noise)
    return [other if one is smooth else one for one in found]


def _best_start(
    forward: ForwardModel,
    family: ShapeModel,
    hint: InitialGuess,
    data: Data,
    known: Sequence[Fit],
    noise: float,
    near: MembraneSolution | None,
    minimum: float,
) -> Fit | None:
    """Fit a model from the start that explains the markers best after matching the force."""
    reached = []
    state = min(known, key=lambda one: one.chi2).state if known else near
    for start in _starts(family, hint, known, _Pressed.of(forward, state)):
        prior = Prior.of(family, start)
        at = beside(forward, family, hint, start, data, prior, state)
        if at is None and (near is None or family.parts):
            at = approach(forward, family, hint, start, data, prior)
        if at is not None:
            reached.append((at, prior))
    if not reached:
        return None
    reached.sort(key=lambda one: one[0].cost)
    if not family.parts:
        del reached[1:]  # with several parts, different starts may converge to different fits
    minimum = min([minimum, *(one.chi2 for one in known)])
    fits = [
        refine(forward, family, hint, at, data, prior, known=minimum, noise=noise)
        for at, prior in reached
    ]
    return min(fits, key=lambda one: one.at.cost)


def _starts(
    family: ShapeModel, hint: InitialGuess, known: Sequence[Fit], pressed: _Pressed | None
) -> Sequence[Array]:
    """Return start parameters of a model. Usually they are the model's own, moved to the contact of
    the other shape and scaled to its size. A model related to another (ball, smooth, cylinder)
    starts from that model's fit."""
    if family.parts:
        return family.starts(hint)
    by_name = {one.family.name: one.theta for one in known}
    if family.name == "ball":
        return (np.array([0.0, 0.0, 0.0, _FIRST_CURVATURE]),)
    if family.name == "smooth" and "ball" in by_name:
        theta = by_name["ball"]
        return (np.array([*theta[:4], 0.0, theta[3]]),)
    if family.name == "cylinder" and "smooth" in by_name:
        theta = by_name["smooth"]
        maximum, _, direction = principal(theta)
        return (np.array([*theta[:3], maximum, direction, 0.0]),)
    if pressed is None:
        return family.starts(hint)
    x, y = 1e3 * (pressed.middle - hint.place)
    radius = 1e3 * math.sqrt(pressed.area / math.pi)
    if family.name == "disc":
        return tuple(np.array([x, y, 0, 0, 0, share * radius]) for share in _WIDE)
    if family.name == "block":
        half = math.sqrt(math.pi) / 2 * radius
        turned = hint.angle + math.pi / 4
        return (
            np.array([x, y, 0, 0, 0, pressed.angle, *1e3 * pressed.halves]),
            np.array([x, y, 0, 0, 0, turned, half, half]),
        )
    return tuple(np.array([x, y, *start[2:]]) for start in family.starts(hint))


@dataclass(frozen=True, eq=False)
class _Pressed:
    """Contact region of a membrane solution. It holds the center `middle` (2,), m, and `area`, m^2.
    `angle` is that of the longer axis, rad. The half-extents (2,), m, are those of a rectangle with
    the same force spread."""

    middle: Array
    area: float
    angle: float
    halves: Array

    @classmethod
    def of(cls, forward: ForwardModel, state: MembraneSolution | None) -> _Pressed | None:
        """Compute the contact region of a membrane solution; None without contact."""
        if state is None or not (state.force > 0).any():
            return None
        force, x, y = _pressing(forward, state)
        share = force / force.sum()
        middle = np.array([share @ x, share @ y])
        off = np.array([x - middle[0], y - middle[1]])
        spread, axes = np.linalg.eigh((off * share) @ off.T)
        wide = np.sqrt(3 * np.maximum(spread[::-1], forward.spacing**2 / 3))
        return cls(middle, float(state.found[AREA]), math.atan2(axes[1, 1], axes[0, 1]), wide)


def _pressing(forward: ForwardModel, state: MembraneSolution) -> tuple[Array, Array, Array]:
    """Return force (n,), N, and positions x and y (n,), m, of the touching nodes."""
    touching = state.force > 0
    x, y = (
        nodes[touching] + moved[touching]
        for nodes, moved in zip(forward.nodes, state.x[:2], strict=True)
    )
    return state.force[touching], x, y


def beside(
    forward: ForwardModel,
    family: ShapeModel,
    hint: InitialGuess,
    start: Array,
    data: Data,
    prior: Prior,
    state: MembraneSolution | None,
) -> FitState | None:
    """Replace a shape, with membrane solution `state`, by another one at the same position. First
    choose its height so that the contact forces do no work on the change. Then adjust it to the
    force. Return the start state of a fit; None: the solver did not converge."""
    if state is None or family.parts or not (state.force > 0).any():
        return None
    force, x, y = _pressing(forward, state)
    theta = np.clip(start, family.low, family.high)
    heights = forward.film.obstacle_heights(family.build(theta, hint), np.column_stack([x, y]))
    there = np.isfinite(heights)
    if not there.any():
        return None
    off = (force * (state.x[2][state.force > 0] - heights))[there].sum() / force[there].sum()
    theta[2] += 1e3 * off
    theta = np.clip(theta, family.low, family.high)
    batch = forward.solve([family.build(theta, hint)], state)
    if not converged(batch):
        return None
    reached = (theta, batch[0], batch[0].force_normal)
    return _to_force(forward, family, hint, reached, data, prior)


def approach(
    forward: ForwardModel,
    family: ShapeModel,
    hint: InitialGuess,
    start: Array,
    data: Data,
    prior: Prior,
) -> FitState | None:
    """Lower a shape from about the height of first contact into the membrane until its force
    matches the estimated force. Return the start state of a fit; None: the solver did not
    converge."""
    theta = np.clip(start, family.low, family.high)
    heights = family.heights
    state = None
    force = 0.0
    reached = theta
    for above in _APPROACH:
        trial = theta.copy()
        trial[heights] += above
        batch = forward.solve([family.build(trial, hint)], state)
        if not converged(batch):
            break
        state = batch[0]
        reached = trial
        force = state.force_normal
        if force > data.force:
            break
    if state is None:
        return None
    return _to_force(forward, family, hint, (reached, state, force), data, prior)


def _to_force(
    forward: ForwardModel,
    family: ShapeModel,
    hint: InitialGuess,
    reached: tuple[Array, MembraneSolution, float],
    data: Data,
    prior: Prior,
) -> FitState | None:
    theta, state, force = reached
    heights = family.heights
    stiffness = _STIFFNESS[1] * len(heights)
    for _ in range(_FORCE_STEPS):
        if abs(force - data.force) < _FORCE_NEAR * data.force:
            break
        down = float(np.clip((data.force - force) / stiffness, -0.5, 0.5))
        trial = theta.copy()
        trial[heights] -= down
        trial = np.clip(trial, family.low, family.high)
        batch = forward.solve([family.build(trial, hint)], state)
        if not converged(batch):
            break
        theta = trial
        state = batch[0]
        before = force
        force = state.force_normal
        if abs(down) > 1e-6:
            stiffness = float(np.clip((force - before) / down, _STIFFNESS[0], _STIFFNESS[2]))
    return standing(forward, family, theta, data, prior, state)
